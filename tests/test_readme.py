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
COMMANDS = [line.split("#")[0].strip() for language, code in BLOCKS if language == "bash" for line in code.strip().splitlines()]

SHORT = {
    "train": "--frames 16 --num-envs 2 --episodes 2 --time-limit 300 --backend eager",
    "evaluate": "--time-limit 300 --backend eager --episodes 2",
    "list": "",
    "scripts/train_constellation.py": "--minutes 0.02 --num-envs 4 --rollout 16 --episodes 2 --time-limit 300",
    "scripts/share_intent.py": "--minutes 0.02 --episodes 2 --time-limit 300",
}
"""What makes a command of the README short enough for a test; later options win over the README's."""


@pytest.mark.compiled
@pytest.mark.parametrize("code", PYTHON, ids=[f"block{k}" for k in range(len(PYTHON))])
def test_python(code, capsys):
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})
    assert "Traceback" not in capsys.readouterr().out


@pytest.mark.parametrize("command", COMMANDS)
def test_commands(command, tmp_path, monkeypatch):
    program, *arguments = command.split()
    monkeypatch.chdir(tmp_path)
    if program == "python":
        command = [sys.executable, str(ROOT / arguments[0]), *arguments[1:], *SHORT[arguments[0]].split()]
        subprocess.run(command, check=True, capture_output=True, text=True)
        return
    if program != "bsk-torch":
        script = ROOT / program
        assert script.exists()
        assert shutil.which(str(script)), f"{program} is not executable"
        return
    result = CliRunner().invoke(app, [*arguments, *SHORT[arguments[0]].split()])
    assert result.exit_code == 0, result.output


def test_figures_are_filled_in():
    assert "@@" not in README
