"""Put faults into a copy of the package, one after the other, and note which test finds each: a mutation check of the tests.

    python scripts/validation/mutants.py --levels default --out default.json
    python scripts/validation/mutants.py --levels default,full --out full.json --processes 2 --only "faults that never end"
    python scripts/validation/mutants.py --check

``mutants.json``, next to this script, lists the faults: a name, the file, the text that the fault replaces, which occurs once in
the file, and the tests most likely to find it. For each fault, pytest runs these tests at the given levels, and if all pass, the
whole ``tests`` (not with ``--first``), up to the first failure. That test then runs without the fault: if it fails again, as a
test that needs a Git repository, it is named in ``unsound`` of the results and left out from then on. A run beyond ``--timeout``
counts as found.

The checkout is copied once, to a temporary folder, and PYTHONPATH lets the copy take precedence over the installed package.
Kernels are cached as by ``scripts/test.sh``; their names are hashes of their sources, so faults only add to the cache. Results
are written after each fault: the same command continues an interrupted run, with faults that ``--out`` does not have yet. A
second run with ``--levels default,full --only`` shows which of the faults not found by default the slower tests find.
"""

from __future__ import annotations

import argparse
import ast
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]

LEFT_OUT = (".git", ".venv*", ".hypothesis", "*_cache", "__pycache__", "*.egg-info", "build", "dist", "runs", "_build")
"""Files and folders that are not copied."""

PASSED = (0, 5)
"""Exit statuses of pytest: all tests have passed, or none belongs to the levels."""

TIMEOUT = "timeout"
"""What has found a fault with which the tests do not end."""

FAILED = re.compile(r"^(?:FAILED|ERROR) (tests/[^\s\[@]+(?:\[.*?\])?)(?:@\S+)?(?= - |$)", re.MULTILINE)
"""A line of pytest's summary, with the name of the test; pytest-xdist adds its group."""


@dataclass(frozen=True)
class Mutant:
    """A fault: ``new`` replaces ``old`` in ``file`` of a ``room`` of the package; ``tests`` may find it, the nearest first."""

    name: str
    room: str
    file: str
    old: str
    new: str
    tests: list[str]


def complaints(folder: Path, mutants: Sequence[Mutant]) -> Iterator[str]:
    """Yield what is wrong with the list of faults in a checkout."""
    for mutant in mutants:
        text = (folder / mutant.file).read_text()
        if text.count(mutant.old) != 1:
            yield f"{mutant.name}: the old text occurs {text.count(mutant.old)} times in {mutant.file}"
            continue
        try:
            ast.parse(text.replace(mutant.old, mutant.new))
        except SyntaxError as error:
            yield f"{mutant.name}: {mutant.file} with the fault is no Python: {error}"
        yield from (f"{mutant.name}: {test} does not exist" for test in mutant.tests if not (folder / test).exists())


class Checker:
    """Runs tests of a copy of the checkout.

    Attributes:
        copy: Root of the copy.
        options: The command line.
        unsound: Tests that fail in the copy without a fault, and are left out.
    """

    def __init__(self, copy: Path, options: argparse.Namespace, unsound: list[str]) -> None:
        """Check that the package of the copy is imported, not the installed one."""
        self.copy, self.options, self.unsound, self.sound = copy, options, unsound, set[str]()
        paths = os.pathsep.join(filter(None, [str(copy), os.environ.get("PYTHONPATH", "")]))
        cache = os.environ.get("BSK_TORCH_CACHE") or str(ROOT / ".venv" / "kernels")
        self.environment = os.environ | {"PYTHONPATH": paths, "BSK_TORCH_CACHE": cache, "OMP_NUM_THREADS": "1"}
        self.environment.pop("PYTHONDONTWRITEBYTECODE", None)
        command = [sys.executable, "-c", "import bsk_torch; print(bsk_torch.__file__)"]
        found = subprocess.run(command, cwd=copy.parent, env=self.environment, capture_output=True, text=True, check=True).stdout
        if not Path(found.strip()).is_relative_to(copy):
            sys.exit(f"the tests would import {found.strip()}, which is not in the copy {copy}")

    def first_failure(self, tests: Sequence[str], *arguments: str) -> str | None:
        """Return the first test that fails, :data:`TIMEOUT` or the end of the output if pytest fails; None if all pass."""
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-rfE", "-p", "no:cacheprovider", *arguments]
        command += [f"--deselect={test}" if "::" in test else f"--ignore={test}" for test in self.unsound]
        shutil.rmtree(self.copy / ".hypothesis", ignore_errors=True)  # examples that have shown other faults
        streams: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "errors": "replace"}
        with subprocess.Popen([*command, *tests], cwd=self.copy, env=self.environment, start_new_session=True, **streams) as run:
            try:
                output = run.communicate(timeout=self.options.timeout)[0]
            except BaseException as error:
                os.killpg(run.pid, signal.SIGKILL)
                if isinstance(error, subprocess.TimeoutExpired):
                    return TIMEOUT
                raise
        if run.returncode in PASSED:
            return None
        failed = FAILED.search(output.rpartition("short test summary info")[2])
        return failed[1] if failed else f"status {run.returncode}: {output.strip()[-200:]!r}"

    def is_sound(self, test: str) -> bool:
        """Return whether a test passes without a fault, or a file can be collected."""
        if test.startswith("tests/") and test not in self.sound:
            if self.first_failure([test], "--levels", "all", *([] if "::" in test else ["--collect-only"])) is not None:
                return False
            self.sound.add(test)
        return True

    def found_by(self, mutant: Mutant) -> str | None:
        """Return the first test that fails because of a fault; None if none does."""
        path, levels = self.copy / mutant.file, ("--levels", self.options.levels)
        text, spread = path.read_text(), ("--dist", "loadgroup", "--no-loadscope-reorder")
        whole = (*levels, "-n", str(self.options.processes), *spread) if self.options.processes > 1 else levels
        for tests, arguments in [(mutant.tests, levels), *([] if self.options.first else [(["tests"], whole)])]:
            while True:
                try:
                    write(path, text.replace(mutant.old, mutant.new))
                    failed = self.first_failure(tests, *arguments)
                finally:
                    write(path, text)
                if failed is None:
                    break
                if self.is_sound(failed):
                    return failed
                if failed in self.unsound:
                    sys.exit(f"{failed} fails without a fault and cannot be left out")
                self.unsound.append(failed)
        return None


def write(path: Path, text: str) -> None:
    """Write a module, and forget its bytecode: a fault may leave size and second of the file unchanged."""
    path.write_text(text)
    Path(importlib.util.cache_from_source(str(path))).unlink(missing_ok=True)


def read_results(out: Path, levels: str) -> dict[str, Any]:
    """Return the results of an interrupted run, or empty ones; ends the program for those of other levels."""
    results = json.loads(out.read_text()) if out.exists() else {"levels": levels, "unsound": [], "mutants": {}}
    if results["levels"] != levels:
        sys.exit(f"{out} has results of --levels {results['levels']}; name another file")
    return results


def main() -> None:
    """Read the command line, examine the faults, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--levels", default="default", help="levels of the tests to run: default | default,full | all")
    parser.add_argument("--out", type=Path, help="JSON file to write, and to continue")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="names of the faults, all unless given")
    parser.add_argument("--first", action="store_true", help="run only the tests listed with each fault")
    parser.add_argument("--processes", type=int, default=1, metavar="N", help="processes that run the whole tests")
    parser.add_argument("--timeout", type=float, default=1800.0, metavar="SECONDS", help="longest run of pytest")
    parser.add_argument("--check", action="store_true", help="check the list of faults; run no tests")
    options = parser.parse_args()
    mutants = [Mutant(**entry) for entry in json.loads(Path(__file__).with_name("mutants.json").read_text())]
    unknown = set(options.only or ()) - {mutant.name for mutant in mutants}
    if unknown:
        parser.error(f"--only: there are no faults {sorted(unknown)}")
    chosen = [mutant for mutant in mutants if not options.only or mutant.name in options.only]
    if options.check:
        print(f"{len(chosen)} faults")
        sys.exit("\n".join(complaints(ROOT, chosen)) or None)
    if options.out is None:
        parser.error("--out is missing")
    results = read_results(options.out, options.levels)
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = Path(folder).resolve() / "checkout"
        shutil.copytree(ROOT, copy, symlinks=True, ignore=shutil.ignore_patterns(*LEFT_OUT))
        if wrong := "\n".join(complaints(copy, chosen)):
            sys.exit(wrong)
        checker = Checker(copy, options, results["unsound"])
        for mutant in chosen:
            known = results["mutants"].get(mutant.name)
            if known is None or not (known["found_by"] or known["whole"] or options.first):
                begin = time.perf_counter()
                found, seconds = checker.found_by(mutant), round(time.perf_counter() - begin, 1)
                known = {"room": mutant.room, "found_by": found, "whole": not options.first, "seconds": seconds}
                results["mutants"][mutant.name] = known
                part = options.out.with_name(f"{options.out.name}.part")
                part.write_text(json.dumps(results, indent=1) + "\n")
                part.replace(options.out)
            print(f"{mutant.name} | {known['found_by'] or 'not found'} | {known['seconds']:.0f} s", flush=True)
    found = [name for name, known in results["mutants"].items() if known["found_by"]]
    print(f"found by {options.levels}: {len(found)} of {len(results['mutants'])}")


if __name__ == "__main__":
    main()
