"""Runs of fleets whose satellites depend on one another within a tick: by traces, type after type."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.simulator import Simulator
from bsk_torch.sim.trace import Flight, Trace

if TYPE_CHECKING:
    from bsk_torch.sim.fleet import Fleet

MOST_NUMBERS = 1 << 25
"""Numbers that the traces of a run hold at once; longer runs, or those of more episodes, are made part by part."""

StopCondition = Callable[[Flight], Tensor]
"""Returns the first tick of a flight, [n], at which something ends the step; more than all ticks where nothing does."""

FlightObserver = Callable[[Flight], None]
"""Called with the flights that a step consists of, each episode in one of them."""


class Following:
    """Which type of satellites follows which, and the order in which types run.

    Attributes:
        leaders: For each type, the type that it follows by slot.
        order: The types, those that are followed before those that follow them.
    """

    def __init__(self, simulators: Sequence[Simulator]) -> None:
        """Find the satellites that are followed."""
        self.simulators = simulators
        self.leaders = [{name: self._owner(name) for name in simulator.followed} for simulator in simulators]
        depth: dict[int, int] = {}
        while len(depth) < len(simulators):  # FleetBuilder has built leaders first, so there are no circles
            for k, leaders in enumerate(self.leaders):
                if k not in depth and all(leader in depth for leader in leaders.values()):
                    depth[k] = 1 + max((depth[leader] for leader in leaders.values()), default=0)
        self.order = sorted(depth, key=lambda k: (depth[k], not simulators[k].stops))

    def _owner(self, name: str) -> int:
        return next(k for k, simulator in enumerate(self.simulators) if any(part.slot == name for part in simulator.parts))

    def samples(self, k: int, traces: Mapping[int, Trace | None]) -> dict[str, Samples]:
        """Return the traces that the satellites of type k follow, by slot."""
        followed = {}
        for name, leader in self.leaders[k].items():
            trace, simulator = traces[leader], self.simulators[k]
            assert trace is not None
            envs = torch.arange(simulator.num_envs, device=simulator.device)
            followed[name] = trace.samples(simulator.h_ns, envs.repeat_interleave(simulator.count))
        return followed

    def present(self, k: int) -> dict[str, Samples]:
        """Return traces of the present alone that the satellites of type k follow, by slot."""
        return self.samples(k, {leader: self.simulators[leader].trace(0) for leader in self.leaders[k].values()})


def fly(fleet: Fleet, moves: Tensor, ends: Tensor, left: Tensor) -> tuple[Tensor, list[Tensor | None]]:
    """Simulate the episodes ``moves`` [N] for at most ``ends`` [N] ticks, of ``left`` [N] to the end of the episode.

    A stop condition that holds, or an event of a type that runs later, ends the run of all satellites of an episode; types that
    have run too far are rewound and run again, to there.

    Returns:
        Ticks that each episode has run, [N], and for each type whether an event ended the actions of its satellites.
    """
    flown = torch.zeros_like(ends)
    events: list[Tensor | None] = [None] * len(fleet.simulators)
    for envs in _parts(fleet, torch.nonzero(moves).squeeze(-1), ends):
        here = torch.zeros_like(moves).index_fill(0, envs, True)
        ran, found = _fly_part(fleet, envs, torch.where(here, ends, 0), left)
        flown = flown + ran
        events = [new if old is None else old if new is None else old | new for old, new in zip(events, found, strict=True)]
    return flown, events


def _parts(fleet: Fleet, envs: Tensor, ends: Tensor) -> Iterator[Tensor]:
    """Yield the episodes ``envs`` [n] in parts whose traces fit into memory together, longest runs first."""
    width = sum(s.count * s.tick.recorded_width for s in fleet.simulators)
    ranked = envs[ends[envs].argsort(descending=True, stable=True)]
    while len(ranked):
        size = max(1, MOST_NUMBERS // (max(1, width) * (int(ends[ranked[0]]) + 1)))
        yield ranked[:size]
        ranked = ranked[size:]


def _fly_part(fleet: Fleet, envs: Tensor, ends: Tensor, left: Tensor) -> tuple[Tensor, list[Tensor | None]]:
    """Simulate some episodes; see :func:`fly`. ``ends`` [N] is zero for all others."""
    since, longest, simulators = fleet.ticks, int(ends.max()), fleet.simulators
    starts = [simulator.events if simulator.has_events else None for simulator in simulators]
    checkpoints = [simulator.checkpoint() for simulator in simulators]
    traces: dict[int, Trace | None] = {}
    ran: dict[int, Tensor] = {}
    for k in fleet.following.order:
        simulator = simulators[k]
        traces[k] = simulator.trace(longest) if simulator.records else None
        ticks = simulator.state.of_env(ends)
        expected = fleet.expected_ticks(k, since, ends)
        followed = fleet.following.samples(k, traces)
        ran[k] = fleet.first_of_each(simulator.run(ticks, expected, True, traces[k], followed), simulator.count)
        ends = torch.minimum(ends, ran[k])
    counts = tuple(simulator.count for simulator in simulators)
    recorded = tuple(traces[k] for k in range(len(simulators)))
    flight = Flight(envs, since[envs], ends[envs], left[envs], recorded, counts)
    for condition in fleet.stop_conditions:
        ends = ends.index_copy(0, envs, torch.minimum(ends[envs], condition(flight)))
    for k, simulator in enumerate(simulators):
        _fly_again(simulator, checkpoints[k], ran[k] > ends, ends, traces[k], fleet.following.samples(k, traces))
    flight = flight._replace(ticks=ends[envs])
    for observe in fleet.flight_observers:
        observe(flight)
    cut = (ends >= left) & (ends > 0)  # the clock stops before events of the last tick are evaluated
    events: list[Tensor | None] = []
    for k, (simulator, start) in enumerate(zip(simulators, starts, strict=True)):
        if start is None:
            events.append(None)
        elif simulator.stops:
            events.append((simulator.events > start) & ~simulator.state.of_env(cut))
        else:
            followed = fleet.following.samples(k, traces)
            events.append(_events_before_last_tick(simulator, checkpoints[k], ends, cut, followed) > start)
    return ends, events


def _fly_again(
    simulator: Simulator,
    checkpoint: tuple[Tensor, Tensor],
    beyond: Tensor,
    ends: Tensor,
    trace: Trace | None,
    followed: Mapping[str, Samples],
) -> None:
    """Rewind the episodes ``beyond`` [N], and simulate them for ``ends`` [N] ticks."""
    if bool(beyond.any()):
        simulator.rewind(checkpoint, simulator.state.of_env(beyond))
        simulator.run(simulator.state.of_env(torch.where(beyond, ends, 0)), None, True, trace, followed)


def _events_before_last_tick(
    simulator: Simulator, checkpoint: tuple[Tensor, Tensor], ends: Tensor, cut: Tensor, followed: Mapping[str, Samples]
) -> Tensor:
    """Return the events, [N * count], of satellites that have run, without those of a last tick that is ``cut`` [N]."""
    if not bool(cut.any()):
        return simulator.events
    _fly_again(simulator, checkpoint, cut, ends - cut.long(), None, followed)
    events = simulator.events
    simulator.run(simulator.state.of_env(cut.long()), None, True, None, followed)
    return events
