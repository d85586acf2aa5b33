"""What ``tests/bsk_rl`` compares the drop-in with is what bsk_rl gives on Basilisk, recorded again."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.rounding import to_rounding

TESTS = Path(__file__).resolve().parents[1]

pytestmark = pytest.mark.basilisk


@pytest.mark.parametrize("recorder", ["record_bsk_rl", "record_drop_in"])
def test_recordings_are_those_of_bsk_rl(recorder, tmp_path):
    script = TESTS.parent / "scripts" / "recorders" / f"{recorder}.py"
    subprocess.run([sys.executable, str(script), "--out", str(tmp_path)], check=True, capture_output=True)
    made = list(tmp_path.glob("*.json"))
    assert made
    for path in made:
        recorded = json.loads((TESTS / "bsk_rl" / "data" / path.name).read_text())
        assert json.loads(path.read_text()) == to_rounding(recorded)
