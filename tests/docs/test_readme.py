"""Every block of the README runs."""

import json
import re

import pytest

from tests.docs.quoted import checking_print
from tests.support.blocks import ROOT, blocks, run_commands, run_python

README = ROOT / "README.md"
PYTHON, SHELL = blocks(README, "python"), blocks(README, "bash")


@pytest.mark.compiled
@pytest.mark.parametrize("block", PYTHON, ids=[f"python{k}" for k in range(len(PYTHON))])
def test_python(block, tmp_path, monkeypatch):
    """Results that comments behind a print quote are those that are printed."""
    monkeypatch.chdir(tmp_path)
    run_python(block, README, {"__name__": "readme", "print": checking_print(README, [])})


@pytest.mark.compiled
@pytest.mark.parametrize("block", SHELL, ids=[block.commands[0][-1] for block in SHELL])
def test_commands(block, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_commands(block)


def test_figures_are_filled_in():
    assert "@@" not in README.read_text()


def result(name):
    return json.loads((ROOT / "benchmarks" / "results" / f"{name}.json").read_text())


def test_figures_are_those_that_were_measured():
    """Speed compared with Basilisk, and the flight of a trained policy on it."""
    text = " ".join(README.read_text().split())
    ratios = {row["case"]: row["ratio"] for name in ("vs_basilisk", "vs_basilisk_imaging") for row in result(name)["rows"]}
    quoted = re.search(
        r"simulated ([\d,]+) times .* imaging satellites ([\d,]+) times as fast .*?; a single scanning satellite is ([\d.]+)",
        text,
    )
    assert quoted.groups() == (f"{ratios['4096']:,.0f}", f"{ratios['imaging-1k-1024']:,.0f}", f"{ratios['1']:.1f}")
    page = " ".join((ROOT / "docs" / "index.md").read_text().split())
    assert f"[{ratios['4096']:,.0f} times]" in page
    flown = result("flight_nadir_scan")["summary"]
    episodes, decisions = re.search(r"flew (\d+) episodes on Basilisk itself and chose .* of ([\d,]+) decisions", text).groups()
    for side in ("bsk_torch", "basilisk"):
        assert f"{flown[side]['decisions'][0] * int(episodes):,.0f}" == decisions
    assert f"[{decisions} of {decisions}]" in page
