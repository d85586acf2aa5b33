"""The stamp of the documentation: its tests are left out only where nothing that they read has changed."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys

import pytest

from tests.support.blocks import ROOT

SCRIPT = ROOT / "scripts" / "tools" / "docs_stamp.py"

MODULE = '''"""A module."""

LIMIT = 3


class Thing:
    """A thing."""

    size: int = 3

    def move(self, far: float = 1.0) -> float:
        """Move it."""
        return far

    def _inner(self):
        return 1
'''


def docs_stamp():
    spec = importlib.util.spec_from_file_location("docs_stamp", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run(root, *options):
    command = [sys.executable, str(SCRIPT), "--root", str(root), *options]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture
def checkout(tmp_path):
    """A checkout of which the documentation has run."""
    files = {
        "docs/page.md": "# A page",
        "examples/example.py": "pass",
        "bsk_torch/thing.py": MODULE,
        ".gitignore": "docs/_build/",
        "tests/docs/test_it.py": "",
        "README.md": "",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    subprocess.run(["git", "init", "-q", "."], cwd=tmp_path, check=True)
    assert run(tmp_path).returncode == 1
    assert run(tmp_path, "--write").stdout == "noted in tests/docs/stamp.json\n"
    assert run(tmp_path).returncode == 0
    return tmp_path


@pytest.mark.parametrize(
    ("path", "change", "part"),
    [
        ("docs/page.md", lambda text: text + "\nmore", "pages"),
        ("docs/new.md", lambda text: "# New", "pages"),
        ("README.md", lambda text: "more", "pages"),
        ("examples/example.py", lambda text: "print()", "examples"),
        ("benchmarks/results/speed.json", lambda text: "{}", "results"),
        ("tests/docs/test_it.py", lambda text: "pass", "tests of pages"),
        ("constraints.txt", lambda text: "torch==3", "versions"),
        ("bsk_torch/thing.py", lambda text: text.replace("far: float = 1.0", "far: float = 2.0"), "signatures and docstrings"),
        ("bsk_torch/thing.py", lambda text: text.replace("-> float", "-> int"), "signatures and docstrings"),
        ("bsk_torch/thing.py", lambda text: text.replace("Move it.", "Move."), "signatures and docstrings"),
        ("bsk_torch/thing.py", lambda text: text.replace("class Thing", "class Thing(dict)"), "signatures and docstrings"),
        ("bsk_torch/thing.py", lambda text: text.replace("size: int", "length: int"), "signatures and docstrings"),
        ("bsk_torch/other.py", lambda text: '"""Another module."""', "signatures and docstrings"),
    ],
)
def test_changes_are_noticed(checkout, path, change, part):
    file = checkout / path
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(change(file.read_text() if file.exists() else ""))
    assert docs_stamp().changed(checkout) == [part]


def test_a_removed_page_is_noticed(checkout):
    (checkout / "docs" / "page.md").unlink()
    done = run(checkout)
    assert (done.returncode, "changed since the documentation ran: pages;" in done.stdout) == (1, True)


def test_bodies_private_names_and_built_pages_do_not_matter(checkout):
    thing = checkout / "bsk_torch" / "thing.py"
    thing.write_text(thing.read_text().replace("return far", "return 2 * far").replace("_inner(self)", "_inner(self, other)"))
    (checkout / "docs" / "_build").mkdir()
    (checkout / "docs" / "_build" / "page.html").write_text("")
    (checkout / "CHANGELOG.md").write_text("# Changes")
    assert run(checkout).returncode == 0


def test_without_git_the_documentation_runs(checkout):
    """The script fails, and scripts/test.sh takes that for a change."""
    (checkout / ".git").rename(checkout / "elsewhere")
    assert run(checkout).returncode != 0


def test_the_script_of_tests_asks_for_it():
    text = (ROOT / "scripts" / "test.sh").read_text()
    left_out = re.search(r"^if (.*docs_stamp\.py); then\n.*not pages.*\nfi\nexec .*\$\{parallel\[@\]\}\"$", text, re.MULTILINE)
    assert left_out, "the tests of the documentation are left out without a look at the stamp"
    assert "docs_stamp.py --write" in text[: left_out.start()]


def test_the_stamp_names_all_parts():
    """Of the checkout itself; whether it is up to date decides only what scripts/test.sh runs."""
    module = docs_stamp()
    found = module.stamp()
    assert set(found) == {*module.PARTS, "signatures and docstrings"}
    assert len(set(found.values())) == len(found)
