"""Communication along lines of sight."""

from __future__ import annotations

import functools

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.comm.base import CommunicationMethod, MultiDegreeCommunication
from bsk_torch.constants import NANO
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sim.access.links.line_of_sight import speed_bound
from bsk_torch.sim.access.links.line_of_sight_search import PAIRS_PER_BATCH, FlownOrbits, LineOfSightSearch
from bsk_torch.sim.access.links.sight_kernel import PAIRS_AT_ONCE, ordered_pairs, sensors_see
from bsk_torch.sim.dyn import LOSCommDynModel
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
    pairs = torch.zeros(fleet.num_envs, fleet.size, fleet.size, dtype=torch.bool, device=fleet.device)
    ticks = fleet.ticks
    counts = (ticks - fleet.since).clamp(min=0) * asked
    if fleet.size < 2:
        return pairs
    some, lost = torch.stack([counts.any(), _lost(fleet, asked)]).tolist()
    if not some:
        return pairs
    _check(lost)
    if len(fleet.simulators) == 1 and _by_kernels(fleet.simulators[0]):
        pairs = _sights_by_kernel(fleet, counts)
        return pairs if directed else pairs | pairs.mT
    search = make_search(fleet, fleet.since, torch.maximum(ticks - 1, fleet.since))
    for some in torch.nonzero(counts).squeeze(-1).split(max(1, PAIRS_PER_BATCH // fleet.size**2)):
        pairs[some] = search.visible_pairs(some, directed)
    return pairs


def _sights_by_kernel(fleet: SatelliteFleet, counts: Tensor) -> Tensor:
    """Return which sensors of satellites of one type see which others in the last ``counts`` [N] ticks, [N, S, S]."""
    simulator, n, s = fleet.simulators[0], fleet.num_envs, fleet.size
    state, first = simulator.state, fleet.since.double()
    span = torch.stack([first * simulator.h_ns * NANO, first, torch.zeros_like(first), first + (counts - 1)])
    orbits = torch.cat([state.planes[state.layout.slices[name]] for name in ("r_BN_N", "v_BN_N")])
    seen, at_once = [], max(1, PAIRS_AT_ONCE // s**2)
    for start in range(0, n, at_once):
        pairs = ordered_pairs(min(at_once, n - start), s)
        pairs = pairs.after(start, s) if start else pairs
        ticks = counts[pairs.env] * pairs.apart
        if (present := simulator.present) is not None:
            ticks = ticks * (present[pairs.i] & present[pairs.j])
        seen.append(sensors_see(simulator.arcs, pairs, orbits, state.arguments[MAX_RANGE], span, ticks, simulator.h_ns))
    return torch.cat(seen).view(n, s, s)


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
    begin = torch.where(asked, (fleet.since - 1).clamp(min=0).double() * fleet.h, torch.inf)
    lost = []
    for simulator in fleet.simulators:
        start = simulator.arcs.start
        if simulator.arcs.restarts:  # the backward continuation of a new orbit is off by its velocity change times a tick
            start = start - (start == simulator.arcs.begun) * (1.5 * simulator.h)
        lost.append((simulator.of_env(begin) < start).any())
    return functools.reduce(torch.logical_or, lost)


def _check(lost: bool) -> None:
    if lost:
        raise RuntimeError("arcs have advanced and no longer cover the start of the step: search before looking ahead")
