"""The next eclipse of each satellite, by a kernel: a search of a few numbers, for which torch needs forty operations."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from pathlib import Path

from torch import Tensor

from bsk_torch.codegen.build import entry, load
from bsk_torch.sim.access.windows.next_windows import check_times

SOURCE = Path(__file__).with_name("next_eclipses.cpp")

SIGNATURE = "ip" + "pipi" + "ppp" + "pp" + "ppp"


@cache
def next_eclipses_kernel() -> Callable[..., None]:
    """Return the kernel, built or loaded when it is first needed."""
    return entry(load(SOURCE.read_text(), "search for the next eclipses"), SIGNATURE)


def next_eclipses(
    constants: Tensor,
    starts: Tensor,
    ends: Tensor,
    time: Tensor,
    begun: Tensor | None,
    reached: Tensor | None,
    sampled: Tensor,
    known: Tensor,
) -> tuple[Tensor, Tensor] | None:
    """Return the same as ``EclipseTable.query``, bit for bit; None if arcs are too short.

    ``constants`` is the struct ``Constants`` of the kernel. The current orbit began at ``begun`` [N] s, None for zero on orbits
    that never restart; arcs go to ``reached`` [N] s, None if they are known to be long enough. ``sampled`` and ``known`` [N] s,
    as in the table, change. TypeError for times that are not float64, or of another shape: kernels read addresses.
    """
    times = {"time": time, "begun": begun, "reached": reached, "sampled": sampled, "known": known}
    check_times(starts.shape[:1], times)
    start, end = time.new_empty(2, len(time)).unbind(0)
    late = ctypes.c_int64()
    next_eclipses_kernel()(
        len(time), constants,
        starts.contiguous(), starts.shape[1], ends.contiguous(), ends.shape[1],
        time.contiguous(), None if begun is None else begun.contiguous(), None if reached is None else reached.contiguous(),
        sampled, known,
        start, end, ctypes.addressof(late),
    )  # fmt: skip
    return None if late.value else (start, end)
