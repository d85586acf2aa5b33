"""Communication along lines of sight."""

from __future__ import annotations

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.comm.base import CommunicationMethod, MultiDegreeCommunication
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sim.access.links.line_of_sight import speed_bound
from bsk_torch.sim.access.links.line_of_sight_search import PAIRS_PER_BATCH, FlownOrbits, LineOfSightSearch
from bsk_torch.sim.access.links.sight_kernel import PAIRS_AT_ONCE, sensors_see
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
    moved = asked & (fleet.ticks > fleet.since)
    envs = torch.nonzero(moved).squeeze(-1)
    if fleet.size < 2 or not len(envs):
        return pairs
    _check_covered(fleet, asked)
    span = fleet.since, torch.maximum(fleet.ticks - 1, fleet.since)
    if len(fleet.simulators) == 1 and _by_kernels(fleet.simulators[0]):
        pairs = _sights_by_kernel(fleet, moved, span)
        return pairs if directed else pairs | pairs.mT
    search = make_search(fleet, *span)
    for some in envs.split(max(1, PAIRS_PER_BATCH // fleet.size**2)):
        pairs[some] = search.visible_pairs(some, directed)
    return pairs


def _sights_by_kernel(fleet: SatelliteFleet, moved: Tensor, span: tuple[Tensor, Tensor]) -> Tensor:
    """Return which sensors of satellites of one type see which others in a ``span`` of the episodes ``moved`` [N], [N, S, S]."""
    simulator, s = fleet.simulators[0], fleet.size
    pairs = moved.view(-1, 1, 1) & ~torch.eye(s, dtype=torch.bool)
    if fleet.present is not None:
        pairs = pairs & fleet.present.unsqueeze(1) & fleet.present.unsqueeze(2)
    orbits = torch.cat([simulator.read("r_BN_N"), simulator.read("v_BN_N")], 1)
    for part in torch.nonzero(pairs).split(PAIRS_AT_ONCE):
        env, i, j = part.unbind(1)
        rows, ticks = (env * s + i, env * s + j), (span[0][env], span[1][env])
        reach = simulator.state.arguments[MAX_RANGE]
        pairs[env, i, j] = sensors_see(simulator.arcs, rows, orbits, reach, ticks, simulator.h_ns)
    return pairs


def sights(fleet: SatelliteFleet, first: int) -> Tensor:
    """Return the lines of sight at ticks from ``first`` to now, in this step of the first episode, [T, sensor, other] bool."""
    _check_covered(fleet, torch.ones(fleet.num_envs, dtype=torch.bool, device=fleet.device))
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


def _check_covered(fleet: SatelliteFleet, asked: Tensor) -> None:
    begin = torch.where(asked, (fleet.since - 1).clamp(min=0).double() * fleet.h, torch.inf)
    for simulator in fleet.simulators:
        arcs = simulator.arcs
        # one tick before a maneuver, the backward continuation of the new orbit is off by the velocity change times a tick
        earlier = (arcs.start == arcs.begun) * (1.5 * simulator.h) if arcs.restarts else 0.0
        if bool((simulator.of_env(begin) < arcs.start - earlier).any()):
            raise RuntimeError("arcs have advanced and no longer cover the start of the step: search before looking ahead")
