"""Every command takes every kind of policy: a table of kinds and commands, on small policies that the libraries write."""

import functools
import json
from importlib.util import find_spec

import pytest
import torch

from bsk_torch.cli import main
from bsk_torch.cli.main import loaded
from tests.support.outside_policies import (
    ACTIONS,
    MODULE,
    OBSERVED,
    TEAM,
    MaskedNet,
    Net,
    exported,
    onnx_model,
    write_experiment,
    write_own,
    write_rllib,
    write_sb3,
)

pytestmark = pytest.mark.compiled

SHORT = ("--time-limit", "180")
FEW = ("--episodes", "20", "--repetitions", "4", "--num-envs", "20", "--time-limit", "60", "--smallest", "0.5")

COMMANDS = {
    "eval": lambda policy, out: ("eval", policy, "--seeds", "0:2", "--no-baselines", "--trust", *SHORT),
    "audit": lambda policy, out: ("audit", policy, "--seeds", "0:1", "--trust", *SHORT),
    "explain": lambda policy, out: ("explain", policy, "--seeds", "0:2", "--num-envs", "2", "--trust", *SHORT),
    "risk": lambda policy, out: ("risk", policy, "--trust", *FEW),
    "film": lambda policy, out: ("film", policy, "--out", out / "a.gif", "--height", "120", "--trust", *SHORT),
    "view": lambda policy, out: ("view", "NadirScan-v1", "--policy", policy, "--out", out / "a.bskview", "--trust", *SHORT),
    "export": lambda policy, out: ("export", "NadirScan-v1", "--policy", policy, "--out", out / "a.csv", "--trust", *SHORT),
    "bench": lambda policy, out: ("bench", policy, "--presets", "NadirScan-v1", "--episodes", "1", "--trust"),
    "dataset": lambda policy, out: (
        *("dataset", "NadirScan-v1", "--out", out / "data", "--behavior", policy, "--target", "rule"),
        *("--seeds", "0:1", "--trust", *SHORT),
    ),
}

PACKAGES = {
    "sb3": ("sb3_contrib", "'bsk_torch[sb3]'"),
    "maskable": ("sb3_contrib", "'bsk_torch[sb3]'"),
    "unpickled": ("sb3_contrib", "'bsk_torch[sb3]'"),
    "onnx": ("onnxruntime", "'bsk_torch[onnx]'"),
    "benchmarl": ("benchmarl", "--no-deps benchmarl==1.5.2"),
}


def written(kind, folder):
    """What names a new policy of a kind on the command line."""
    folder.mkdir()
    match kind:
        case "run":
            return write_own(folder / "policy.pt").parent
        case "file":
            return write_own(folder / "own.pt")
        case "rule" | "pretrained":
            return kind
        case "planner":
            return "plan:rollout,base=rule,horizon=60"
        case "function" | "object" | "entrant":
            return "my_kinds:" + {"function": "best_legal", "object": "network", "entrant": "enter"}[kind]
        case "python file":
            return f"{folder.parent}/my_kinds.py:best_legal"
        case "sb3":
            return write_sb3(folder / "ppo.zip")
        case "maskable":
            return write_sb3(folder / "masked.zip", "MaskablePPO")
        case "unpickled":
            return write_sb3(folder / "m.zip", policy_kwargs={"net_arch": [8], "activation_fn": torch.nn.Hardtanh})
        case "onnx":
            (folder / "net.onnx").write_bytes(onnx_model(torch.eye(OBSERVED, ACTIONS)))
            return folder / "net.onnx"
        case "export":
            (folder / "net.pt2").write_bytes(exported(MaskedNet()))
            return folder / "net.pt2"
        case "module":
            torch.save(Net(), folder / "net.pt")
            return folder / "net.pt"
        case "rllib":
            return write_rllib(folder / "module")
    return write_experiment(folder)


KINDS = (
    *("run", "file", "rule", "pretrained", "planner", "function", "object", "entrant", "python file", "sb3", "maskable"),
    *("unpickled", "onnx", "export", "module", pytest.param("rllib", marks=pytest.mark.rllib)),
)


@pytest.fixture(scope="session")
def policies(tmp_path_factory):
    root = tmp_path_factory.mktemp("kinds")
    (root / "my_kinds.py").write_text(MODULE)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(root)
        yield functools.cache(lambda kind: written(kind, root / kind))


@pytest.fixture
def policy(request, policies):
    module, package = PACKAGES.get(request.param, ("torch", ""))
    if find_spec(module) is None:
        pytest.skip(f"needs pip install {package}")
    return request.param, policies(request.param)


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("policy", KINDS, indirect=True)
def test_every_command_takes_every_kind(run, policy, command, tmp_path):
    kind, named = policy
    result = run(*COMMANDS[command](named, tmp_path))
    if kind == "planner" and command in ("audit", "risk"):  # which fly the policy in copies of its environment
        assert "plans in its own environment" in result.output
        return
    assert result.exit_code == 0, result.output


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("policy", ["benchmarl"], indirect=True)
@pytest.mark.parametrize("command", ["eval"])
def test_commands_for_constellations_take_experiments_of_benchmarl(run, policy, command, tmp_path):
    options = [text for name, value in TEAM.items() for text in ("--option", f"{name}={value}")]
    result = run(*COMMANDS[command](policy[1], tmp_path), "--preset", "Constellation-v1", *options)
    assert result.exit_code == 0, result.output


def test_results_say_which_library_made_a_policy(run, policies, tmp_path):
    pytest.importorskip("sb3_contrib", reason="needs pip install 'bsk_torch[sb3]'")
    out, board = tmp_path / "bench.json", tmp_path / "board.json"
    result = run("bench", policies("sb3"), "rule", "--presets", "NadirScan-v1,AEOS-v1", "--episodes", "1", "--out", out)
    assert result.exit_code == 0, result.output
    assert "is not for AEOS-v1: the model" in result.output
    played = json.loads(out.read_text())["policies"]
    assert played[str(policies("sb3"))]["NadirScan-v1"]["library"].startswith("stable-baselines3 2.")
    assert played["rule"]["NadirScan-v1"]["library"].startswith("bsk_torch ")
    result = run("leaderboard", out, "--presets", "NadirScan-v1", "--out", board)
    assert result.exit_code == 0, result.output
    assert json.loads(board.read_text())["methods"][str(policies("sb3"))]["library"][0].startswith("stable-baselines3 2.")


def test_all_commands_that_take_policies_have_the_option():
    names = {name: {parameter.name for parameter in loaded(name).params} for name in main.COMMANDS}
    takers = {name for name, own in names.items() if own & {"policy", "policies", "behavior"}}
    takers.remove("export-policy")  # which writes networks of this package
    assert takers == {*COMMANDS, "export-aeosbench"}
    assert all("trust" in names[name] for name in takers)
