"""Flags of all points over a run: which points each inspector has inspected, and which were lit.

A run of n ticks from T on has the records j = 0 .. n - 1, as they were written at T + j h: positions, attitude, Sun, and the
level of each inspector's store. An inspector inspects a point if it has access to it and the point is lit in a record after
which its store changes: ``L(j + 1) - L(j)``, of whatever sign. The last record takes the change of the one before, so that a run
of one tick inspects nothing.

The same function of a record, :func:`_look`, is one tick of a kernel, and runs on tensors under the eager back end.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.astro.sight import stretch
from bsk_torch.codegen.kernel import Kernel, Samples
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.component import Field, Layout, Track
from bsk_torch.sim.orbit.builder import KernelBuilder
from bsk_torch.sim.tick.trace import Trace
from bsk_torch.tasks.inspection.points import COLUMNS, Point, faces, in_view, sunlit
from bsk_torch.vec3 import Mat3, Vec3, only

GROUP = 25
"""Points in a kernel; more run in further calls. Compilers take longer than in proportion to the length of a function: 100 points
at once take 30 s to build instead of 6, and run no faster."""

CHIEF_FIELDS = ("r_BN_N", "sigma_BN", "illumination", "sun_N", "pole_N")
"""Recorded fields of the inspected spacecraft that flags follow from: its position in N, m, its attitude, the visible fraction of
the Sun, the Sun's position in N, m, and the direction of the Earth's axis in N."""

INSPECTOR_FIELDS = ("r_BN_N", "storage")
"""Recorded fields of an inspector that flags follow from: its position in N, m, and the level of its store, bit."""


class Records(NamedTuple):
    """Records of a run by R pairs of an inspector and the spacecraft that it inspects."""

    chief: Trace  # trace of inspected spacecraft, with CHIEF_FIELDS among its fields
    chief_rows: Tensor  # row of the trace of each pair, [R]
    inspectors: Trace  # trace of inspectors, with INSPECTOR_FIELDS among its fields; a record more than there are ticks
    inspector_rows: Tensor  # row of the trace of each pair, [R]
    ticks: Tensor  # number of ticks of each pair, [R]
    seen_from: Tensor  # first record in which points may be inspected, [R]
    lit_from: Tensor  # first record in which points may be lit, [R]


def find_flags(columns: Tensor, records: Records, compiled: bool) -> tuple[Tensor, Tensor]:
    """Return the points that inspectors have inspected in a run, and those that were lit, [R, P] bool each.

    Args:
        columns: Numbers of the points, [10, P], or [10, R, P] where they differ between pairs; see
            :func:`bsk_torch.tasks.inspection.points.point_columns`.
        records: Records of the run.
        compiled: Whether to use kernels, on the CPU.
    """
    run = _run_kernels if compiled and columns.device.type == "cpu" else _run_tensors
    inspected, lit = run(columns, records)
    return inspected > 0.5, lit > 0.5


# -- one record ----------------------------------------------------------------------------------------------------------------


class _Moment(NamedTuple):
    """One record of a chief and an inspector: planes, or tensors that broadcast with points."""

    r_BN_N: Vec3
    sigma_BN: Vec3
    illumination: Tensor
    sun_N: Vec3
    pole_N: Vec3
    inspector_N: Vec3

    @staticmethod
    def of(chief: dict[str, Any], inspector: dict[str, Any]) -> _Moment:
        r_BN_N, sigma_BN, illumination, sun_N, pole_N = (chief[name] for name in CHIEF_FIELDS)
        return _Moment(r_BN_N, sigma_BN, illumination, sun_N, pole_N, inspector["r_BN_N"])


def _fields(layout: Layout, names: Sequence[str], planes: Sequence[Tensor], first: int = 0) -> dict[str, Any]:
    """Return fields by name, from the planes of a record that begins with plane ``first``."""
    parts = {name: planes[first + layout.slices[name].start : first + layout.slices[name].stop] for name in names}
    return {name: part[0] if len(part) == 1 else Vec3(*part) for name, part in parts.items()}


class _Limits(NamedTuple):
    """Bounds over all points."""

    reach2: Tensor  # square of the longest distance from the spacecraft's center at which a point may be seen, m^2
    radius: Tensor  # largest distance of a point from the center, m
    light: Tensor  # least illumination in which a point may be lit


def _look(
    points: Sequence[Point],
    limits: _Limits,
    at: _Moment,
    counts: Tensor,
    lights: Tensor,
    inspected: tuple[Tensor, ...],
    lit: tuple[Tensor, ...],
) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Return the flags ``inspected`` and ``lit``, 0 or 1 for each entry of ``points``, after a record.

    ``points`` are single ones, or all of them as one entry of tensors. ``counts`` tells whether access counts, since the store
    changes after the record, and ``lights`` whether light does.
    """
    BN = mrp_to_dcm(at.sigma_BN)
    s_B, rho_N = BN @ at.sun_N.unit(), at.inspector_N - at.r_BN_N
    rho2 = rho_N.dot(rho_N)

    def by_day() -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        sun = [sunlit(point, s_B, at.illumination) for point in points]
        after = tuple(torch.where(lights & now, 1.0, before) for now, before in zip(sun, lit, strict=True))

        def by_sight() -> tuple[Tensor, ...]:
            rho_B = BN @ rho_N
            facing = [faces(point, rho_B) for point in points]
            free = _free(points, limits, at, BN, rho2)
            return tuple(
                torch.where(now & near & (view > 0.5), 1.0, before)
                for now, near, view, before in zip(sun, facing, free, inspected, strict=True)
            )

        return only(counts & (rho2 <= limits.reach2), by_sight, inspected), after

    return only(at.illumination >= limits.light, by_day, (inspected, lit))


def _free(points: Sequence[Point], limits: _Limits, at: _Moment, BN: Mat3, rho2: Tensor) -> tuple[Tensor, ...]:
    """Return 1 for points with a free line of sight to the inspector.

    The line lies within ``max(|rho|, radius)`` of the spacecraft's center; where all of that is outside of the Earth's equatorial
    radius nothing needs to be computed: stretching does not bring anything nearer.
    """
    r2, one = at.r_BN_N.dot(at.r_BN_N), torch.ones_like(rho2)
    slack = torch.sqrt(r2) - (R_EARTH + 1.0)  # a meter, far more than rounding
    clear = (slack > limits.radius) & (slack * torch.abs(slack) > rho2)

    def tested() -> tuple[Tensor, ...]:
        pole_B, r_B = BN @ at.pole_N, BN @ at.r_BN_N
        inspector_B = stretch(BN @ at.inspector_N, pole_B)
        return tuple(in_view(point, r_B, inspector_B, pole_B).to(one.dtype) for point in points)

    return only(~clear, tested, (one,) * len(points))


def _bounds(columns: Tensor) -> Tensor:
    """Return the numbers of :class:`_Limits`, [3, ...], of columns [10, ..., P]."""
    radius = columns[:3].norm(dim=0)
    reach = columns[7].sqrt() + radius
    return torch.stack([(1.000001 * reach.amax(-1)).square(), radius.amax(-1), columns[9].amin(-1)])


# -- kernels -------------------------------------------------------------------------------------------------------------------

TICK_NS = 1_000_000_000
"""Length of a tick of the kernels, which count records in seconds."""


@cache
def flags_kernel(source: str, chief_fields: tuple[Field, ...], inspector_fields: tuple[Field, ...]) -> Kernel:
    """Return the kernel of :data:`GROUP` points, whose numbers come from ``source``, ``"shared"`` or ``"own"``.

    The state is the flags of inspected, then of lit points, and the last change of the store; ``own`` begins with the number of
    the last record and those of the first ones in which points may be inspected, and lit. A tick is a record, of the given
    fields of the inspected spacecraft, and of the inspector.
    """
    builder = KernelBuilder()
    last, seen_from, lit_from = builder.planes("own", 3)
    first = 3 if source == "own" else 0
    limits = _Limits(*builder.planes(source, 3, first))
    numbers = builder.planes(source, COLUMNS * GROUP, first + 3)
    points = [Point.of(numbers[k::GROUP]) for k in range(GROUP)]
    inspected, lit = (tuple(builder.planes("state", GROUP, k * GROUP)) for k in range(2))
    (change,) = builder.planes("state", 1, 2 * GROUP)
    chief, inspector = Layout(chief_fields), Layout(inspector_fields)
    records = builder.records(2, 2 * inspector.size)
    now, after = (_fields(inspector, INSPECTOR_FIELDS, records, k * inspector.size) for k in range(2))
    number = builder.number("ticks_now")
    change = torch.where(number >= last, change, after["storage"] - now["storage"])
    at = _Moment.of(_fields(chief, CHIEF_FIELDS, builder.records(1, chief.size)), now)
    inspected, lit = _look(points, limits, at, change.ne(0.0) & (number >= seen_from), number >= lit_from, inspected, lit)
    tracks = Track("chief", 1.0, chief_fields, count=1), Track("inspector", 1.0, inspector_fields, count=2)
    return Kernel("inspection", builder.loop([*inspected, *lit, change], [], tracks))


def _run_kernels(columns: Tensor, records: Records) -> tuple[Tensor, Tensor]:
    ticks, source = records.ticks, "shared" if columns.ndim == 2 else "own"
    limits = torch.stack([ticks - 1, records.seen_from, records.lit_from]).double()
    pairs = (records.chief, records.chief_rows), (records.inspectors, records.inspector_rows)
    # records are looked up half way between two
    tracks = [Samples(trace.table, torch.full((len(trace.table),), -0.5, dtype=torch.float64), rows) for trace, rows in pairs]
    kernel = flags_kernel(source, *(tuple(trace.layout.fields.values()) for trace, _ in pairs))
    flags = []
    for group in _filled(columns).split(GROUP, -1):
        packs = torch.cat([_bounds(group), group.movedim(-1, 1).flatten(0, 1)])
        own, shared = (torch.cat([limits, packs]), None) if source == "own" else (limits, packs)
        state = torch.zeros(2 * GROUP + 1, len(ticks), dtype=torch.float64)
        kernel(state, ticks, tracks, ticks=torch.full_like(ticks, -1), nanoseconds=TICK_NS, own=own, shared=shared)
        flags.append(state[:-1].unflatten(0, (2, GROUP)))
    inspected, lit = torch.cat(flags, 1)[:, : columns.shape[-1]].mT.contiguous()
    return inspected, lit


def _filled(columns: Tensor) -> Tensor:
    missing = -columns.shape[-1] % GROUP
    return torch.cat([columns, columns[..., -1:].expand(*columns.shape[:-1], missing)], -1)


# -- tensors -------------------------------------------------------------------------------------------------------------------


def _run_tensors(columns: Tensor, records: Records) -> tuple[Tensor, Tensor]:
    ticks, seen_from, lit_from = (part.unsqueeze(-1) for part in records[4:])
    points, limits = Point.of(columns), _Limits(*_bounds(columns).unsqueeze(-1))
    inspected = torch.zeros(len(ticks), columns.shape[-1], dtype=torch.float64, device=columns.device)
    lit, change = inspected, inspected[:, :1]

    def record(trace: Trace, rows: Tensor, names: Sequence[str], j: int) -> dict[str, Any]:
        return _fields(trace.layout, names, trace.table[rows, j].unsqueeze(-1).unbind(1))

    def inspector(j: int) -> dict[str, Tensor]:
        return record(records.inspectors, records.inspector_rows, INSPECTOR_FIELDS, j)

    now = inspector(0)
    for j in range(int(ticks.max())):
        after, chief = inspector(j + 1), record(records.chief, records.chief_rows, CHIEF_FIELDS, j)
        change = torch.where(j >= ticks - 1, change, after["storage"] - now["storage"])
        runs = j < ticks
        counts, lights = runs & change.ne(0.0) & (j >= seen_from), runs & (j >= lit_from)
        (inspected,), (lit,) = _look([points], limits, _Moment.of(chief, now), counts, lights, (inspected,), (lit,))
        now = after
    return inspected, lit
