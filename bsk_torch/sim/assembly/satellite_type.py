"""What all simulations of satellites of one type share: models, arguments, modes, the tick and its kernels.

A :class:`SatelliteType` is made once, by :func:`satellite_type`, and handed to every simulator of such satellites: that of the
trial episodes of an environment, of its batch, of its prepared episodes, and of other environments of the same kind. Nothing of
it changes; other arguments make another type (:meth:`SatelliteType.changed`).
"""

from __future__ import annotations

import dataclasses
import functools
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from bsk_torch._checks import number
from bsk_torch.astro.element_sets import ElementSet
from bsk_torch.codegen.kept import Kept, of_package
from bsk_torch.rand import Key
from bsk_torch.sim.arguments.values import Arguments, Overrides, merge
from bsk_torch.sim.assembly.composition import check_required_dyn, provided_by, world_components, world_of
from bsk_torch.sim.assembly.draws import ArgumentChange, TrialDraw, TypeArguments
from bsk_torch.sim.component import Component, Field, MissingMessageError, UserArguments, declared
from bsk_torch.sim.dyn.events import with_failure_event
from bsk_torch.sim.dyn.forces.field import prepare
from bsk_torch.sim.dyn.models import DynamicsModel
from bsk_torch.sim.faults.component import SLOT, changing, declared_faults, planned, with_faults
from bsk_torch.sim.fsw.models import Command, FSWModel, MagicOrbitalManeuverFSWModel
from bsk_torch.sim.fsw.modes import Mode, mode_table
from bsk_torch.sim.instruments import Instrument, check_faults, described_instruments, instrument_args, with_instruments
from bsk_torch.sim.orbit.sampled import with_elements
from bsk_torch.sim.schedule import Schedule
from bsk_torch.sim.tick.loop import ARC_ORBIT, Tick
from bsk_torch.sim.tick.runners import Runners, TickLoop, make_runners
from bsk_torch.sim.world import WorldModel

logger = logging.getLogger(__name__)

Ticks = Kept[tuple[Tick, Runners]]  # ticks, with what runs them, by their identity
TICKS: Ticks = Kept(32)  # ticks of components of the package that the process has made last: there are fewer presets

ORBITS = ("arc", "integrated", "free", "sgp4")

SHORTEST_TICK, LONGEST_TICK = 1e-3, 60.0
"""Bounds of the length of a tick, s. With shorter ones a step of minutes takes millions of ticks; longer ones than a minute would
pass over the nodes of arcs."""


@dataclass(frozen=True, kw_only=True)
class SimulationOptions:
    """How satellites are simulated; all satellites of an environment have the same."""

    device: torch.device  # device of all tensors
    # type of attitude, wheels and flight software; everything is stored, and the rest computed, in float64
    dtype: torch.dtype = torch.float64
    sim_rate: float = 1.0  # length of a tick, s
    orbit: str | None = None  # `"arc"`, `"integrated"`, `"free"`, `"sgp4"`, or None for the default of the dynamics model
    backend: str = "compiled"  # `"compiled"` or `"eager"`
    compat: bool = False  # whether the errors of recordings are repeated
    replan: bool = True  # whether windows and eclipses follow maneuvers


@dataclass(frozen=True, kw_only=True)
class Usage:
    """How an environment uses the satellites of one type."""

    columns: tuple[int, ...] = (0,)  # numbers of the satellites among all those of an environment, of other types too
    stops: bool = False  # whether events such as an image end a run
    watches: bool = False  # whether failures end a run, too
    controlled: bool = True  # whether actions may switch attitude control on, so that its gains matter
    segment: float = 600.0  # seconds by which look-ahead windows are extended
    randomize: Callable[[Key], Overrides] = lambda key: {}  # draws arguments that replace those of some satellites
    # fields that the satellites record which components follow, by their slot; see bsk_torch.sim.tick.trace
    followed: Mapping[str, Sequence[Field]] = field(default_factory=dict)
    recorded: tuple[str, ...] = ()  # fields of the hub that runs record, those of components aside
    drawn: frozenset[str] = frozenset()  # names of what the scenario draws


@dataclass(frozen=True)
class SatelliteType:
    """Satellites of one type: what their simulations share."""

    arguments: TypeArguments  # arguments of satellites and world, and their draws
    structural: frozenset[str]  # names of arguments for which components were built, so that they cannot change
    world_type: type[WorldModel]
    schedule: Schedule
    modes: Mapping[str, Mode]
    commands: Mapping[str, Command]  # commands of the flight software by name
    has_tank: bool  # whether the satellites can change their velocity
    instruments: tuple[Instrument, ...]  # several instruments, of which actions choose; none if there is a single one
    h_ns: int  # length of a tick, ns
    orbit: str  # `"arc"`, `"integrated"` or `"free"`; `"arc"` for those of SGP4, too
    sampled: tuple[ElementSet, ...]  # element sets of the satellites whose arcs are those of SGP4; none if they are integrated
    gravity_degree: int  # degree of the Earth's field
    options: SimulationOptions  # how they are simulated
    usage: Usage  # how the environment uses them
    trial: Mapping[str, object]  # arguments of a trial draw, by whose shapes states are laid out
    tick: Tick
    runners: Runners  # what runs it
    uniform: Tensor  # values of the parameters of `tick.shared`, [C, 1]
    flag_table: Tensor  # flags of the modes, [F, M]
    # planes [P] of the state that some mode resets, masks of the modes that do, and the values, [P, M] each
    resets: tuple[Tensor, Tensor, Tensor]

    @property
    def compat(self) -> bool:
        """Whether the errors of recordings are repeated."""
        return self.options.compat

    @functools.cached_property
    def mode_names(self) -> tuple[str, ...]:
        """Names of the modes, in the order of their numbers."""
        return tuple(self.modes)

    @functools.cached_property
    def alone(self) -> SatelliteType:
        """The first satellite without the others: the same tick for fewer rows."""
        arguments = dataclasses.replace(self.arguments, sat_args=self.arguments.sat_args.of_first())
        usage = dataclasses.replace(self.usage, columns=self.usage.columns[:1])
        return dataclasses.replace(self, arguments=arguments, usage=usage, sampled=self.sampled[:1])

    def changed(self, satellite: Sequence[ArgumentChange], world: Sequence[ArgumentChange], num_envs: int) -> SatelliteType:
        """Return the type with other arguments of satellites and world, which a trial draw for a batch of ``num_envs`` checks.

        Its tick is the same, unless parameters that all rows shared may differ now. KeyError or ValueError for wrong changes.
        """
        for _, name, _, _ in (*satellite, *world):
            if name == "oe" and self.sampled:
                raise ValueError(
                    "oe of satellites under orbit='sgp4' is their element set, from which arcs are made; build another"
                )
            if name in self.structural:
                raise ValueError(
                    f"{name} was the same for all environments when this one was built, and components were made for it; give a "
                    "distribution, such as rand.Choice, when an environment is built, and it can be changed"
                )
        arguments = self.arguments.changed(satellite, world)
        trial = arguments.trial(num_envs, [env for *_, envs in (*satellite, *world) for env in envs or ()])
        for _, name, _, _ in (*satellite, *world):
            had = isinstance(self.trial[name], Tensor)
            if isinstance(trial.values[name], Tensor) != had:
                was = "a value" if had else "None"
                raise ValueError(f"{name} had {was} when the environment was built, which decides what is built; build another")
        new = dataclasses.replace(self, arguments=arguments)
        differ = set(self.tick.shared.fields) - trial.uniform
        return new._with_own(differ) if differ else new

    def _with_own(self, names: set[str]) -> SatelliteType:
        """Return the type in which parameters, which were the same for all rows so far, may differ: it has another tick."""
        logger.info("a tick is built in which %s may differ between environments", sorted(names))
        old = self.tick
        tick = old.with_shared(set(old.shared.fields) - names)
        planes = [p for name in tick.shared.fields for p in range(old.shared.slices[name].start, old.shared.slices[name].stop)]
        runners = make_runners(tick, self.options.backend, self.options.device, self.arguments.count)
        return dataclasses.replace(self, tick=tick, runners=runners, uniform=self.uniform[planes].contiguous())


def satellite_type(
    models: tuple[type[DynamicsModel], type[FSWModel]],
    sat_args: Mapping[str, object] | Sequence[Mapping[str, object]],
    world_args: Mapping[str, object],
    options: SimulationOptions,
    usage: Usage,
    *,
    num_envs: int = 2,
    world_type: type[WorldModel] | None = None,
    ticks: Ticks | None = None,
) -> SatelliteType:
    """Build the tick of satellites of a dynamics and a flight-software model, and check their arguments with trial draws.

    ``sat_args`` are those of all satellites, or of each. The type is for batches of ``num_envs`` environments; ``world_type``
    is None for what the dynamics model requires. ``ticks`` are those of users' components made by types of the same
    environment, for reuse; see :mod:`bsk_torch.codegen.kept`.

    Raises:
        TypeError: For models that do not fit together, or a component that reads what none writes.
        ValueError: For an argument, or an option, that is not allowed.
    """
    dyn_type, fsw_type = models
    h_ns = whole_nanoseconds(number("sim_rate", options.sim_rate, SHORTEST_TICK, LONGEST_TICK, unit="s"))
    orbit = dyn_type.orbit if options.orbit is None else options.orbit
    if orbit not in ORBITS:
        raise ValueError(f"orbit={orbit!r} must be one of {list(ORBITS)}, or None for the model's own")
    sampled: tuple[ElementSet, ...] = ()
    if orbit == "sgp4":
        if issubclass(fsw_type, MagicOrbitalManeuverFSWModel):
            raise ValueError(f"orbit='sgp4' has no maneuvers, but {fsw_type.__name__} has a tank; leave out orbit= to integrate")
        sat_args, sampled = with_elements(sat_args, len(usage.columns))
        orbit = "arc"
    elif orbit == "arc" and not dyn_type.gravity_degree:
        raise ValueError(
            f"orbit='arc' needs the Earth's oblateness, but {dyn_type.__name__} has gravity_degree = 0; pass orbit='integrated'"
        )
    check_required_dyn(dyn_type, fsw_type)
    world, around = world_of(dyn_type, world_type), world_components(dyn_type, world_type)
    onboard = (*dyn_type.all_components(), *fsw_type.all_components())
    lenient = options.compat
    arguments = Arguments(around, world_args, "world_args"), Arguments(onboard, sat_args, "sat_args", usage.columns, lenient)
    instruments = described_instruments(arguments[1].given, arguments[1].table)
    known_args = arguments[1].table | instrument_args(instruments, arguments[1].table)
    faults = declared_faults(arguments[1].given, known_args)
    check_faults(instruments, faults)
    looked = [Looked(arguments[0].given), Looked(changing(arguments[1].given, faults))]
    around, onboard = (fitted(some, mapping) for some, mapping in zip((around, onboard), looked, strict=True))
    onboard = with_faults(with_instruments(onboard, instruments), faults)
    onboard = with_failure_event(onboard) if usage.watches else onboard
    arguments = arguments[0].of_components(around, world_args), arguments[1].of_components(onboard, sat_args)
    onboard = tuple(part for part in onboard if not (part.mends and lenient))
    parts = dyn_type.schedule.ordered((*(dataclasses.replace(part, at_start=True) for part in around), *onboard))
    # a component of the user's own in the slot of another may leave the flags and resets to that one
    every_component = (*declared(world, dyn_type, fsw_type), *parts)
    modes, on_arc = mode_table(fsw_type.all_modes(), every_component), orbit == "arc"
    flags = dict.fromkeys(flag for part in every_component for flag in part.flags)
    on = [[float(flag in (mode.on or ())) for mode in modes.values()] for flag in flags]
    drawing = TypeArguments(
        arguments[1], arguments[0], parts, h_ns, orbit, usage.controlled, usage.randomize, frozenset(usage.drawn), lenient=lenient
    )
    trial = drawing.trial(num_envs)
    if faults:
        parts = planned(parts, faults, trial.values, h_ns)
        drawing = dataclasses.replace(drawing, parts=parts)
        trial = drawing.trial(num_envs)
        acting = next(part for part in parts if part.slot == SLOT)
        trial = trial._replace(uniform=trial.uniform - {field.name for field in acting.params})  # env.inject changes rows
    running = _running(parts, dyn_type.schedule, on_arc, usage.recorded)
    opaque = options.device.type != "cpu"
    if opaque and not on_arc:
        prepare(options.device, torch.float64, dyn_type.gravity_degree)
    layout = options.dtype, opaque, usage.stops, usage.followed, flags, dyn_type.gravity_degree
    tick = Tick(running, trial.uniform, h_ns, on_arc, *layout)
    return SatelliteType(
        arguments=drawing,
        structural=frozenset(looked[0].names_read - arguments[0].random).union(looked[1].names_read - arguments[1].random),
        world_type=world,
        schedule=dyn_type.schedule,
        modes=modes,
        commands=fsw_type.all_commands(),
        has_tank=issubclass(fsw_type, MagicOrbitalManeuverFSWModel),
        instruments=instruments,
        h_ns=h_ns,
        orbit=orbit,
        sampled=sampled,
        gravity_degree=dyn_type.gravity_degree,
        options=options,
        usage=usage,
        trial=trial.values,
        tick=tick,
        runners=_runners(tick, trial, drawing, options, Kept(1) if ticks is None else ticks),
        uniform=tick.shared.rows(trial.parameters, 1).to(options.device).contiguous(),
        flag_table=torch.tensor(on, device=options.device, dtype=torch.float64),
        resets=_resets(tick, modes, dict(reset for part in every_component for reset in part.resets), options.device),
    )


class Looked(dict[str, object]):
    """Values by name that remember which of them were looked at."""

    def __init__(self, arguments: UserArguments) -> None:
        super().__init__(arguments)
        self.names_read: set[str] = set()

    def __getitem__(self, name: str) -> object:
        self.names_read.add(name)
        return super().__getitem__(name)

    def get(self, name: str, default: object = None) -> object:
        """Return a value, or the default."""
        if name in self:
            self.names_read.add(name)
        return super().get(name, default)


def whole_nanoseconds(seconds: float) -> int:
    """Return seconds on Basilisk's clock."""
    return int(seconds * 1e9 + 0.5)


def fitted(parts: tuple[Component, ...], arguments: Mapping[str, object]) -> tuple[Component, ...]:
    """Return the parts with the structure that the given arguments need."""
    return tuple(part.fit(arguments) if part.fit else part for part in parts)


def _running(parts: Sequence[Component], schedule: Schedule, on_arc: bool, recorded: Sequence[str]) -> tuple[Component, ...]:
    """Return the components that run in a tick, in their order; the hub also records the fields ``recorded``."""
    running = tuple(part for part in parts if not (on_arc and part.integrated_only))
    running = schedule.ordered((*running, ARC_ORBIT)) if on_arc else running
    return tuple(
        dataclasses.replace(part, records=(*part.records, *recorded)) if part.slot == "hub" else part for part in running
    )


def _runners(tick: Tick, trial: TrialDraw, arguments: TypeArguments, options: SimulationOptions, ticks: Ticks) -> Runners:
    """Return the runners of a tick, those of an equal one if it has been made.

    A new one runs once on a trial draw, or is traced; TypeError for a component that reads what none writes, with the models that
    provide it.
    """

    def make() -> tuple[Tick, Runners]:
        try:
            runners = make_runners(tick, options.backend, options.device, arguments.count)
            if isinstance(runners.run, TickLoop):  # kernels have been traced, which shows the same
                n = max(len(value) for value in trial.values.values() if isinstance(value, Tensor))
                state = tick.state.rows(merge(trial.values, arguments.parts, "initial"), n)
                tick.check_updates(state, tick.shared.rows(trial.parameters, 1), tick.own.rows(trial.parameters, n))
        except MissingMessageError as error:
            raise TypeError(f"{error}; {provided_by(str(error.name))}") from None
        return tick, runners

    is_shared = options.device.type == "cpu" and of_package(tick.functions)
    _, runners = (TICKS if is_shared else ticks).get((tick.identity, options.backend, options.device), make)
    runners.build(arguments.count)
    return runners


def _resets(
    tick: Tick, modes: Mapping[str, Mode], always: Mapping[str, float], device: torch.device
) -> tuple[Tensor, Tensor, Tensor]:
    layout, rows = tick.state, []
    for name in sorted({name for mode in modes.values() for name in mode.resets} | set(always)):
        if name in layout.fields:
            values = [mode.resets.get(name, always.get(name)) for mode in modes.values()]
            rows += [(plane, values) for plane in range(layout.slices[name].start, layout.slices[name].stop)]
    planes = torch.tensor([plane for plane, _ in rows], dtype=torch.int64, device=device)
    resets = torch.tensor([[v is not None for v in values] for _, values in rows], dtype=torch.bool, device=device)
    numbers = torch.tensor([[v or 0.0 for v in values] for _, values in rows], dtype=torch.float64, device=device)
    return planes, resets.view(len(rows), len(modes)), numbers.view(len(rows), len(modes))
