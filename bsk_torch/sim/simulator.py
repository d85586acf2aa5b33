"""Simulation of the satellites of one type: parameters, state, commands and runs."""

from __future__ import annotations

import dataclasses
import functools
import logging
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import torch
from torch import Tensor

from bsk_torch._checks import no_gradient, number
from bsk_torch.codegen.kernel import Kernel, Samples
from bsk_torch.constants import NANO
from bsk_torch.rand import Key, first_key
from bsk_torch.sim.access.lookahead import LookAhead, Manoeuvres
from bsk_torch.sim.access.places import place_kinds
from bsk_torch.sim.access.visibility.backend import make_visibility
from bsk_torch.sim.access.windows import AccessWindows
from bsk_torch.sim.component import Arg, Component, Field, Layout, MissingMessageError, declared
from bsk_torch.sim.composition import check_required_dyn, commanded_by, provided_by, world_components, world_of
from bsk_torch.sim.dyn import hub
from bsk_torch.sim.dyn.events import notice_image
from bsk_torch.sim.dyn.field import prepare
from bsk_torch.sim.dyn.models import DynamicsModel
from bsk_torch.sim.fsw.manoeuvre import burn
from bsk_torch.sim.fsw.models import IDLE, FSWModel, MagicOrbitalManeuverFSWModel
from bsk_torch.sim.fsw.modes import mode_table
from bsk_torch.sim.given import Answers
from bsk_torch.sim.initial_orbits import check_orbits
from bsk_torch.sim.orbit.arcs import Arcs
from bsk_torch.sim.orbit.solvers import make_solver
from bsk_torch.sim.params import Arguments, Overrides, merge, nearest
from bsk_torch.sim.readout.observables import Observer
from bsk_torch.sim.run import RunInputs, Runners, TickLoop, make_runners, ticks_at_once
from bsk_torch.sim.satellite_state import ArgumentState, SatelliteState
from bsk_torch.sim.state import StateTable
from bsk_torch.sim.tick import ARC_ORBIT, Tick
from bsk_torch.sim.trace import Trace
from bsk_torch.sim.world import WorldModel

logger = logging.getLogger(__name__)

ArgumentChange = tuple[int, str, Any, Sequence[int] | None]
"""See :meth:`bsk_torch.sim.params.Arguments.changed`."""

TicksMade = dict[Hashable, tuple[Tick, Runners]]
"""Ticks by their identity, with what runs them."""

ORBITS = ("arc", "integrated")

SHORTEST_TICK, LONGEST_TICK = 1e-3, 60.0
"""Bounds of the length of a tick, s. With shorter ones a step of minutes takes millions of ticks; longer ones than a minute would
pass over the nodes of arcs."""

CLOSE = 1e-9
"""Relative difference of parameters that two machines compute from the same arguments."""


class _Looked(dict[str, Any]):
    """Given arguments that remember which of them were looked at."""

    def __init__(self, given: Mapping[str, Any]) -> None:
        super().__init__(given)
        self.seen: set[str] = set()

    def __getitem__(self, name: str) -> Any:
        self.seen.add(name)
        return super().__getitem__(name)

    def get(self, name: str, default: Any = None) -> Any:
        """Return an argument, or the default."""
        self.seen.add(name)
        return super().get(name, default)


def fitted(parts: tuple[Component, ...], given: Mapping[str, Any]) -> tuple[Component, ...]:
    """Return the parts with the structure that the given arguments need."""
    return tuple(part.fit(given) if part.fit else part for part in parts)


def _planes(layout: Layout, names: Iterable[str]) -> list[int]:
    """Return the planes of some fields of a layout."""
    return [plane for name in names for plane in range(layout.slices[name].start, layout.slices[name].stop)]


def whole_nanoseconds(seconds: float) -> int:
    """Return seconds on Basilisk's clock."""
    return int(seconds * 1e9 + 0.5)


def checked_runners(start: tuple[Tensor, Tensor, Tensor], tick: Tick, backend: str, device: torch.device, count: int) -> Runners:
    """Return the runners of a tick; TypeError for a component that reads what none writes, with the models that provide it.

    ``start`` holds a state [C, n] and parameters [C, 1] and [C, n] on which a tick can run.
    """
    try:
        runners = make_runners(tick, backend, device, count)
        if isinstance(runners.run, TickLoop):  # kernels have been traced, which shows the same
            tick.check_messages(*start)
    except MissingMessageError as error:
        raise TypeError(f"{error}; {provided_by(str(error.name))}") from None
    return runners


class Checkpoint(NamedTuple):
    """A state of rows of a simulation to which they can be rewound.

    Attributes:
        planes: Fields of the components, [C, n].
        ticks: Ticks since reset, [n].
        rows: The rows, [n] indices; None for all.
    """

    planes: Tensor
    ticks: Tensor
    rows: Tensor | None


class Simulator:
    """The simulation of the satellites of one type in ``num_envs`` environments, ``count`` of them in each.

    Attributes:
        state: Everything that belongs to the present episodes; satellite k of environment e is row ``e * count + k``.
        scenario_state: The scenario's draws, [num_envs, ...] each, shared by the simulations of an environment.
        lookahead: Arcs, eclipses and windows, which are part of the state.
        observer: Properties of the present, computed together.
        world: Sun, Earth and stations at the present time.
        has_tank: Whether the satellites can change their velocity; see :meth:`thrust`.
    """

    def __init__(
        self,
        dyn_type: type[DynamicsModel],
        fsw_type: type[FSWModel],
        sat_args: Mapping[str, Any] | Sequence[Mapping[str, Any]],
        world_args: Mapping[str, Any],
        *,
        num_envs: int,
        device: torch.device,
        dtype: torch.dtype,
        sim_rate: float,
        horizon: float,
        orbit: str | None = None,
        backend: str = "compiled",
        segment: float = 600.0,
        scenario_state: StateTable | None = None,
        stops: bool = False,
        columns: Sequence[int] = (0,),
        randomize: Callable[[Key], Overrides] = lambda key: {},
        world_type: type[WorldModel] | None = None,
        compat: str | None = None,
        replan: bool = True,
        advised: set[Any] | None = None,
        controlled: bool = True,
        followed: Mapping[str, Sequence[Field]] | None = None,
        recorded: Sequence[str] = (),
        together: int | None = None,
        ticks: TicksMade | None = None,
    ) -> None:
        """Build the tick and check the arguments with trial draws; :meth:`reset` fills the state.

        Args:
            dyn_type: Dynamics model.
            fsw_type: Flight-software model.
            sat_args: Arguments of both by name: those of all satellites, or of each.
            world_args: Arguments of the world by name.
            num_envs: Number of environments.
            device: Device of all tensors.
            dtype: Type of attitude, wheels and flight software; everything is stored, and the rest computed, in float64.
            sim_rate: Length of a tick, s.
            horizon: Seconds for which windows are generated at reset.
            orbit: ``"arc"``, ``"integrated"``, or None for the default of the dynamics model.
            backend: ``"compiled"`` or ``"eager"``.
            segment: Seconds by which look-ahead windows are extended.
            scenario_state: The scenario's draws.
            stops: Whether events such as an image end a run.
            columns: Numbers of the satellites among all those of an environment, of other types too.
            randomize: Draws arguments that replace those of some satellites.
            world_type: World model; None for what the dynamics model requires.
            compat: ``"bsk_rl"`` for access windows with bsk_rl's errors.
            replan: Whether windows and eclipses follow manoeuvres.
            advised: What has been logged about arguments, so that simulations that share it do not say it again.
            controlled: Whether actions may switch attitude control on, so that its gains matter.
            followed: Fields that the satellites record which components follow, by their slot; see :mod:`bsk_torch.sim.trace`.
            recorded: Fields of the hub that runs record beside those of components.
            together: Satellites of an episode that kernels are built for; as many as there are, unless given.
            ticks: Ticks that simulations of the same satellites have made, and their kernels, which are used again; new ones are
                added.

        Raises:
            TypeError: For models that do not fit together, or a component that reads what none writes.
        """
        self.num_envs, self.count, self.device, self.dtype = num_envs, len(columns), device, dtype
        self.columns, self.backend = tuple(columns), backend
        self.scenario_state = StateTable(num_envs, 1, device) if scenario_state is None else scenario_state
        self.h_ns = whole_nanoseconds(number("sim_rate", sim_rate, SHORTEST_TICK, LONGEST_TICK, unit="s"))
        self.orbit = dyn_type.orbit if orbit is None else orbit
        self.as_bsk_rl = compat == "bsk_rl"
        self.has_tank = issubclass(fsw_type, MagicOrbitalManeuverFSWModel)
        if self.orbit not in ORBITS:
            raise ValueError(f"orbit={self.orbit!r} must be one of {list(ORBITS)}, or None for the model's own")
        self.stops, self._randomize = stops, randomize
        self._advised, self._controlled = set() if advised is None else advised, controlled
        self._fits_tick: dict[str, Arguments] = {}
        self.followed, self._recorded = dict(followed or {}), tuple(recorded)
        self._together, self._ticks = self.count if together is None else together, {} if ticks is None else ticks
        self._make_components(dyn_type, fsw_type, world_type, sat_args, world_args)
        self._make_tick()
        self._make_lookahead(horizon, segment, replan)
        self.observer = Observer(self.state, self.lookahead.flight, backend)
        stations = self.world_args.given.get("groundStationsData", ())
        self.world = self.world_type(self.state, self.lookahead.flight, stations)

    # -- construction -------------------------------------------------------------------------------------------------

    def _make_components(
        self, dyn_type: Any, fsw_type: Any, world_type: Any, sat_args: Any, world_args: Mapping[str, Any]
    ) -> None:
        check_required_dyn(dyn_type, fsw_type)
        self.world_type, world_parts = world_of(dyn_type, world_type), world_components(dyn_type, world_type)
        self.world_args = Arguments(world_parts, world_args, "world_args")
        own = (*dyn_type.all_components(), *fsw_type.all_components())
        self.sat_args = Arguments(own, sat_args, "sat_args", self.columns)
        around, given = _Looked(self.world_args.given), _Looked(self.sat_args.given)
        world_parts, own = fitted(world_parts, around), fitted(own, given)
        own = tuple(part for part in own if not (part.mends and self.as_bsk_rl))
        looked = (self.world_args, around.seen), (self.sat_args, given.seen)
        self._structural = {name for args, names in looked for name in names if not args.is_random(name)}
        self.schedule, self.gravity_degree = dyn_type.schedule, dyn_type.gravity_degree
        self.parts = self.schedule.ordered((*(dataclasses.replace(part, at_start=True) for part in world_parts), *own))
        # a component of the user's own in the slot of another may leave the flags and resets to that one
        self._declared = (*declared(self.world_type, dyn_type, fsw_type), *self.parts)
        self.modes, self.commands = mode_table(fsw_type.all_modes(), self._declared), fsw_type.all_commands()
        self.mode_names = tuple(self.modes)

    def _trial(self, envs: Sequence[int] = ()) -> tuple[dict[str, Any], dict[str, Tensor], set[str]]:
        """Return the arguments and parameters of a trial draw, and the names of the parameters that are uniform.

        The first of ``envs`` takes part in the draw.
        """
        key = first_key(min(2, self.num_envs))
        if envs:
            key = dataclasses.replace(key, env_id=torch.tensor([envs[0], *envs[-1:]])[: len(key)])
        given = self._randomize(key)
        trial = self.draw(key, given=given)
        random = {name for args in (self.sat_args, self.world_args) for name in args.table if args.is_random(name)} | set(given)
        params = merge(trial, self.parts, "prepare")
        uniform = {name for name, value in params.items() if len(value) == 1}
        if self.num_envs * self.count == 1:
            uniform = self._independent_of(random, uniform, trial)
        return trial, params, uniform

    def _make_tick(self) -> None:
        """Build the tick and its state; a trial draw determines which parameters are uniform."""
        trial, params, uniform = self._trial()
        on_arc = self.orbit == "arc"
        parts = tuple(self._scheduled(part, on_arc) for part in self._running(on_arc))
        opaque = self.device.type != "cpu"
        flags = dict.fromkeys(flag for part in self._declared for flag in part.flags)
        self.tick = Tick(parts, uniform, self.h_ns, on_arc, self.dtype, opaque, self.stops, self.followed, flags)
        if opaque and not on_arc:
            prepare(self.device, torch.float64, self.gravity_degree)
        shared, n = self.tick.shared.rows(params, 1), min(2, self.num_envs) * self.count
        initial = self.tick.state.rows(merge(trial, self.parts, "initial"), n)
        start = initial, shared, self.tick.own.rows(params, n)
        self.runners = self._runners(start)
        self.uniform = shared.to(self.device).contiguous()
        on = [[float(flag in (self.modes[name].on or ())) for name in self.mode_names] for flag in flags]
        self.flag_table = torch.tensor(on, device=self.device, dtype=torch.float64)
        self.state = SatelliteState(
            self.tick.state,
            self.tick.own,
            trial,
            num_envs=self.num_envs,
            count=self.count,
            device=self.device,
            h_ns=self.h_ns,
            modes=len(self.mode_names),
            overwritten=dict(pair for part in parts for pair in part.overwrites),
        )

    def _runners(self, start: tuple[Tensor, Tensor, Tensor] | None = None) -> Runners:
        """Return what runs the tick; a new one is checked, with ``start``, as :func:`checked_runners` does."""
        if self.tick.identity in self._ticks:
            _, runners = self._ticks[self.tick.identity]
            runners.build(self._together)
            return runners
        made = self.tick, self.backend, self.device, self._together
        runners = make_runners(*made) if start is None else checked_runners(start, *made)
        self._ticks[self.tick.identity] = self.tick, runners
        return runners

    def _independent_of(self, random: set[str], uniform: set[str], trial: dict[str, Any]) -> set[str]:
        """Return the uniform parameters that follow from no random argument, which a batch of one cannot show otherwise."""
        double = {n: torch.cat([v, v]) if n in random and isinstance(v, Tensor) else v for n, v in trial.items()}
        return {name for name, value in merge(double, self.parts, "prepare").items() if len(value) == 1} & uniform

    def _running(self, on_arc: bool) -> tuple[Component, ...]:
        parts = tuple(part for part in self.parts if not (on_arc and part.integrated_only))
        return self.schedule.ordered((*parts, ARC_ORBIT)) if on_arc else parts

    def _scheduled(self, part: Component, on_arc: bool) -> Component:
        if part.slot != "hub":
            return part
        update, recorded = hub.rotate if on_arc else hub.integrator(self.gravity_degree), (*part.records, *self._recorded)
        return dataclasses.replace(part, update=update, records=recorded)

    def _make_lookahead(self, horizon: float, segment: float, replan: bool) -> None:
        places = place_kinds(self.world_args, self.scenario_state, self.state.arguments)
        solver = make_solver(self.h_ns * NANO, self.backend, self.device, self.gravity_degree)
        visibility = make_visibility(self.backend, self.device)
        manoeuvres = Manoeuvres(self.has_tank and (replan or self.orbit == "arc"), self.has_tank and replan)
        self.lookahead = LookAhead(
            self.num_envs,
            self.count,
            solver,
            visibility,
            places,
            horizon=horizon,
            segment=segment,
            as_bsk_rl=self.as_bsk_rl,
            manoeuvres=manoeuvres,
        )
        self.state.add("lookahead", self.lookahead)

    # -- changes of arguments -----------------------------------------------------------------------------------------

    def prepare_change(self, own: Sequence[ArgumentChange], world: Sequence[ArgumentChange]) -> Callable[[], None]:
        """Check changes of the arguments of satellites and world by a trial draw; return a function that makes them.

        Raises:
            KeyError, ValueError: For wrong changes.
        """
        for _, name, _, _ in (*own, *world):
            if name in self._structural:
                raise ValueError(
                    f"{name} was the same for all environments when this one was built, and components were made for it; give a "
                    "distribution, such as rand.Choice, when an environment is built, and it can be changed"
                )
        before = self.sat_args, self.world_args
        self.sat_args, self.world_args = after = self.sat_args.changed(own), self.world_args.changed(world)
        try:
            trial, _, uniform = self._trial([env for *_, envs in (*own, *world) for env in envs or ()])
            for _, name, _, _ in (*own, *world):
                if isinstance(trial[name], Tensor) != (name in self.state.arguments):
                    was = "a value" if name in self.state.arguments else "None"
                    raise ValueError(
                        f"{name} had {was} when the environment was built, which decides what is built; build another"
                    )
        finally:
            self.sat_args, self.world_args = before

        def make() -> None:
            self.sat_args, self.world_args = after
            self._free(set(self.tick.shared.fields) - uniform)

        return make

    def _free(self, names: set[str]) -> None:
        """Let parameters, which were the same for all rows so far, differ between rows: needs another tick."""
        if not names:
            return
        logger.info("a tick is built in which %s may differ between environments", sorted(names))
        old, shared, parameters = self.tick, self.uniform, self.state.parameters
        left = set(old.shared.fields) - names
        on_arc = self.orbit == "arc"
        options = self.h_ns, on_arc, self.dtype, old.opaque_field, self.stops, self.followed, old.flags.fields
        self.tick = Tick(old.components, left, *options)
        self.runners = self._runners()
        self.uniform = shared[_planes(old.shared, self.tick.shared.fields)].contiguous()
        rows = [
            shared[old.shared.slices[name]].expand(-1, self.state.rows) if name in names else parameters[old.own.slices[name]]
            for name in self.tick.own.fields
        ]
        self.state.parameters = torch.cat(rows)

    # -- reset --------------------------------------------------------------------------------------------------------

    def draw(
        self,
        key: Key,
        world: Mapping[str, Any] | None = None,
        given: Overrides | None = None,
        answers: Sequence[Answers] | None = None,
    ) -> dict[str, Any]:
        """Return the arguments from which episodes of the key's n environments start; raises before anything has changed.

        Args:
            key: Key of the environments.
            world: Arguments of the world that have been drawn already, such as by a simulation of other satellites.
            given: Arguments that replace those of some satellites.
            answers: What functions of the user returned for each environment; unless given, they are called now.

        Returns:
            Values of satellites and world by name, [1, ...] or [n * count, ...].
        """
        around = self.world_args.draw(key, world, answers)
        random = (name for name in around if self.count > 1 and self.world_args.is_random(name))
        values = {**around, **{name: around[name].repeat_interleave(self.count, 0) for name in random}}
        values |= self.sat_args.draw(key, None, answers)
        for name, (columns, replaced) in (given or {}).items():
            values[name] = self.sat_args.override(name, values.get(name), columns, replaced)
        if taken := sorted(values.keys() & set(self.scenario_state)):
            raise ValueError(f"the scenario draws {taken}, which are arguments of satellite or world; give them other names")
        for part in self.parts:
            part.check(values)
        self._check_tick(values, bool(given))
        check_orbits(values, on_arc=self.orbit == "arc")
        return values

    def _check_tick(self, values: dict[str, Any], replaced: bool) -> None:
        """Check that arguments fit the length of a tick; marginal values are logged once for each part of a model.

        Parts whose check reads no random argument are checked once, unless arguments of some satellites are ``replaced``.
        """
        wrong = []
        for part in self.parts:
            known = self._fits_tick.get(part.slot) is self.sat_args and not replaced
            if known or (part.slot == "control" and not self._controlled):
                continue
            looked = _Looked(values)
            try:
                words = part.check_tick(looked, self.h_ns * NANO)
            except ValueError as error:
                wrong.append(str(error))
                continue
            if not replaced and not any(self._arguments_with(name).is_random(name) for name in looked.seen):
                self._fits_tick[part.slot] = self.sat_args
            if words and (self.columns, part.slot) not in self._advised:
                self._advised.add((self.columns, part.slot))
                logger.warning("sat_args: %s", words)
        if wrong:
            raise ValueError(f"sat_args: {'; and '.join(wrong)}")

    def reset(
        self, envs: Tensor, values: dict[str, Any], duration: Tensor, followed: Mapping[str, Samples] = MappingProxyType({})
    ) -> None:
        """Start the episodes ``envs`` [n] anew from drawn ``values``, with windows for ``duration`` [n] s.

        ``state.reset`` must have been called, and the scenario's draws written to ``scenario_state`` before. ``followed`` are the
        traces of the satellites that this one follows, which have been reset.
        """
        state, rows = self.state, self.state.rows_of(envs)
        n = len(rows)
        state.planes[:, rows] = self.tick.state.rows(merge(values, self.parts, "initial"), n).to(self.device)
        state.parameters[:, rows] = self.tick.own.rows(merge(values, self.parts, "prepare"), n).to(self.device)
        state.mode[rows] = self.mode_names.index(IDLE)
        state.set_arguments(rows, values)
        et = values["utc_init"].expand(n).to(self.device)
        r_N, v_N = (x.expand(n, 3).to(self.device) for x in hub.initial_orbit(values))
        seconds = state.of_env(duration)
        if self.present is None:
            self.lookahead.solve(rows, et, r_N, v_N, seconds)
        else:
            self._look_ahead_of_present(self.present[rows], rows, et, r_N, v_N, seconds)
        self._first_tick(rows, followed)
        state.touch()

    def _look_ahead_of_present(self, present: Tensor, rows: Tensor, *start: Tensor) -> None:
        """Solve look-ahead of those of ``rows`` [n] that are ``present`` [n], from ``start``; see :meth:`LookAhead.solve`.

        The others share that of the first one of their episode, so that their state is that of a satellite. Where none of this
        type is present, the first satellite's is solved.
        """
        solved = present.view(-1, self.count).clone()
        solved[:, 0] |= ~solved.any(1)
        first = solved.long().argmax(1, keepdim=True)  # the first of the largest
        source = rows.view(-1, self.count).gather(1, first).expand(-1, self.count).flatten()
        there = solved.flatten()
        self.lookahead.solve(rows[there], *(value[there] for value in start))
        self.lookahead.repeat_rows(rows[~there], source[~there])

    def check_saved(self, saved: SatelliteState, path: str) -> None:
        """Check that arguments and parameters of a saved state are such as are drawn here; ``path`` is its place in the state.

        Raises:
            ValueError: For arguments that are not allowed, or parameters that do not follow from them.
        """
        drawn = saved.tables["arguments"]
        assert isinstance(drawn, ArgumentState)
        values, low, high = {name: drawn[name] for name in drawn}, *self._argument_bounds
        wrong = ~((drawn.values >= low) & (drawn.values <= high))
        for name, place in drawn.places.items() if bool(wrong.any()) else ():
            limits = f"[{float(low[place].max()):g}, {float(high[place].min()):g}]"
            saved.refuse(
                f"{path}arguments.{name}",
                values[name],
                wrong[place].movedim(-1, 0).reshape(values[name].shape),
                f"it must lie in {limits}",
            )
        for name, value in values.items():
            if self._argument(name).shared:
                saved.refuse(f"{path}arguments.{name}", value, value != value[:1], "it must be the same in all episodes")
                values[name] = value[:1]
        on_host = {name: value.cpu() for name, value in values.items()} | saved.constants
        for part in self.parts:
            part.check(on_host)
        check_orbits(on_host, on_arc=self.orbit == "arc")
        own = self.tick.own.rows(merge(on_host, self.parts, "prepare"), saved.rows).to(saved.device).mT
        wrong = ~torch.isclose(saved.parameters.mT, own, rtol=CLOSE, atol=0.0, equal_nan=True)
        saved.refuse(f"{path}parameters", saved.parameters.mT, wrong, "it does not follow from the arguments of the satellite")

    def _arguments_with(self, name: str) -> Arguments:
        return self.sat_args if name in self.sat_args.table else self.world_args

    def _argument(self, name: str) -> Arg:
        return self._arguments_with(name).table[name]

    @functools.cached_property
    def _argument_bounds(self) -> tuple[Tensor, Tensor]:
        """Smallest and largest value of each plane of the arguments, [C, 1]."""
        arguments = self.state.arguments
        bounds = torch.zeros(2, len(arguments.values), 1, dtype=torch.float64, device=self.device)
        for name, place in arguments.places.items():
            arg = self._argument(name)
            bounds[0, place], bounds[1, place] = (0, len(arg.choices) - 1) if arg.kind == "choice" else (arg.low, arg.high)
        return bounds[0], bounds[1]

    def _first_tick(self, rows: Tensor, followed: Mapping[str, Samples]) -> None:
        """Run Basilisk's tick at time zero in ``rows`` [n]; ``followed`` are traces of all rows."""
        state = self.state
        planes, mine = state.planes[:, rows], {name: rows_of_samples(trace, rows) for name, trace in followed.items()}
        inputs = self._inputs(mine, rows)
        inputs["present"] = None  # satellites that are not present have finite fields, too
        self.runners.first_tick(planes, torch.ones_like(rows), **inputs)
        state.planes[:, rows] = planes

    # -- commands -----------------------------------------------------------------------------------------------------

    def check_command(self, command: str) -> None:
        """Raise ValueError for a command that the flight software does not have."""
        if command not in self.commands:
            having = commanded_by(command)
            advice = f"{' or '.join(having)} has it" if having else nearest(command, self.commands)
            raise ValueError(f"fsw_action={command!r} is not a command of the flight software; {advice}")

    def mode_index(self, command: str) -> Tensor:
        """Return the index into the mode table, [N], that a command means for each row."""
        entry = self.commands[command]
        if entry.choice is None:
            return torch.full_like(self.state.ticks, self.mode_names.index(entry.modes[0]))
        table = torch.tensor([self.mode_names.index(name) for name in entry.modes], device=self.device)
        return table[self.state.arguments[entry.choice].long()]

    def command(self, rows: Tensor, mode: Tensor) -> None:
        """Enter ``mode`` [N] where ``rows`` [N] is true: switch tasks and devices and reset the fields that the mode resets."""
        state = self.state
        state.mode = torch.where(rows, mode, state.mode)
        planes, resets, values = self.resets
        where = resets[:, mode] & rows
        state.planes[planes] = torch.where(where, values[:, mode], state.planes[planes])
        state.touch()

    def check_tank(self, title: str) -> None:
        """Raise ValueError for satellites that cannot change their velocity; ``title`` says what would."""
        if not self.has_tank:
            raise ValueError(
                f"{title} changes the velocity of a satellite without a tank; compose its flight software with one, "
                "such as fsw_type = (fsw.MagicOrbitalManeuverFSWModel, fsw.ImagingFSWModel)"
            )

    def thrust(self, rows: Tensor, dv_N: Tensor) -> None:
        """Change the velocity of satellites at once, at the present time; what the tank is not good for is left out.

        The message of the present keeps the velocity before the manoeuvre until the next tick. A second manoeuvre at the same
        time is added to the first; under ``compat="bsk_rl"`` it replaces it, though both are paid for.

        Args:
            rows: Satellites that manoeuvre, [N] bool; those with a change of zero count, too.
            dv_N: Changes of velocity in N, [N, 3] m/s; those of other rows do not matter.

        Raises:
            ValueError: For satellites without a tank, tensors of other shapes, changes that are not finite or require a gradient.
        """
        self.check_tank("thrust(rows, dv_N)")
        state = self.state
        n = state.rows
        if rows.shape != (n,) or rows.dtype != torch.bool or dv_N.shape != (n, 3):
            raise ValueError(
                f"thrust(rows, dv_N) got rows of shape {list(rows.shape)} and {rows.dtype}, dv_N of shape {list(dv_N.shape)}; "
                f"rows must be a mask [{n}] bool, dv_N [{n}, 3] m/s"
            )
        no_gradient("dv_N", dv_N)
        done = burn(dv_N.double(), state.read("dv_available"))
        infinite, clipped = torch.stack([(rows & ~torch.isfinite(dv_N).all(-1)).any(), (rows & done.clipped).any()]).tolist()
        if infinite:
            row = int(torch.nonzero(rows & ~torch.isfinite(dv_N).all(-1))[0])
            raise ValueError(f"thrust(rows, dv_N): dv_N[{row}] is {dv_N[row].tolist()} m/s; it must be finite")
        if clipped and "tank" not in self._advised:
            self._advised.add("tank")
            row = int(torch.nonzero(rows & done.clipped)[0])
            logger.warning(
                "dv_N[%d] requests %g m/s but %g m/s remain; clipped, and the satellite is marked dead; this is logged once",
                row,
                float(dv_N[row].norm()),
                float(state.read("dv_available")[row]),
            )
        before = state.read("delta_v_N")
        after = torch.where(rows.unsqueeze(-1), done.dv_N + (0.0 if self.as_bsk_rl else before), before)
        state.write("dv_available", rows, done.left)
        state.write("thrust_count", rows, state.read("thrust_count") + 1.0)
        state.write("delta_v_N", rows, after)
        if self.lookahead.follows:
            changed = torch.nonzero((after != before).any(-1)).squeeze(-1)
            if len(changed):
                self._begin_orbits(changed, before[changed], after[changed])

    def _begin_orbits(self, rows: Tensor, before: Tensor, after: Tensor) -> None:
        """Let new orbits of ``rows`` [n] begin now.

        The changes of velocity at this time, [n, 3] m/s, were ``before``, which arcs know already, and are ``after``.
        """
        now = self.state.sim_time
        if self.orbit == "arc":
            r_N, v_N = self.lookahead.state_at(rows, now)
            v_N = v_N - before
        else:
            r_N, v_N = (self.state.read(name)[rows] for name in ("r_BN_N", "v_BN_N"))
        self.lookahead.restart(rows, now, r_N, v_N + after)

    @functools.cached_property
    def resets(self) -> tuple[Tensor, Tensor, Tensor]:
        """Planes [P] of the state that some mode resets, masks of the modes that do, and the values, [P, M] each."""
        layout, modes = self.tick.state, list(self.modes.values())
        always = dict(reset for part in self._declared for reset in part.resets)
        rows = []
        for name in sorted({name for mode in modes for name in mode.resets} | set(always)):
            if name in layout.fields:
                given = [mode.resets.get(name, always.get(name)) for mode in modes]
                where = layout.slices[name]
                rows += [(plane, given) for plane in range(where.start, where.stop)]
        options: dict[str, Any] = {"device": self.device}
        planes = torch.tensor([plane for plane, _ in rows], dtype=torch.int64, **options)
        resets = torch.tensor([[v is not None for v in given] for _, given in rows], dtype=torch.bool, **options)
        values = torch.tensor([[v or 0.0 for v in given] for _, given in rows], dtype=torch.float64, **options)
        shape = len(rows), len(modes)
        return planes, resets.view(shape), values.view(shape)

    # -- reading ------------------------------------------------------------------------------------------------------

    @property
    def h(self) -> float:
        """Length of a tick, s."""
        return self.state.h

    @property
    def sim_time(self) -> Tensor:
        """Time since reset, [N] s, float64."""
        return self.state.sim_time

    @property
    def ticks(self) -> Tensor:
        """Ticks since reset, [N]."""
        return self.state.ticks

    @property
    def mode(self) -> Tensor:
        """Index into the mode table, [N]."""
        return self.state.mode

    @property
    def memory(self) -> StateTable:
        """Declared tensors of satellites' actions and of users, [N, ...] each; ``memory.declare(name, initial)`` adds one."""
        return self.state.memory

    @property
    def present(self) -> Tensor | None:
        """Satellites that take part in their episodes, [N]; None where all do in all."""
        return self.state["present"] if "present" in self.state.fields else None

    @property
    def arcs(self) -> Arcs:
        """Arcs of the satellites, those that they fly on."""
        return self.lookahead.flight

    @property
    def access(self) -> AccessWindows | None:
        """Access windows of places; None without places."""
        return self.lookahead.access

    def read(self, name: str) -> Tensor:
        """Return a field of the components, [N] or [N, width]."""
        return self.state.read(name)

    def write(self, name: str, rows: Tensor, value: Tensor) -> None:
        """Set a field of the components where the mask ``rows`` [N] is true; see :meth:`SatelliteState.write`."""
        self.state.write(name, rows, value)

    def argument(self, name: str) -> Any:
        """Return an argument of the present episodes, [N] or [N, width], or a constant."""
        return self.state.argument(name)

    def of_env(self, table: Tensor) -> Tensor:
        """Return values [num_envs, ...] of the episodes for each of their satellites, [N, ...]."""
        return self.state.of_env(table)

    def look_up(self, table: Tensor, place: Tensor) -> Tensor:
        """Return entries [N, n, ...] of a table [num_envs, P, ...] of the episodes for places [N, n]."""
        return self.state.look_up(table, place)

    # -- running ------------------------------------------------------------------------------------------------------

    @property
    def records(self) -> bool:
        """Whether runs leave traces."""
        return bool(self.tick.recorded)

    def trace(self, ticks: int, rows: Tensor | None = None) -> Trace:
        """Return a trace for a run of ``rows`` [n], or all, of at most so many ticks from now on, with its first record."""
        state = self.state
        trace = Trace.room(self.tick.recorded, state.ticks if rows is None else state.ticks[rows], ticks)
        trace.table[:, 0] = self._planes_of(rows)[self.tick.recorded_planes].mT
        return trace

    def run(
        self,
        ticks: Tensor,
        expected: Tensor | None = None,
        may_rewind: bool = False,
        trace: Trace | None = None,
        followed: Mapping[str, Samples] = MappingProxyType({}),
        rows: Tensor | None = None,
    ) -> Tensor:
        """Advance ``rows`` [n], or all, by at most ``ticks`` [n]; return the number of ticks done, [n].

        Zero ticks leave a row untouched. An event that ends the run of one satellite ends that of all satellites of its
        environment, in the same tick. Satellites that are not present run no ticks, and their clocks stay at zero; the number
        returned for them is that of their episode.

        Args:
            ticks: Most ticks of each row, [n].
            expected: Probable number of ticks, [n], if events are expected.
            may_rewind: Whether :meth:`rewind` may undo the run, so that arcs keep their past.
            trace: Where the rows write the fields that components record.
            followed: Traces of other satellites that components read, by slot.
            rows: The rows of whole environments, [n] indices in ascending order; all unless given.
        """
        state = self.state
        if self.records and trace is None:
            trace = self.trace(int(ticks.max()), rows)
        if isinstance(self.runners.run, Kernel) and int(ticks.max()) > (most := ticks_at_once(len(ticks))):
            if may_rewind:
                self._reach(ticks, rows)
            return self._run_in_pieces(ticks, most, trace, followed, rows)
        self._reach(ticks, rows)
        planes = state.planes if rows is None else state.planes[:, rows]
        written = None if trace is None else trace.table[:, 1:]
        flown = self.runners.run(planes, ticks, expected_ticks=expected, written=written, **self._inputs(followed, rows))
        if rows is None:
            state.ticks = state.ticks + self._of_present(flown, None)
        else:
            state.planes[:, rows] = planes
            state.ticks = state.ticks.index_add(0, rows, self._of_present(flown, rows))
        state.touch()
        return flown

    def _of_present(self, ticks: Tensor, rows: Tensor | None) -> Tensor:
        """Return ``ticks`` [n] of ``rows`` [n], or all, zero for satellites that are not present."""
        present = self._present_of(rows)
        return ticks if present is None else torch.where(present, ticks, 0)

    def _present_of(self, rows: Tensor | None) -> Tensor | None:
        """Return which of ``rows`` [n], or all, are present, [n]; None where all always are."""
        present = self.present
        return present if present is None or rows is None else present[rows]

    def _reach(self, ticks: Tensor, rows: Tensor | None) -> None:
        """Solve arcs as far as runs of ``rows`` by ``ticks`` [n] may go."""
        state = self.state
        further = self._of_present(ticks, rows)
        if rows is not None:
            further = torch.zeros_like(state.ticks).index_copy(0, rows, further)
        self.lookahead.reach_in_flight(state.sim_time + further * state.h, state.sim_time)

    def _inputs(self, followed: Mapping[str, Samples], rows: Tensor | None) -> RunInputs:
        """Return what a run of ``rows`` [n], or all, reads beside their fields; ``followed`` are traces of these rows."""
        state, arcs = self.state, self.lookahead.flight.tracks(self.tick.arc_tracks)
        own, mode, ticks = state.parameters, state.mode, state.ticks
        if rows is not None:
            own, mode, ticks = own[:, rows], mode[rows], ticks[rows]
            arcs = tuple(rows_of_samples(track, rows) for track in arcs)
        return {
            "tracks": [*arcs, *(followed[name] for name in self.tick.followed)],
            "shared": self.uniform,
            "own": own,
            "mode": mode,
            "flags": self.flag_table,
            "ticks": ticks,
            "nanoseconds": self.h_ns,
            "lockstep": self.count,
            "present": self._present_of(rows),
        }

    def _run_in_pieces(
        self, ticks: Tensor, most: int, trace: Trace | None, followed: Mapping[str, Samples], rows: Tensor | None
    ) -> Tensor:
        """Run ``ticks`` [n], at most ``most`` at once: Python handles signals, such as Ctrl-C, between two calls of a kernel."""
        flown, left, done = torch.zeros_like(ticks), ticks, 0
        while int(left.max()) > 0:
            part = None if trace is None else trace.after(done)
            ran, stopped = self._run_piece(left.clamp(max=most - 1), left, part, followed, rows)
            done += most - 1
            flown = flown + ran
            left = torch.where(stopped, 0, left - ran)
        return flown

    def _run_piece(
        self, piece: Tensor, left: Tensor, trace: Trace | None, followed: Mapping[str, Samples], rows: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """Run ``piece`` [n] of the ticks that are ``left`` [n]; return the number of ticks done, and whether they were stopped.

        The number does not tell whether the last tick of the piece stopped the run. Images are counted; where other components
        stop runs, a tick more is run first, and rows that were not stopped before it are rewound.
        """
        if not self.tick.stops:
            return self.run(piece, None, False, trace, followed, rows), torch.zeros_like(piece, dtype=torch.bool)
        if all(part.update is notice_image for part in self.tick.components if part.stops):
            before = self.events(rows)
            ran = self.run(piece, None, False, trace, followed, rows)
            return ran, self.state.of_env((self.events(rows) > before).view(-1, self.count).any(1))
        checkpoint = self.checkpoint(rows)
        ran = self.run(torch.minimum(piece + 1, left), None, False, trace, followed, rows)
        goes_on = ran > piece
        self.rewind(checkpoint, goes_on)
        self.run(torch.where(goes_on, piece, 0), None, False, trace, followed, rows)
        return torch.where(goes_on, piece, ran), ~goes_on

    def replay(self, start: Checkpoint, since: Tensor, ticks: Tensor, planes: Tensor, followed: Mapping[str, Samples]) -> Tensor:
        """Run the rows of a checkpoint again, from there, and return their fields on the way; the state does not change.

        Args:
            start: Where the n rows begin; it is used up.
            since: Ticks since reset there, [n], also of satellites that are not present.
            ticks: Ticks since reset at which the fields are read, in ascending order, [n, P]; what is read at earlier ones than
                those before is meaningless.
            planes: Planes of the fields, [w].
            followed: Traces of other satellites that components read, by slot.

        Returns:
            The fields, [n, P, w].
        """
        fields, now, inputs = start.planes, since, self._inputs(followed, start.rows)
        values = fields.new_empty(*ticks.shape, len(planes))
        written = None
        for p, goal in enumerate(ticks.unbind(1)):
            counts = (goal - now).clamp(min=0)
            inputs["ticks"] = now
            if self.records:
                written = fields.new_empty(len(now), int(counts.max()), self.tick.recorded_width)
            self.runners.run(fields, counts, written=written, **inputs)
            now = now + counts
            values[:, p] = fields[planes].mT
        return values

    def _planes_of(self, rows: Tensor | None) -> Tensor:
        """Return the fields of the components, [C, n], of ``rows`` [n], or of all."""
        return self.state.planes if rows is None else self.state.planes[:, rows]

    def checkpoint(self, rows: Tensor | None = None) -> Checkpoint:
        """Return the fields of the components and the clocks of ``rows`` [n], or of all; see :meth:`rewind`."""
        if rows is None:
            return Checkpoint(self.state.planes.clone(), self.state.ticks, None)
        return Checkpoint(self.state.planes[:, rows], self.state.ticks[rows], rows)

    def rewind(self, checkpoint: Checkpoint, back: Tensor) -> None:
        """Put the rows of a checkpoint back to it where the mask ``back`` [n] is true."""
        state, rows = self.state, checkpoint.rows
        if rows is None:
            state.planes = torch.where(back, checkpoint.planes, state.planes)
            state.ticks = torch.where(back, checkpoint.ticks, state.ticks)
        else:
            state.planes[:, rows] = torch.where(back, checkpoint.planes, state.planes[:, rows])
            state.ticks = state.ticks.index_copy(0, rows, torch.where(back, checkpoint.ticks, state.ticks[rows]))
        state.touch()

    def events(self, rows: Tensor | None = None) -> Tensor:
        """Return the number of events since reset that end an action, of ``rows`` [n], or of all."""
        if not self.has_events:
            return torch.zeros_like(self.state.sim_time if rows is None else self.state.sim_time[rows])
        images = self.state.read("images")
        return images if rows is None else images[rows]

    @property
    def has_events(self) -> bool:
        """Whether there are events that end an action."""
        return "images" in self.tick.state.fields


def rows_of_samples(samples: Samples, rows: Tensor) -> Samples:
    """Return the samples of ``rows`` [n] of a run."""
    return samples._replace(owner=rows if samples.owner is None else samples.owner[rows])
