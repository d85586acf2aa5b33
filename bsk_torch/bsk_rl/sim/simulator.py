"""The simulation of an episode: its clock, its events, and runs to the next of them."""

from __future__ import annotations

import inspect
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from bsk_torch.bsk_rl.sim.engine import Engine, row_mask
from bsk_torch.bsk_rl.sim.messages import COMPONENT, Recorder
from bsk_torch.bsk_rl.sim.rso_imaging import Aims
from bsk_torch.bsk_rl.sim.setup import NotSimulatedError
from bsk_torch.bsk_rl.sim.views import WorldView
from bsk_torch.comm.los import sights, visible_pairs
from bsk_torch.constants import NANO
from bsk_torch.env.limits import whole_limit
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sim.assembly.satellite_type import whole_nanoseconds
from bsk_torch.sim.dyn.events import DISARMED
from bsk_torch.sim.names import nearest
from bsk_torch.sim.run.encounters import LEFT, MET

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite
    from bsk_torch.sim.world import WorldModel

logger = logging.getLogger(__name__)

LATEST = 2**31
"""Latest time of an episode, s."""

LONGEST_RUN = 1 << 40
"""Most ticks of one run."""

LONGEST_SEARCH = 4096
"""Most ticks of one run with conditions on the clock, whose first time is searched tick by tick."""


@dataclass
class Event:
    """Something that happens at a time, when an image has been taken, or when a condition holds."""

    tick: int | None  # the first at which it happens; None for an image or a condition
    effect: Callable[[Simulator], object] | None
    terminal: bool  # whether it ends the step
    eventActive: bool = True
    image_of: Satellite | None = None
    condition: Callable[[Any], object] | None = None
    every: int = 1  # ticks between evaluations of the condition


class Clock:
    """Stands for a simulator that a condition reads only the time of."""

    def __init__(self, nanoseconds: int) -> None:
        self.sim_time_ns, self.sim_time = nanoseconds, nanoseconds * NANO
        self.TotalSim = SimpleNamespace(CurrentNanos=nanoseconds)


CLOCK = {"TotalSim", "CurrentNanos", "sim_time", "sim_time_ns"}
"""What a condition reads of the clock."""


def reads_only_clock(condition: Callable[..., object]) -> bool:
    """Return whether a condition follows from the time alone, as its code shows: it names the clock, numbers and modules."""
    code: Any = getattr(condition, "__code__", None)
    if code is None or any(inspect.iscode(constant) for constant in code.co_consts):
        return False
    variables = inspect.getclosurevars(condition)
    values = [*variables.nonlocals.values(), *variables.globals.values()]
    modules = [value for value in values if inspect.ismodule(value)]
    attributes = variables.unbound - CLOCK
    return all(isinstance(value, int | float) or inspect.ismodule(value) for value in values) and all(
        any(hasattr(module, name) for module in modules) for name in attributes
    )


def satellite_named(name: str, satellites: Sequence[Satellite]) -> Satellite:
    """Return the satellite of a name; ValueError if there is none."""
    for satellite in satellites:
        if satellite.name == name:
            return satellite
    raise ValueError(f"Satellite with name '{name}' not found; {nearest(name, [satellite.name for satellite in satellites])}")


class Simulator:
    """Simulation of the satellites of an episode; every reset of an environment makes a new one.

    Attributes:
        satellites: The satellites, in their order.
        sim_rate, tick_ns: Length of a tick, s and ns.
        max_step_duration: Longest run, s; a change counts from the next run on.
        time_limit: End of the episode, s, likewise.
        world: Sun, Earth and ground stations.
        fleet: The core's simulation, with one environment.
        eventMap: Events by name.
        recorders: Recorders of messages, which keep them at every tick.
        aims: Satellites at which imagers point.
        collisions: Pairs of satellites that have collided, in the order in which bsk_rl books them.
    """

    def __init__(
        self,
        satellites: Sequence[Satellite],
        world_type: type[WorldModel],
        world_args: Mapping[str, object],
        sim_rate: float = 1.0,
        max_step_duration: float = 600.0,
        time_limit: float = float("inf"),
        engine: Engine | None = None,
    ) -> None:
        """Start the episode; its satellites have drawn their arguments."""
        self.satellites, self.sim_rate, self.max_step_duration = list(satellites), sim_rate, max_step_duration
        self.time_limit, self.logger = time_limit, logger
        self.eventMap: dict[str, Event] = {}
        self.recorders: list[Recorder] = []
        self.engine = engine or Engine()
        self.fleet: SatelliteFleet = self.engine.begin(self.satellites, world_type, dict(world_args), sim_rate, time_limit)
        self.world_args: dict[str, Any] = self.engine.world
        self.aims = Aims(self.fleet)
        self._every = torch.ones(1, dtype=torch.bool)
        self.tick_ns = self.fleet.simulators[0].h_ns
        self._et = self.fleet.simulators[0].lookahead.flight.et[:1].clone()
        self._now = 0
        self._limited: tuple[float, torch.Tensor, int] = (math.nan, torch.zeros(1, dtype=torch.float64), 0)
        self.collisions: list[tuple[object, object]] = []
        self._booked: set[tuple[str, int, int]] = set()
        places = {column: (k, row) for k, s in enumerate(self.fleet.simulators) for row, column in enumerate(s.columns)}
        for column, satellite in enumerate(self.satellites):
            satellite.core_row = places[column]
            satellite.set_simulator(self)
        self.world = WorldView(self.fleet.simulators[0].world, self)
        self.dynamics_list: dict[str, object] = {}
        self.fsw_list: dict[str, object] = {}
        for satellite in self.satellites:
            self.dynamics_list[satellite.name] = satellite.set_dynamics(sim_rate)
            self.fsw_list[satellite.name] = satellite.set_fsw(sim_rate)

    def __getstate__(self) -> object:
        """Raise TypeError, as Basilisk's simulation does: the core reads the arguments of this episode from its environment."""
        raise TypeError(
            "the simulation of an episode cannot be copied or pickled, as in bsk_rl: copy the environment before its first "
            "reset. Episodes of bsk_torch.SatelliteTasking can be copied with env.restore: docs/how_to/record.md"
        )

    # -- reading ------------------------------------------------------------------------------------------------------

    @property
    def sim_time_ns(self) -> int:
        """Time since reset, ns."""
        return self._now * self.tick_ns

    @property
    def sim_time(self) -> float:
        """Time since reset, s."""
        return self.sim_time_ns * NANO

    @property
    def TotalSim(self) -> SimpleNamespace:
        """Basilisk's clock: ``CurrentNanos``, time since reset, ns."""
        return SimpleNamespace(CurrentNanos=self.sim_time_ns)

    def get_satellite(self, name: str) -> Satellite:
        """Return the satellite of a name; ValueError if there is none."""
        return satellite_named(name, self.satellites)

    def visible_pairs(self) -> set[tuple[int, int]]:
        """Return pairs of a satellite and another one, by their positions, that it has seen since the last run began."""
        return {(i, j) for i, j in torch.nonzero(visible_pairs(self.fleet, self._every, directed=True)[0]).tolist()}

    def recorded_sights(self) -> np.ndarray:
        """Return whether one satellite sees another one in each tick that Basilisk's recorders keep, [T, S, S] booleans.

        Ticks are those from the start of the last run to the last but one.
        """
        return sights(self.fleet, int(self.fleet.since[0]))[:-1].numpy()

    def sights_now(self) -> np.ndarray:
        """Return whether one satellite sees another one now, [S, S] booleans."""
        return sights(self.fleet, int(self.fleet.ticks[0]))[0].numpy()

    # -- events -------------------------------------------------------------------------------------------------------

    def tick_at(self, seconds: float) -> int:
        """Return the first tick at or after a time, s; ValueError for NaN."""
        if math.isnan(seconds):
            raise ValueError("a task or a step ends at nan s; check the durations of actions and max_step_duration")
        if not seconds < LONGEST_RUN * NANO * self.tick_ns:
            return LONGEST_RUN
        return math.ceil(whole_nanoseconds(seconds) / self.tick_ns)

    def add_timed_event(self, name: str, seconds: float, effect: Callable[[Simulator], object] | None, terminal: bool) -> None:
        """Let something happen at the first tick at or after ``seconds``; an event of the same name is replaced."""
        self.eventMap[name] = Event(self.tick_at(seconds), effect, terminal)

    def add_image_event(
        self, name: str, satellite: Satellite, effect: Callable[[Simulator], object] | None, terminal: bool
    ) -> None:
        """Let something happen when a satellite has taken an image: when the first partition of its store grows."""
        self.eventMap[name] = Event(None, effect, terminal, image_of=satellite)
        self._arm(satellite, True)

    def _arm(self, satellite: Satellite, armed: bool) -> None:
        part, row = satellite.core_row
        simulator = self.fleet.simulators[part]
        mask = row_mask(self.fleet, part, row)
        if "rso_ends" in simulator.tick.state.fields:
            name, value = "rso_ends", float(armed)
        else:
            level = self.fleet.satellites[part].dynamics.partition_levels[row, 0] if armed else DISARMED
            name, value = "image_level", float(level)
        simulator.write(name, mask, torch.full(mask.shape, value, dtype=torch.float64))

    def createNewEvent(
        self,
        eventName: str,
        eventRate: int = 0,
        eventActive: bool = False,
        conditionList: Sequence[str] | None = None,
        actionList: Sequence[str] | None = None,
        conditionTime: int | None = None,
        conditionFunction: Callable[[Any], object] | None = None,
        actionFunction: Callable[[Simulator], object] | None = None,
        terminal: bool = False,
        exactRateMatch: bool = True,
    ) -> None:
        """Add an event at a time, ns, or when a condition holds, as Basilisk does; an existing one of the same name stays.

        A condition is evaluated every ``eventRate`` ns, at ticks. One that reads only the clock is evaluated before a run, for
        the ticks that follow; with another one the simulation runs from evaluation to evaluation, which is slow.

        Raises:
            NotImplementedError: For conditions and actions that are text, which Basilisk executes.
        """
        if conditionList or actionList:
            raise NotImplementedError(
                f"createNewEvent({eventName!r}): text is not executed; write functions of the simulator: "
                "conditionFunction=lambda sim: sim.TotalSim.CurrentNanos >= 10e9, actionFunction=..."
            )
        if eventName in self.eventMap:
            return
        if conditionTime is not None:
            self.eventMap[eventName] = Event(math.ceil(conditionTime / self.tick_ns), actionFunction, terminal, eventActive)
        elif conditionFunction is not None:
            every = max(1, math.ceil(eventRate / self.tick_ns))
            event = Event(None, actionFunction, terminal, eventActive, condition=conditionFunction, every=every)
            self.eventMap[eventName] = event

    def _next_condition(self, event: Event, last: int) -> int:
        """Return the next tick at which a condition is to be evaluated: the one at which it holds, if it reads only the clock."""
        first, condition = (self._now // event.every + 1) * event.every, event.condition
        if condition is None or not reads_only_clock(condition):
            return first
        last = min(last, self._now + LONGEST_SEARCH)
        return next((tick for tick in range(first, last + 1, event.every) if condition(Clock(tick * self.tick_ns))), last)

    # -- tasks --------------------------------------------------------------------------------------------------------

    def enableTask(self, name: str) -> None:
        """Switch on a task of a satellite's flight software, within a command of it."""
        self._switch_task(name, True)

    def disableTask(self, name: str) -> None:
        """Switch off a task, likewise."""
        self._switch_task(name, False)

    def _switch_task(self, name: str, on: bool) -> None:
        for satellite in self.satellites:
            if name.endswith(satellite.name) and (command := satellite.fsw._commanding) is not None:
                command.task(name.removesuffix(satellite.name), on)
                return
        raise NotSimulatedError(f"task {name!r} can be switched within methods of flight software marked by @action. {COMPONENT}")

    def AddModelToTask(self, TaskName: str, NewModel: object, ModelPriority: int = -1) -> None:
        """Add the recorder of a message; NotSimulatedError for a module of Basilisk's."""
        if not isinstance(NewModel, Recorder):
            raise NotSimulatedError(
                f"AddModelToTask({TaskName!r}, {type(NewModel).__name__}): modules of Basilisk's do not run here; recorders of "
                f"messages do. {COMPONENT}"
            )
        self.recorders.append(NewModel)
        NewModel.record(self.sim_time_ns)

    def __getattr__(self, name: str) -> Any:
        if name in ("CreateNewTask", "CreateNewProcess", "InitializeSimulation", "ConfigureStopTime", "ExecuteSimulation"):
            raise AttributeError(f"simulator.{name} is one of Basilisk's, and there is none. {COMPONENT}")
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def setEventActivity(self, eventName: str, activityCommand: bool) -> None:
        """Switch an event on or off."""
        self.eventMap[eventName].eventActive = bool(activityCommand)

    def delete_event(self, event_name: str) -> None:
        """Remove an event; KeyError for an unknown one."""
        event = self.eventMap.pop(event_name)
        if event.image_of is not None and event.eventActive:
            self._arm(event.image_of, False)

    # -- running ------------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Run to the first event that ends the step, for ``max_step_duration``, or to the time limit.

        Other events happen on the way. As in Basilisk, those that are due happen before the first tick, too, and none does at the
        time limit.
        """
        fleet = self.fleet
        limit_ticks, limit = self._limit()
        fleet.since = torch.tensor([self._now])
        longest = self._now + self.tick_at(self.max_step_duration)
        last = min(longest, limit)
        images: Sequence[torch.Tensor | None] = [None] * len(fleet.satellites)
        until = self._now
        while self._now < limit:
            imaged = any(self._is_due(event, images) for event in self.eventMap.values() if event.image_of is not None)
            broken_off = self._now < until and not imaged  # by the core, such as by a conjunction
            ended = self._fire(images)
            if self._now >= longest:
                self.logger.info("Max step duration reached")
            if ended or broken_off or self._now >= last:
                return
            until = self._until(last)
            result = fleet.run(self._every, limit_ticks, torch.tensor([until]))
            self._now += int(result.ticks[0])
            images = result.events
            for recorder in self.recorders:
                recorder.record(self.sim_time_ns)
            self._book_encounters()
            for part in fleet.satellites:
                part.memory.touch()

    def _limit(self) -> tuple[torch.Tensor, int]:
        if self._limited[0] != self.time_limit:
            ticks = whole_limit(torch.tensor([min(self.time_limit, LATEST)], dtype=torch.float64), self._et, self.tick_ns)[0]
            self._limited = self.time_limit, ticks, int(ticks)
        return self._limited[1:]

    def _until(self, last: int) -> int:
        """Return the tick at which the next run must stop: for an event, a condition or a recorder."""
        if self.recorders:
            return self._now + 1
        active = [event for event in self.eventMap.values() if event.eventActive]
        ticks = [max(event.tick, self._now + 1) for event in active if event.tick is not None]
        return min([last, *ticks, *(self._next_condition(event, last) for event in active if event.condition is not None)])

    def _book_encounters(self) -> None:
        """Keep and log the conjunctions and the ranges left that are new, as bsk_rl does."""
        pairs, memory = self.fleet.encounters.pairs, self.fleet.memory
        fired = [
            (name, *pair)
            for name, listed in ((MET, pairs.conjunctions), (LEFT, pairs.ranges))
            if name in memory
            for pair, met in zip(listed, memory[name][0].tolist(), strict=True)
            if met
        ]
        for event in fired:
            if event in self._booked:
                continue
            self._booked.add(event)
            one, other = self.satellites[event[1]], self.satellites[event[2]]
            if event[0] == LEFT:
                reach = one.sat_args["max_range_radius"]
                one.logger.info("Exceeded maximum range of %s m from %s", reach, other.name)
                continue
            other = self.satellites[event[1] - 1]  # with which bsk_rl books the collision
            self.collisions.append((one, other))
            one.logger.info("collided with %s", other.name)
            other.logger.info("collided with %s", one.name)
            if self._now == 0:
                one.logger.warning("Collision occurred at t=0, may incorrectly report failure type")

    def _fire(self, images: Sequence[torch.Tensor | None]) -> bool:
        """Let the events happen that are due, in the order of the map, and return whether one of them ends the step.

        Those that an effect adds, or activates later in the map, are looked at as well.
        """
        ends, k = False, 0
        while k < len(self.eventMap):
            event = list(self.eventMap.values())[k]
            k += 1
            if not self._is_due(event, images):
                continue
            event.eventActive = False
            ends |= event.terminal
            if event.effect is not None:
                event.effect(self)
            k = 1 + next((n for n, other in enumerate(self.eventMap.values()) if other is event), -1)
        return ends

    def _is_due(self, event: Event, images: Sequence[torch.Tensor | None]) -> bool:
        if not event.eventActive:
            return False
        if event.image_of is not None:
            part, row = event.image_of.core_row
            return (taken := images[part]) is not None and bool(taken[row])
        if event.condition is not None:
            return self._now % event.every == 0 and bool(event.condition(self))
        return event.tick is not None and event.tick <= self._now
