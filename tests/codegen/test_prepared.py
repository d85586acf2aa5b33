"""Headers that are compiled and a library that is linked once for all kernels of a cache."""

import os
import shutil
import subprocess
import sys
import time

import pytest

from bsk_torch.codegen import build, prepared
from tests.codegen.test_kernel import SOURCE

pytestmark = [
    pytest.mark.compiled,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only made for GCC on Linux"),
]

SINE = """#include "simd.h"
using namespace lanes;
extern "C" void run(double* x) { D(V::loadu(x).sin()).store(x); }
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A cache that does not exist yet, in which this process has built nothing."""
    monkeypatch.setenv("BSK_TORCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(build, "LOADED", {})
    return tmp_path / "cache"


def load(number):
    return build.load(SOURCE.replace("42", str(number)), "test kernel").lanes_width()


def made(folder):
    return list(folder.glob(f"{prepared.FOLDERS}*"))


def test_the_third_kernel_prepares_what_it_and_later_ones_use(folder, monkeypatch):
    commands, run = [], subprocess.run
    monkeypatch.setattr(subprocess, "run", lambda command, **options: commands.append(command) or run(command, **options))
    assert [load(1), load(2)] == [1, 2]
    assert not made(folder)
    assert [load(3), load(4)] == [3, 4]
    (place,) = made(folder)
    assert {path.name for path in place.iterdir()} == {"standard.h", "standard.h.gch", "libtorch_cpu.so"}
    assert place.stat().st_mode & 0o077 == 0
    builds = [command for command in commands if "kernel.so" in command]
    assert [str(place / "standard.h") in command for command in builds] == [False, False, True, True]
    assert len(list(folder.glob("*.so"))) == 4


@pytest.fixture
def ready(folder, monkeypatch):
    """A cache with what is prepared, and a kernel."""
    monkeypatch.setattr(prepared, "PAYS_FROM", 0)
    load(1)
    (place,) = made(folder)
    return place


@pytest.mark.parametrize("damage", ["truncated", "missing", "empty"])
@pytest.mark.nightly("empty")
def test_builds_go_on_where_it_is_damaged(ready, damage):
    headers = ready / "standard.h.gch"
    if damage == "truncated":
        headers.write_bytes(headers.read_bytes()[:5000])
    for path in ready.iterdir() if damage == "missing" else [headers] if damage == "empty" else []:
        path.write_bytes(b"") if damage == "empty" else path.unlink()
    assert load(2) == 2


def test_kernels_are_the_same_and_find_the_functions_of_torch(ready, tmp_path):
    (tmp_path / "kernel.cpp").write_text(SINE)
    command = build._command("test kernel")
    quick = prepared.faster(command, ready.parent, build.processor())
    assembly = []
    for words in (command, quick):
        subprocess.run([*("kernel.s" if word == "kernel.so" else word for word in words), "-S"], cwd=tmp_path, check=True)
        assembly.append((tmp_path / "kernel.s").read_text())
    assert "sin" in assembly[0].lower()
    assert assembly[0] == assembly[1]
    used = subprocess.run([*quick, "-Winvalid-pch", "-H"], cwd=tmp_path, capture_output=True, text=True, check=True).stderr
    assert used.startswith(f"! {ready / 'standard.h'}.gch")
    build.load(SINE, "test kernel")  # resolves the sine


def test_headers_that_others_may_write_to_are_not_used(ready, caplog):
    ready.chmod(0o777)
    assert load(2) == 2
    assert "precompiled headers are not used" in caplog.text
    assert "may be written to by other users" in caplog.text


@pytest.mark.parametrize("age", [0.0, 2.0 * prepared.UNUSED])
def test_headers_of_other_compilers_are_deleted_once_unused(ready, monkeypatch, age):
    """Processes with other options share a cache: what one of them uses stays."""
    last = time.time() - age
    os.utime(ready, (last, last))
    prepared._prepare.cache_clear()
    monkeypatch.setattr(prepared, "_key", lambda command, machine: "other")
    assert load(2) == 2
    assert {path.name for path in made(ready.parent)} == {"prepared-other", *(() if age else (ready.name,))}


def test_a_cache_that_another_process_empties_is_filled_again(ready, monkeypatch):
    is_dir = type(ready).is_dir
    monkeypatch.setattr(type(ready), "is_dir", lambda path: path == ready or is_dir(path))
    shutil.rmtree(ready)
    assert load(2) == 2


def test_without_it_kernels_are_built_all_the_same(folder, monkeypatch, caplog):
    monkeypatch.setattr(prepared, "PAYS_FROM", 0)
    monkeypatch.setattr(prepared, "INCLUDES", "#error no headers")
    prepared._prepare.cache_clear()
    with caplog.at_level("INFO", logger="bsk_torch"):
        assert [load(1), load(2)] == [1, 2]
    assert "headers are not precompiled" in caplog.text
    assert not made(folder)
