"""From satellites and options to simulations: fleets of N episodes, and the trial episode from which specs are made."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from bsk_torch.data import checked
from bsk_torch.data.base import GlobalReward
from bsk_torch.env.machine import check_memory
from bsk_torch.env.options import TaskingOptions
from bsk_torch.env.pool import SMALLEST
from bsk_torch.env.randomizer import Randomizer
from bsk_torch.env.satellite_group import SatelliteGroup, groups_of
from bsk_torch.env.types import check_names, check_world, grouped, world_arguments, world_components
from bsk_torch.obs.base import Values
from bsk_torch.rand import Distribution, Key, first_key
from bsk_torch.sats.satellite import Satellite
from bsk_torch.scene.base import Scenario
from bsk_torch.sim.argument_table import ArgumentTable
from bsk_torch.sim.component import Arg, MissingMessageError
from bsk_torch.sim.composition import compose, provided_by
from bsk_torch.sim.fleet import EpisodeDraw, Fleet, share
from bsk_torch.sim.params import Overrides, convert
from bsk_torch.sim.simulator import Simulator
from bsk_torch.sim.state import StateTable
from bsk_torch.sim.world import WorldModel

LIMIT = Arg("time_limit", float("inf"), "s", "time after which an episode is truncated", low=0.0)

SAMPLE = 1024
"""Random time limits that are drawn to estimate the length of arcs before a batch is built."""


class FleetBuilder:
    """Makes the fleets of an environment, draws episodes for them, and starts them.

    Attributes:
        satellites: The user's satellites.
        names: Their names.
        types: Positions of the satellites of each type.
        world_type: World model of the options; None where it follows from the satellites.
        scenario: The scenario, a copy of the user's.
        options: Options of the environment.
        randomizer: Draws arguments of all satellites together, if any.
    """

    def __init__(
        self,
        satellites: Sequence[Satellite],
        scenario: Scenario,
        options: TaskingOptions,
        randomizer: Randomizer | None,
        device: torch.device,
    ) -> None:
        """Check the names of the satellites, group them by type, and check the world's arguments."""
        self.satellites, self.names, self.types = list(satellites), check_names(satellites), grouped(satellites)
        self.scenario, self.options, self.randomizer, self.device = scenario, options, randomizer, device
        self.world_type = None if options.world_type is None else compose(options.world_type, WorldModel)
        self._world_names = [set(world_arguments(self.satellites[columns[0]], self.world_type)) for columns in self.types]
        check_world(options.world_args or {}, [*self._world_names, self.default_world_args()])

    def default_world_args(self) -> ArgumentTable:
        """Return every argument of the world, with its default."""
        first_of_each = (self.satellites[columns[0]] for columns in self.types)
        parts = [part for satellite in first_of_each for part in world_components(satellite, self.world_type)]
        return ArgumentTable([*(self.world_type.all_components() if self.world_type else ()), *parts])

    # -- fleets -------------------------------------------------------------------------------------------------------

    def make_fleet(self, n: int, trial: bool = False) -> Fleet:
        """Return simulations of ``n`` episodes; of one satellite of each type only, if on ``trial``."""
        # the trial's arcs shall be as long as those of the batch: see check_memory
        sample = isinstance(self.options.time_limit, Distribution) and n < self.options.num_envs
        limit = self.draw_time_limit(first_key(min(SAMPLE, self.options.num_envs) if sample else n))
        types = [columns[:1] for columns in self.types] if trial else self.types
        scenario_state = StateTable(n, 1, self.device)
        for name, value in self.scenario.draw_checked(first_key(min(2, n))).items():
            scenario_state.declare(name, None, *value.shape[1:], dtype=value.dtype)
        simulators = [self._make_simulator(k, columns, n, limit, scenario_state) for k, columns in enumerate(types)]
        chosen = sorted(column for columns in types for column in columns)
        return Fleet(simulators, [self.names[k] for k in chosen], self.scenario.draw_checked)

    def _make_simulator(self, k: int, columns: Sequence[int], n: int, limit: Tensor, scenario_state: StateTable) -> Simulator:
        satellite, options = self.satellites[columns[0]], self.options
        given = [self.satellites[column].sat_args_generator for column in columns]
        finite = limit[torch.isfinite(limit)]
        return Simulator(
            satellite.dyn_type,
            satellite.fsw_type,
            given[0] if all(args is given[0] for args in given) else given,
            {name: value for name, value in (options.world_args or {}).items() if name in self._world_names[k]},
            num_envs=n,
            device=self.device,
            dtype=options.sim_dtype,
            sim_rate=options.sim_rate,
            horizon=float(satellite.generation(limit).max()),
            orbit=options.orbit,
            backend=options.backend,
            segment=satellite.segment,
            max_time=float(finite.max()) if len(finite) else 0.0,
            scenario_state=scenario_state,
            stops=satellite.variable_interval,
            columns=columns,
            randomize=self._share_of(columns),
            world_type=self.world_type,
        )

    def _share_of(self, columns: Sequence[int]) -> Callable[[Key], Overrides]:
        """Return the sampler of the randomized arguments of the satellites ``columns``, numbered within their type."""
        if self.randomizer is None:
            return lambda key: {}
        return lambda key: share(self.randomizer(key), columns)  # type: ignore[misc]

    @property
    def calls_user(self) -> bool:
        """Whether drawing an episode calls a function of the user; such functions are called only for episodes that begin now."""
        options = self.options
        given = [value for satellite in self.satellites for value in satellite.sat_args_generator.values()]
        given += [*(options.world_args or {}).values(), options.time_limit]
        calls = any(callable(value) and not isinstance(value, Distribution) for value in given)
        return calls or self.scenario.calls_user or (self.randomizer is not None and self.randomizer.calls_user)

    @property
    def pool_pays(self) -> bool:
        """Whether the batch is so large that the next episodes are prepared in bulk."""
        return self.options.num_envs * len(self.names) >= SMALLEST and not self.calls_user

    # -- episodes -----------------------------------------------------------------------------------------------------

    def draw_time_limit(self, key: Key) -> Tensor:
        """Return the time limits [n] s of the key's environments, not yet rounded to whole ticks."""
        value = self.options.time_limit
        if isinstance(value, Distribution):
            return convert(LIMIT, value.draw(key.named("time_limit")), len(key))
        values = [value() for _ in range(len(key))] if callable(value) else [value] * len(key)
        return convert(LIMIT, values, len(key))

    def draw(self, fleet: Fleet, key: Key) -> tuple[EpisodeDraw, Tensor]:
        """Return draws for the episodes of the key's environments, and their time limits, [n] s."""
        return fleet.draw(key, self.randomizer), self.draw_time_limit(key).to(self.device)

    def start(self, fleet: Fleet, envs: Tensor, drawn: EpisodeDraw, limit: Tensor) -> None:
        """Start the episodes ``envs`` [n] of a fleet."""
        durations = [self.satellites[s.columns[0]].generation(limit) for s in fleet.simulators]
        fleet.reset(envs, drawn, durations, limit)

    # -- trial --------------------------------------------------------------------------------------------------------

    def trial(self, rewarder: GlobalReward) -> list[Values]:
        """Return the observations of a trial episode, for each type: their shapes make the specs.

        Raises:
            MemoryError: If the batch will not fit into memory.
        """
        fleet, scenario = self.make_fleet(1, trial=True), copy.copy(self.scenario)
        drawn, limit = self.draw(fleet, first_key(1))
        groups = groups_of(self.satellites, fleet)
        each = sum(s.state.nbytes * len(columns) for s, columns in zip(fleet.simulators, self.types, strict=True))
        each += fleet.scenario_state.nbytes
        check_memory(self.device, self.options.num_envs, each * (2 if self.pool_pays else 1))
        link(fleet, scenario, copy.copy(rewarder))
        self.start(fleet, fleet.all_envs, drawn, limit)
        scenario.begin_episodes(fleet.all_envs)
        return [_observed(group) for group in groups]


def _observed(group: SatelliteGroup) -> Values:
    """Return the observations of a trial; TypeError for one that reads a field which the satellite's models lack."""
    try:
        group.satellite.is_alive()
        return group.observations.get_dict()
    except MissingMessageError as error:
        raise TypeError(f"{group.satellite.name}: {error}; {provided_by(str(error.name))}") from error


def link(fleet: Fleet, scenario: Scenario, rewarder: GlobalReward) -> None:
    """Link satellites, scenario and rewarder."""
    scenario.attach(fleet)
    for group in fleet.groups:
        group.scenario = scenario
    checked.link(rewarder, scenario, fleet)
