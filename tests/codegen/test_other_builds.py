"""All presets give the numbers of the eager back end whatever compiler and instructions their kernels are built with."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from bsk_torch.presets import PRESETS
from tests.codegen.emulated import EMULATOR, TRIPLE
from tests.codegen.other_builds import LARGEST, differences

ROOT = Path(__file__).parents[2]

BUILDS = {
    "g++ avx512": ("g++", "avx512"),
    "g++ avx2": ("g++", "avx2"),
    "g++ plain": ("g++", "default"),
    "clang++ avx512": ("clang++", "avx512"),
    "clang++ avx2": ("clang++", "avx2"),
    "clang++ plain": ("clang++", "default"),
}
"""Compiler and ``BSK_TORCH_ISA`` of each build."""


def has(isa: str) -> bool:
    """Whether this processor has the instructions."""
    flags = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    return isa == "default" or {"avx512": "avx512f", "avx2": "avx2"}[isa] in flags


def played(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the driver with what a build needs."""
    command = [sys.executable, "-m", "tests.codegen.other_builds", *arguments]
    return subprocess.run(command, cwd=ROOT, env=os.environ | environment, capture_output=True, text=True)


@pytest.mark.nightly
def test_the_driver_compares_what_agents_see(tmp_path):
    run = played("NadirScan-v1", f"--eager={tmp_path}")
    assert run.returncode == 0, run.stderr
    assert run.stdout.startswith("NadirScan-v1 {")
    assert all(name in run.stdout for name in ("'observation'", "'reward'", "'duration'"))
    kept = torch.load(tmp_path / "NadirScan-v1.pt")
    kept[-1]["observation"] += 1e-6
    torch.save(kept, tmp_path / "NadirScan-v1.pt")
    assert differences("NadirScan-v1", tmp_path)["observation"] == pytest.approx(1e-6, rel=0.01)
    assert LARGEST < 1e-6


@pytest.fixture(scope="module")
def eager(tmp_path_factory):
    """Argument of the driver: the folder with what the eager back end shows, which is played once for all builds."""
    return f"--eager={tmp_path_factory.mktemp('eager')}"


@pytest.mark.parametrize("build", BUILDS)
@pytest.mark.nightly
def test_every_build_gives_the_numbers_of_the_eager_back_end(build, eager, tmp_path):
    compiler, isa = BUILDS[build]
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    if not has(isa):
        pytest.skip(f"this processor has no {isa}")
    run = played(*PRESETS, eager, CXX=compiler, BSK_TORCH_ISA=isa, BSK_TORCH_CACHE=str(tmp_path))
    assert run.returncode == 0, run.stdout + run.stderr
    assert len(run.stdout.splitlines()) == len(PRESETS)


@pytest.mark.parametrize("isa", ["avx512", "default"])
@pytest.mark.nightly
def test_sanitizers_find_nothing(isa, eager, tmp_path):
    """Kernels of all presets, with checks of addresses and of undefined behaviour."""
    if not has(isa):
        pytest.skip(f"this processor has no {isa}")
    runtime = ":".join(
        subprocess.run(["g++", f"-print-file-name={name}"], capture_output=True, text=True).stdout.strip()
        for name in ("libasan.so", "libubsan.so")
    )
    options = "detect_leaks=0:halt_on_error=1:abort_on_error=0:exitcode=77"
    environment = dict(CXX="g++", BSK_TORCH_ISA=isa, BSK_TORCH_CACHE=str(tmp_path), LD_PRELOAD=runtime, ASAN_OPTIONS=options)
    run = played(*PRESETS, eager, "--sanitize", **environment)
    assert run.returncode == 0, run.stdout + run.stderr
    assert len(run.stdout.splitlines()) == len(PRESETS)


@pytest.mark.parametrize("preset", ["NadirScan-v1", "AEOSPower-v1", "RelayConstellation-v1"])
@pytest.mark.nightly
def test_kernels_for_aarch64_give_the_numbers_of_the_eager_back_end(preset, eager, tmp_path):
    """In an emulator; these presets together have all components."""
    for program in (f"{TRIPLE}-g++", EMULATOR):
        if shutil.which(program) is None:
            pytest.skip(f"needs {program}: apt-get install g++-aarch64-linux-gnu qemu-user")
    run = played(preset, eager, "--aarch64", BSK_TORCH_CACHE=str(tmp_path))
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.startswith(preset)
