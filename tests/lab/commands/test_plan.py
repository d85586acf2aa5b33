"""``bsk-torch eval plan:NAME``."""

import csv
import json

import pytest

pytestmark = pytest.mark.compiled

TWO = ["--time-limit", "400", "--seeds", "0:2"]


def test_planners_are_compared_with_the_baselines_that_fit(run, tmp_path):
    options = ["--plan", "base=rule", "--plan", "horizon=200", "--plan", "gamma=1"]
    files = ["--out", tmp_path / "all.json", "--episodes-out", tmp_path / "all.csv"]
    result = run("eval", "plan:rollout", *TWO, *options, *files)
    assert result.exit_code == 0, result.output
    kept = json.loads((tmp_path / "all.json").read_text())
    assert list(kept) == ["plan:rollout", "random", "rule", "cautious"]
    assert 0.0 < kept["plan:rollout"]["simulated_per_decision"] <= 4 * 200.0
    assert "simulated_per_decision" not in kept["rule"]
    assert "simulated s / decision" in result.output
    with (tmp_path / "all.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert all((float(line["simulated"]) > 0.0) == (line["policy"] == "plan:rollout") for line in lines)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["plan:rolout"], "'plan:rolout' is not a planner; did you mean 'plan:rollout'?"),
        (["plan:rollout", "--plan", "horizn=3"], "plan:rollout has no option 'horizn'; did you mean 'horizon'"),
        (["plan:rollout", "--plan", "horizon"], "--plan 'horizon' must be NAME=VALUE"),
        (["plan:rollout", "--plan", "horizon=0"], "horizon=0 must be a number in (0, inf] s"),
        (["plan:rollout", "--plan", "budget=0"], "budget=0 must be a whole number from 1 on"),
        (["plan:rollout", "--plan", "base=ruel"], "'ruel' is not a run folder"),
        (["plan:rollout", "--plan", "base=hasty"], "the policy 'hasty' does not fit NadirScan-v1"),
        (["plan:rollout", "--plan", "value=3"], "'value' is a module or a function; give it in Python"),
        (["plan:cem"], "plans real numbers"),
        (["plan:rollout", "--shield", "safe"], "--shield cannot stand before 'plan:rollout'"),
        (["rule", "--plan", "horizon=3"], "--plan 'horizon=3' is for planners"),
    ],
)
def test_wrong_options_end_the_command(run, arguments, message):
    result = run("eval", *arguments, "--preset", "NadirScan-v1", *TWO)
    assert result.exit_code == 1
    assert message in " ".join(result.output.split())
