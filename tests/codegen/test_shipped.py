"""Kernels that are built on one machine for others without a compiler."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torch._inductor import config
from typer.testing import CliRunner

from bsk_torch.cli import app, kernels
from bsk_torch.codegen import build, cache, shipped
from tests.codegen.test_kernel import SOURCE
from tests.support.refusals import check_refusals, refusal

pytestmark = [
    pytest.mark.compiled,
    pytest.mark.skipif(platform.machine() != "x86_64", reason="kernels are shipped between x86-64 machines only"),
]

PLAYS = """
import bsk_torch
for batch in (1, 5, 40):
    bsk_torch.make("NadirScan-v1", num_envs=batch, seed=1).rollout(30, break_when_any_done=False)
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder for shipped kernels; the cache does not exist yet."""
    monkeypatch.setenv("BSK_TORCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("BSK_TORCH_KERNELS", raising=False)
    monkeypatch.setattr(build, "LOADED", {})
    cache.sweep.cache_clear()
    return tmp_path / "kernels"


def ship(folder, isa=None, source=SOURCE):
    """Build a kernel for other machines; return the library's file."""
    with shipped.building(folder, isa) as target:
        build.load(source, "test kernel")
    (path,) = folder.glob(f"{target.isa}-*.so")
    return path


@pytest.fixture
def without_compiler(monkeypatch):
    """Another process of a machine that has no compiler."""

    def fail(name):
        raise RuntimeError("no compiler")

    monkeypatch.setattr(build, "LOADED", {})
    monkeypatch.setattr(build, "_command", fail)


@pytest.mark.parametrize("isa", shipped.can_run())
def test_shipped_kernels_need_no_compiler(isa, folder, monkeypatch, request):
    path = ship(folder, isa)
    assert os.stat(path).st_mode & 0o777 == shipped.READABLE
    request.getfixturevalue("without_compiler")
    check_refusals(refusal(lambda: build.load(SOURCE, "test kernel"), RuntimeError, "no compiler"))
    monkeypatch.setenv("BSK_TORCH_KERNELS", os.pathsep.join([str(folder.parent), str(folder)]))
    assert build.load(SOURCE, "test kernel").lanes_width() == 42
    assert not (folder.parent / "cache").exists()


def test_instructions_of_this_very_processor_are_not_used(monkeypatch, folder):
    seen = []
    monkeypatch.setattr(subprocess, "run", lambda command, **_: seen.append(command) or subprocess.CompletedProcess([], 1, ""))
    with shipped.building(folder, "default"), pytest.raises(RuntimeError, match="cannot compile"):
        build.load(SOURCE, "test kernel")
    (command,) = seen
    assert [part for part in command if part.startswith("-m")] == ["-march=x86-64"]


def test_kernels_of_other_sources_versions_and_instructions_are_not_found(folder, monkeypatch, without_compiler):
    parts = [SOURCE, "2.13.0"]
    names = {shipped.library_name(p, isa) for p in (parts, [SOURCE, "2.14.0"], ["other", "2.13.0"]) for isa in shipped.LEVELS}
    assert len(names) == 9


def test_damaged_libraries_are_not_used(folder, monkeypatch, caplog, request):
    path = ship(folder)
    content = bytearray(path.read_bytes())
    content[100] ^= 1
    path.unlink()  # not in place: this process has loaded the library, and runs its finaliser when it exits
    path.write_bytes(content)
    monkeypatch.setenv("BSK_TORCH_KERNELS", str(folder))
    request.getfixturevalue("without_compiler")
    check_refusals(refusal(lambda: build.load(SOURCE, "test kernel"), RuntimeError, "no compiler"))
    assert f"{path} is damaged" in caplog.text


def test_rejects_folders_that_are_missing_unsafe_or_empty(folder, monkeypatch):
    shared, empty = folder.with_name("shared"), folder.with_name("empty")
    shared.mkdir()
    shared.chmod(0o777)
    empty.mkdir()

    def load(place):
        monkeypatch.setenv("BSK_TORCH_KERNELS", str(place))
        build.load(SOURCE, "test kernel")

    with config.patch({"cpp.cxx": (None, "/nowhere/g++")}):
        check_refusals(
            refusal(lambda: load(""), RuntimeError, "BSK_TORCH_KERNELS", "bsk-torch build-kernels"),
            refusal(lambda: load(folder), FileNotFoundError, "BSK_TORCH_KERNELS", folder),
            refusal(lambda: load(shared), PermissionError, shared, "0777"),
            refusal(lambda: shipped.building(shared).__enter__(), PermissionError, shared, "0777"),
            refusal(lambda: load(empty), RuntimeError, "BSK_TORCH_KERNELS", empty, torch.__version__),
        )


def test_rejects_what_cannot_be_built(folder, monkeypatch):
    build_for = lambda *isa: shipped.building(folder, *isa).__enter__()
    check_refusals(refusal(lambda: build_for("sse"), ValueError, "isa='sse'", "["))
    monkeypatch.setattr(shipped.torch.backends.cpu, "get_cpu_capability", lambda: "AVX2")
    assert shipped.can_run() == ["avx2", "default"]
    check_refusals(refusal(lambda: build_for("avx512"), ValueError, "isa='avx512'"))
    monkeypatch.setattr(shipped.platform, "machine", lambda: "aarch64")
    check_refusals(refusal(build_for, ValueError, "x86-64", "aarch64"))
    assert not folder.exists()
    assert shipped.BUILDING.get() is None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["NadirScan-v2"], "'NadirScan-v2' is not a preset"), (["NadirScan-v1", "--isa", "sse"], "isa='sse' must be one of")],
)
def test_rejects_wrong_words_of_the_command(arguments, words, tmp_path):
    result = CliRunner().invoke(app, ["build-kernels", *arguments, "--out", str(tmp_path / "kernels")])
    assert result.exit_code == 1
    assert words in result.output
    assert not (tmp_path / "kernels").exists()


@pytest.mark.parametrize("presets", [["NadirScan-v1"], ["NadirScan-v1", "AEOSConstellation-v1"]], ids=["one", "two"])
@pytest.mark.nightly("two")
def test_the_command_plays_all_presets(tmp_path, monkeypatch, presets):
    """Without compiling; the whole command is a nightly test."""
    made, short = kernels.made, {"backend": "eager", "max_step_duration": 3.0}
    monkeypatch.setattr(kernels, "made", lambda preset, batch, options: made(preset, batch, options | short))
    monkeypatch.setattr(kernels, "LISTED", dict.fromkeys(presets))
    result = CliRunner().invoke(app, ["build-kernels", "--mixed", "--out", str(tmp_path / "kernels")])
    assert result.exit_code == 0, result.output
    assert all(f"{preset}: built for" in result.output for preset in presets)


@pytest.mark.nightly
def test_a_preset_plays_with_shipped_kernels_alone(tmp_path):
    """The command in its own process, without optimisation, which makes it short; then a machine without compiler."""
    out = tmp_path / "kernels"
    quick = "from bsk_torch.codegen import build; build.FLAGS += ('-O0',); from bsk_torch.cli import app; app()"
    built = run("-c", quick, "build-kernels", "NadirScan-v1", "--out", str(out))
    assert "NadirScan-v1: built for " in built
    played = f"from bsk_torch.codegen import build; build.FLAGS += ('-O0',){PLAYS}"
    run("-c", played, CXX="/nowhere/g++", BSK_TORCH_CACHE=str(tmp_path / "cache"), BSK_TORCH_KERNELS=str(out))
    assert not (tmp_path / "cache").exists()


def run(*arguments, **environment):
    """Run Python; return what it prints."""
    done = subprocess.run(
        [sys.executable, *arguments],
        env=os.environ | environment,
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
