"""Tracks of arcs, and the tracing of kernels that read them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

from torch import Tensor

from bsk_torch.astro.interpolate import BEFORE, COUNT, coefficients
from bsk_torch.codegen.ir import Loop, Value
from bsk_torch.codegen.kernel import Kernel
from bsk_torch.codegen.trace import Tracer
from bsk_torch.sim.component import Bus, Track, vec
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, ephemeris_at
from bsk_torch.sim.orbit.grid import NODE_SPACING, PLAN_STEP
from bsk_torch.vec3 import Vec3

ARC = Track("arc", NODE_SPACING, (vec("r_BN_N", "m", exact=True),), COUNT, BEFORE)
"""Nodes of an arc, as ticks and searches see it."""

FINE = Track("fine", PLAN_STEP, (vec("r_BN_N", "m", exact=True),), count=1)  # samples of the planned arc


class KernelBuilder:
    """The inputs of a kernel that is being traced.

    Sources are those of :class:`bsk_torch.codegen.kernel.Kernel`'s tensors, such as ``"state"``, ``"own"`` and ``"shared"``;
    tracks are numbered from 1 on.
    """

    def __init__(self) -> None:
        self.program = Tracer()

    def number(self, source: str, *index: int) -> Tensor:
        """An input: a value that stands for a tensor in tensor code."""
        return cast(Tensor, self.program.input(source, *index))

    def planes(self, source: str, count: int, first: int = 0) -> list[Tensor]:
        """Inputs ``first`` to ``first + count`` of a source."""
        return [self.number(source, first + k) for k in range(count)]

    def vectors(self, source: str, count: int, first: int = 0) -> list[Vec3]:
        """``count`` vectors from plane ``first`` on."""
        planes = self.planes(source, 3 * count, first)
        return [Vec3(*planes[3 * k : 3 * k + 3]) for k in range(count)]

    def records(self, t: int, count: int) -> list[Tensor]:
        """Planes of a track's records."""
        return [self.number("track", t, k) for k in range(count)]

    def tau(self, t: int) -> Tensor:
        """Seconds since a track's record."""
        return self.number("tau", t)

    def ephemeris(self) -> Bus:
        """Sun and Earth at the time of the tick, from track 1."""
        return ephemeris_at(self.records(1, EPHEMERIS_TRACK.count * EPHEMERIS_TRACK.width), self.tau(1))

    def path(self, t: int) -> tuple[list[Vec3], Tensor]:
        """Coefficients of the arc around the time of the tick from track t, and steps since its middle node."""
        planes = self.records(t, 3 * COUNT)
        nodes = [Vec3(*planes[3 * k : 3 * k + 3]) for k in range(COUNT)]
        return coefficients(nodes), self.tau(t) * (1.0 / NODE_SPACING)

    def kernel(
        self,
        name: str,
        outputs: Sequence[Vec3],
        tracks: tuple[Track, ...],
        written: Sequence[Vec3] = (),
        clock: str = "ticks",
        schedule: int = 0,
    ) -> Kernel:
        """Return the kernel whose state becomes ``outputs`` and that writes ``written`` in each tick."""
        state, records = ([plane for vector in vectors for plane in vector] for vectors in (outputs, written))
        return Kernel(name, self.loop(state, records, tracks, clock, schedule))

    def loop(
        self,
        outputs: Sequence[Tensor],
        written: Sequence[Tensor],
        tracks: tuple[Track, ...],
        clock: Tensor | str = "ticks",
        schedule: int = 0,
    ) -> Loop:
        """Return the tick that computes the tensors ``outputs``, and writes those ``written``; see :class:`Loop`."""
        state, records = (cast("Sequence[Value]", tensors) for tensors in (outputs, written))
        return Loop(self.program, state, tracks, records, cast("Value | str", clock), schedule)
