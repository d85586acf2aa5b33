"""``bsk-torch aeossp plan`` and ``bsk-torch aeossp check``."""

import json

import pytest

from bsk_torch.files import write_file
from tests.tasks.aeossp.part import PART, part


def test_plans_are_written_and_checked(run, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    result = run("aeossp", "plan", PART, "--out", tmp_path / "s.json", "--model", "flyable", "--margin", "2")
    assert result.exit_code == 0, result.output
    assert "case_0001: 3 satellites" in result.output
    assert "No plan with these slews has a WCR above 0." in result.output
    assert max(map(len, result.output.splitlines())) <= 80
    shown = next(line for line in result.output.splitlines() if line.split()[:1] == ["valid"])
    checked = run("aeossp", "check", PART, tmp_path / "s.json")
    assert checked.exit_code == 0, checked.output
    assert shown in checked.output


def test_violations_are_printed_and_fail(run, tmp_path):
    actions = json.loads(part("solution.json"))["actions"]
    write_file(tmp_path / "s.json", json.dumps({"actions": actions + actions[:12]}))
    result = run("aeossp", "check", PART, tmp_path / "s.json")
    assert result.exit_code == 1
    assert "invalid" in result.output
    assert "overlaps the previous observation" in result.output
    assert "and 2 more violations" in result.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["aeossp", "plan", "none", "--out", "{tmp}/s.json"], "'none/mission.yaml': No such file"),
        (["aeossp", "plan", "{part}", "--out", "{tmp}/no/s.json"], "cannot be written: there is no folder"),
        (["aeossp", "plan", "{part}", "--out", "{tmp}/s.json", "--model", "flyabl"], "did you mean 'flyable'"),
        (["aeossp", "check", "{part}", "{part}/tasks.yaml"], "tasks.yaml: Invalid JSON"),
    ],
)
def test_wrong_calls_are_refused(run, tmp_path, arguments, message):
    result = run(*(text.format(part=PART, tmp=tmp_path) for text in arguments))
    assert result.exit_code == 1
    assert message in " ".join(result.output.split())
