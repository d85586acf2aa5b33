"""The examples run from end to end at their smallest size; what they learn in a moment is not tested."""

import json
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest

from bsk_torch import make
from tests.support.programs import run_script

EXAMPLES = Path(__file__).parents[1] / "examples"

ONE = ["--steps=200", "--num-envs=8", "--rollout=8", "--episodes=4", "--time-limit=900"]
"""Smallest size of a training with one satellite."""

RULES = ["random", "greedy", "nearest", "hasty", "farsighted"]

pytestmark = pytest.mark.compiled


def needs(module, extra):
    return pytest.mark.skipif(find_spec(module) is None, reason=f"needs pip install {extra}")


def run(name, tmp_path, *arguments):
    command = [*map(str, arguments)]
    if find_spec("matplotlib") is not None:  # the environment of RLlib has no extra viz
        command += ["--figure", "picture.png"]
    result = run_script(EXAMPLES / name, *command, folder=tmp_path, environment={})
    assert result.returncode == 0, result.stderr
    assert "--figure" not in command or (tmp_path / "picture.png").is_file()
    return result.stdout


def first_column(output):
    """Entries of the first column of the table that an example prints, without its head."""
    rows = [line.split("|")[1].strip() for line in output.splitlines() if line.startswith("| ")]
    return [row for row in rows if row not in ("policy", "---")]


@needs("sb3_contrib", "'bsk_torch[sb3]'")
def test_stable_baselines3(tmp_path):
    """Under a mask, which AEOSPower-v1's shield makes."""
    assert first_column(run("ppo_sb3.py", tmp_path, *ONE, "--algorithm", "dqn", "--out", "dqn")) == [
        "DQN",
        "random",
        "rule",
        "cautious",
    ]
    output = run("ppo_sb3.py", tmp_path, *ONE, "--preset", "AEOSPower-v1", "--out", "model")
    assert first_column(output) == ["MaskablePPO", *RULES]
    assert {path.name for path in (tmp_path / "model").iterdir()} == {"model.zip", "normalize.pkl"}
    from examples.ppo_sb3 import entrant  # here, where its packages are installed

    env, policy = entrant("AEOSPower-v1", partial(make, "AEOSPower-v1", num_envs=2), str(tmp_path / "model"))
    assert policy(env.reset())["action"].shape == (2,)
    assert entrant("NadirScan-v1", partial(make, "NadirScan-v1", num_envs=2), str(tmp_path / "model")) is None
    assert entrant("MultiInspection-v1", partial(make, "MultiInspection-v1", num_envs=2), str(tmp_path / "model")) is None


@pytest.mark.parametrize("learner", ["ppo", "dqn", "sac"])
def test_torchrl(tmp_path, learner):
    """Under a mask, which AEOSPower-v1's shield makes."""
    output = run("learners_torchrl.py", tmp_path, *ONE, "--preset", "AEOSPower-v1", "--learner", learner)
    assert first_column(output) == [learner, *RULES]


def test_cleanrl(tmp_path):
    output = run("ppo_cleanrl.py", tmp_path, *ONE, "--out", "agent.pt")
    assert [line.split(":")[0].strip() for line in output.splitlines()] == ["random", "trained"]
    assert (tmp_path / "agent.pt").is_file()


@pytest.mark.rllib
def test_rllib(tmp_path):
    """Ray takes half a minute to start."""
    output = run("ppo_rllib.py", tmp_path, *ONE, "--preset", "AEOSPower-v1", "--out", "checkpoint")
    assert first_column(output) == ["RLlib PPO", *RULES]
    assert (tmp_path / "checkpoint" / "rllib_checkpoint.json").is_file()
    from examples.ppo_rllib import entrant  # here, where its packages are installed

    env, policy = entrant(
        "AEOSPower-v1", partial(make, "AEOSPower-v1", num_envs=2, backend="eager"), str(tmp_path / "checkpoint")
    )
    assert policy(env.reset())["action"].shape == (2,)
    assert (
        entrant("NadirScan-v1", partial(make, "NadirScan-v1", num_envs=2, backend="eager"), str(tmp_path / "checkpoint")) is None
    )


@needs("benchmarl", "--no-deps benchmarl==1.5.2")
def test_benchmarl(tmp_path):
    sizes = ("--iterations=1", "--num-envs=4", "--rollout=8", "--n-targets=200", "--time-limit=600", "--episodes=2")
    output = run("mappo_benchmarl.py", tmp_path, *sizes, "--algorithm", "ippo", "--out", "logs", "--policy", "policy.pt")
    assert first_column(output) == ["ippo", *RULES, "untrained"]
    assert any((tmp_path / "logs").iterdir())
    from examples.mappo_benchmarl import entrant  # here, where its packages are installed

    small = partial(make, "Constellation-v1", num_envs=2, n_satellites=4, n_planes=2, n_targets=200)
    env, policy = entrant("Constellation-v1", small, str(tmp_path / "policy.pt"))
    assert policy(env.reset())["agents", "action"].shape == (2, 4)
    assert entrant("AEOSConstellation-v1", small, str(tmp_path / "policy.pt")) is None


def test_sharing(tmp_path):
    sizes = ("--minutes=0.02", "--num-envs=4", "--n-satellites=3", "--n-targets=500", "--time-limit=400", "--episodes=2")
    output = run("share_intent.py", tmp_path, *sizes, "--out", "results")
    assert first_column(output) == ["trained alone", "greedy"] * 4
    kept = json.loads((tmp_path / "results" / "share_intent.json").read_text())
    assert set(kept) == {"trained alone", "greedy"}
    assert {name: len(returns) for name, returns in kept["greedy"].items()}["none"] == 2
