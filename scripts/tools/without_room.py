"""Test a copy of the repository that lacks one of its rooms.

    python scripts/tools/without_room.py [ROOM ...] [--pytest tests/rl -k rule]

A room is a folder outside the core, such as ``tasks/objects``; all of them by default. Left out with it are its tests, and the
tests elsewhere that import it or name one of its presets or rules: these files and functions are printed. The fast tests of what
remains must pass, the list of presets must name the folder that is missing, and making one of its presets must raise an error.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bsk_torch._listed import LISTED

ROOT = Path(__file__).resolve().parents[2]

TASKS = ("aeos_bench", "aeossp", "areas", "inspection", "objects", "safe_autonomy", "sites")
ROOMS = (*(f"tasks/{task}" for task in TASKS), "lab", "viewer", "bsk_rl")


def copy_repository(target: Path) -> None:
    """Copy the files under version control, and new files that are not ignored."""
    listing = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    for name in listing.stdout.splitlines():
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)


def imported_modules(tree: ast.Module) -> Iterator[str]:
    """Yield the dotted names that a module imports, names in modules included."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{name.name}" for name in node.names)


def files_that_import(room: str, tests: dict[str, ast.Module]) -> set[str]:
    """Return the test modules, by dotted name, that import a room, or another module that does."""
    imports = {name: set(imported_modules(tree)) for name, tree in tests.items()}
    dependent: set[str] = set()
    prefixes = {f"bsk_torch.{room.replace('/', '.')}"}
    while True:
        more = {
            name
            for name, modules in imports.items()
            if name not in dependent and any(module == p or module.startswith(f"{p}.") for module in modules for p in prefixes)
        }
        if not more:
            return dependent
        dependent |= more
        prefixes |= more


def functions_that_name(words: re.Pattern[str], tests: dict[str, ast.Module]) -> Iterator[tuple[str, str]]:
    """Yield module and name of the test functions whose decorators or statements have a string that matches ``words``."""
    for name, tree in tests.items():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                strings = (
                    part.value for part in ast.walk(node) if isinstance(part, ast.Constant) and isinstance(part.value, str)
                )
                if any(words.search(string) for string in strings):
                    yield name, node.name


def names_the_folder(folder: str, preset: str, copy: Path, environment: dict[str, str]) -> bool:
    """Return whether the list of presets, and the error for one of them, name the folder that is missing."""
    commands = ["-m", "bsk_torch", "list"], ["-c", f"import bsk_torch; bsk_torch.make({preset!r})"]
    for command in commands:
        run = subprocess.run([sys.executable, *command], cwd=copy, env=environment, capture_output=True, text=True)
        if f"no folder {folder}" not in " ".join((run.stdout + run.stderr).split()):
            print(f"{command[-1]!r} does not name {folder}:\n{run.stdout}{run.stderr}")
            return False
    return True


def test_without(room: str, arguments: list[str]) -> bool:
    """Return whether the tests pass in a copy without a room."""
    folder = f"bsk_torch/{room}"
    presets = [name for name, preset in LISTED.items() if preset.function.startswith(f"{folder.replace('/', '.')}.")]
    with tempfile.TemporaryDirectory() as temporary:
        copy = Path(temporary)
        copy_repository(copy)
        shutil.rmtree(copy / folder)
        shutil.rmtree(copy / "tests" / room, ignore_errors=True)
        tests = {
            ".".join(path.relative_to(copy).with_suffix("").parts): ast.parse(path.read_text())
            for path in sorted((copy / "tests").rglob("*.py"))
        }
        left_out = files_that_import(room, tests)
        for name in left_out:
            (copy / name.replace(".", "/")).with_suffix(".py").unlink()
        words = re.compile("|".join(map(re.escape, [*presets, f"bsk_torch.{room.replace('/', '.')}", f"{folder}/"])))
        functions = list(functions_that_name(words, {name: tree for name, tree in tests.items() if name not in left_out}))
        print(f"\n{room}: left out are {len(left_out)} files that import it, and {len(functions)} tests that name it", flush=True)
        for name in sorted(left_out):
            print(f"  {name}")
        environment = os.environ | {"PYTHONPATH": temporary}
        run = [sys.executable, "-m"]
        if presets and not names_the_folder(folder, presets[0], copy, environment):
            return False
        deselected = [f"--deselect={name.replace('.', '/')}.py::{function}" for name, function in functions]
        command = [*run, "pytest", "-q", "--levels", "default", *deselected, *arguments]
        return subprocess.run(command, cwd=copy, env=environment).returncode == 0


def main() -> None:
    """Test without each of the given rooms."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", nargs="*", choices=[[], *ROOMS], help="rooms to leave out, one after the other; default: all")
    parser.add_argument("--pytest", nargs=argparse.REMAINDER, default=["tests"], help="arguments of pytest, up to the end")
    options = parser.parse_args()
    failed = [room for room in options.rooms or ROOMS if not test_without(room, options.pytest)]
    sys.exit(f"without_room.py: tests fail without {', '.join(failed)}" if failed else 0)


if __name__ == "__main__":
    main()
