"""The scripts that train with other libraries run from end to end; what they learn in a moment is not looked at."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"

SHORT = ["--steps=200", "--num-envs=8", "--rollout=8", "--episodes=4", "--time-limit=900"]

pytestmark = pytest.mark.compiled


def needs(module, extra):
    return pytest.mark.skipif(find_spec(module) is None, reason=f"needs pip install {extra}")


def run(name, tmp_path, *arguments):
    command = [sys.executable, str(SCRIPTS / name), *SHORT, *arguments]
    return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)


@needs("sb3_contrib", "'bsk_torch[sb3]'")
def test_stable_baselines3(tmp_path):
    """Under a mask, which AEOSPower-v1's shield makes."""
    result = run("sb3_train.py", tmp_path, "--preset", "AEOSPower-v1", "--out", "model")
    assert result.returncode == 0, result.stderr
    rows = [line.split("|")[1].strip() for line in result.stdout.splitlines() if line.endswith("% |")]
    assert rows == ["MaskablePPO", "random", "greedy", "nearest", "hasty"]
    assert {path.name for path in (tmp_path / "model").iterdir()} == {"model.zip", "normalize.pkl"}


def test_cleanrl(tmp_path):
    result = run("cleanrl_ppo.py", tmp_path, "--out", "agent.pt")
    assert result.returncode == 0, result.stderr
    assert [line.split(":")[0].strip() for line in result.stdout.splitlines()] == ["random", "trained"]
    assert (tmp_path / "agent.pt").is_file()


@pytest.mark.slow
@needs("ray", "'ray[rllib]==2.60.0', in a virtual environment of its own")
def test_rllib(tmp_path):
    """Ray takes half a minute to start."""
    result = run("rllib_train.py", tmp_path, "--preset", "AEOSPower-v1", "--out", "checkpoint")
    assert result.returncode == 0, result.stderr
    assert "| RLlib PPO |" in result.stdout
    assert (tmp_path / "checkpoint" / "rllib_checkpoint.json").is_file()
