"""Every block of the README runs."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bsk_torch.cli import app

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", README, re.DOTALL)
PYTHON = [code for language, code in BLOCKS if language == "python"]
SHELL = [[line.split("#")[0].strip() for line in code.strip().splitlines()] for language, code in BLOCKS if language == "bash"]

SHORT = {
    "train": "--frames 32 num_envs=2 rollout=8 evaluate_every=16 evaluate_episodes=2 --episodes 2 --time-limit 300",
    "eval": "--seeds 0:2 --time-limit 300",
    "report": "--episodes 3",
    "list": "",
    "schedule": "",
    "examples/share_intent.py": "--minutes 0.02 --episodes 2 --time-limit 300",
}
"""What makes a command of the README short enough for a test; later options win over the README's."""

ELSEWHERE = {"examples/ppo_sb3.py": "test_clients.py", "examples/ppo_cleanrl.py": "test_clients.py"}
"""What other tests run."""


@pytest.mark.compiled
@pytest.mark.parametrize("code", PYTHON, ids=[f"block{k}" for k in range(len(PYTHON))])
def test_python(code, tmp_path, monkeypatch):
    """No exception; what is printed is not compared."""
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})


@pytest.mark.compiled
@pytest.mark.parametrize("commands", SHELL, ids=[block[0].split()[0] + f"{k}" for k, block in enumerate(SHELL)])
def test_commands(commands, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for command in commands:
        run(*command.split())


def run(program, *arguments):
    """A command in its short form."""
    if program == "python" and arguments[0] in ELSEWHERE:
        assert Path(arguments[0]).name in (ROOT / "tests" / ELSEWHERE[arguments[0]]).read_text()
    elif program == "python":
        command = [sys.executable, str(ROOT / arguments[0]), *arguments[1:], *SHORT[arguments[0]].split()]
        subprocess.run(command, check=True, capture_output=True, text=True)
    elif program == "bsk-torch":
        result = CliRunner().invoke(app, [*arguments, *SHORT[arguments[0]].split()])
        assert result.exit_code == 0, result.output
    else:
        assert shutil.which(str(ROOT / program)), f"{program} is missing or not executable"


def test_figures_are_filled_in():
    assert "@@" not in README
