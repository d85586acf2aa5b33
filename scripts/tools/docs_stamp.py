"""Check whether the documentation has run in its current form: pages, examples, and signatures and docstrings of the package.

    python scripts/tools/docs_stamp.py            exit with 1 and list what has changed since the documentation last ran
    python scripts/tools/docs_stamp.py --write    note that it has run; scripts/test.sh --docs does so after its tests

The tests of the marker pages are those of the documentation: blocks of its pages, tutorials, site. ``scripts/test.sh``
leaves them out where nothing that they read has changed, and runs them otherwise. A change inside of a function that breaks
a page is found by ``scripts/test.sh --nightly``, which always runs them.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
STAMP = Path("tests/docs/stamp.json")
PACKAGE = "bsk_torch"
PARTS = {
    "pages": ("README.md", "docs"),
    "examples": ("examples",),
    "results": ("benchmarks/results",),
    "tests of pages": ("tests/docs", "tests/support/blocks.py", "tests/support/programs.py"),
    "versions": ("constraints.txt", "pyproject.toml"),
}
"""Files and folders that the tests of pages read, by what messages call them."""


def files(root: Path, *places: str) -> list[Path]:
    """Files of a checkout in some places, but for those that git ignores."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "--", *places]
    listed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout.split("\0")
    return sorted({root / name for name in listed if name and Path(name) != STAMP and (root / name).is_file()})


def interface(source: str) -> list[str]:
    """What users see of a module: docstrings, bases, fields, arguments and results of its public names."""
    return list(_described(ast.parse(source), ""))


def _described(node: ast.Module | ast.ClassDef, prefix: str) -> Iterator[str]:
    yield f"{prefix}: {ast.get_docstring(node)}"
    for child in node.body:
        if isinstance(child, ast.AnnAssign):
            yield f"{prefix}{ast.unparse(child.target)}: {ast.unparse(child.annotation)}"
        if not isinstance(child, ast.FunctionDef | ast.ClassDef) or (child.name.startswith("_") and child.name != "__init__"):
            continue
        name = prefix + child.name
        yield from (f"@{ast.unparse(decorator)}" for decorator in child.decorator_list)
        if isinstance(child, ast.ClassDef):
            yield f"class {name}({', '.join(map(ast.unparse, child.bases))})"
            yield from _described(child, f"{name}.")
        else:
            returns = ast.unparse(child.returns) if child.returns else None
            yield f"def {name}({ast.unparse(child.args)}) -> {returns}: {ast.get_docstring(child)}"


def stamp(root: Path = ROOT) -> dict[str, str]:
    """Hashes of what the tests of pages read, by part."""
    hashes = {part: hashlib.sha256() for part in (*PARTS, "signatures and docstrings")}
    for part, places in PARTS.items():
        for path in files(root, *places):
            hashes[part].update(f"{path.relative_to(root).as_posix()}\0".encode() + path.read_bytes() + b"\0")
    for path in files(root, PACKAGE):
        if path.suffix == ".py":
            lines = [path.relative_to(root).as_posix(), *interface(path.read_text())]
            hashes["signatures and docstrings"].update("\n".join(lines).encode())
    return {part: found.hexdigest() for part, found in hashes.items()}


def changed(root: Path = ROOT) -> list[str]:
    """Parts that are not as they were when the documentation ran."""
    try:
        noted = json.loads((root / STAMP).read_text())
    except FileNotFoundError:
        noted = {}
    return [part for part, found in stamp(root).items() if noted.get(part) != found]


def main() -> None:
    """Check or write the stamp."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="note that the documentation has run as it is now")
    parser.add_argument("--root", type=Path, default=ROOT, help="the checkout (default: that of this script)")
    options = parser.parse_args()
    if options.write:
        (options.root / STAMP).write_text(json.dumps(stamp(options.root), indent=1) + "\n")
        print(f"noted in {STAMP}")
    elif parts := changed(options.root):
        print(f"changed since the documentation ran: {', '.join(parts)}; scripts/test.sh --docs runs it and notes that")
        sys.exit(1)
    else:
        print("the documentation has run as it is")


if __name__ == "__main__":
    main()
