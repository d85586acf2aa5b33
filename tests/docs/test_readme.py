"""Every block of the README runs."""

import pytest

from tests.docs.quoted import checking_print
from tests.support.blocks import ROOT, blocks, run_commands, run_python

README = ROOT / "README.md"
PYTHON, SHELL = blocks(README, "python"), blocks(README, "bash")


@pytest.mark.compiled
@pytest.mark.parametrize("block", PYTHON, ids=[f"line{block.line}" for block in PYTHON])
def test_python(block, tmp_path, monkeypatch):
    """Results that comments behind a print quote are those that are printed."""
    monkeypatch.chdir(tmp_path)
    run_python(block, README, {"__name__": "readme", "print": checking_print(README, [])})


@pytest.mark.compiled
@pytest.mark.parametrize("block", SHELL, ids=[f"line{block.line}" for block in SHELL])
def test_commands(block, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_commands(block)


def test_figures_are_filled_in():
    assert "@@" not in README.read_text()
