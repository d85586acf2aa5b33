"""From satellites and options to simulations: fleets of N episodes, their draws and starts."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from bsk_torch.act.continuous import ContinuousAction
from bsk_torch.act.discrete import Broadcast
from bsk_torch.astro.ephemeris import coverage, coverage_in_words
from bsk_torch.codegen.kept import Kept
from bsk_torch.constants import NANO, R_EARTH
from bsk_torch.data.base import GlobalReward
from bsk_torch.data.checked import CheckedRewarder
from bsk_torch.env.assembly.randomizer import Randomizer
from bsk_torch.env.assembly.types import check_names, check_world, grouped
from bsk_torch.env.options import CONTINUOUS, ConstellationOptions, TaskingOptions
from bsk_torch.rand import Distribution, Key, first_key, seeded
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sats.satellite import Satellite
from bsk_torch.scene.base import Scenario
from bsk_torch.sim.arguments.sources import Answers, Member, expand, is_function
from bsk_torch.sim.arguments.table import ArgumentTable
from bsk_torch.sim.arguments.values import convert, drawn_once, holds_orbit
from bsk_torch.sim.assembly.composition import compose, world_components
from bsk_torch.sim.assembly.satellite_type import SatelliteType, SimulationOptions, Ticks, Usage, satellite_type
from bsk_torch.sim.component import Arg, Component, Field, Values
from bsk_torch.sim.draw_table import DrawTable
from bsk_torch.sim.fleet import EpisodeDraw, Fleet, share
from bsk_torch.sim.fsw.target import VERTICAL
from bsk_torch.sim.run.encounters import find_pairs
from bsk_torch.sim.simulator import Simulator
from bsk_torch.sim.world import WorldModel

LIMIT = Arg("time_limit", float("inf"), "s", "time after which an episode is truncated", low=NANO)

SMALLEST_POOL = 32
"""Number of satellites in a batch from which preparing the next episode of all environments in bulk pays."""

IN_BULK = 16
"""Satellites of smaller batches whose episodes are prepared in bulk, several of each environment."""

SAMPLE = 1024
"""Random time limits drawn to estimate the length of arcs before a batch is built."""


class FleetBuilder:
    """Creates the fleets of an environment, draws their episodes, and starts them.

    Attributes:
        satellites: The user's satellites.
        types: Indices of the satellites of each type.
        pairs: Pairs of satellites whose distance can end steps.
        world_type: World model given in the options; None if it follows from the satellites.
        scenario: A copy of the user's scenario.
        randomizer: Draws arguments of all satellites together; None without ``sat_arg_randomizer``.
    """

    def __init__(
        self,
        satellites: Sequence[Satellite],
        scenario: Scenario,
        rewarder: GlobalReward,
        options: TaskingOptions,
        randomizer: Randomizer | None,
        device: torch.device,
        made: Sequence[SatelliteType] | None = None,
    ) -> None:
        """Check the names of the satellites, group them by type, and check the world's arguments.

        ``made`` are the types of the satellites, where another environment of the same kind has them. Satellites of different
        groups of the scenario or the rewarder are of different types.
        """
        self.names = check_names(satellites)
        self.satellites = [satellite.as_given() for satellite in satellites]
        for satellite in self.satellites:
            satellite.sat_args_generator.update(scenario._own_arguments(satellite))
            if options.compat == "bsk_rl":  # there, elevations are counted from the radius
                satellite.sat_args_generator.pop(VERTICAL, None)
        self.types = grouped(self.satellites, lambda name: (scenario.group_of(name), rewarder.group_of(name)))
        if options.failures == CONTINUOUS:
            check_watched(self.satellites)
        models = [satellite.dyn_type for satellite in self.satellites]
        chiefs = [constant(satellite.sat_args_generator.get("chief_name")) for satellite in self.satellites]
        self.compat = options.compat == "bsk_rl"
        self.pairs = find_pairs(self.names, models, chiefs, self.compat)
        self.scenario, self.options, self.randomizer, self.device = scenario, options, randomizer, device
        self.population = options.population if isinstance(options, ConstellationOptions) else None
        if self.population is not None:
            check_population(self.population, self.names, scenario)
        self.world_type = None if options.world_type is None else compose(options.world_type, WorldModel)
        worlds = [world_components(self.satellites[columns[0]].dyn_type, self.world_type) for columns in self.types]
        self._world_names = [{arg.name for component in world for arg in component.args} for world in worlds]
        self.world_args = expand(options.world_args, "world_args")
        if options.compat == "bsk_rl" and any("groundLocationPlanetRadius" in names for names in self._world_names):
            self.world_args.setdefault("groundLocationPlanetRadius", R_EARTH)  # there, stations lie on a sphere
        if options.compat is None and any(holds_orbit(each.sat_args_generator.get("oe")) for each in self.satellites):
            self.world_args = {"earthRotation": "ITRF"} | self.world_args  # real orbits are above the real Earth
        self._made = made
        self._scenario_draws: dict[int, dict[str, Tensor]] = {}
        check_world(self.world_args, [*self._world_names, self.default_world_args()])

    def default_world_args(self) -> ArgumentTable:
        """Return every argument of the world, with its default."""
        models = (self.satellites[columns[0]].dyn_type for columns in self.types)
        parts = [part for model in models for part in world_components(model, self.world_type)]
        return ArgumentTable([*(self.world_type.all_components() if self.world_type else ()), *parts])

    @functools.cached_property
    def satellite_types(self) -> Sequence[SatelliteType]:
        """Data shared by the simulations of each type of satellite."""
        if self._made is not None:
            return self._made
        types: dict[int, SatelliteType] = {}
        ticks: Ticks = Kept(len(self.types))
        for k, followed in self._leaders_first():
            fields = {slot: types[leader].tick.recorded for slot, leader in followed.items()}
            types[k] = self._make_type(k, fields, ticks)
        return [types[k] for k in range(len(types))]

    def make_fleet(self, n: int, types: Sequence[SatelliteType] | None = None, trial: bool = False) -> SatelliteFleet:
        """Return simulations of ``n`` episodes, of changed ``types`` if given; for a ``trial``, of one satellite of each type."""
        # the trial's arcs shall be as long as those of the batch: see check_memory
        sample = isinstance(self.options.time_limit, Distribution) and n < self.options.num_envs
        limit = self.draw_time_limit(first_key(min(SAMPLE if sample else n, self.options.num_envs)))
        scenario_state, bounds = DrawTable(n, 1, self.device), self.scenario._bounds()
        for name, value in self._scenario_draw(min(2, n, self.options.num_envs)).items():
            low, high = bounds.get(name, (None, None))
            scenario_state.declare(name, None, *value.shape[1:], dtype=value.dtype, low=low, high=high)
        types = self.satellite_types if types is None else types
        each = []
        for made, columns in zip(types, self.types, strict=True):
            horizon = float(self.satellites[columns[0]].generation(limit).max())
            kind = made.alone if trial else made
            kinds = functools.partial(self.scenario.place_kinds_of, [self.names[column] for column in columns])
            each.append(Simulator(kind, n, horizon=horizon, scenario_state=scenario_state, places=kinds))
        chosen = sorted(column for simulator in each for column in simulator.columns)
        members = {c: (k, 0 if trial else i) for k, columns in enumerate(self.types) for i, c in enumerate(columns)}
        places = {name: members[column] for column, name in enumerate(self.names)}
        pairs, names, varies = self.pairs.among(chosen), [self.names[k] for k in chosen], self.varies and not trial
        return SatelliteFleet(each, names, self.scenario.draw_checked, places, pairs, self.compat, varies)

    def _scenario_draw(self, n: int) -> dict[str, Tensor]:
        """Return trial draws of the scenario for ``n`` environments, which determine its names and shapes."""
        if n not in self._scenario_draws:
            self._scenario_draws[n] = self.scenario.draw_checked(first_key(n))
        return self._scenario_draws[n]

    def _leaders_first(self) -> Iterator[tuple[int, dict[str, int]]]:
        """Yield the types of satellites in order of dependence, each with the types that it follows, by slot."""
        parts = [
            [*s.dyn_type.all_components(), *s.fsw_type.all_components()] for s in (self.satellites[c[0]] for c in self.types)
        ]
        waiting = {
            k: {p.follows: self._leader(p.follows, parts) for p in type_parts if p.follows} for k, type_parts in enumerate(parts)
        }
        while waiting:
            ready = next((k for k, followed in waiting.items() if not waiting.keys() & set(followed.values())), None)
            if ready is None:
                names = [self.names[self.types[k][0]] for k in waiting]
                raise ValueError(f"satellites {names} follow each other, so none of them can run first")
            yield ready, waiting.pop(ready)

    def _leader(self, slot: str, parts: Sequence[Sequence[Component]]) -> int:
        having = [k for k, components in enumerate(parts) if any(part.slot == slot for part in components)]
        names = [self.names[column] for k in having for column in self.types[k]]
        if len(names) != 1:
            raise ValueError(f"satellites follow the one whose model has the slot {slot!r}; {names or 'none'} have it, not one")
        return having[0]

    def _make_type(self, k: int, followed: Mapping[str, Sequence[Field]], ticks: Ticks) -> SatelliteType:
        columns, options = self.types[k], self.options
        satellite = self.satellites[columns[0]]
        arguments = [self.satellites[column].sat_args_generator for column in columns]
        return satellite_type(
            (satellite.dyn_type, satellite.fsw_type),
            arguments[0] if all(args is arguments[0] for args in arguments) else arguments,
            {name: value for name, value in self.world_args.items() if name in self._world_names[k]},
            SimulationOptions(
                device=self.device,
                dtype=options.sim_dtype,
                sim_rate=options.sim_rate,
                orbit=options.orbit,
                backend=options.backend,
                compat=self.compat,
                replan=bool(options.replan),
            ),
            Usage(
                columns=tuple(columns),
                stops=satellite.variable_interval,
                watches=options.failures == CONTINUOUS,
                controlled=_may_control(satellite),
                segment=satellite.segment,
                randomize=lambda key: {} if self.randomizer is None else share(self.randomizer(key), columns),
                followed=followed,
                recorded=("r_BN_N",) if self.pairs.watched.intersection(columns) else (),
                drawn=frozenset(self._scenario_draw(min(2, options.num_envs))),
            ),
            num_envs=options.num_envs,
            world_type=self.world_type,
            ticks=ticks,
        )

    @property
    def calls_user(self) -> bool:
        """Whether drawing an episode calls a user function; these are called only for episodes that begin now."""
        values = [value for satellite in self.satellites for value in satellite.sat_args_generator.values()]
        calls = any(map(is_function, [*values, *self.world_args.values()]))
        return calls or self._calls_others

    @property
    def _calls_others(self) -> bool:
        """Whether user functions return anything other than single arguments."""
        randomizes = self.randomizer is not None and self.randomizer.calls_user
        return is_function(self.options.time_limit) or randomizes or self.scenario.calls_user

    @property
    def prepared(self) -> int:
        """Number of episodes of each environment prepared in bulk; 0 where user functions draw episodes."""
        satellites = self.options.num_envs * len(self.names)
        return 0 if self.calls_user else 1 if satellites >= SMALLEST_POOL else max(2, IN_BULK // satellites)

    def draw_time_limit(self, key: Key, answers: Sequence[Answers] = ()) -> Tensor:
        """Return the time limits [n] s of the key's environments, not yet rounded to whole ticks."""
        value = self.options.time_limit
        if isinstance(value, Distribution):
            return convert(LIMIT, value.draw(key.named("time_limit")), len(key))
        if not callable(value):
            return convert(LIMIT, [value] * len(key), len(key))
        if answers:
            values = [answer["time_limit"] for answer in answers]
        else:
            with seeded(key.named("time_limit")) as rows:
                values = [value() for _ in rows]
        return convert(LIMIT, [drawn_once(LIMIT, each, key, row) for row, each in enumerate(values)], len(key))

    def ask(self, fleet: Fleet, key: Key) -> list[Answers]:
        """Return the results of the user functions for each of the key's environments; empty without such functions.

        The functions share one stream of random numbers. They are called in this order: time limit, world, randomizer,
        satellites, scenario.
        """
        if not (fleet.calls_user or self._calls_others):
            return []
        answers: list[Answers] = []
        randomize = self.randomizer.ask if self.randomizer is not None and self.randomizer.calls_user else None
        with seeded(key.named("episode")) as rows:
            for row in rows:
                answers.append({})
                if is_function(self.options.time_limit):
                    answers[-1]["time_limit"] = self.options.time_limit()  # type: ignore[operator]
                fleet.ask(int(row.env_id), answers[-1], randomize)
                if self.scenario.calls_user:
                    answers[-1]["scenario"] = self.scenario.draw_checked(row)
                    if self.scenario.varies_population:
                        answers[-1]["present"] = self.scenario.present_checked(row, self.names)
        return answers

    @property
    def varies(self) -> bool:
        """Whether satellites may be absent from episodes."""
        return self.population is not None or self.scenario.varies_population

    def draw_present(self, fleet: Fleet, key: Key, answers: Sequence[Answers]) -> Tensor | None:
        """Return which satellites are present in the episodes of the key's environments, [n, S]; None if all always are."""
        if not fleet.varies:
            return None
        if self.population is not None:
            present = between(key.named("population"), *self.population, fleet.size)
        elif self.scenario.calls_user:
            present = torch.cat([answer["present"] for answer in answers])
        else:
            present = self.scenario.present_checked(key, self.names)
        for leader in {leader for needed in fleet.dependencies.depends_on for leader in needed.values()}:
            for column in fleet.columns[leader].tolist():
                if not bool(present[:, column].all()):
                    raise ValueError(
                        f"{self.names[column]!r} is not present in all episodes, and components of other satellites follow it; "
                        "let a scenario draw who is present, with it in each episode"
                    )
        return present

    def draw(self, fleet: Fleet, key: Key) -> tuple[EpisodeDraw, Tensor]:
        """Return draws for the episodes of the key's environments, and their time limits, [n] s."""
        answers = self.ask(fleet, key)
        arguments = None if self.randomizer is None else self.randomizer(key, answers)
        parts = [answer["scenario"] for answer in answers] if self.scenario.calls_user else []
        scenario = {name: torch.cat([part[name] for part in parts]) for name in parts[0]} if parts else None
        drawn, limit = fleet.draw(key, arguments, answers, scenario), self.draw_time_limit(key, answers)
        check_ephemeris(drawn, limit)
        return drawn._replace(present=self.draw_present(fleet, key, answers)), limit.to(self.device)

    def draw_arguments(self, fleet: Fleet, key: Key) -> Sequence[Values]:
        """Return only the arguments of satellites and world of the key's environments, as :meth:`draw` does, for each type."""
        answers = self.ask(fleet, key)
        arguments = None if self.randomizer is None else self.randomizer(key, answers)
        return fleet.draw(key, arguments, answers, {}).values

    def start(self, fleet: Fleet, envs: Tensor, drawn: EpisodeDraw, limit: Tensor) -> None:
        """Start the episodes ``envs`` [n] of a fleet."""
        durations = [self.satellites[s.columns[0]].generation(limit) for s in fleet.simulators]
        fleet.reset(envs, drawn, durations, limit)

    def draw_and_start(self, fleet: Fleet, envs: Tensor, key: Key) -> None:
        """Start the key's episodes in ``envs`` [n] of a fleet; everything is drawn and checked before anything changes."""
        self.start(fleet, envs, *self.draw(fleet, key))


def _may_control(satellite: Satellite) -> bool:
    """Return whether an action of the satellite may switch attitude control on; assumed for actions of user classes."""
    modes, commands = satellite.fsw_type.all_modes(), satellite.fsw_type.all_commands()
    for entry in satellite.action_spec:
        if isinstance(entry, ContinuousAction):
            return True
        if isinstance(entry, Broadcast):
            continue
        command = commands.get(str(getattr(entry, "fsw_action", "")).removeprefix("action_"))
        if command is None or any(mode not in modes or "control_on" in (modes[mode].on or ()) for mode in command.modes):
            return True
    return False


def constant(value: object) -> Any:
    """Return the value of an argument that is constant over episodes; a function may return it together with others."""
    return value.trial if isinstance(value, Member) else value


def check_watched(satellites: Sequence[Satellite]) -> None:
    """Raise ValueError for a satellite whose failures cannot end a step."""
    for satellite in satellites:
        if not satellite.variable_interval:
            raise ValueError(
                f"failures='continuous': {satellite.name} has variable_interval=False, so that nothing in it ends a step; leave "
                "one of them out"
            )


def check_population(population: tuple[int, int], names: Sequence[str], scenario: Scenario) -> None:
    """Raise ValueError for a maximum above the number of satellites, or if the scenario draws the present ones."""
    if population[1] > len(names):
        raise ValueError(f"population={population}: at most {len(names)} satellites can be present")
    if scenario.varies_population:
        raise ValueError(
            f"population={population}: {type(scenario).__name__}.present(key, names) draws who is present; leave one of them out"
        )


def between(key: Key, low: int, high: int, size: int) -> Tensor:
    """Return which of ``size`` satellites are present, [n, size]: ``low`` to ``high``; all numbers and choices equally likely."""
    drawn = key.uniform(1 + size)
    number = low + torch.floor(drawn[:, :1] * (high - low + 1)).long()
    return drawn[:, 1:].argsort(dim=1, stable=True).argsort(dim=1) < number


def check_ephemeris(drawn: EpisodeDraw, limit: Tensor) -> None:
    """Raise ValueError for episodes with finite time limits [n] s beyond the end of the Sun's ephemeris."""
    finite = torch.where(torch.isfinite(limit), limit, 0.0)
    for values in drawn.values:
        et = values["utc_init"].cpu()
        ends = (et.view(len(limit), -1) if len(et) % len(limit) == 0 else et) + finite.unsqueeze(-1)
        beyond = float(ends.max()) - coverage()[1]
        if beyond > 0.0:
            raise ValueError(
                f"world_args: utc_init and time_limit: an episode would end {beyond:.10g} s after the ephemeris table, which "
                f"covers {coverage_in_words()} (TDB); give an earlier utc_init or a shorter time_limit"
            )


def link(fleet: SatelliteFleet, scenario: Scenario, rewarder: GlobalReward) -> CheckedRewarder:
    """Link satellites, scenario and rewarder; return the hooks of the rewarder."""
    scenario.attach(fleet)
    for satellite in fleet.satellites:
        satellite.scenario, satellite.rewarder = scenario.seen_by(satellite.names), rewarder
    checked = CheckedRewarder(rewarder)
    checked.link(scenario, fleet)
    return checked
