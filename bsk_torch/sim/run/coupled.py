"""How the types of satellites of a fleet run together: in which order, how far, and what is read from their traces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.access.visibility.planned import take_rows
from bsk_torch.sim.simulator import Checkpoint, Simulator
from bsk_torch.sim.tick.trace import Flight, Trace

if TYPE_CHECKING:
    from bsk_torch.sim.fleet import Fleet

MOST_NUMBERS, DEVICE_MOST_NUMBERS = 1 << 22, 1 << 25
"""Numbers that the traces of a run hold at once; longer runs, or those of more episodes, are made part by part.

On the CPU, larger traces get new pages of memory for every part, which takes longer than what is computed from them.
"""

StopCondition = Callable[[Flight], Tensor]
"""Returns the first tick of a flight, [n], at which something ends the step; more than all ticks where nothing does."""

FlightObserver = Callable[[Flight], None]  # called with the flights that a step consists of, each episode in one of them


class RunResult(NamedTuple):
    """What the simulation of N episodes to their next event has come to."""

    ticks: Tensor  # ticks that each episode has run, [N]
    # for each type of satellites, whether an event such as an image ended the action of a row, [N * count]; None for types
    # without such events
    events: tuple[Tensor | None, ...]


class Dependencies:
    """Which type of satellites reads the trace of which, and the order in which types run."""

    def __init__(self, simulators: Sequence[Simulator]) -> None:
        self.simulators = simulators
        # for each type, the type that it follows by slot
        self.depends_on = [{name: self._owner(name) for name in simulator.followed} for simulator in simulators]
        depth: dict[int, int] = {}
        while len(depth) < len(simulators):  # FleetBuilder has built those followed first, so there are no circles
            for k, others in enumerate(self.depends_on):
                if k not in depth and all(other in depth for other in others.values()):
                    depth[k] = 1 + max((depth[other] for other in others.values()), default=0)
        # those followed before those that follow them, and those whose events end steps first
        self.order = sorted(depth, key=lambda k: (depth[k], not simulators[k].stops))
        # types that run before the end of a step is known, by whether there are stop conditions
        self.first = {watched: self._first(watched) for watched in (False, True)}

    def _owner(self, name: str) -> int:
        return next(
            k for k, simulator in enumerate(self.simulators) if any(part.slot == name for part in simulator.type.arguments.parts)
        )

    def samples(self, k: int, traces: Mapping[int, Trace]) -> dict[str, Samples]:
        """Return the traces that the satellites of type k follow, by slot."""
        followed = {}
        for name, other in self.depends_on[k].items():
            trace, simulator = traces[other], self.simulators[k]
            episodes = torch.arange(len(trace.start), device=simulator.device)
            followed[name] = trace.samples(simulator.h_ns, episodes.repeat_interleave(simulator.count))
        return followed

    def present(self, k: int) -> dict[str, Samples]:
        """Return traces of the present alone that the satellites of type k follow, by slot."""
        return self.samples(k, {other: self.simulators[other].trace(0) for other in self.depends_on[k].values()})

    def _first(self, watched: bool) -> list[int]:
        """Return types whose events end steps, and those that they follow; with stop conditions, all that leave traces.

        Types whose events end no step are among them if they leave traces: see :meth:`Part._finish`.
        """
        needed: set[int] = set()
        for k in reversed(self.order):
            simulator = self.simulators[k]
            if k in needed or simulator.stops or (simulator.records and (watched or simulator.has_events)):
                needed |= {k, *self.depends_on[k].values()}
        return [k for k in self.order if k in needed]


@dataclass
class Call:
    """A run of one type that is due, from the current state."""

    k: int
    ticks: Tensor  # most ticks of each row, [n * count]
    expected: Tensor | None  # probable number of them, [n * count]; None if no event is expected
    may_rewind: bool  # whether the rows may be rewound to where they are now
    trace: Trace | None  # where it records fields
    followed: dict[str, Samples]  # traces that it reads, by slot
    ran: Tensor = field(init=False)  # ticks that the rows have run, [n * count], once they have


class Part:
    """A run of n episodes of a fleet, whose traces are in memory together.

    They run ``ends`` [n] ticks, at most until all calls have been made; ``events`` are those of :class:`RunResult`.
    """

    def __init__(
        self, fleet: Fleet, envs: Tensor | None, now: Tensor, ends: Tensor, remaining: Tensor, expected: Sequence[Tensor]
    ) -> None:
        """Prepare the run of the episodes ``envs`` [n], or all, which are ``now`` [N] ticks old, by at most ``ends`` [N] ticks.

        ``remaining`` [N] are the ticks to the end of the episode, ``expected`` [N], for each type, the ticks to an event that
        ends the step.
        """
        self.fleet, self.envs, self.since, self.ends, self.remaining, self.expected = fleet, envs, now, ends, remaining, expected
        self.rows: list[Tensor | None] = [None] * len(fleet.simulators)
        if envs is not None:
            self.since, self.ends, self.remaining, *self.expected = (ticks[envs] for ticks in (now, ends, remaining, *expected))
            if len(envs) < fleet.num_envs:
                self.rows = [simulator.state.rows_of(envs) for simulator in fleet.simulators]
        self.events: list[Tensor | None] = [None] * len(self.rows)
        self.traces: dict[int, Trace] = {}
        self.checkpoints: dict[int, Checkpoint] = {}
        self.starts: list[Tensor | None] = []
        self.ran: dict[int, Tensor] = {}

    def calls(self) -> Iterator[Call]:
        """Yield the runs of types that are due; each must have been made before the next one is asked for.

        Types that can end the run go first, each at most as far as those before it. Then stop conditions are checked; types that
        have run too far are rewound and run again, and all others run, to the end.
        """
        fleet, simulators = self.fleet, self.fleet.simulators
        if fleet.traced:
            longest = int(self.ends.max())
            self.traces = {k: s.trace(longest, self.rows[k]) for k, s in enumerate(simulators) if s.records}
        self.starts = [s.events(rows) if s.has_events else None for s, rows in zip(simulators, self.rows, strict=True)]
        recordings = [(recording, recording.prepare(self.envs)) for recording in fleet.recordings]
        first = fleet.dependencies.first[bool(fleet.stop_conditions)]
        rewinds = len(first) > 1 or bool(fleet.stop_conditions)
        for k in first:
            simulator = simulators[k]
            if rewinds or simulator.ends_apart:
                self.checkpoints[k] = simulator.checkpoint(self.rows[k])
            ends = simulator.state.of_env(self.ends)
            call = self._call(k, ends, torch.minimum(simulator.state.of_env(self.expected[k]), ends))
            yield call
            self.ran[k] = call.ran.view(-1, simulator.count)[:, 0]
            self.ends = torch.minimum(self.ends, self.ran[k])
        for condition in fleet.stop_conditions:
            self.ends = torch.minimum(self.ends, condition(self._flight()))
        for k in fleet.dependencies.order:
            yield from self._finish(k)
        for observe in fleet.flight_observers:
            observe(self._flight())
        for recording, places in recordings:
            recording.add(self._episodes()[places], self.ends[places], self._followed(places))
        self.traces.clear()

    def _finish(self, k: int) -> Iterator[Call]:
        """Yield the runs that bring type k to the end, and read its events.

        The clock of an episode stops before events of its last tick are evaluated: where these do not end runs, the tick is run
        after they have been read.
        """
        simulator, rows, start = self.fleet.simulators[k], self.rows[k], self.starts[k]
        of_env, apart, goal = simulator.state.of_env, simulator.ends_apart, self.ends
        if start is not None:
            last = (self.ends >= self.remaining) & (self.ends > 0)
            goal = self.ends - last.long() if apart else self.ends
        if k not in self.ran:
            yield self._call(k, of_env(goal))
        elif k in self.checkpoints and bool((beyond := self.ran[k] > goal).any()):
            simulator.rewind(self.checkpoints[k], of_env(beyond))
            yield self._call(k, of_env(torch.where(beyond, goal, 0)))
        if start is not None:
            new = simulator.events(rows) > start
            self.events[k] = new if apart else new & ~of_env(last)
        if apart and bool(last.any()):
            call = self._call(k, of_env(last.long()))
            call.trace = None  # the records have been made by a run of all ticks
            yield call

    def _call(self, k: int, ticks: Tensor, expected: Tensor | None = None) -> Call:
        dependencies = self.fleet.dependencies
        followed = dependencies.samples(k, self.traces) if dependencies.depends_on[k] else {}
        may_rewind = k in self.checkpoints or bool(self.fleet.recordings)
        return Call(k, ticks, expected, may_rewind, self.traces.get(k), followed)

    def _followed(self, places: Tensor) -> dict[int, dict[str, Samples]]:
        followed_rows = {}
        for k, simulator in enumerate(self.fleet.simulators):
            rows = simulator.state.rows_of(places)
            followed = self.fleet.dependencies.samples(k, self.traces)
            followed_rows[k] = {name: take_rows(trace, rows) for name, trace in followed.items()}
        return followed_rows

    def _episodes(self) -> Tensor:
        return self.fleet.all_envs if self.envs is None else self.envs

    def _flight(self) -> Flight:
        counts = tuple(simulator.count for simulator in self.fleet.simulators)
        traces = tuple(self.traces.get(k) for k in range(len(counts)))
        return Flight(self._episodes(), self.since, self.ends, self.remaining, traces, counts)


def parts_of(fleet: Fleet, moves: Tensor, ends: Tensor) -> Iterator[Tensor | None]:
    """Yield the episodes ``moves`` [N] in parts whose traces fit into memory together, longest runs first.

    Only where traces are read one must know which episodes move; elsewhere all run together, for which None stands.
    """
    if not (fleet.traced or fleet.stop_conditions or fleet.flight_observers):
        yield None
        return
    width = sum(simulator.count * len(simulator.tick.recorded_planes) for simulator in fleet.simulators)
    most = MOST_NUMBERS if moves.device.type == "cpu" else DEVICE_MOST_NUMBERS
    envs = torch.nonzero(moves).squeeze(-1)
    ranked = envs[ends[envs].argsort(descending=True, stable=True)]
    while len(ranked):
        size = max(1, most // (max(1, width) * (int(ends[ranked[0]]) + 1)))
        yield ranked[:size].sort().values
        ranked = ranked[size:]


def together(fleet: Fleet, parts: Sequence[Part]) -> RunResult:
    """Return the result of a run in parts."""
    if len(parts) == 1 and parts[0].envs is None:
        return RunResult(parts[0].ends, tuple(parts[0].events))
    ticks = torch.zeros_like(fleet.all_envs)
    events = [torch.zeros_like(s.state.ticks, dtype=torch.bool) if s.has_events else None for s in fleet.simulators]
    for part in parts:
        ticks[part.envs] = part.ends
        for event, new, rows in zip(events, part.events, part.rows, strict=True):
            if event is not None and new is not None:
                event[slice(None) if rows is None else rows] = new
    return RunResult(ticks, tuple(events))
