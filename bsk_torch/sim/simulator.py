"""Spacecraft of one type in their worlds: parameters, state, commands, and how they move on."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from bsk_torch.astro.atmosphere import top_radius
from bsk_torch.astro.ephemeris import coverage
from bsk_torch.astro.orbit import periapsis_radius
from bsk_torch.constants import NANO
from bsk_torch.lanes.loop import Samples
from bsk_torch.rand import Key, first_key
from bsk_torch.sim.access import Access, Windows
from bsk_torch.sim.component import Component, collect
from bsk_torch.sim.dyn import hub
from bsk_torch.sim.dyn.field import prepare
from bsk_torch.sim.dyn.models import DynamicsModel
from bsk_torch.sim.eclipse import SEARCH_STEP, SEARCHES, EclipseTable
from bsk_torch.sim.fsw.models import IDLE, FSWModel
from bsk_torch.sim.fsw.modes import ALWAYS_RESET, FLAGS
from bsk_torch.sim.memory import Memory
from bsk_torch.sim.observe import Observer
from bsk_torch.sim.orbit import PLANNED_SPANS, Arcs, spans_for
from bsk_torch.sim.params import Arguments, Overrides, merge, nearest
from bsk_torch.sim.queries import TARGETS, places_in_view
from bsk_torch.sim.run import Flight, make_runners
from bsk_torch.sim.sight import View, make_sight
from bsk_torch.sim.solver import make_solver
from bsk_torch.sim.span import PLAN_STEP, SPAN
from bsk_torch.sim.surroundings import World
from bsk_torch.sim.tick import ARC_ORBIT, Tick
from bsk_torch.vec3 import Vec3

ORBITS = ("arc", "integrated")

MARGIN = SEARCH_STEP * (SEARCHES - 1) + 2.0 * PLAN_STEP
"""Seconds that arcs reach beyond what is asked for: what the search for eclipses looks ahead."""

KEPT = SPAN
"""Seconds of the past that an arc keeps when it moves on."""

CHUNK, DEVICE_CHUNK = 256, 16384
"""Rows reset at once on the CPU, where they should fit into its cache, and on other devices, where memory bounds them."""

SEARCHED, DEVICE_SEARCHED = 1 << 18, 1 << 24
"""Pairs of satellite and place whose windows are searched at once, likewise."""

LONGEST_TICK = 60.0


def fitted(parts: tuple[Component, ...], given: Mapping[str, Any]) -> tuple[Component, ...]:
    """The parts as the arguments that users gave make them."""
    return tuple(part.fit(given) if part.fit else part for part in parts)


def whole_nanoseconds(seconds: float) -> int:
    """Seconds on Basilisk's clock."""
    return int(seconds * 1e9 + 0.5)


Checkpoint = tuple[Tensor, Tensor]
"""State and clock of a simulation."""


class Simulator:
    """The simulation of the satellites of one type in ``num_envs`` environments, ``count`` of them in each.

    Their rows, N of them, stand side by side: satellite k of environment e is row ``e * count + k``. State lives in ``pack``
    [C, N]; ``ticks`` [N] counts ticks since each environment's reset, ``mode`` [N] indexes the mode table. Look-ahead is in
    ``eclipses`` and, where there are places to be seen, ``access``. What a scenario draws is kept once for each environment, in
    ``tables``.
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
        max_time: float = 0.0,
        scene: Callable[[Key], dict[str, Tensor]] = lambda key: {},
        stops: bool = False,
        columns: Sequence[int] = (0,),
        tables: dict[str, Tensor] | None = None,
        randomize: Callable[[Key], Overrides] = lambda key: {},
    ) -> None:
        """Build the tick and check the arguments with trial draws; :meth:`reset` fills the state.

        Args:
            dyn_type: Dynamics model.
            fsw_type: Flight-software model.
            sat_args: Arguments of both by name: those of all satellites, or of each.
            world_args: Arguments of the world by name.
            num_envs: Number of environments.
            device: Where everything lives.
            dtype: Type of attitude, wheels and flight software; everything is stored, and the rest computed, in float64.
            sim_rate: Length of a tick, s.
            horizon: Seconds for which windows are generated at reset.
            orbit: ``"arc"``, ``"integrated"``, or None for what the dynamics model says.
            backend: ``"compiled"`` or ``"eager"``.
            segment: Seconds by which look-ahead windows are extended.
            max_time: Longest finite time limit, to check the ephemeris' coverage.
            scene: Draws what the scenario asks for; see :meth:`bsk_torch.scene.base.Scenario.draw`.
            stops: Whether events such as an image end a run.
            columns: Numbers of the satellites among all those of an environment, of other types too.
            tables: What another simulation of the same environments has drawn of the scenario, to be shared.
            randomize: Draws arguments that replace those of some satellites.
        """
        self.num_envs, self.count, self.device, self.dtype = num_envs, len(columns), device, dtype
        self.size, self.columns = num_envs * self.count, tuple(columns)
        self.owns_tables, self.tables = tables is None, {} if tables is None else tables
        self.h_ns, self.orbit = whole_nanoseconds(sim_rate), orbit or dyn_type.orbit
        if self.orbit not in ORBITS:
            raise ValueError(f"orbit={self.orbit!r} must be one of {list(ORBITS)}, or None for the model's own")
        if not 0 < self.h_ns * NANO <= LONGEST_TICK:
            raise ValueError(f"sim_rate={sim_rate:g} s must lie in (0, {LONGEST_TICK:g}]")
        self.max_time, self.scene, self.stops, self.randomize = max_time, scene, stops, randomize
        self._parts(dyn_type, fsw_type, sat_args, world_args)
        self._layout(backend)
        self._storage(horizon, segment, backend)

    # -- construction -------------------------------------------------------------------------------------------------

    def _parts(self, dyn_type: Any, fsw_type: Any, sat_args: Any, world_args: Mapping[str, Any]) -> None:
        world_parts = collect(reversed(dyn_type.__mro__), "world_components")
        self.world_args = Arguments(world_parts, world_args, "world_args")
        own = (*dyn_type.all_components(), *fsw_type.all_components())
        self.sat_args = Arguments(own, sat_args, "sat_args", self.columns)
        world_parts, own = fitted(world_parts, self.world_args.given), fitted(own, self.sat_args.given)
        self.parts = tuple(sorted((*world_parts, *own), key=lambda part: part.order))
        self.modes, self.commands = fsw_type.all_modes(), fsw_type.all_commands()
        self.mode_names = tuple(self.modes)

    def _layout(self, backend: str) -> None:
        key = first_key(min(2, self.num_envs))
        asked = self.scene(key) if self.owns_tables else {}
        given = self.randomize(key)
        trial = self.draw(key, asked, given=given)
        random = {name for args in (self.sat_args, self.world_args) for name in args.table if args.is_random(name)} | set(given)
        self.drawn: dict[str, Any] = {}
        self.draws = self._packed = 0  # how often arguments have changed, and had when they were packed
        self._packs: dict[tuple[str, ...], Tensor] = {}
        for name, value in trial.items():
            self.drawn[name] = (
                value.new_zeros(self.size, *value.shape[1:]).to(self.device) if isinstance(value, Tensor) else value
            )
        for name, value in asked.items():
            self.tables[name] = value.new_zeros(self.num_envs, *value.shape[1:]).to(self.device)
        params = merge(trial, self.parts, "prepare")
        shared = {name for name, value in params.items() if len(value) == 1}
        if self.size == 1:
            shared = self._independent_of(random, shared, trial)
        on_arc = self.orbit == "arc"
        parts = tuple(self._scheduled(part, on_arc) for part in self._running(on_arc))
        opaque = self.device.type != "cpu"
        self.tick = Tick(parts, shared, self.h_ns, on_arc, self.dtype, opaque, self.stops)
        if opaque and not on_arc:
            prepare(self.device, torch.float64)
        self.runners = make_runners(self.tick, backend, self.device, self.count)
        self.shared = self.tick.shared.rows(params, 1).to(self.device).contiguous()

    def _independent_of(self, random: set[str], shared: set[str], trial: dict[str, Any]) -> set[str]:
        """The shared parameters when a batch of one hides which arguments are random: those that do not follow from them."""
        double = {n: torch.cat([v, v]) if n in random and isinstance(v, Tensor) else v for n, v in trial.items()}
        return {name for name, value in merge(double, self.parts, "prepare").items() if len(value) == 1} & shared

    def _running(self, on_arc: bool) -> list[Component]:
        parts = [part for part in self.parts if not (on_arc and part.integrated_only)]
        return sorted((*parts, ARC_ORBIT), key=lambda part: part.order) if on_arc else parts

    @staticmethod
    def _scheduled(part: Component, on_arc: bool) -> Component:
        update = hub.rotate if on_arc else hub.translate_and_rotate
        return dataclasses.replace(part, update=update) if part.slot == "hub" else part

    def _storage(self, horizon: float, segment: float, backend: str) -> None:
        n = self.size
        self.pack = torch.zeros(self.tick.state.size, n, device=self.device, dtype=torch.float64)
        self.own = torch.zeros(self.tick.own.size, n, device=self.device, dtype=torch.float64)
        self.ticks = torch.zeros(n, dtype=torch.int64, device=self.device)
        self.mode, self.all_rows = torch.zeros_like(self.ticks), torch.arange(n, device=self.device)
        self.world, self.observer, self.memory = World(self), Observer(self, backend), Memory(n, self.device)
        kept = max(PLANNED_SPANS, spans_for(segment) + PLANNED_SPANS - 1)
        self.arcs = Arcs(n, spans_for(horizon + MARGIN), make_solver(self.h, backend, self.device), kept)
        sight = make_sight(backend, self.device)
        self.eclipses = EclipseTable(self.arcs, sight)
        kinds = places_in_view(self)
        self.access = Access(self.arcs, sight, kinds, segment) if kinds else None
        on = [[float(flag in self.modes[name].on) for name in self.mode_names] for flag in FLAGS]
        self.flag_table = torch.tensor(on, device=self.device, dtype=torch.float64)

    @property
    def bytes_per_env(self) -> int:
        """Bytes that the tensors of one environment take now: state, parameters, arguments, arcs and look-ahead."""
        access = () if self.access is None else [x for windows in self.access.windows.values() for x in windows]
        parts = (*self.drawn.values(), *vars(self.arcs).values(), *vars(self.eclipses).values(), *access)
        tensors = (self.pack, self.own, self.ticks, self.mode, self.all_rows, *parts)
        return sum(x.nbytes for x in tensors if isinstance(x, Tensor)) // self.num_envs

    # -- time ---------------------------------------------------------------------------------------------------------

    @property
    def h(self) -> float:
        """Length of a tick, s."""
        return self.h_ns * NANO

    @property
    def sim_time_ns(self) -> Tensor:
        """Time since reset, [N] nanoseconds."""
        return self.ticks * self.h_ns

    @property
    def sim_time(self) -> Tensor:
        """Time since reset, [N] s, float64."""
        return self.sim_time_ns.double() * NANO

    # -- reset --------------------------------------------------------------------------------------------------------

    def draw(
        self, key: Key, asked: Mapping[str, Tensor], world: Mapping[str, Any] | None = None, given: Overrides | None = None
    ) -> dict[str, Any]:
        """Arguments from which episodes of the key's n environments start; raises before anything has changed.

        Args:
            key: Key of the environments.
            asked: What the scenario has drawn for them.
            world: Arguments of the world that have been drawn already, such as by a simulation of other satellites.
            given: Arguments that replace those of some satellites.

        Returns:
            Values of satellites and world by name, [1, ...] or [n * count, ...].
        """
        around = self.world_args.draw(key, world)
        random = (name for name in around if self.count > 1 and self.world_args.is_random(name))
        values = {**around, **{name: around[name].repeat_interleave(self.count, 0) for name in random}}
        values |= self.sat_args.draw(key)
        for name, (columns, replaced) in (given or {}).items():
            values[name] = self.sat_args.override(name, values.get(name), columns, replaced)
        if taken := sorted(values.keys() & asked.keys()):
            raise ValueError(f"the scenario draws {taken}, which are arguments of satellite or world; give them other names")
        for part in self.parts:
            part.check(values)
        self._check_orbit(values)
        return values

    def _check_orbit(self, values: dict[str, Any]) -> None:
        end = float(values["utc_init"].max()) + self.max_time
        if end > coverage()[1]:
            raise ValueError(
                f"utc_init: an episode would end {end - coverage()[1]:.0f} s after the ephemeris, which ends in 2060"
            )
        if self.orbit != "arc" or "baseDensity" not in values:
            return
        air = (float(values[name].max()) for name in ("planetRadius", "baseDensity", "scaleHeight"))
        top = top_radius(*air)
        r, v = (Vec3.of(x) for x in hub.initial_orbit(values))
        lowest = float(periapsis_radius(r, v).min())
        if lowest < top:
            raise ValueError(
                f"sat_args: an orbit comes down to {lowest / 1e3:.0f} km from the Earth's centre, but drag is felt below "
                f"{top / 1e3:.0f} km and the orbit is computed without it; pass orbit='integrated' to the environment"
            )

    def reset(self, rows: Tensor, values: dict[str, Any], duration: Tensor, asked: Mapping[str, Tensor] | None = None) -> None:
        """Start ``rows`` [n], those of whole environments, anew from drawn ``values``, with windows for ``duration`` [n] s.

        ``asked`` [m, ...] is what the scenario has drawn for the m environments, unless another simulation keeps that.
        """
        n = len(rows)
        self.pack[:, rows] = self._rows(self.tick.state, merge(values, self.parts, "initial"), n)
        self.own[:, rows] = self._rows(self.tick.own, merge(values, self.parts, "prepare"), n)
        self.ticks[rows], self.mode[rows] = 0, self.mode_names.index(IDLE)
        self._remember(rows, values)
        self._keep(rows, asked or {})
        while self.arcs.length < float(duration.max()):
            self.grow()
        start = (
            values["utc_init"].expand(n).to(self.device),
            *(x.expand(n, 3).to(self.device) for x in hub.initial_orbit(values)),
        )
        for part in torch.split(torch.arange(n, device=self.device), self._chunk):
            fine = self.arcs.reset(rows[part], *(x[part] for x in start))
            epoch = torch.zeros(len(part), dtype=torch.float64, device=self.device)
            sky = Samples(self.arcs.sky[rows[part]], epoch)
            view = View(Samples(fine[:, ::2].contiguous(), epoch), sky, Samples(fine, epoch))
            self.eclipses.reset(rows[part], view, duration[part])
            if self.access is not None:
                self.access.reset(rows[part], view, duration[part])
        self._first_tick(rows)
        self.memory.reset(rows)
        self.observer.forget()

    @property
    def _chunk(self) -> int:
        """Rows to reset at once."""
        rows, pairs = (CHUNK, SEARCHED) if self.device.type == "cpu" else (DEVICE_CHUNK, DEVICE_SEARCHED)
        places = self.tables[TARGETS].shape[1] if TARGETS in self.tables else 1
        return max(1, min(rows, pairs // places))

    def adopt(self, rows: Tensor, other: Simulator) -> None:
        """Take over the episodes that ``other``, a simulation of the same make, holds in ``rows`` [n]."""
        while other.arcs.length < self.arcs.length:
            other.grow()
        while self.arcs.length < other.arcs.length:
            self.grow()
        self.pack[:, rows], self.own[:, rows] = other.pack[:, rows], other.own[:, rows]
        self.ticks[rows], self.mode[rows] = other.ticks[rows], other.mode[rows]
        self._remember(rows, {name: v[rows] if isinstance(v, Tensor) else v for name, v in other.drawn.items()})
        envs = rows[:: self.count] // self.count
        self._keep(rows, {name: table[envs] for name, table in other.tables.items()} if self.owns_tables else {})
        self.arcs.adopt(rows, other.arcs)
        self.eclipses.adopt(rows, other.eclipses)
        if self.access is not None and other.access is not None:
            self.access.until[rows], self.access.ready[rows] = other.access.until[rows], other.access.ready[rows]
            for kind, windows in other.access.windows.items():
                self.access.store(kind, rows, Windows(*(table[rows] for table in windows)))
        self.memory.reset(rows)
        self.observer.forget()

    def _first_tick(self, rows: Tensor) -> None:
        """What Basilisk's tick at time zero leaves behind."""
        tracks = tuple(Samples(track.table[rows], track.start[rows]) for track in self.arcs.tracks(self.tick.tracks))
        packs = self.pack[:, rows], self.shared, self.own[:, rows], self.mode[rows], self.flag_table, self.ticks[rows]
        flight = Flight(*packs, tracks)
        self.runners.wake(flight, torch.ones_like(rows))
        self.pack[:, rows] = flight.state

    def _rows(self, layout: Any, values: dict[str, Tensor], n: int) -> Tensor:
        return layout.rows(values, n).to(self.device)

    def _remember(self, rows: Tensor, values: dict[str, Any]) -> None:
        """Keep the drawn arguments where satellites and users find them."""
        self.draws += 1
        for name, value in values.items():
            if not isinstance(value, Tensor):
                self.drawn[name] = value
                continue
            if name not in self.drawn:
                shape = (self.size, *value.shape[1:])
                self.drawn[name] = torch.zeros(shape, dtype=torch.float64, device=self.device)
            self.drawn[name][rows] = value.to(self.device)

    def _keep(self, rows: Tensor, asked: Mapping[str, Tensor]) -> None:
        """Keep what the scenario has drawn for the environments of ``rows``."""
        envs = rows[:: self.count] // self.count
        for name, value in asked.items():
            self.tables[name][envs] = value.to(self.device)

    def of_env(self, table: Tensor) -> Tensor:
        """Rows [N, ...] of what is the same for all satellites of an environment, [num_envs, ...]."""
        return table if self.count == 1 else table.repeat_interleave(self.count, 0)

    def look_up(self, table: Tensor, place: Tensor) -> Tensor:
        """Entries [N, n, ...] of a table [num_envs, P, ...] of the environments for places [N, n]."""
        flat = place.reshape(self.num_envs, -1)
        index = flat.view(*flat.shape, *[1] * (table.ndim - 2)).expand(*flat.shape, *table.shape[2:])
        return table.gather(1, index).view(*place.shape, *table.shape[2:])

    def argument(self, name: str) -> Any:
        """An argument of the present episodes, [N] or [N, width], or a constant; KeyError for a name that no model has."""
        if name not in self.drawn:
            raise KeyError(f"no argument is called {name!r}; {nearest(name, self.drawn)}")
        return self.drawn[name]

    def argument_pack(self, names: tuple[str, ...]) -> Tensor:
        """Arguments of the present episodes as planes [C, N]."""
        if self._packed != self.draws:
            self._packs, self._packed = {}, self.draws
        if names not in self._packs:
            self._packs[names] = torch.cat([self.drawn[name].reshape(self.size, -1) for name in names], 1).mT.contiguous()
        return self._packs[names]

    # -- commands -----------------------------------------------------------------------------------------------------

    def check_command(self, command: str) -> None:
        """Raise ValueError for a command that the flight software does not know."""
        if command not in self.commands:
            raise ValueError(f"fsw_action={command!r} is not a command of the flight software; {nearest(command, self.commands)}")

    def mode_index(self, command: str) -> Tensor:
        """Index into the mode table, [N], that a command means for each environment."""
        entry = self.commands[command]
        if entry.choice is None:
            return torch.full_like(self.ticks, self.mode_names.index(entry.modes[0]))
        table = torch.tensor([self.mode_names.index(name) for name in entry.modes], device=self.device)
        return table[self.drawn[entry.choice].long()]

    def command(self, rows: Tensor, mode: Tensor) -> None:
        """Enter ``mode`` [N] where ``rows`` [N] is true: switch tasks and devices and reset what the mode resets."""
        self.mode = torch.where(rows, mode, self.mode)
        planes, resets, values = self.resets
        where = resets[:, mode] & rows
        self.pack[planes] = torch.where(where, values[:, mode], self.pack[planes])
        self.observer.forget()

    @functools.cached_property
    def resets(self) -> tuple[Tensor, Tensor, Tensor]:
        """Planes [P] of the state that some mode resets, whether each mode does, and to which value, [P, M]."""
        layout, modes = self.tick.state, list(self.modes.values())
        rows = []
        for name in sorted({name for mode in modes for name in mode.resets} | set(ALWAYS_RESET)):
            if name in layout.fields:
                given = [mode.resets.get(name, ALWAYS_RESET.get(name)) for mode in modes]
                where = layout.slices[name]
                rows += [(plane, given) for plane in range(where.start, where.stop)]
        options: dict[str, Any] = {"device": self.device}
        planes = torch.tensor([plane for plane, _ in rows], dtype=torch.int64, **options)
        resets = torch.tensor([[v is not None for v in given] for _, given in rows], dtype=torch.bool, **options)
        values = torch.tensor([[v or 0.0 for v in given] for _, given in rows], dtype=torch.float64, **options)
        shape = len(rows), len(modes)
        return planes, resets.view(shape), values.view(shape)

    def write(self, name: str, rows: Tensor, value: Tensor) -> None:
        """Set a field of the state to ``value`` [N] or [N, width] where ``rows`` [N] is true."""
        where = self.tick.state.slices[name]
        self.pack[where] = torch.where(rows, value.reshape(self.size, -1).mT, self.pack[where])
        self.observer.forget()

    # -- running ------------------------------------------------------------------------------------------------------

    def run(self, ticks: Tensor, order: Tensor | None = None) -> Tensor:
        """Advance every satellite by at most ``ticks`` [N], zero leaves it untouched; by how many it did, [N].

        An event that ends the run of one ends that of all satellites of its environment, in the same tick. ``order`` [N] is about
        how many ticks it will be, if events are expected.
        """
        self.reach(self.sim_time + ticks * self.h)
        tracks = self.arcs.tracks(self.tick.tracks)
        flight = Flight(self.pack, self.shared, self.own, self.mode, self.flag_table, self.ticks, tracks, order, self.count)
        with torch.no_grad():
            flown = self.runners.run(flight, ticks)
        self.ticks = self.ticks + flown
        self.observer.forget()
        return flown

    def checkpoint(self) -> Checkpoint:
        """Where the satellites are now; see :meth:`rewind`."""
        return self.pack.clone(), self.ticks

    def rewind(self, checkpoint: Checkpoint, rows: Tensor) -> None:
        """Put ``rows`` [N], a mask, back to a checkpoint."""
        pack, ticks = checkpoint
        self.pack, self.ticks = torch.where(rows, pack, self.pack), torch.where(rows, ticks, self.ticks)
        self.observer.forget()

    @property
    def events(self) -> Tensor:
        """Number of events since reset that end an action, [N]."""
        return self.read("images") if self.has_events else torch.zeros_like(self.sim_time)

    @property
    def has_events(self) -> bool:
        """Whether there are events that end an action."""
        return "images" in self.tick.state.fields

    def reach(self, time: Tensor) -> None:
        """Make every arc cover ``time`` [N]: move it on, or make all longer where it would forget too much."""
        missing = torch.ceil((time - self.arcs.end) / SPAN).clamp(min=0)
        if not bool(missing.any()):
            return
        room = torch.floor((self.sim_time - KEPT - self.arcs.start) / SPAN).clamp(min=0)
        longer = int((missing - room).max().clamp(min=0))
        for _ in range(longer):
            self.grow()
        missing = (missing - longer).clamp(min=0)
        for spans in range(1, int(missing.max()) + 1):
            rows = torch.nonzero(missing >= spans).squeeze(-1)
            if self.access is not None:
                self.access.catch_up(rows)
            self.arcs.extend(rows)
            self.eclipses.lengthen(rows)

    def grow(self) -> None:
        """Make every arc an hour longer."""
        if self.access is not None:
            self.access.catch_up(self.all_rows)
        self.arcs.grow()
        self.eclipses.lengthen(self.all_rows)

    # -- reading ------------------------------------------------------------------------------------------------------

    def read(self, name: str) -> Tensor:
        """A field of the state, [N] or [N, width]."""
        view = self.tick.state.view(self.pack, name)
        return view.mT.clone() if view.ndim == 2 else view.clone()
