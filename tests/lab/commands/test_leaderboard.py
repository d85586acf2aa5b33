"""``bsk-torch leaderboard``."""

import json

import pytest
import torch

from bsk_torch.lab.commands import board as board_module
from bsk_torch.lab.commands.board import with_references
from bsk_torch.lab.suites import suite as suites
from bsk_torch.lab.suites.suite import PUBLISHED, references, tasks_of

SCAN, POWER = "NadirScan-v1", "AEOSPower-v1"


def scoring(preset, *scores, certified=None):
    """Return the row of a policy whose episodes have the given scores."""
    low, high = (references("v1")[preset][end]["return"] for end in ("low", "high"))
    row = {"returns": [low + score * (high - low) for score in scores]}
    return {preset: row | ({} if certified is None else {"basilisk": {"same": certified, "returns": [0.0, 0.0]}})}


POLICIES = {
    "runs/ppo/seed_0": scoring(SCAN, 0.9, 0.7),
    "runs/ppo/seed_1": scoring(SCAN, 1.2, 1.0),
    "runs/power/seed_0": scoring(POWER, 0.6, 0.6),
    "runs/power/seed_1": scoring(POWER, 0.4, 0.4),
    "scanner": scoring(SCAN, 0.9, 0.5, certified=2),
    "hasty": scoring(POWER, 0.3, 0.3),
    "plan:rollout,base=rule": scoring(SCAN, 2.0),
}

METHODS = ["--method", "ppo=runs/*/seed_*", "--method", "rules=scanner", "--method", "rules=hasty"]


@pytest.fixture
def board(tmp_path):
    """Return a file of ``bsk-torch bench``."""
    path = tmp_path / "bench.json"
    path.write_text(json.dumps({"format": 1, "suite": "v1", "policies": POLICIES}))
    return path


def test_methods_are_aggregated_over_their_runs_and_tasks(run, board, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    result = run("leaderboard", board, *METHODS, "--out", tmp_path / "out.json", "--draw", tmp_path / "profiles.svg")
    assert result.exit_code == 0, result.output
    kept = json.loads((tmp_path / "out.json").read_text())
    assert (kept["tasks"], kept["against"]) == ([SCAN, POWER], "ppo")
    ppo, rules = kept["methods"]["ppo"], kept["methods"]["rules"]
    # scores of the runs: 0.8, 1.1 and 0.6, 0.4; of four, one at either end is left out
    assert ppo["IQM"]["value"] == pytest.approx(0.7)
    assert ppo["mean"]["value"] == pytest.approx(0.725)
    assert ppo["optimality gap"]["value"] == pytest.approx((0.2 + 0.0 + 0.4 + 0.6) / 4)
    assert ppo["IQM"]["low"] < 0.7 < ppo["IQM"]["high"]
    assert (rules["IQM"]["value"], rules["better"]["value"]) == (pytest.approx(0.5), 0.0)
    assert rules["basilisk"] == {"same": 2, "episodes": 2}
    assert "2 of 2" in result.output
    assert "<svg" in (tmp_path / "profiles.svg").read_text()


def test_methods_are_shown_with_their_most_expensive_training(run, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "240")
    cost = lambda decisions, runs: {"training": {"decisions": decisions, "core_seconds": 90.0, "tuning_runs": runs}}
    costs = {"a/0": cost(262_144, 3), "a/1": cost(250_000, 0), "b": cost(2_500_000, None), "c": cost(3_000_000, 1), "d": {}}
    costs["rule"] = cost(0, None)
    policies = {name: {SCAN: scoring(SCAN, 0.5, 0.6)[SCAN] | row} for name, row in costs.items()}
    path = tmp_path / "bench.json"
    path.write_text(json.dumps({"format": 1, "suite": "v1", "policies": policies}))
    methods = [f"--method={name}={name}" for name in ("b", "c", "d", "rule")]
    result = run("leaderboard", path, "--method=a=a/*", *methods, "--out", tmp_path / "out.json")
    assert result.exit_code == 0, result.output
    kept = {name: one["training"] for name, one in json.loads((tmp_path / "out.json").read_text())["methods"].items()}
    assert kept["a"] == {"track": "250k", "decisions": 262_144, "core_seconds": 90.0, "tuning_runs": 3}
    assert {name: row and row["track"] for name, row in kept.items()} == {
        "a": "250k",
        "b": "2.5M",
        "c": "open",
        "d": None,
        "rule": "none",
    }
    assert "262,144" in result.output
    assert result.output.count("no record") >= 2


def test_intervals_include_uncertain_references():
    scale = lambda half: {"low": {"return": 2.0}, "high": {"return": 6.0, "half_width": half}}
    drawn = torch.full((20_000, 1, 2), 0.5, dtype=torch.float64)
    found = with_references({"a": drawn, "b": 2.0 * drawn}, [scale(0.0), scale(0.4)])
    assert (found["a"][..., 0] == 0.5).all()
    # score 0.5 * 4 / (4 + e), with a 95 % interval of e of +-0.4
    low, high = found["a"][..., 1].quantile(torch.tensor([0.025, 0.975], dtype=torch.float64)).tolist()
    assert (low, high) == (pytest.approx(2.0 / 4.4, abs=3e-3), pytest.approx(2.0 / 3.6, abs=3e-3))
    assert torch.allclose(found["b"], 2.0 * found["a"])  # the same draws


def test_files_are_merged_by_policy_and_task(run, board, tmp_path):
    other = tmp_path / "other.json"
    more = {"scanner": scoring(POWER, 0.2, 0.2) | scoring(SCAN, 0.0), "hasty": scoring(POWER, 0.4, 0.4)}
    other.write_text(json.dumps({"format": 1, "suite": "v1", "policies": more}))
    out = tmp_path / "out.json"
    methods = ["--method", "scanner=scanner", "--method", "ppo=runs/*/seed_*"]
    assert run("leaderboard", board, other, *methods, "--out", out).exit_code == 0
    kept = json.loads(out.read_text())
    assert kept["tasks"] == [SCAN, POWER]
    # two episodes of the first file, not the one of the second
    assert kept["methods"]["scanner"]["mean"]["value"] == pytest.approx((0.7 + 0.2) / 2)
    assert run("leaderboard", board, other, "--method", "hasty=hasty", "--out", out).exit_code == 0
    assert json.loads(out.read_text())["methods"]["hasty"]["mean"]["value"] == pytest.approx(0.4)  # of the last file


def test_policies_of_the_most_episodes_are_compared(run, board):
    result = run("leaderboard", board, "--method", "all=scanner", "--method", "planned=plan:*")
    assert result.exit_code == 1
    assert "plan:rollout,base=rule played 1 of 2 episodes, and is left out" in result.output
    assert "no task is played by all of all, planned" in result.output


def test_policies_are_methods_by_default(run, board):
    result = run("leaderboard", board, "--presets", POWER, "--against", "hasty")
    assert result.exit_code == 1
    assert "no task is played by all of" in result.output
    content = json.loads(board.read_text())
    content["policies"] = {"both": POLICIES["scanner"] | POLICIES["hasty"], "hasty": POLICIES["hasty"]}
    board.write_text(json.dumps(content))
    result = run("leaderboard", board)
    assert result.exit_code == 0, result.output
    assert "left out, as others play more tasks: hasty" in result.output


@pytest.fixture
def public(monkeypatch, tmp_path):
    """Publish results of the suite v1, in which a method has two runs."""
    policies = {
        "ppo/seed_0": scoring(SCAN, 0.9, 0.7) | scoring(POWER, 0.6, 0.6),
        "ppo/seed_1": scoring(SCAN, 1.2, 1.0) | scoring(POWER, 0.4, 0.4),
        "hasty": scoring(POWER, 0.8, 0.8),
    }
    (tmp_path / "published").mkdir()
    content = {"methods": {"ppo": ["ppo/seed_0", "ppo/seed_1"]}, "policies": policies}
    (tmp_path / "published/v1.json").write_text(json.dumps(content))
    suites.published.cache_clear()
    monkeypatch.setattr(suites, "PUBLISHED", tmp_path / "published")
    yield
    suites.published.cache_clear()


def test_published_methods_are_compared_with_policies_of_files(run, board, tmp_path, public):
    out = tmp_path / "out.json"
    rules = ["--method", "mine=scanner", "--method", "mine=hasty"]
    assert run("leaderboard", board, "--published", "v1", *rules, "--out", out).exit_code == 0
    kept = json.loads(out.read_text())
    assert (list(kept["methods"]), kept["tasks"]) == (["ppo", "mine"], [SCAN, POWER])
    assert kept["methods"]["ppo"]["IQM"]["value"] == pytest.approx(0.7)
    # the file's hasty counts, not the published one
    assert kept["methods"]["mine"]["mean"]["value"] == pytest.approx((0.7 + 0.3) / 2)


def test_published_methods_alone(run, tmp_path, public):
    out = tmp_path / "out.json"
    assert run("leaderboard", "--published", "v1", "--out", out).exit_code == 0
    assert list(json.loads(out.read_text())["methods"]) == ["ppo"]


def test_published_methods_of_some_tasks_have_a_table_of_these(run, board, tmp_path, monkeypatch, public):
    content = json.loads((suites.PUBLISHED / "v1.json").read_text())
    content["policies"]["other"] = scoring(POWER, 0.7, 0.9)
    (suites.PUBLISHED / "v1.json").write_text(json.dumps(content | {"methods": content["methods"] | {"other": ["other"]}}))
    suites.published.cache_clear()
    monkeypatch.setenv("COLUMNS", "200")
    out = tmp_path / "out.json"
    result = run("leaderboard", "--published", "v1", "--out", out)
    assert result.exit_code == 0, result.output
    kept = json.loads(out.read_text())
    assert (kept["tasks"], list(kept["methods"])) == ([SCAN, POWER], ["ppo"])
    (part,) = kept["parts"]
    assert (part["tasks"], part["against"]) == ([POWER], "other")
    assert {name: row["mean"]["value"] for name, row in part["methods"].items()} == pytest.approx({"ppo": 0.5, "other": 0.8})
    assert f"suite v1, 1 task: {POWER}" in result.output
    # methods of files tell which tasks are compared: `other` does not play the first, and plays the second like all
    assert run("leaderboard", board, "--published", "v1", "--method", "mine=scanner", "--out", out).exit_code == 0
    kept = json.loads(out.read_text())
    assert (kept["tasks"], list(kept["methods"]), kept["parts"]) == ([SCAN], ["ppo", "mine"], [])
    assert run("leaderboard", board, "--published", "v1", "--method", "mine=hasty", "--out", out).exit_code == 0
    kept = json.loads(out.read_text())
    assert (kept["tasks"], list(kept["methods"]), kept["parts"]) == ([POWER], ["ppo", "other", "mine"], [])


def test_wrong_use_of_published_results(run, board, public):
    assert "name a file of bsk-torch bench, or a suite with --published" in run("leaderboard").output
    result = run("leaderboard", board, "--published", "v1", "--method", "ppo=hasty")
    assert "'ppo' is a method of the published results" in result.output
    assert "suite='aeosbench' has no published results" in run("leaderboard", "--published", "aeosbench").output
    assert "suite='v2' is withdrawn" in run("leaderboard", "--published", "v2").output
    assert "suite='v9' is not a suite" in run("leaderboard", "--published", "v9").output


def test_published_results_are_whole():
    kept, tasks = json.loads((PUBLISHED / "v3.json").read_text()), tasks_of("v3")
    assert len(kept["methods"]) > 2
    for name, policies in kept["methods"].items():
        runs = {
            task.title: [kept["policies"][policy][task.title] for policy in policies if task.title in kept["policies"][policy]]
            for task in tasks
        }
        played = {task: rows for task, rows in runs.items() if rows}
        assert len(played) == len(tasks) or name not in ("random", "rules", "ppo"), name
        assert len({len(rows) for rows in played.values()}) == 1, name
        assert all(len(row["returns"]) == task.episodes for task in tasks for row in played.get(task.title, ())), name
    for task in tasks:
        low = sum(kept["policies"]["random"][task.title]["returns"]) / task.episodes
        assert low == pytest.approx(references("v3")[task.title]["low"]["return"], rel=1e-6)


def test_families_have_a_mean_each_and_count_the_same(run, tmp_path, monkeypatch):
    known = {task.title: {"low": {"return": 0.0}, "high": {"return": 2.0}} for task in tasks_of("v3")}
    for module in (suites, board_module):
        monkeypatch.setattr(module, "references", lambda suite: known)
    monkeypatch.setenv("COLUMNS", "80")
    scores = {"all": (0.45, 0.55, 0.65, 0.5, 0.55, 0.6), "areas": (0.0, 0.1, 0.2, 0.9, 0.95, 1.3)}
    policies = {
        name: {task: {"returns": [1.9 * score, 2.1 * score]} for task, score in zip(known, values, strict=True)}
        for name, values in scores.items()
    }
    path, out = tmp_path / "bench.json", tmp_path / "out.json"
    path.write_text(json.dumps({"format": 1, "suite": "v3", "policies": policies}))
    result = run("leaderboard", path, "--out", out)
    assert result.exit_code == 0, result.output
    assert result.output.index("\n areas ") < result.output.index("\n all ")  # the other order by the mean of the pile
    assert all(name in result.output for name in ("IQM sites", "IQM areas", "1.050 ["))
    kept = json.loads(out.read_text())
    assert kept["against"] == "areas"
    one = kept["methods"]["all"]
    assert not {"IQM", "mean", "optimality gap"} & one.keys()
    assert {name: row["value"] for name, row in one["families"].items()} == pytest.approx({"sites": 0.55, "areas": 0.55})
    assert [row["value"] for row in one["tasks"].values()] == pytest.approx(list(scores["all"]))
    assert one["tasks"]["sites"]["low"] < 0.45 < one["tasks"]["sites"]["high"]
    assert one["families"]["areas"]["low"] < 0.55 < one["families"]["areas"]["high"]
    result = run("leaderboard", path, "--presets", "areas,sites", "--method", "one=all")
    assert "suite v3, 2 tasks: areas, sites" in result.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--method", "hasty"], "--method 'hasty' must be NAME=PATTERN"),
        (["--method", "rules=hasti"], "did you mean 'hasty'?"),
        (["--method", "ppo=runs/*/seed_0", "--method", "ppo=runs/ppo/*"], "as many runs in each task"),
        ([*METHODS, "--against", "rule"], "--against 'rule' is not a method; did you mean 'rules'?"),
        ([*METHODS, "--presets", "NadirScan"], "did you mean 'NadirScan-v1'"),
        ([*METHODS, "--draw", "a.bmp"], "--draw"),
    ],
)
def test_wrong_arguments_say_what_is_allowed(run, board, arguments, message):
    result = run("leaderboard", board, *arguments)
    assert result.exit_code == 1
    assert message in " ".join(result.output.split())


def test_suites_without_references_are_refused(run, tmp_path):
    path = tmp_path / "aeos.json"
    path.write_text(json.dumps({"format": 1, "suite": "aeosbench", "policies": {}}))
    result = run("leaderboard", path)
    assert result.exit_code == 1
    assert "the suite aeosbench has no references, so that its results have no scores" in " ".join(result.output.split())
    path.write_text(json.dumps({"format": 1, "suite": "v0", "policies": {}}))
    assert "suite='v0' is not a suite" in run("leaderboard", path).output
    path.write_text(json.dumps({"format": 1, "suite": "v1", "policies": {}}))
    assert "has no policies" in run("leaderboard", path).output


def test_columns_without_text_take_no_room(run, board, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    result = run("leaderboard", board, "--method", "rules=hasty")
    assert result.exit_code == 0, result.output
    assert "better than" not in result.output
    assert "same on Basilisk" not in result.output
    assert "optimality gap" in result.output
