"""Names on the command line: the list without torch, checks before torch is imported, and policies of the user's modules."""

import subprocess
import sys

import pytest

import bsk_torch
from bsk_torch._listed import LISTED, PLANNERS, RULES, makings
from bsk_torch.lab.planners import names
from bsk_torch.rl.policies import shared_policy

WITH_OPTIONS = {
    "Services-v1": dict(outlook=True),
    "ThreeSensors-v1": dict(as_set=True, outlook=True),
    "Walker4-v1": dict(as_set=True, outlook=True),
    "AEOSBench-v1": dict(candidates=True),
}
"""Options with which the other rules of a preset apply."""


def test_names_are_those_of_the_tables():
    assert set(RULES) == set(shared_policy.RULES)
    assert set(PLANNERS) == set(names.PLANNERS)
    assert makings().keys() <= LISTED.keys()


@pytest.mark.compiled
@pytest.mark.parametrize("preset", LISTED)
def test_rules_of_a_preset_are_those_that_fit(preset):
    if preset == "AEOSCity-v1":
        pytest.importorskip("pandas")
    fitting = {"random"}
    for options in [{}, WITH_OPTIONS[preset]] if preset in WITH_OPTIONS else [{}]:
        fitting |= set(shared_policy.shared_baselines(bsk_torch.make(preset, num_envs=1, **options)))
    assert fitting == {"random", *LISTED[preset].rules}


WRONG = {
    "eval farsigted": ["'farsigted'", "did you mean 'farsighted'"],
    "eval rulle": ["did you mean 'rule'?"],
    "eval qqqq --preset CWDocking-v1": ["those of CWDocking-v1: random, glide, pretrained"],
    "eval rule --preset NadirScn-v1": ["'NadirScn-v1' is not a preset", "'NadirScan-v1'"],
    "eval NadirScan-v1": ["it is a preset: name a policy first, such as pretrained"],
    "eval pretrained --preset HeteroCluster-v1": ["no pretrained policy", "cooperative", "bsk-torch train"],
    "eval rule plan:rolout": ["'plan:rolout' is not a planner", "'plan:rollout'"],
    "eval nowhere/runs/x": ["there is no folder 'nowhere/runs'"],
    "film nonsense/policy.pt": ["there is no folder 'nonsense'"],
    "view NadirScn-v1": ["neither a preset", "'NadirScan-v1'"],
    "train NadirScn-v1": ["'NadirScn-v1' is not a preset"],
    "bench farsigted": ["did you mean 'farsighted'"],
}
"""Command lines with wrong names, and what the messages contain."""


def test_names_are_checked_without_torch():
    code = (
        "import sys\n"
        "from bsk_torch.cli import app\n"
        f"for line in {list(WRONG)!r}:\n"
        "    try:\n"
        "        app(line.split())\n"
        "    except SystemExit as end:\n"
        "        assert end.code == 1, line\n"
        "    assert not {'torch', 'tensordict'} & set(sys.modules), line\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for message, words in zip(done.stderr.splitlines(), WRONG.values(), strict=True):
        assert all(word in message for word in words), message


MINE = """
import torch
from tensordict.nn import TensorDictModule

def enter(preset, make, text="1"):
    return make(time_limit=300.0), lambda observation: torch.full((len(observation),), int(text))

def policy(observation, action_mask):
    return action_mask.long().argmax(-1)

net = torch.nn.Linear(12, 4)

def wrong(preset, make):
    return 3
"""


@pytest.fixture
def mine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "own_policies.py").write_text(MINE)
    yield "own_policies"
    sys.modules.pop("own_policies", None)


@pytest.mark.compiled
def test_eval_compares_several_policies_of_the_users(run, mine):
    names = [f"{mine}:enter,2", f"{mine}:policy", f"{mine}:net"]
    result = run("eval", *names, "rule", "--seeds", "0:2", "--time-limit", 300, "--no-baselines")
    assert result.exit_code == 0, result.output
    assert [name for name in ("enter,2", "policy", "net", "rule") if name not in result.output] == []


@pytest.mark.compiled
@pytest.mark.parametrize("command", ["audit", "explain", "film"])
def test_other_commands_take_them_too(run, mine, command, tmp_path):
    more = {"audit": ["--seeds", "0:1", "--horizon", 60], "explain": ["--seeds", "0:2"], "film": ["--out", tmp_path / "a.gif"]}
    result = run(command, f"{mine}:policy", "--time-limit", 300, *more[command])
    assert result.exit_code == 0, result.output


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("wrong", "must return (env, policy)"),
        ("absent", "has no 'absent'"),
        ("MINE", "has no 'MINE'"),
    ],
)
def test_what_is_no_policy_is_one_line(run, mine, name, words):
    result = run("eval", f"{mine}:{name}", "--seeds", "0:1")
    assert result.exit_code == 1
    assert words in result.output
    assert len(result.output.splitlines()) == 1


@pytest.mark.compiled
@pytest.mark.parametrize(
    "arguments",
    [
        ("train", "NadirScan-v1", "options.sat_args.batteryStorageCapacity=500000", "--frames", 20),
        ("train", "NadirScan-v1", "options.sat_args.batteryStorageCapacity=500000", "--frames", 20, "--episodes", 0),
        ("eval", "rule", "--option", "sat_args={'batteryStorageCapacity': 500000}", "--seeds", "0:2"),
        ("audit", "rule", "--option", "sat_args={'oe': [1, 2]}"),
    ],
)
def test_arguments_that_only_a_draw_reveals_are_one_line(run, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    result = run(*arguments)
    assert result.exit_code == 1, result.output
    assert isinstance(result.exception, SystemExit)
    assert len(result.output.splitlines()) == 1, result.output
    if "batteryStorageCapacity" in str(arguments):
        assert "sat_args['storedCharge_Init']" in result.output
