"""With ``BSK_TORCH_PORTABLE``, episodes and trained weights are the recorded ones, bit for bit: on this processor, too."""

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from bsk_torch._portable import SETTINGS, VARIABLE, choose_instructions
from tests.support.refusals import check_refusals, refusal

RECORDED = Path(__file__).with_name("portable.json")
"""Versions, and hashes that ``python -m tests.support.portable`` printed with them."""

VERSIONS = {"torch": torch.__version__, "numpy": np.__version__, "libc": platform.libc_ver()[1]}

FLAGS = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""


@pytest.mark.compiled
@pytest.mark.skipif(" avx2 " not in FLAGS or " fma " not in FLAGS, reason="this processor has no AVX2")
@pytest.mark.nightly("2")
@pytest.mark.parametrize("threads", [1, 2])
def test_the_bits_are_the_recorded_ones(threads):
    """With two threads, beside a program that leaves them no core for themselves."""
    recorded = json.loads(RECORDED.read_text())
    if recorded["versions"] != VERSIONS:
        pytest.skip(f"recorded with {recorded['versions']}, not {VERSIONS}")
    load = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(threads - 1)]
    command = [sys.executable, "-m", "tests.support.portable", str(threads)]
    run = subprocess.run(command, env=os.environ | {VARIABLE: "1"}, capture_output=True, text=True)
    for other in load:
        other.kill()
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout) == recorded["hashes"]


def test_rejects_numpy_that_has_chosen_its_instructions(monkeypatch):
    monkeypatch.setenv(VARIABLE, "1")
    monkeypatch.setenv("MKL_CBWR", "AVX2")
    check_refusals(refusal(choose_instructions, ImportError, VARIABLE, "NumPy", f"MKL_CBWR='{SETTINGS['MKL_CBWR']}'"))
    assert os.environ["MKL_CBWR"] == "AVX2"
