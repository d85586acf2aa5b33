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

LATER = "space-to-space imaging, which bsk_torch does not have yet"
RAY = "needs Ray"
INSIDE = "builds modules of Basilisk"

LEFT_OUT = {
    "test_int_rso_imaging_env.py": LATER,
    "test_int_mixed.py": LATER,
    "test_int_space_to_space_imaging_example.py": LATER,
    "mixed_environment": LATER,
    "space_to_space_rso_imaging": LATER,
    "space_to_space_rso_imaging_demo": LATER,
    "space_to_space_rso_imaging_evaluation": LATER,
    "async_multiagent_training": RAY,
    "curriculum_learning": RAY,
    "rllib_training": RAY,
    "time_discounted_gae": RAY,
    "training_with_shield": RAY,
    "fault_environment": INSIDE,
}
"""Files that do not run, with the reason."""

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
        if path.name not in LEFT_OUT:
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
    command = [sys.executable, "-m", "pytest", "-q", f"--junitxml={report}", *options, "integration"]
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
        folder = Path(name)
        root = options.source or source(folder)
        found = (run_tests if options.what == "tests" else run_examples)(root, folder)
    for file, outcomes in sorted(found.items()):
        print(f"{file:44} {', '.join(f'{number} {outcome}' for outcome, number in sorted(outcomes.items()))}")
    for file, reason in LEFT_OUT.items():
        if (file.endswith(".py")) == (options.what == "tests"):
            print(f"{file:44} left out: {reason}")
    return int(any({"failure", "error"} & outcomes.keys() for outcomes in found.values()))


if __name__ == "__main__":
    sys.exit(main())
