"""benchmarks/results/truth.json, from which the pages of truth are made, is that of the tests."""

import importlib.util
import json

import pytest

from tests.support.blocks import ROOT

RESULT = json.loads((ROOT / "benchmarks" / "results" / "truth.json").read_text())
ROWS = {(row["group"], row["recording"]): row for row in RESULT["rows"]}


@pytest.fixture(scope="module")
def cases():
    """Replays of scripts/validation/truth.py, which take their bounds from the tests."""
    path = ROOT / "scripts" / "validation" / "truth.py"
    spec = importlib.util.spec_from_file_location("truth_script", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.cases()


def test_it_has_every_replay_with_the_bounds_of_its_test(cases):
    assert {(case.group, case.recording): case.bounds for case in cases} == {key: row["bounds"] for key, row in ROWS.items()}
    assert len(ROWS) > 40
    for key, row in ROWS.items():
        assert not {name: row["largest"][name] for name, bound in row["bounds"].items() if not row["largest"][name] <= bound}, key
        assert row["group"] == "mixed" or all(row["exact"].values()), key
    from docs._ext import truth

    assert {name for row in ROWS.values() for name in row["largest"]} <= set(truth.QUANTITIES)
