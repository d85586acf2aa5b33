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

    Args:
        constants: The struct ``Constants`` of the kernel.
        starts: Times of transitions into the umbra, [N, W] s.
        ends: Times of transitions out of it, likewise.
        time: Time of the query, [N] s.
        begun: Time at which the current orbit began, [N] s; None for zero on orbits that never restart.
        reached: Time which the arcs reach, [N] s, compared with what the query needs; None if they are known to be long enough.
        sampled: Time up to which samples have been propagated, [N] s; changes.
        known: Time up to which their transitions have been recorded, [N] s; changes.

    Raises:
        TypeError: For times that are not float64, or of another shape: kernels read addresses.
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
