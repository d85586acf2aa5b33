"""Communication along lines of sight."""

from __future__ import annotations

import functools

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.codegen.kernel import Samples
from bsk_torch.codegen.rows import RowKernel, RowTrace
from bsk_torch.comm.base import CommunicationMethod, MultiDegreeCommunication
from bsk_torch.constants import NANO
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sim.access.links.line_of_sight import speed_bound
from bsk_torch.sim.access.links.line_of_sight_search import PAIRS_PER_BATCH, FlownOrbits, LineOfSightSearch
from bsk_torch.sim.access.links.sight_kernel import PAIRS_AT_ONCE, OrderedPairs, ordered_pairs, sight_kernel
from bsk_torch.sim.dyn import LOSCommDynModel
from bsk_torch.sim.orbit.grid import LEAD_NODES, NODE_SPACING
from bsk_torch.sim.simulator import Simulator
from bsk_torch.vec3 import Vec3

MAX_RANGE = "losMaximumRange"
"""Satellite argument: range of the sensor, m; unlimited unless positive."""


class LOSCommunication(CommunicationMethod):
    """Two satellites communicate, both ways, if at any time since the previous step there was a line of sight between them.

    A line of sight from one satellite to another is a straight line not blocked by the Earth and no longer than
    ``losMaximumRange`` of the first. All dynamics models must have :class:`~bsk_torch.sim.dyn.LOSCommDynModel` among their bases.
    Lines of sight in steps without communication because of ``min_period`` are dropped.

    Satellites without a line of sight never communicate.
    """

    def link(self, fleet: SatelliteFleet) -> None:
        """See :meth:`CommunicationMethod.link`; TypeError without LOSCommDynModel, ValueError without orbits solved ahead."""
        super().link(fleet)
        for part, simulator, columns in zip(fleet.satellites, fleet.simulators, fleet.columns, strict=True):
            name = fleet.names[int(columns[0])]
            if not issubclass(part.dyn_type, LOSCommDynModel):
                raise TypeError(
                    f"{type(self).__name__} needs dyn.LOSCommDynModel among the bases of {name}'s dyn_type, which is "
                    f"{part.dyn_type.__name__}"
                )
            if simulator.orbit != "arc":
                raise ValueError(
                    f"{type(self).__name__} needs orbits computed in advance, but {name} has "
                    f"orbit={simulator.orbit!r}; pass orbit='arc' to the environment, and where the orbit is so low that drag is "
                    "felt also world_args={'baseDensity': 0.0}, which leaves drag out"
                )

    @override
    def communication_pairs(self) -> Tensor:
        return visible_pairs(self.fleet, self.due)


class LOSMultiCommunication(MultiDegreeCommunication, LOSCommunication):
    """Satellites communicate if a chain of lines of sight connects them."""


def visible_pairs(fleet: SatelliteFleet, asked: Tensor, directed: bool = False) -> Tensor:
    """Return the pairs that had a line of sight since the current step began, [N, S, S] booleans.

    Ticks count from the start of the step to the last but one, because Basilisk's recorders run before the modules.

    Args:
        fleet: The satellites.
        asked: Episodes to search, [N]; the result is False for all others.
        directed: Whether the result is that of each sensor, [N, sensor, other], or that of either sensor of a pair.
    """
    n, s, simulator = fleet.num_envs, fleet.size, fleet.simulators[0]
    if s > 1 and len(fleet.simulators) == 1 and _by_kernels(simulator):
        at_once = max(1, PAIRS_AT_ONCE // s**2)
        parts = (ordered_pairs(min(at_once, n - start), s).after(start, s) for start in range(0, n, at_once))
        pairs = torch.cat([_sensors_see(simulator, part, fleet.since, fleet.ticks, asked) for part in parts]).view(n, s, s)
        return pairs if directed else pairs | pairs.mT
    pairs = torch.zeros(n, s, s, dtype=torch.bool, device=fleet.device)
    ticks = fleet.ticks
    counts = _searched(fleet.since, ticks, asked)
    if s < 2:
        return pairs
    some, lost = torch.stack([counts.any(), _lost(fleet, asked)]).tolist()
    if not some:
        return pairs
    _check(lost)
    search = make_search(fleet, fleet.since, torch.maximum(ticks - 1, fleet.since))
    for some in torch.nonzero(counts).squeeze(-1).split(max(1, PAIRS_PER_BATCH // fleet.size**2)):
        pairs[some] = search.visible_pairs(some, directed)
    return pairs


def _sensors_see(simulator: Simulator, pairs: OrderedPairs, since: Tensor, ticks: Tensor, asked: Tensor) -> Tensor:
    """Return which sensors see other satellites of their type since a tick, by ``pairs`` [m], [m] bool; [N] each elsewhere."""
    arcs, state, m = simulator.arcs, simulator.state, len(pairs.i)
    first = (state.layout.slices[name].start for name in ("r_BN_N", "v_BN_N"))
    numbers, planes = _numbers(simulator.h_ns, simulator.h, state.rows, *first), torch.empty(18, m, dtype=torch.float64)
    inputs = dict(
        env=pairs.env, i=pairs.i, j=pairs.j, later=pairs.later, apart=pairs.apart, numbers=numbers, since=since, ticks=ticks,
        asked=asked, max_range=state.arguments[MAX_RANGE], start=_first_covered(simulator), fields=state.planes.view(-1),
        planes=planes, every=_numbers(*range(18)).long(), present=simulator.present,
    )  # fmt: skip
    (counts,), (most, lost) = _pairs_kernel(simulator.present is not None)(m, inputs)
    if most > 0.0:
        _check(lost > 0.0)
        lead = arcs.start - LEAD_NODES * NODE_SPACING
        tracks = Samples(arcs.ephemeris, arcs.start, pairs.i), *(Samples(arcs.flown, lead, rows) for rows in (pairs.i, pairs.j))
        sight_kernel()(planes[:3], counts, tracks, shared=numbers, own=planes[3:])
    return planes[2] > 0.0


@functools.lru_cache(maxsize=8)
def _numbers(*numbers: float) -> Tensor:
    """Return numbers that all pairs share; kernels only read them."""
    with torch.inference_mode(False):
        return torch.tensor(numbers, dtype=torch.float64)


@functools.cache
def _pairs_kernel(varies: bool) -> RowKernel:
    """What the search by :func:`sight_kernel` reads of every pair; with ``varies``, some satellites are not present."""
    trace = RowTrace()
    env, i, j = (trace.row(name, torch.int64) for name in ("env", "i", "j"))
    h_ns, h, rows, *first = (trace.table("numbers", torch.float64)[k] for k in range(5))
    since, ticks = (trace.table(name, torch.int64)[env] for name in ("since", "ticks"))
    asked, fields = trace.table("asked", torch.bool)[env], trace.table("fields", torch.float64)
    counts = _searched(since, ticks, asked)
    orbits = [fields[(plane + axis) * rows + satellite] for satellite in (i, j) for plane in first for axis in range(3)]
    sensor = trace.table("max_range", torch.float64)[i], trace.row("later", torch.float64)
    planes = since * h_ns * NANO, since, torch.zeros_like(since), *orbits, *sensor, since + (counts - 1)
    counts = counts * trace.row("apart", torch.bool)
    if varies:
        present = trace.table("present", torch.bool)
        counts = counts * (present[i] & present[j])
    lost = _start(since, asked, h) < trace.table("start", torch.float64)[i]
    stored = {k: (trace.plane("planes", "every", k), value) for k, value in enumerate(planes)}
    return RowKernel("pairs of a search", trace, {"counts": (counts, torch.int64)}, (counts, lost.double()), stored)


def _searched(since: Tensor, ticks: Tensor, asked: Tensor) -> Tensor:
    """Return the number of ticks that are searched, [N], 0 for episodes that are not ``asked`` [N]."""
    return (ticks - since).clamp(min=0) * asked


def sights(fleet: SatelliteFleet, first: int) -> Tensor:
    """Return the lines of sight at ticks from ``first`` to now, in this step of the first episode, [T, sensor, other] bool."""
    _check(bool(_lost(fleet, torch.ones(fleet.num_envs, dtype=torch.bool, device=fleet.device))))
    search = make_search(fleet, fleet.since, fleet.ticks)
    ticks = torch.arange(first, int(fleet.ticks[0]) + 1, device=fleet.device)
    return search.all_margins(torch.zeros_like(ticks), ticks) > 0.0


def make_search(fleet: SatelliteFleet, first: Tensor, last: Tensor) -> LineOfSightSearch:
    """Return the search among the satellites of a fleet during ticks ``first`` to ``last`` [N]."""
    types = [flown_orbits(simulator, columns) for simulator, columns in zip(fleet.simulators, fleet.columns, strict=True)]
    return LineOfSightSearch(types, first, last, fleet.simulators[0].h_ns)


def flown_orbits(simulator: Simulator, columns: Tensor) -> FlownOrbits:
    """Return the flown orbits of the satellites of one type, with their sensors' ranges and bounds of their speeds."""
    r_BN_N, v_BN_N = (Vec3.of(simulator.read(name)) for name in ("r_BN_N", "v_BN_N"))
    speed, by_kernels = speed_bound(r_BN_N, v_BN_N), _by_kernels(simulator)
    return FlownOrbits(simulator.arcs, columns, simulator.state.arguments[MAX_RANGE], speed, by_kernels, simulator.present)


def _by_kernels(simulator: Simulator) -> bool:
    return simulator.lookahead.eclipses.visibility.kernels


def _lost(fleet: SatelliteFleet, asked: Tensor) -> Tensor:
    """Return whether arcs no longer cover the start of the step in an episode of ``asked`` [N], []."""
    lost = []
    for simulator in fleet.simulators:
        begin = simulator.of_env(_start(fleet.since, asked, fleet.h))
        lost.append((begin < _first_covered(simulator)).any())
    return functools.reduce(torch.logical_or, lost)


def _start(since: Tensor, asked: Tensor, h: float) -> Tensor:
    """Return from when on a search since the tick ``since`` [N] reads arcs, [N] s; infinity where none is ``asked`` [N] for."""
    return torch.where(asked, (since - 1).clamp(min=0).double() * h, torch.inf)


def _first_covered(simulator: Simulator) -> Tensor:
    """Return from when on arcs tell where satellites have been, [rows] s."""
    start = simulator.arcs.start
    if simulator.arcs.restarts:  # the backward continuation of a new orbit is off by its velocity change times a tick
        start = start - (start == simulator.arcs.begun) * (1.5 * simulator.h)
    return start


def _check(lost: bool) -> None:
    if lost:
        raise RuntimeError("arcs have advanced and no longer cover the start of the step: search before looking ahead")
