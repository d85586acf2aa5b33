"""Kernels for another processor, which an emulator runs: each call of a kernel is a process of qemu.

Kernels use headers of torch only, so that a cross compiler builds them, as plain C++ with what torch's vectors are there, into
programs without shared libraries. A program reads the arguments of a call and writes what its pointers lead to.
"""

import ctypes
import hashlib
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path

from torch import Tensor

from bsk_torch.codegen import build

TRIPLE, EMULATOR = "aarch64-linux-gnu", "qemu-aarch64"
"""Prefix of the cross compiler's name, and the emulator; Debian's packages g++-aarch64-linux-gnu and qemu-user."""

MAIN = r"""
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <utility>

namespace {
struct Argument {
  int64_t kind, value;  // kind 0: null pointer, 1: integer, 2: pointer to so many bytes
  void* bytes;
  operator int64_t() const { return value; }
  template <typename T> operator T*() const { return static_cast<T*>(bytes); }
};

template <typename... Types, size_t... K>
void call(void (*function)(Types...), const Argument* given, std::index_sequence<K...>) {
  function(static_cast<Types>(given[K])...);
}

template <typename... Types>
int serve(void (*function)(Types...)) {
  Argument given[sizeof...(Types)];
  for (Argument& one : given) {
    one.bytes = nullptr;
    if (fread(&one.kind, 8, 1, stdin) != 1 || fread(&one.value, 8, 1, stdin) != 1) return 1;
    if (one.kind < 2) continue;
    one.bytes = aligned_alloc(64, (one.value + 127) / 64 * 64);
    if (fread(one.bytes, 1, one.value, stdin) != size_t(one.value)) return 2;
  }
  call(function, given, std::index_sequence_for<Types...>());
  for (const Argument& one : given)
    if (one.kind == 2 && fwrite(one.bytes, 1, one.value, stdout) != size_t(one.value)) return 3;
  return 0;
}
}  // namespace

int main(int count, char**) {
  if (count > 1) return printf("%d", lanes_width()) < 0;
  return serve(run);
}
"""


class Emulated:
    """A kernel's program, in the place of its library."""

    def __init__(self, program: Path) -> None:
        self.program = program

    def run(self, *arguments: str, given: bytes = b"") -> bytes:
        done = subprocess.run([EMULATOR, str(self.program), *arguments], input=given, capture_output=True)
        assert done.returncode == 0, (done.returncode, done.stderr[-1000:])
        return done.stdout

    def lanes_width(self) -> int:
        return int(self.run("width"))


def load(source: str, name: str) -> Emulated:
    """In the place of :func:`bsk_torch.codegen.build.load`."""
    from torch.utils.cpp_extension import include_paths

    whole = source + MAIN
    program = build.cache_folder() / hashlib.sha256((whole + build.HEADERS[0].read_text()).encode()).hexdigest()[:32]
    if not program.exists():
        program.parent.mkdir(parents=True, exist_ok=True)
        code = program.with_suffix(".cpp")
        code.write_text(whole)
        includes = [f"-I{folder}" for folder in (build.HEADERS[0].parent, *include_paths())]
        command = [f"{TRIPLE}-g++", "-std=c++20", "-O2", "-fopenmp", "-static", *build.FLAGS, *includes, str(code)]
        done = subprocess.run([*command, "-o", str(program)], capture_output=True, text=True)
        assert done.returncode == 0, f"{name}: {done.stderr[-4000:]}"
    return Emulated(program)


def entry(program: Emulated, signature: str) -> Callable[..., None]:
    """In the place of :func:`bsk_torch.codegen.build.entry`."""

    def call(*given: Tensor | int | None) -> None:
        assert len(given) == len(signature)
        parts, places = [], []
        for value in given:
            if isinstance(value, Tensor):
                size = value.untyped_storage().nbytes() - value.storage_offset() * value.element_size()
                parts += [struct.pack("=qq", 2, size), ctypes.string_at(value.data_ptr(), size)]
                places.append((value.data_ptr(), size))
            else:
                parts.append(struct.pack("=qq", value is not None, value or 0))
        answer, start = program.run(given=b"".join(parts)), 0
        assert len(answer) == sum(size for _, size in places)
        for place, size in places:
            ctypes.memmove(place, answer[start : start + size], size)
            start += size

    return call


def install() -> None:
    """Let all kernels that this process builds from now on run in the emulator."""
    build.load, build.entry = load, entry  # type: ignore[assignment]
