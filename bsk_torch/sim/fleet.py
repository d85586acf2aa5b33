"""All satellites of a batch of episodes, of one or several types: their draws, their state, and runs to the next event."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from bsk_torch.rand import Key
from bsk_torch.sim.arguments.sources import Answers
from bsk_torch.sim.arguments.values import Overrides
from bsk_torch.sim.assembly.satellite_type import SatelliteType
from bsk_torch.sim.component import Values
from bsk_torch.sim.names import nearest
from bsk_torch.sim.run.antennas import Antennas
from bsk_torch.sim.run.coupled import Dependencies, FlightObserver, Part, RunResult, StopCondition, parts_of, together
from bsk_torch.sim.run.encounters import NO_PAIRS, EncounterPairs, Encounters
from bsk_torch.sim.satellite_state import SatelliteState
from bsk_torch.sim.simulator import Simulator
from bsk_torch.sim.state import StateTable

if TYPE_CHECKING:
    from bsk_torch.sim.run.recording import Recording


class EpisodeDraw(NamedTuple):
    """Draws of n episodes: those of the scenario, and the arguments of each simulation."""

    scenario: dict[str, Tensor]
    values: Sequence[Values]
    present: Tensor | None = None
    """Satellites that take part, [n, S] (default: all)."""


class FleetState(StateTable):
    """State of N episodes with S satellites each; see :class:`Fleet`."""

    time_limit: Tensor
    removed: Tensor

    def __init__(self, num_envs: int, size: int, device: torch.device) -> None:
        super().__init__(num_envs, 1, device)
        self.declare("time_limit", 0.0, low=0.0)
        self.declare("removed", False, size)
        self._some_removed: tuple[Tensor, bool] | None = None

    @property
    def some_removed(self) -> bool:
        """Whether there are satellites that have been removed."""
        noted = self._some_removed
        if noted is None or noted[0] is not self.removed:
            noted = self._some_removed = self.removed, bool(self.removed.any())
        return noted[1]

    def check_relations(self, path: str) -> None:
        """See :meth:`StateTable.check_relations`: the clocks of an episode's satellites agree."""
        tables = {name: table for name, table in self.tables.items() if isinstance(table, SatelliteState)}
        clocks = {name: table.ticks.view(self.num_envs, -1) for name, table in tables.items()}
        now = torch.cat([*clocks.values()], 1).amax(1, keepdim=True)
        for name, ticks in clocks.items():
            wrong, why = ticks != now, "all satellites of an episode must have the same"
            if "present" in tables[name]:
                absent = ~tables[name]["present"].view(self.num_envs, -1)
                wrong, why = torch.where(absent, ticks != 0, wrong), f"{why}, but for those that are not present: 0"
            self.refuse(f"{path}{name}.ticks", ticks, wrong, why)


class Fleet:
    """The satellites of ``num_envs`` episodes, S in each, simulated type by type.

    Attributes:
        simulators: One simulation for each type of satellite.
        columns: Positions of the satellites of each type among the S of the fleet, [count] each.
        names: Name of every satellite.
        places: Type of each satellite of an episode by name, and its number among those of the type; on a trial, where there is
            one of each type, satellites that are not simulated have the place of that one.
        state: Everything that belongs to the current episodes: ``time_limit`` [N] s, ``removed`` [N, S] (satellites
            that are not present, or have died and left), the tables ``scenario`` (its draws) and ``memory`` (tensors that
            rewarders, communicators and users declare), and the state of each type.
        scenario_state: The table ``scenario`` of the state, [N, ...] each.
        memory: The table ``memory`` of the state, [N, ...] each.
        h: Length of a tick, s.
        since: Ticks since reset at the start of the current step, [N].
        env_ids: Index of each episode in draws, [N].
        traced: Whether satellites depend on one another within a tick, so that runs leave traces.
        varies: Whether some satellites are not present in some episodes; see :attr:`present`.
        dependencies: Which types of satellites follow which.
        stop_conditions: Conditions on several satellites that end a step; they need traces of the satellites.
        flight_observers: Functions that read the traces of what has been run.
        recordings: Recordings that have not been stopped.
        beginnings: Functions that an environment calls with the episodes [n] that have begun.
        encounters: Conjunctions and ranges of the satellites.
        antennas: Antennas of ground stations for which satellites contend; None without.
    """

    def __init__(
        self,
        simulators: Sequence[Simulator],
        names: Sequence[str],
        draw_scenario: Callable[[Key], dict[str, Tensor]] = lambda key: {},
        places: Mapping[str, tuple[int, int]] | None = None,
        pairs: EncounterPairs = NO_PAIRS,
        compat: bool = False,
        varies: bool = False,
    ) -> None:
        """Put simulations of the same environments together; ``names`` are those of all satellites.

        ``draw_scenario`` draws for episodes to come, see :meth:`bsk_torch.scene.base.Scenario.draw`. The ``places`` of ``names``
        follow by default. ``pairs`` are satellites, by their numbers among ``names``, whose distance ends steps, and whose hubs
        record positions; with ``compat`` conjunctions are booked with the errors of recordings.
        """
        self.simulators, self.names, self.varies = tuple(simulators), list(names), varies
        first = self.simulators[0]
        self.num_envs, self.size, self.device, self.h = first.num_envs, len(names), first.device, first.h
        flown = sorted(column for simulator in self.simulators for column in simulator.columns)  # of a trial, one of each type
        position = {column: k for k, column in enumerate(flown)}
        self.columns = tuple(torch.tensor([position[c] for c in s.columns], device=self.device) for s in self.simulators)
        place_of = {self.names[p]: (k, i) for k, columns in enumerate(self.columns) for i, p in enumerate(columns.tolist())}
        self.places = {name: place_of[name] for name in self.names} if places is None else dict(places)
        order = torch.cat(self.columns)
        self._order = None if torch.equal(order, torch.arange(self.size, device=self.device)) else order.argsort()
        self.dependencies = Dependencies(self.simulators)
        self.traced = any(simulator.records or simulator.followed for simulator in self.simulators)
        self.stop_conditions: list[StopCondition] = []
        self.flight_observers: list[FlightObserver] = []
        self.recordings: list[Recording] = []
        self.draw_scenario = draw_scenario
        self.beginnings: list[Callable[[Tensor], object]] = []
        self.all_envs = self.env_ids = torch.arange(self.num_envs, device=self.device)
        self.since = torch.zeros(self.num_envs, dtype=torch.int64, device=self.device)
        self.memory, self.scenario_state = StateTable(self.num_envs, 1, self.device), first.scenario_state
        self.state = FleetState(self.num_envs, self.size, self.device)
        self.state.add("memory", self.memory)
        self.state.add("scenario", self.scenario_state)
        for k, simulator in enumerate(self.simulators):
            self.state.add(f"satellites_{k}", simulator.state)
            if varies:
                simulator.state.declare("present", True)
        self.encounters = Encounters(self, pairs, compat)
        self.antennas = Antennas.of(self)

    def place_of(self, name: str) -> tuple[int, int]:
        """Return the type of a satellite and its number within the type; KeyError for an unknown name, with the nearest one."""
        if name not in self.places:
            raise KeyError(f"{name!r} is not a satellite of the environment; {nearest(str(name), self.places)}")
        return self.places[name]

    @property
    def ticks(self) -> Tensor:
        """Ticks since reset, [N]."""
        return self._clock("ticks")

    @property
    def sim_time(self) -> Tensor:
        """Time since reset, [N] s."""
        return self._clock("sim_time")

    def _clock(self, name: str) -> Tensor:
        if self.varies:  # the clocks of satellites that are not present stay at zero
            return self.joined([getattr(simulator.state, name) for simulator in self.simulators]).amax(1)
        state = self.simulators[0].state
        return self.first_of_each(getattr(state, name), state.count)

    @property
    def present(self) -> Tensor | None:
        """Satellites that take part in their episodes from beginning to death or end, [N, S]; None if all do in all."""
        return self.joined([simulator.state["present"] for simulator in self.simulators]) if self.varies else None

    def first_of_each(self, rows: Tensor, count: int) -> Tensor:
        """Return the values of the first satellite of each episode, [N], of rows [N * count]."""
        return rows if count == 1 else rows[::count].contiguous()

    def joined(self, parts: Sequence[Tensor]) -> Tensor:
        """Return the rows [N * count, ...] of all types by episode and satellite, [N, S, ...]."""
        if self.size == 1:
            return parts[0].unsqueeze(1)
        if len(parts) == 1:
            whole = parts[0].reshape(self.num_envs, -1, *parts[0].shape[1:])
        else:
            whole = torch.cat([part.reshape(self.num_envs, -1, *part.shape[1:]) for part in parts], 1)
        return whole if self._order is None else whole[:, self._order]

    def rows_of(self, part: int, table: Tensor) -> Tensor:
        """Return the rows [N * count, ...] of one type from a table [N, S, ...]."""
        rows = table if len(self.simulators) == 1 and self._order is None else table[:, self.columns[part]]
        return rows.flatten(0, 1)

    def key(self) -> Key:
        """Return the key of random numbers of the current episodes; that of first episodes under seed 0 on a trial."""
        none = torch.zeros(self.num_envs, dtype=torch.int64)
        seed, episode = (self.state[name].cpu() if name in self.state else none for name in ("seed", "episode"))
        return Key(seed, self.env_ids.cpu(), episode)

    # -- episodes -----------------------------------------------------------------------------------------------------

    def ask(self, env: int, answers: Answers, randomize: Callable[[], object] | None = None) -> None:
        """Call the user functions that give arguments of the environment ``env``, in the order of draws; add their answers.

        World first, then ``randomize``, which gives arguments of all satellites, then the satellites in their order.
        """
        for simulator in self.simulators:
            simulator.type.arguments.world_args.ask(0, env, answers)
        if randomize is not None:
            answers["sat_arg_randomizer"] = randomize()
        pairs = ((simulator.type.arguments, simulator.columns) for simulator in self.simulators)
        each = ((column, usage.sat_args, k) for usage, columns in pairs for k, column in enumerate(columns))
        for _, arguments, k in sorted(each, key=lambda entry: entry[0]):
            arguments.ask(k, env, answers)

    @property
    def calls_user(self) -> bool:
        """Whether arguments are given by user functions."""
        each = (simulator.type.arguments for simulator in self.simulators)
        return any(arguments.world_args.calls_user or arguments.sat_args.calls_user for arguments in each)

    def draw(
        self,
        key: Key,
        overrides: Mapping[str, tuple[Sequence[int], Tensor]] | None = None,
        answers: Sequence[Answers] | None = None,
        scenario: dict[str, Tensor] | None = None,
    ) -> EpisodeDraw:
        """Return the draws of the key's n environments; raises before anything has changed.

        ``overrides`` are arguments of satellites of all types that replace others: by name, the satellites [c] and values [n, c,
        ...]. User functions are called now, unless ``answers`` has what they returned (:meth:`ask`), and the scenario draws
        unless given.
        """
        drawn = self.draw_scenario(key) if scenario is None else scenario
        world: dict[str, object] = {}
        values = []
        for simulator in self.simulators:
            arguments = simulator.type.arguments
            around = arguments.world_args.draw(key, world, answers)
            world |= around
            values.append(arguments.draw(key, around, share(overrides or {}, simulator.columns), answers))
        return EpisodeDraw(drawn, values)

    def reset(self, envs: Tensor, drawn: EpisodeDraw, durations: Sequence[Tensor], time_limit: Tensor) -> None:
        """Start drawn episodes in ``envs`` [n], with windows for ``durations``, [n] s of each type, and time limits, [n] s."""
        self.state.reset(envs)
        self.state.time_limit = self.state.time_limit.index_copy(0, envs, time_limit)
        for name, value in drawn.scenario.items():
            self.scenario_state[name][envs] = value.to(self.device)
        if drawn.present is not None:
            present = drawn.present.to(self.device)
            self.state.removed = self.state.removed.index_copy(0, envs, ~present)
            for columns, simulator in zip(self.columns, self.simulators, strict=True):
                state = simulator.state
                state["present"] = state["present"].index_copy(0, state.rows_of(envs), present[:, columns].flatten())
        for k in self.dependencies.order:
            self.simulators[k].reset(envs, drawn.values[k], durations[k], self.dependencies.present(k))

    def change(self, types: Sequence[SatelliteType]) -> None:
        """Take types of the same satellites with other arguments; present episodes keep theirs."""
        for simulator, satellite_type in zip(self.simulators, types, strict=True):
            simulator.change(satellite_type)

    # -- running ------------------------------------------------------------------------------------------------------

    def run(self, moves: Tensor, limit_ticks: Tensor, until: Tensor, expected: Sequence[Tensor] | None = None) -> RunResult:
        """Simulate the episodes ``moves`` [N] to a given tick, to the first event that ends a step, or to the episode's end.

        Types whose events end no step run last. Where a later one of two types ends a step early, the earlier one runs again.
        ``limit_ticks`` [N] is the last tick of each episode, ``until`` [N] the tick since reset at which the step ends unless
        an event does, and ``expected`` [N] that at which events of each type of satellites will probably end it; a matter of
        speed only.
        """
        if self.antennas is not None:
            self.antennas.assign(moves, torch.minimum(until, limit_ticks))
        now = self.ticks
        ends, remaining = ticks_to_run(now, limit_ticks, until, moves)
        probably = [ends] * len(self.simulators) if expected is None else [ticks - now for ticks in expected]
        parts = []
        for envs in parts_of(self, moves, ends):
            parts.append(part := Part(self, envs, now, ends, remaining, probably))
            for call in part.calls():
                simulator, rows = self.simulators[call.k], part.rows[call.k]
                call.ran = simulator.run(call.ticks, call.expected, call.may_rewind, call.trace, call.followed, rows)
        return together(self, parts)


def as_ticks(whole: Tensor) -> Tensor:
    """Return whole numbers, or truth values, as int64; kernels count in float64, which is exact, too."""
    return whole.long() if isinstance(whole, Tensor) else whole.double()


def ticks_to_run(now: Tensor, limit: Tensor, until: Tensor, moves: Tensor) -> tuple[Tensor, Tensor]:
    """Return the ticks [N] that the episodes ``moves`` [N] run from the tick ``now`` [N] to ``until`` [N], and all that remain.

    ``limit`` [N] is the last tick of each episode.
    """
    remaining = (limit - now).clamp(min=0)
    return torch.minimum(until - now, remaining).clamp(min=0) * moves, remaining


def share(overrides: Mapping[str, tuple[Sequence[int], Tensor]], columns: Sequence[int]) -> Overrides:
    """Return the overrides of the satellites ``columns`` of one type, numbered within the type."""
    of_type = {}
    for name, (satellites, values) in overrides.items():
        pairs = [(columns.index(s), k) for k, s in enumerate(satellites) if s in columns]
        if pairs:
            within, where = (torch.tensor(side) for side in zip(*pairs, strict=True))
            of_type[name] = within, values[:, where]
    return of_type
