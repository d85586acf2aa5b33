"""Every block of every page runs: those of one page in order, in one namespace and one empty folder."""

import re

import pytest

from bsk_torch.presets import PRESETS
from tests.docs.quoted import checking_print
from tests.support.blocks import ROOT, blocks, run_commands, run_python

DOCS = ROOT / "docs"
GENERATED = ("_build", "_tutorials", "gallery", "api/reference")
PAGES = [path for path in sorted(DOCS.rglob("*.md")) if not path.relative_to(DOCS).as_posix().startswith(GENERATED)]
RUNNABLE = [path for path in PAGES if blocks(path, "python", "bash")]


def name(path):
    return path.relative_to(DOCS).as_posix()


@pytest.fixture
def presets():
    """Presets that a page adds are forgotten after its test."""
    known = dict(PRESETS)
    yield
    PRESETS.clear()
    PRESETS.update(known)


@pytest.mark.compiled
@pytest.mark.parametrize("path", RUNNABLE, ids=name)
def test_blocks(path, tmp_path, monkeypatch, presets):
    """Results that comments behind a print quote are those that are printed; pictures of a guide are what its blocks draw."""
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": "page", "print": checking_print(path, [])}
    for block in blocks(path, "python", "bash"):
        run_python(block, path, namespace) if block.language == "python" else run_commands(block)
    drawn = re.findall(r"_static/how_to/([\w.]+)", path.read_text())
    assert all((tmp_path / name).is_file() for name in drawn)


def test_pages_have_one_heading_and_say_what_they_are_for():
    failures = []
    for path in PAGES:
        text = re.sub(r"^```.*?^```", "", path.read_text(), flags=re.DOTALL | re.MULTILINE)
        first = re.sub(r"^# .*", "", text, count=1, flags=re.MULTILINE).strip().partition("\n")[0]
        if "{include}" in path.read_text() or (
            len(re.findall(r"^# ", text, re.MULTILINE)) == 1 and re.match(r"[\w`*\[(]", first)
        ):
            continue
        failures.append(f"{name(path)}: not one heading, or the first line is no sentence: {first}")
    assert not failures, "\n".join(failures)


WIDEST = 96
"""Columns of code that a page of 1,280 pixels shows."""


def test_code_fits_a_page():
    wide = [
        f"{name(path)}:{block.line + k}"
        for path in PAGES
        for block in blocks(path, "python", "bash")
        for k, line in enumerate(block.code.splitlines())
        if len(line) > WIDEST
    ]
    assert not wide


def test_pages_are_found():
    assert len(PAGES) >= 10
