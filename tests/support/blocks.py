"""Runs the blocks of code of a page: README.md and the pages of the documentation."""

import re
import shlex
import shutil
from pathlib import Path
from typing import NamedTuple

from typer.testing import CliRunner

from bsk_torch.cli import app

ROOT = Path(__file__).parents[2]

SHORT = {
    "train": "--frames 32 num_envs=2 rollout=8 evaluate_every=32 evaluate_episodes=2 --episodes 2 --time-limit 120",
    "eval": "--seeds 0:2 --time-limit 300",
    "report": "--episodes 3",
    "export-aeosbench": "--time-limit 60",
    "import-aeosbench": "--time-limit 60",
    "list": "",
    "film": "--time-limit 300 --height 120",
    "view": "--time-limit 300",
    "schedule": "",
    "explain": "--seeds 0:1",
    "export-policy": "--time-limit 1200",
    "bench": "--episodes 1",
    "leaderboard": "",
    "dataset": "--seeds 0:4 --time-limit 1200",
    "args": "",
    "aeossp": "",
}
"""What makes a command short enough for a test; later options win over those of the page."""

ELSEWHERE = {
    "benchmarks/inspection_rules.py": "test_scripts.py",
    "examples/curriculum.py": "test_scripts.py",
    "examples/offline_cql.py": "test_scripts.py",
    "examples/ppo_cleanrl.py": "test_clients.py",
    "examples/ppo_sb3.py": "test_clients.py",
    "examples/share_intent.py": "test_clients.py",
}
"""Programs, and the tests that run them."""


class Block(NamedTuple):
    """A fenced block of a page: its language, its text, and the line of the page on which the text begins."""

    language: str
    code: str
    line: int

    @property
    def commands(self) -> list[list[str]]:
        """Words of each command, without comments; empty lines are left out."""
        lines = (shlex.split(line, comments=True) for line in self.code.replace("\\\n", " ").strip().splitlines())
        return [words for words in lines if words]


def blocks(path: Path, *languages: str) -> list[Block]:
    """Return the blocks of ``languages`` of a page, in order."""
    text = path.read_text()
    found = re.finditer(r"^```(\w+)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    parts = (Block(part[1], part[2], text.count("\n", 0, part.start()) + 2) for part in found)
    return [block for block in parts if block.language in languages]


def run_python(block: Block, path: Path, namespace: dict[str, object]) -> None:
    """Run a block of Python; a traceback shows the line of the page."""
    exec(compile("\n" * (block.line - 1) + block.code, str(path), "exec"), namespace)


def run_commands(block: Block) -> None:
    """Run the commands of a block in their short form."""
    for command in block.commands:
        _run(*command)


def _run(program: str, *arguments: str) -> None:
    if program == "python":
        assert Path(arguments[0]).name in (ROOT / "tests" / ELSEWHERE[arguments[0]]).read_text()
    elif program == "bsk-torch":
        seed = ["--seeds", "1"] if arguments[0] == "train" and "--seeds" in arguments else []  # several: tests/cli/test_train.py
        result = CliRunner().invoke(app, [*arguments, *SHORT[arguments[0]].split(), *seed])
        assert result.exit_code == 0, result.output
    else:
        assert shutil.which(str(ROOT / program)), f"{program} is missing or not executable"
