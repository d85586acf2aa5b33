"""Compilation and cache of kernels.

A kernel is a shared library in the user's cache folder, or in ``BSK_TORCH_CACHE``; :mod:`bsk_torch.codegen.cache` says to whom it
may belong. Its name is a hash of its source, of torch's version, of the compiler's options and of the processor: a change of any
of these builds another library. The file ends with a hash of its name and of the library, so that a truncated file, or a library
under the name of another one, is built again instead of loaded.

The vector instructions are those that torch uses on this machine. ``BSK_TORCH_ISA`` names others: ``avx512``,
``avx2``, or ``default``, which means plain C++. It is meant for tests; the machine must have the named instructions.
Kernels built for other machines, :mod:`bsk_torch.codegen.shipped`, are looked for before the cache.
"""

from __future__ import annotations

import ctypes
import hashlib
import logging
import os
import platform
import re
import shlex
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch._portable import is_portable
from bsk_torch.codegen import prepared, shipped
from bsk_torch.codegen.cache import PRIVATE, build_folder, cache_folder, check_owner, read_trusted, sweep

if TYPE_CHECKING:
    from torch._inductor.cpu_vec_isa import VecISA

logger = logging.getLogger(__name__)

HEADERS = tuple(Path(__file__).with_name(name) for name in ("simd.h", "x86.h"))
"""The header that kernels include, and the one that it includes."""

INCLUDE = f'#include "{HEADERS[0].name}"'

FLAGS = ("-O2", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math", "-g0", "-w")
"""Options of the compiler behind inductor's, whose -O3 takes twice the time and makes no faster ticks; contraction fuses a
product and a sum into one rounding."""

GCC_FLAGS = ("-O1", "-fexpensive-optimizations", "-fira-region=one", "-fschedule-insns", "-fsched-pressure")
"""Options of GCC only. Ticks, which are vector instructions already, gain nothing by what -O2 does beyond the expensive
optimizations (contraction is one of them) and by registers allocated loop by loop, but compile in a quarter less time.
Scheduling with regard to register pressure makes them 10 % faster."""

PORTABLE_FLAGS = ("-ffp-contract=off",)
"""Options behind these for kernels with the same results on other processors, see :mod:`bsk_torch._portable`."""

IN_USE = {"AVX512": "avx512", "AVX2": "avx2"}
"""Instructions by what torch calls its own; on other processors torch's inductor chooses."""

SEALED = "name and code"
"""What the hash at the end of a library covers; part of its name, so that libraries sealed otherwise are not looked at."""

LOADED: dict[str, ctypes.CDLL] = {}
"""Libraries that this process has loaded, by the names of their files."""

WITHOUT = 'backend="eager" needs no compiler, but is slower.'

SHOWN_LINES = 15
"""Lines of the compiler's output that an error repeats."""

NO_OPENMP = re.compile(r"-lomp\b|library '?-?l?omp'? not found|\bomp\.h\b.*(not found|No such file)")
"""What linkers and clang say without OpenMP's library or header, which clang's packages do not bring and g++'s do."""

INSTALL_OPENMP = (
    "OpenMP's library for this compiler is missing. Install it (libomp-dev on Debian and Ubuntu, libomp-devel on Fedora, "
    "llvm-openmp with conda), or let CXX name g++, which has its own."
)


@cache
def processor() -> str:
    """Return a description of the processor: libraries of others may hold instructions that it does not have."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    described = sorted({line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))})
    return "\n".join([platform.machine(), platform.processor(), torch.backends.cpu.get_cpu_capability(), *described])


def entry(library: ctypes.CDLL, signature: str) -> Callable[..., None]:
    """Return the function ``run`` of a library.

    ``signature`` has a letter for each parameter: p for a contiguous tensor or None, i for an integer.
    """
    types: dict[str, type] = {"p": ctypes.c_void_p, "i": ctypes.c_int64}
    function = library.run
    function.argtypes, function.restype = [types[code] for code in signature], None

    def call(*args: Tensor | int | None) -> None:
        function(*[arg.data_ptr() if isinstance(arg, Tensor) else arg for arg in args])

    return call


def load(source: str, name: str) -> ctypes.CDLL:
    """Return the library of a kernel's source, compiled if the cache lacks it; ``name`` is its name in messages.

    Raises:
        FileNotFoundError: If a folder of shipped kernels is missing.
        PermissionError: If others own the cache folder, or one of shipped kernels, or may write to it.
        RuntimeError: Without a compiler, or a cache folder that can be written to.
    """
    headers, target = (header.read_text() for header in HEADERS), shipped.BUILDING.get()
    parts = [source, *headers, *_flags(), *GCC_FLAGS, torch.__version__, SEALED]
    if target is not None:
        path = target.folder / shipped.library_name(parts, target.isa)
    else:
        key = hashlib.sha256("\n".join([*parts, processor(), _chosen_isa()]).encode()).hexdigest()[:32]
        path = cache_folder() / f"{key}.so"
    if path.name not in LOADED:
        places = [path]
        if target is None:
            isas = [isa] if (isa := _chosen_isa()) else shipped.can_run()
            places = [*shipped.candidates(parts, isas), path]
        LOADED[path.name] = next((library for place in places if (library := _cached(place))), None) or _built(source, path, name)
    return LOADED[path.name]


# -- building ----------------------------------------------------------------------------------------------------------------


def _cached(path: Path) -> ctypes.CDLL | None:
    """Return the library in the cache, or None if it is missing, damaged or not to be trusted."""
    if not path.parent.exists():
        return None
    check_owner(path.parent)
    sweep(path.parent)
    content = read_trusted(path)
    if content is None:
        return None
    code, seal = content[:-32], content[-32:]
    if _seal(path.name, code) != seal:
        logger.warning("%s is damaged and will be built again", path)
        return None
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:
        logger.warning("%s cannot be loaded and will be built again: %s", path, error)
        return None


def _seal(name: str, code: bytes) -> bytes:
    return hashlib.sha256(name.encode() + code).digest()


@cache
def _announce(folder: Path) -> None:
    """Warn once that compilation takes time: a warning reaches users who have not configured logging, too."""
    logger.warning(
        "compiling for this machine, once: a satellite type takes about 15 s; kernels are kept in %s",
        folder,
        extra={"kernel_folder": str(folder)},
    )


def _built(source: str, path: Path, name: str) -> ctypes.CDLL:
    begin = time.perf_counter()
    _announce(path.parent)
    logger.info("compiling the %s", name, extra={"kernel": name})
    command = _command(name)
    try:
        _build(source, path, name, command)
    except OSError as error:
        raise RuntimeError(
            f"the {name} cannot be kept in {path.parent} ({error}); let BSK_TORCH_CACHE name a folder that can be written to. "
            f"{WITHOUT}"
        ) from error
    seconds = time.perf_counter() - begin
    logger.info("compiled the %s in %.1f s", name, seconds, extra={"kernel_seconds": seconds, "folder": str(path.parent)})
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:
        raise RuntimeError(
            f"{path}, the {name}, was built but cannot be loaded: {error}; BSK_TORCH_CACHE can name another folder"
        ) from error


def _build(source: str, path: Path, name: str, command: list[str]) -> None:
    """Compile in a temporary folder and move the library into place at once: several processes may start together."""
    path.parent.mkdir(mode=PRIVATE, parents=True, exist_ok=True)
    check_owner(path.parent)
    with build_folder(path.parent) as folder:
        code, library = folder / "kernel.cpp", folder / "kernel.so"
        code.write_text(source)
        run = _run(command, folder, path.parent)
        if run.returncode:
            source_file = path.with_suffix(".cpp")
            os.replace(code, source_file)
            complaint = "\n".join(run.stdout.splitlines()[-SHOWN_LINES:])
            advice = f"\n{INSTALL_OPENMP}" if NO_OPENMP.search(run.stdout) else ""
            raise RuntimeError(
                f"{command[0]} cannot compile the {name}:\n{complaint}{advice}\nThe source is kept in {source_file}. {WITHOUT}"
            )
        with library.open("ab") as file:
            file.write(_seal(path.name, library.read_bytes()))
        library.chmod(PRIVATE if shipped.BUILDING.get() is None else shipped.READABLE)  # whatever the umask is
        if path.is_dir():  # a file does not replace a folder; it goes with the folder of the build
            with suppress(FileNotFoundError):  # another process was faster
                os.replace(path, folder / "replaced")
        os.replace(library, path)


def _run(command: list[str], folder: Path, cache_dir: Path) -> subprocess.CompletedProcess[str]:
    gcc = shipped.BUILDING.get() is None and re.match(r"(.*-)?g\+\+(-\d+)?$", Path(command[0]).name)
    quick = prepared.faster(command, cache_dir, processor()) if gcc else None
    for attempt in [quick, command] if quick else [command]:
        run = subprocess.run(attempt, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
        if not run.returncode:
            break
    return run


def _command(name: str) -> list[str]:
    """Return the compiler and its arguments, which turn kernel.cpp of the working directory into kernel.so."""
    from torch._inductor import config, cpp_builder, exc

    try:
        compiler = cpp_builder.get_cpp_compiler()
    except (exc.InvalidCxxCompiler, OSError) as error:
        choices = config.cpp.cxx if isinstance(config.cpp.cxx, list | tuple) else [config.cpp.cxx]
        compilers = " or ".join(str(choice) for choice in choices if choice)
        raise RuntimeError(
            f"the {name} needs a C++ compiler, but {compilers} does not run here; install it or let CXX name another one"
            f"{_not_shipped()}. {WITHOUT}"
        ) from error
    flags = [*_flags(), *(GCC_FLAGS if cpp_builder.is_gcc() else ()), f"-I{shlex.quote(str(HEADERS[0].parent))}"]
    options = cpp_builder.CppTorchOptions(vec_isa=_vector_isa(), extra_flags=flags, compiler=compiler)
    command = shlex.split(cpp_builder.CppBuilder("kernel", ["kernel.cpp"], options).get_command_line())
    return shipped.portable(command, _chosen_isa()) if is_portable() or shipped.BUILDING.get() else command


def _flags() -> tuple[str, ...]:
    """Return the options of the compiler."""
    return (*FLAGS, *PORTABLE_FLAGS) if is_portable() else FLAGS


def _not_shipped() -> str:
    """Return what to say of a kernel that the folders of shipped ones lack, if there are such folders."""
    folders = os.environ.get(shipped.VARIABLE)
    if not folders:
        return f"; or let {shipped.VARIABLE} name a folder that 'bsk-torch build-kernels' has filled on another machine"
    return f"; {shipped.VARIABLE}={folders} has none for this satellite, torch {torch.__version__} and {shipped.can_run()}"


def _chosen_isa() -> str:
    if (target := shipped.BUILDING.get()) is not None:
        return target.isa
    isa = os.environ.get("BSK_TORCH_ISA", "")
    if isa not in ("", *shipped.LEVELS):
        raise ValueError(f"BSK_TORCH_ISA={isa} must be one of {', '.join(shipped.LEVELS)}")
    return isa


def _vector_isa() -> VecISA:
    """Return inductor's description of the vector instructions.

    Inductor's own choice compiles and loads ten libraries first, which takes as long as all kernels of a satellite.
    """
    from torch._inductor import cpu_vec_isa

    isas = {"avx512": cpu_vec_isa.VecAVX512(), "avx2": cpu_vec_isa.VecAVX2(), "default": cpu_vec_isa.invalid_vec_isa}
    isa = _chosen_isa() or IN_USE.get(torch.backends.cpu.get_cpu_capability(), "")
    return isas[isa] if isa else cpu_vec_isa.pick_vec_isa()
