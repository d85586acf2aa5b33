"""Runs commands in process."""

import pytest
import torch
from typer.testing import CliRunner

from bsk_torch.cli import app


@pytest.fixture
def run():
    """Runs ``bsk-torch`` with the given arguments; gives output and exit code."""
    threads = torch.get_num_threads()
    yield lambda *arguments: CliRunner().invoke(app, [str(a) for a in arguments])
    torch.set_num_threads(threads)
