"""Run bsk_rl's tests and examples on ``bsk_torch.bsk_rl``, with nothing but the packages' names in their imports replaced.

The source distribution of bsk_rl 1.3.8 is downloaded from the package index; ``--source`` takes an unpacked one.

Examples:
    python scripts/validation/upstream.py tests
    python scripts/validation/upstream.py examples
"""

from __future__ import annotations

import argparse
import collections
import json
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

VERSION = "1.3.8"

RETRIES = 5
"""Repetitions of flaky tests, as in bsk_rl."""

RAY = "needs Ray"
INSIDE = "builds modules of Basilisk"
CHANGES = "changes modules of Basilisk during an episode"
VERSIONS = "reads the versions of the packages bsk_rl and bsk"

LEFT_OUT = {
    "space_to_space_rso_imaging_demo": VERSIONS,
    "space_to_space_rso_imaging_evaluation": VERSIONS,
    "async_multiagent_training": RAY,
    "curriculum_learning": RAY,
    "rllib_training": RAY,
    "time_discounted_gae": RAY,
    "training_with_shield": RAY,
    "fault_environment": INSIDE,
}
"""Examples that do not run, with the reason."""

RSO, EXAMPLE = "test_int_rso_imaging_env.py", "test_int_space_to_space_imaging_example.py"
TESTS_LEFT_OUT = {
    f"{RSO}::test_real_access_interruption_resets_only_continuous_hold[continuous]": CHANGES,
    f"{RSO}::test_real_access_interruption_resets_only_continuous_hold[cumulative]": CHANGES,
    f"{RSO}::test_real_illumination_and_capacity_block_storage": CHANGES,
    f"{RSO}::test_spacecraft_imaging_runs_without_ground_stations": INSIDE,
    f"{RSO}::test_public_example_and_manifest_replay": VERSIONS,
    f"{RSO}::test_evaluation_physical_products_reward_and_replay": VERSIONS,
    f"{RSO}::test_evaluation_plots_and_step_budget": VERSIONS,
    f"{EXAMPLE}::test_unpinned_catalog_manifest_records_the_realized_epoch_and_replays": VERSIONS,
    f"{EXAMPLE}::test_manifest_does_not_attribute_an_untracked_package_to_enclosing_git_head": VERSIONS,
}
"""Tests that do not run, with the reason."""

IMPORTS = re.compile(r"^(\s*)(from|import) (bsk_rl|Basilisk)\b", re.MULTILINE)

OTHERS = re.compile(r"(import|from) ray\b|\bray\.|vizard_dir|version\(.ray.\)|\.rllib|RLModule")
"""What cells of notebooks are left out by: they train with Ray, read its policies, or make films for Vizard."""

PLACES = {"bsk_rl": "bsk_torch.bsk_rl", "Basilisk": "bsk_torch.bsk_rl.basilisk"}
"""Packages that take the place of bsk_rl and of the few things that its examples import of Basilisk."""


def source(folder: Path) -> Path:
    """Download and unpack the source distribution; return its root."""
    command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--no-binary", ":all:", f"bsk-rl=={VERSION}"]
    subprocess.run([*command, "-d", str(folder)], check=True)
    with tarfile.open(next(folder.glob("*.tar.gz"))) as archive:
        archive.extractall(folder, filter="data")
    return folder / f"bsk_rl-{VERSION}"


def replaced(text: str) -> str:
    """Return a program with the packages' names replaced in its imports."""
    return IMPORTS.sub(lambda found: f"{found[1]}{found[2]} {PLACES[found[3]]}", text)


def run_tests(root: Path, folder: Path) -> dict[str, dict[str, int]]:
    """Run the integration tests; return the number of outcomes by file."""
    for path in (root / "tests" / "integration").rglob("*.py"):
        target = folder / path.relative_to(root / "tests")
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(replaced(path.read_text()))
    for path in (root / "examples").glob("*.py"):  # which tests read in the folder above theirs
        target = folder.parent / "examples" / path.name
        target.parent.mkdir(exist_ok=True)
        target.write_text(replaced(path.read_text()))
    (folder / "pytest.ini").write_text("[pytest]\nmarkers =\n  flaky\n  repeat\n")
    outcomes = run_pytest(folder, [])
    for _ in range(RETRIES):  # tests that bsk_rl marks as flaky draw random episodes, and are repeated there as well
        if "failure" not in outcomes.values():
            break
        outcomes |= run_pytest(folder, ["-m", "flaky", "--last-failed", "--last-failed-no-failures", "none"])
    found: dict[str, dict[str, int]] = collections.defaultdict(lambda: collections.defaultdict(int))
    for (module, _), outcome in outcomes.items():
        found[f"{module}.py"][outcome] += 1
    return found


def run_pytest(folder: Path, options: list[str]) -> dict[tuple[str, str], str]:
    """Run pytest in a folder; return the outcome of each test by its module and name."""
    report = folder / "report.xml"
    left_out = [f"--deselect=integration/{name}" for name in TESTS_LEFT_OUT]
    command = [sys.executable, "-m", "pytest", "-q", f"--junitxml={report}", *left_out, *options, "integration"]
    subprocess.run(command, cwd=folder, check=False)
    outcomes = {}
    for case in ElementTree.parse(report).iter("testcase"):
        outcome = next((part.tag for part in case if part.tag in ("failure", "error", "skipped")), "passed")
        module = next(part for part in case.attrib["classname"].split(".") if part.startswith("test_"))
        outcomes[module, f"{case.attrib['classname']}::{case.attrib['name']}"] = outcome
    return outcomes


def cells(notebook: Path) -> str:
    """Return the code of a notebook as a script, without cells for Ray and Vizard."""
    every = ("".join(c["source"]) for c in json.loads(notebook.read_text())["cells"] if c["cell_type"] == "code")
    text = "\n\n".join(cell for cell in every if not OTHERS.search(cell))
    return "\n".join(line for line in text.splitlines() if not line.lstrip().startswith(("%", "!")))


def run_examples(root: Path, folder: Path) -> dict[str, dict[str, int]]:
    """Run the examples that are in scope; return their outcomes."""
    found = {}
    for path in sorted((root / "examples").glob("*.ipynb")):
        if path.stem in LEFT_OUT:
            continue
        script = folder / f"{path.stem}.py"
        script.write_text(replaced(cells(path)))
        ran = subprocess.run([sys.executable, str(script)], cwd=folder, check=False, capture_output=True, text=True)
        found[path.stem] = {"passed" if ran.returncode == 0 else "failure": 1}
        if ran.returncode:
            print(ran.stderr[-2000:], file=sys.stderr)
    return found


def main() -> int:
    """Run what the command line asks for; return 1 if anything has failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("tests", "examples"))
    parser.add_argument("--source", type=Path, help="unpacked source distribution; downloaded unless given")
    options = parser.parse_args()
    os.environ.setdefault("MPLBACKEND", "agg")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "tests"
        folder.mkdir()
        root = options.source or source(folder)
        found = (run_tests if options.what == "tests" else run_examples)(root, folder)
    for file, outcomes in sorted(found.items()):
        print(f"{file:44} {', '.join(f'{number} {outcome}' for outcome, number in sorted(outcomes.items()))}")
    for name, reason in (TESTS_LEFT_OUT if options.what == "tests" else LEFT_OUT).items():
        print(f"{name:44} left out: {reason}")
    return int(any({"failure", "error"} & outcomes.keys() for outcomes in found.values()))


if __name__ == "__main__":
    sys.exit(main())
