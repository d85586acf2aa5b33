"""``bsk-torch audit``."""

import json

import pytest

pytestmark = pytest.mark.compiled

TWO = ["--preset", "NadirScan-v1", "--time-limit", "600", "--seeds", "0:2"]


def test_the_decisions_at_which_a_policy_loses_are_listed_and_drawn(run, tmp_path):
    result = run("audit", "random", *TWO, "--draw", tmp_path / "r.svg", "--out", tmp_path / "r.json")
    assert result.exit_code == 0, result.output
    assert "Regret by chosen action" in result.output
    assert "fastest wheel" in result.output
    assert (tmp_path / "r.svg").read_text().count("share of all regret") >= 1
    kept = json.loads((tmp_path / "r.json").read_text())
    assert kept["seeds"] == [0, 1]
    decisions = kept["decisions"]
    assert len(decisions["regret"]) == len(decisions["values"]) == len(decisions["situation"]["battery"])
    assert max(decisions["regret"]) > 0.0
    best = [max(value for value in row if value is not None) for row in decisions["values"]]
    chosen = [row[action] for row, action in zip(decisions["values"], decisions["action"], strict=True)]
    assert decisions["regret"] == pytest.approx([b - c for b, c in zip(best, chosen, strict=True)], abs=1e-15)


def test_several_futures_and_few_actions(run):
    short = ["--option", "n_targets=300", "--time-limit", "300", "--seeds", "1", "--horizon", "60"]
    result = run("audit", "hasty", "--preset", "CloudyAEOS-v1", *short, "--futures", "2", "--budget", "2")
    assert result.exit_code == 0, result.output
    assert "CloudyAEOS-v1, hasty, 1 episodes, seeds 1" in result.output


def test_largest_regrets_are_regrets(run):
    result = run("audit", "rule", *TWO)
    assert result.exit_code == 0, result.output
    found = int(result.output.split("of which ")[1].split()[0])
    assert 0 < found < 5
    rows = result.output.split("Largest regrets")[1].strip().splitlines()[2:]
    assert sum(bool(row.strip()) for row in rows) == found


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("audit", "survey", "--preset", "RSOInspection-v1", "--time-limit", "600"),
            "returns are computed of numbered actions; those of Inspector1 are real numbers",
        ),
        (("audit", "ruel", *TWO), "did you mean 'rule'"),
        (("audit", "rule", *TWO, "--horizon", "0"), "horizon=0"),
        (("audit", "rule", *TWO, "--draw", "regret.gif"), "must end with .png, .svg or .pdf"),
        (("audit", "rule", *TWO, "--out", "nowhere/r.json"), "there is no folder"),
    ],
)
def test_wrong_arguments_are_named(run, arguments, message):
    result = run(*arguments)
    assert result.exit_code == 1
    assert message in result.output
