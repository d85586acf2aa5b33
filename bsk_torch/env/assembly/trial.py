"""Trial episodes that determine the shapes of observations and check user functions, before an environment is built."""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from dataclasses import replace
from typing import NamedTuple

import torch

from bsk_torch._checks import no_gradient
from bsk_torch.comm import CommunicationMethod
from bsk_torch.data.base import GlobalReward
from bsk_torch.env.assembly.devices import check_memory
from bsk_torch.env.assembly.fleets import FleetBuilder, link
from bsk_torch.env.satellite_group import SatelliteGroup, groups_of
from bsk_torch.obs.base import Values
from bsk_torch.rand import first_key
from bsk_torch.sats.user_function import UserFunction
from bsk_torch.scene.base import Scenario
from bsk_torch.sim.assembly.composition import provided_by
from bsk_torch.sim.assembly.satellite_type import SatelliteType
from bsk_torch.sim.component import MissingMessageError
from bsk_torch.sim.readout.observables import Function

BATCHES = (5, 7, 11, 13, 17, 19)
"""Number of environments in the second trial: a number that differs from all other dimensions of observations."""


class Trial(NamedTuple):
    """Results of trial episodes."""

    values: list[Values]  # observations of one environment, for each type of satellite
    calls_user: bool  # whether user functions have been tried
    nbytes: int  # size of an environment's state in bytes
    # observables of each type that observations read and do not list; one kernel is to compute them, too
    read: list[tuple[Function, ...]]


class Made(NamedTuple):
    """Parts that an environment takes over from another one of the same kind."""

    types: Sequence[SatelliteType]  # types of satellites
    trial: Trial | None  # trial episodes; None if they have tried user functions


_made: ContextVar[Made | None] = ContextVar("made", default=None)


@contextlib.contextmanager
def taking_over(made: Made) -> Iterator[None]:
    """Return a context in which the next constructed environment takes over parts; users' constructors have no such argument."""
    token = _made.set(made)
    try:
        yield
    finally:
        _made.reset(token)


def taken_over() -> Made | None:
    """Return the parts that the environment under construction takes over, once; None if there are none."""
    made = _made.get()
    _made.set(None)
    return made


class TrialFleet:
    """A fleet of ``n`` environments with one satellite of each type, in its first episodes."""

    def __init__(self, builder: FleetBuilder, n: int) -> None:
        """Create the satellites, not yet linked."""
        self.builder, self.fleet = builder, builder.make_fleet(n, trial=True)
        first = first_key(n)
        self.drawn = builder.draw(self.fleet, replace(first, env_id=first.env_id % builder.options.num_envs))
        self.satellites = groups_of(builder.satellites, self.fleet)
        self.scenario: Scenario = copy.copy(builder.scenario)

    def start(self, rewarder: GlobalReward, communicator: CommunicationMethod) -> list[UserFunction]:
        """Start the episodes; return the user functions, which keep their results from now on."""
        self.checked = link(self.fleet, self.scenario, copy.copy(rewarder))
        copy.copy(communicator).attach(self.fleet)  # it may declare what satellites observe
        functions = [f for satellite in self.satellites for f in (*satellite.observations.functions, *satellite.functions)]
        for function in functions:
            function.results = []
        self.builder.start(self.fleet, self.fleet.all_envs, *self.drawn)
        self.scenario.begin_episodes(self.fleet.all_envs)
        return functions

    def observe(self) -> list[Values]:
        """Return the observations of each type; TypeError for one that reads a field missing in the satellite's models."""
        return [_observed(satellite) for satellite in self.satellites]

    def spread(self) -> None:
        """Offset the clocks of the environments by some seconds, so that mixing of environments is detected."""
        for simulator in self.fleet.simulators:
            state = simulator.state
            state.ticks = state.ticks + state.of_env(self.fleet.all_envs + 1)
            state.touch()

    def score(self) -> None:
        """Call hooks of rewarder and satellites once, for a step of zero duration; TypeError for results of wrong shapes."""
        checked = self.checked
        checked.reward(checked.log(), checked.log())
        checked.terminated()
        checked.truncated()
        checked.counts()
        for satellite in self.satellites:
            satellite.action_mask()


def _observed(satellite: SatelliteGroup) -> Values:
    try:
        satellite.is_alive()
        with torch.enable_grad():  # so that an observation that depends on parameters can be told
            return no_gradient(f"observation of {satellite.name}", satellite.observations.get_dict())
    except MissingMessageError as error:
        raise TypeError(f"{satellite.name}: {error}; {provided_by(str(error.name))}") from error


def check_room(builder: FleetBuilder, nbytes: int) -> None:
    """Raise MemoryError if a batch with ``nbytes`` bytes per environment, and as many for a prepared episode, does not fit."""
    check_memory(builder.device, builder.options.num_envs, nbytes * (1 + builder.prepared))


def try_out(builder: FleetBuilder, rewarder: GlobalReward, communicator: CommunicationMethod) -> Trial:
    """Observe a trial episode, whose shapes determine the specs; try user functions with one and with several environments."""
    alone = TrialFleet(builder, 1)
    fleet, n = alone.fleet, builder.options.num_envs
    each = sum(s.state.nbytes * len(columns) for s, columns in zip(fleet.simulators, builder.types, strict=True))
    each += fleet.scenario_state.nbytes
    check_room(builder, each)
    functions = alone.start(rewarder, communicator)
    for simulator in fleet.simulators:
        simulator.observer.missed.clear()
    values = alone.observe()
    read = [tuple(simulator.observer.missed) for simulator in fleet.simulators]
    if n == 1 and fleet.size == len(builder.names):
        alone.score()  # with as many environments and satellites as there will be
    if n == 1 or not functions:
        return Trial(values, bool(functions), each, read)
    dimensions = {size for function in functions for size in function.dimensions()}
    together = TrialFleet(builder, next((size for size in BATCHES if size not in dimensions), BATCHES[-1]))
    batched = together.start(rewarder, communicator)
    together.spread()
    together.observe()
    first = fleet.all_envs[:1]
    fleet.state.copy_rows(first, together.fleet.state, first)
    alone.scenario.begin_episodes(first)
    alone.observe()
    for function, several in zip(functions, batched, strict=True):
        function.compare(several)
    return Trial(values, True, each, read)
