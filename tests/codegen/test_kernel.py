"""Kernels: what they compute, and how they are built, kept and loaded."""

import itertools
import logging
import math
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
import torch

from bsk_torch.codegen import build
from bsk_torch.codegen.trace import BINARY, COMPARISONS, ELEMENTARY, EXPONENTIAL, TRIGONOMETRIC
from bsk_torch.vec3 import only
from tests.codegen.columns import mapped
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

ISAS = ["", "avx2", "default"] if torch.backends.cpu.get_cpu_capability() in ("AVX2", "AVX512") else ["", "default"]
DTYPES = {"double": torch.float64, "float": torch.float32}
TOLERANCE = {"double": dict(rtol=1e-12, atol=0.0), "float": dict(rtol=1e-6, atol=0.0)}

NAN = math.nan
SPECIAL = [NAN, math.inf, -math.inf, 0.0, -0.0, 1.0, -1.0, 0.5, 2.5, -2.5, 7.0, 1e-30, -1e30]


def unary(name):
    return lambda a, b, c: getattr(torch, name)(a)


def binary(name):
    return lambda a, b, c: getattr(torch, name)(a, b)


def without_nan(b):
    return torch.where(torch.isnan(b), 0.25, b)


def nested(a, b, c):
    def inner():
        return only(b > 0.0, lambda: torch.sqrt(b) + torch.exp(c), torch.cos(b))

    return only(a > 0.0, inner, a)


def within(a, b, c):
    return torch.sqrt(a) * b


CASES = {
    **{name: unary(name) for name in (*ELEMENTARY, *EXPONENTIAL, *TRIGONOMETRIC)},
    **{name: binary(name) for name in (*BINARY, *COMPARISONS) if name not in ("minimum", "maximum", "fmod")},
    **{name: unary(name) for name in ("reciprocal", "rsqrt", "square", "isnan", "isinf", "isfinite", "deg2rad", "rad2deg")},
    **{name: unary(name) for name in ("zeros_like", "ones_like", "clone")},
    # only NaNs of the first argument are kept everywhere
    "minimum": lambda a, b, c: torch.minimum(a, without_nan(b)),
    "maximum": lambda a, b, c: torch.maximum(a, without_nan(b)),
    "minimum_of_number": lambda a, b, c: torch.minimum(a, torch.full_like(a, 0.3)),
    "clamp_below": lambda a, b, c: torch.clamp(a, min=-0.5),
    "clamp_above": lambda a, b, c: a.clamp(max=0.5),
    "clamp_both": lambda a, b, c: torch.clamp(a, -0.5, 0.75),
    "clamp_planes": lambda a, b, c: torch.clamp(a, min=-abs(c), max=abs(c)),
    # quotients of any size would need more than Sleef has
    "fmod": lambda a, b, c: torch.fmod(torch.clamp(a, -50.0, 50.0), 0.75),
    "remainder": lambda a, b, c: torch.clamp(a, -50.0, 50.0) % 0.75,
    "remainder_of_planes": lambda a, b, c: torch.remainder(torch.clamp(a, -50.0, 50.0), c),
    "operators": lambda a, b, c: (2.0 - a) * -b / (c + 3.0),
    "operators_with_numbers": lambda a, b, c: (1.0 / (abs(a) ** 2 + 0.5)) * (0.5 + b**3 * b),
    "full_like": lambda a, b, c: torch.full_like(a, -0.1),
    "atan2_of_zeros": lambda a, b, c: torch.atan2(torch.full_like(a, -0.0), torch.where(a > 0.0, 0.0, -0.0)),
    "infinity": lambda a, b, c: torch.where(a > b, torch.inf, -torch.inf),
    "nan": lambda a, b, c: torch.where(a > b, a, NAN),
    # masks
    "and": lambda a, b, c: (a > 0.0) & (b <= 0.5),
    "or": lambda a, b, c: (a > 0.0) | (b <= 0.5),
    "xor": lambda a, b, c: (a > 0.0) ^ (b <= 0.5),
    "not": lambda a, b, c: ~(a > 0.0),
    "and_true": lambda a, b, c: (a > 0.0) & True,
    "logical": lambda a, b, c: torch.logical_or(torch.logical_not(a), torch.logical_and(b, c > 0.0)),
    "equal_masks": lambda a, b, c: (a > 0.0) == (b > 0.0),
    "different_masks": lambda a, b, c: (a > 0.0) != (b > 0.0),
    "where": lambda a, b, c: torch.where(a > b, a + c, b),
    "where_of_numbers": lambda a, b, c: torch.where(a >= b, 1.0, 0.1) * c,
    "where_of_masks": lambda a, b, c: torch.where(a > 0.0, b > 0.0, c > 0.0),
    "mask_as_number": lambda a, b, c: (a > b).to(a.dtype) * c + (a < b).double(),
    "number_as_mask": lambda a, b, c: a.bool() & (b.to(torch.bool) | (c > 0.0)),
    "mask_times_number": lambda a, b, c: (a > b) * 0.1,
    # one type of number and another
    "float": lambda a, b, c: a.float(),
    "double": lambda a, b, c: a.double() / 3.0,
    "promoted": lambda a, b, c: a.float() * c.double(),
    "rounded": lambda a, b, c: (c.double() * 0.1).to(torch.float32) * 3.0,
    # regions
    "only": lambda a, b, c: only(a > 0.0, lambda: within(a, b, c), c),
    "only_never": lambda a, b, c: only(abs(a) < -1.0, lambda: within(a, b, c), c),
    "only_always": lambda a, b, c: only((a == a) | (a != a), lambda: within(a, b, c), c),
    "only_constant": lambda a, b, c: only(torch.ones_like(a) > 0.0, lambda: within(a, b, c), c),
    "only_nested": nested,
    "only_masks": lambda a, b, c: only(a > 0.0, lambda: b > c, b < c),
}


def samples():
    """Planes [3, n] with special numbers in all combinations, then common ones; n is no multiple of any width."""
    special = torch.tensor(list(itertools.product(SPECIAL, SPECIAL)), dtype=torch.float64).T
    generator = torch.Generator().manual_seed(5)
    x = torch.cat([special, 3.0 * torch.randn(2, 300 - special.shape[1] + 3, dtype=torch.float64, generator=generator)], 1)
    c = torch.randn(1, x.shape[1], dtype=torch.float64, generator=generator)
    return torch.cat([x, c]).float().double()


def results(isa, dtype):
    """What a kernel computes for every case, and what torch does."""

    def function(planes, _):
        a, b, c = (plane.to(DTYPES[dtype]) for plane in planes)
        return [case(a, b, c) for case in CASES.values()]

    with pytest.MonkeyPatch.context() as patch:
        if isa:
            patch.setenv("BSK_TORCH_ISA", isa)
        found = mapped(function, 3, 0, f"test of {isa or 'native'} {dtype}")(samples())
    expected = [y.double() for y in function(samples().unbind(0), [])]
    return zip(CASES, found, expected, strict=True)


def test_kernels_compute_what_torch_does():
    failures = []
    for isa, dtype in itertools.product(ISAS, DTYPES):
        for name, found, expected in results(isa, dtype):
            try:
                torch.testing.assert_close(found, expected, equal_nan=True, **TOLERANCE[dtype])
            except AssertionError as error:
                failures.append(f"{isa or 'native'} {dtype} {name}: {error}")
    assert not failures, "\n".join(failures)


def rounding(planes, shared):
    a, b, c, other = planes
    return [a * b + c, torch.abs(other * b) + c, torch.sin(shared[0]) * a, shared[1], a, a, torch.ones_like(a)]


@cache
def rounding_kernel(isa):
    with pytest.MonkeyPatch.context() as patch:
        if isa:
            patch.setenv("BSK_TORCH_ISA", isa)
        return mapped(rounding, 4, 2, "test of rounding")


@pytest.mark.parametrize("isa", ISAS)
def test_products_are_fused_into_sums_unless_abs_stands_between(isa):
    e = 2.0**-30
    x = torch.tensor([[1.0 + e], [1.0 - e], [-1.0], [1.0 + e]], dtype=torch.float64).expand(4, 20).contiguous()
    y = rounding_kernel(isa)(x, torch.zeros(2, dtype=torch.float64))
    if torch.backends.cpu.get_cpu_capability() == "AVX512" and isa != "default":
        assert (y[0] == -e * e).all()  # rounded once
    assert (y[1] == 0.0).all()  # rounded twice


def test_any_number_of_columns():
    failures = []
    for n in (*range(35), 1000):
        x, shared = torch.randn(4, n, dtype=torch.float64), torch.randn(2, dtype=torch.float64)
        y = rounding_kernel("")(x, shared)
        expected = torch.stack([value.expand(n) for value in rounding(x.unbind(0), shared.unbind(0))])
        wrong = [k for k, rows in enumerate(zip(y, expected, strict=True)) if not torch.allclose(*rows, rtol=1e-12, atol=1e-12)]
        if y.shape != (7, n) or wrong:
            failures.append(f"{n} columns: shape {tuple(y.shape)}, rows {wrong} differ")
    assert not failures, "\n".join(failures)


SOURCE = 'extern "C" int lanes_width() { return 42; }'


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty cache, of which this process has loaded nothing."""
    monkeypatch.setenv("BSK_TORCH_CACHE", str(tmp_path / "a cache"))
    monkeypatch.setattr(build, "LOADED", {})
    return tmp_path / "a cache"


def names(folder):
    return sorted(path.suffix or path.name for path in folder.iterdir())


@pytest.mark.parametrize("options", ["FLAGS", "GCC_FLAGS"])
def test_other_options_of_the_compiler_build_another_library(folder, monkeypatch, options):
    build.load(SOURCE, "test kernel")
    monkeypatch.setattr(build, options, (*getattr(build, options), "-DOTHER"))
    build.load(SOURCE, "test kernel")
    assert names(folder) == [".so", ".so"]


def test_libraries_are_kept(folder, monkeypatch, caplog):
    caplog.set_level(logging.INFO, logger="bsk_torch")
    assert (build.load(SOURCE, "test kernel").lanes_width(), names(folder)) == (42, [".so"])
    assert "compiling the test kernel" in caplog.text
    caplog.clear()
    assert build.load(SOURCE, "test kernel") is build.load(SOURCE, "test kernel")
    monkeypatch.setattr(build, "LOADED", {})
    assert build.load(SOURCE, "test kernel").lanes_width() == 42
    assert not caplog.text


def test_instructions_are_part_of_the_name(folder, monkeypatch):
    build.load(SOURCE, "test kernel")
    monkeypatch.setenv("BSK_TORCH_ISA", "default")
    build.load(SOURCE, "test kernel")
    assert names(folder) == [".so", ".so"]


@pytest.mark.parametrize(
    ("damage", "warning"),
    [
        (lambda name, content: content[: len(content) // 2], "damaged"),
        (lambda name, content: b"", "damaged"),
        (lambda name, content: content[:100] + b"?" + content[101:], "damaged"),
        (lambda name, content: content[:-32] + build._seal("other.so", content[:-32]), "damaged"),
        (lambda name, content: b"no library" + build._seal(name, b"no library"), "cannot be loaded"),
    ],
    ids=["cut", "empty", "changed", "of another name", "sealed"],
)
def test_damaged_libraries_are_built_again(folder, monkeypatch, caplog, damage, warning):
    caplog.set_level("WARNING")
    build.load(SOURCE, "test kernel")
    (library,) = folder.iterdir()
    elsewhere = folder.with_name("elsewhere")  # what this process has loaded must not change
    elsewhere.mkdir()
    damaged = elsewhere / library.name
    damaged.write_bytes(damage(library.name, library.read_bytes()))
    monkeypatch.setenv("BSK_TORCH_CACHE", str(elsewhere))
    for _ in range(2):
        monkeypatch.setattr(build, "LOADED", {})
        assert build.load(SOURCE, "test kernel").lanes_width() == 42
    others = [record for record in caplog.records if "compiling for this machine" not in record.message]
    assert [record.levelname for record in others] == ["WARNING"]
    assert warning in caplog.text
    assert str(damaged) in caplog.text
    assert (damaged.read_bytes(), names(elsewhere)) == (library.read_bytes(), [".so"])


def test_rejects_code_and_machines_that_cannot_compile(folder):
    from torch._inductor import config

    with (
        config.patch({"cpp.cxx": (None, "/missing/c++")}),
        pytest.raises(RuntimeError, match=r"test kernel needs a C\+\+ compiler, but /missing/c\+\+ .*CXX.*backend=\"eager\""),
    ):
        build.load(SOURCE, "test kernel")
    assert not folder.exists()
    with pytest.raises(RuntimeError, match=r"cannot compile the test kernel(.|\n)*nonsense(.|\n)*backend=\"eager\"") as caught:
        build.load("int nonsense(", "test kernel")
    (kept,) = folder.iterdir()
    assert str(kept) in str(caught.value)
    assert kept.read_text() == "int nonsense("


MISSING_OPENMP = [
    "/usr/bin/ld: cannot find -lomp: No such file or directory",  # clang 14 on Debian 12, without libomp-dev
    "ld.lld: error: unable to find library -lomp",
    "ld: library not found for -lomp",
    "ld: library 'omp' not found",
    "kernel.cpp:1:10: fatal error: 'omp.h' file not found",
]
OTHER_COMPLAINTS = ["/usr/bin/ld: cannot find -lm: No such file or directory", "fatal error: 'vector' file not found"]


@pytest.fixture
def complaining(folder, monkeypatch):
    """Makes the compiler a program that prints a complaint and fails, and returns the error of a build with it."""

    def error(complaint):
        compiler = folder.parent / "clang++"
        failing = f"cat <<'END' >&2\n{complaint}\nclang: error: linker command failed with exit code 1\nEND\nexit 1"
        compiler.write_text(f'#!/bin/sh\n[ "$1" = --version ] && echo "clang version 14.0.6" && exit 0\n{failing}\n')
        compiler.chmod(0o755)
        from torch._inductor import config

        with config.patch({"cpp.cxx": (None, str(compiler))}), pytest.raises(RuntimeError) as caught:
            build.load(SOURCE, "test kernel")
        return str(caught.value)

    return error


@pytest.mark.parametrize("complaint", MISSING_OPENMP)
def test_a_missing_library_of_openmp_is_named(complaining, complaint):
    message = complaining(complaint)
    assert "clang++ cannot compile the test kernel" in message
    assert complaint in message
    assert build.INSTALL_OPENMP in message
    assert "libomp-dev" in message


@pytest.mark.parametrize("complaint", OTHER_COMPLAINTS)
def test_other_complaints_are_repeated_without_that_advice(complaining, complaint):
    message = complaining(complaint)
    assert complaint in message
    assert "libomp" not in message


def test_rejects_what_cannot_be_built_loaded_or_kept(folder):
    def load(source=SOURCE, **environment):
        with pytest.MonkeyPatch.context() as patch:
            for name, value in environment.items():
                patch.setenv(name, str(value))
            build.load(source, "test kernel")

    in_file, in_device = (folder.with_name(name) / "cache" for name in ("file", "device"))
    in_file.parent.write_text("")
    in_device.parent.symlink_to("/dev/null")
    unloadable = 'extern "C" int missing_function(); extern "C" int lanes_width() { return missing_function(); }'
    check_refusals(
        refusal(lambda: load(BSK_TORCH_ISA="mmx"), ValueError, "BSK_TORCH_ISA", "mmx", *build.shipped.LEVELS),
        refusal(lambda: load(unloadable), RuntimeError, "test kernel", "missing_function", "BSK_TORCH_CACHE"),
        refusal(lambda: load(BSK_TORCH_CACHE=in_file), RuntimeError, "test kernel", in_file, "BSK_TORCH_CACHE"),
        refusal(lambda: load(BSK_TORCH_CACHE=in_device), RuntimeError, "test kernel", in_device, "BSK_TORCH_CACHE"),
    )


# Importing all of bsk_torch would take most of the time.
START = f"""
import sys, types
package = types.ModuleType("bsk_torch")
package.__path__ = [{str(Path(build.__file__).parents[1])!r}]
sys.modules["bsk_torch"] = package
from bsk_torch.codegen import build
"""

BUILD = f"""{START}
from torch._inductor import cpp_builder
print("ready", flush=True)
sys.stdin.readline()
print(build.load({SOURCE!r}, "test kernel").lanes_width())
"""

LOAD = f"""{START}
print(build.load({SOURCE!r}, "test kernel").lanes_width())
print([name for name in sys.modules if name.startswith(("torch._inductor", "torch._dynamo"))])
"""


def test_processes_that_start_at_once(folder):
    env = os.environ | {"BSK_TORCH_CACHE": str(folder), "BSK_TORCH_ISA": "default"}
    pipe = subprocess.PIPE
    processes = [
        subprocess.Popen([sys.executable, "-c", BUILD], env=env, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
        for _ in range(2)
    ]
    for process in processes:
        assert process.stdout.readline() == "ready\n", process.stderr.read()
    assert not folder.exists()
    for process in processes:
        process.stdin.write("go\n")
        process.stdin.flush()
    for process in processes:
        out, errors = process.communicate(timeout=120)
        assert (process.returncode, out) == (0, "42\n"), errors
    assert names(folder) == [".so"]
    later = subprocess.run(
        [sys.executable, "-c", LOAD], env=env | {"CXX": "/missing/c++"}, capture_output=True, text=True, timeout=120
    )
    assert later.stdout == "42\n[]\n", later.stderr


def test_the_wait_is_announced_once_for_each_folder(folder, monkeypatch, caplog):
    for number in (1, 2):
        build.load(SOURCE.replace("42", f"4{number}"), "test kernel")
    announced = [record for record in caplog.records if "compiling for this machine" in record.message]
    assert [record.levelname for record in announced] == ["WARNING"]
    assert str(folder) in announced[0].message
