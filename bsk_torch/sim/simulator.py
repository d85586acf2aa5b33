"""N spacecraft of one type in their worlds: parameters, state, commands, and how they move on."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, cast

import torch
from torch import Tensor

from bsk_torch.astro.atmosphere import top_radius
from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE, coverage, earth_angles, earth_orientation, sun_position, sun_state
from bsk_torch.astro.orbit import periapsis_radius
from bsk_torch.constants import NANO
from bsk_torch.rand import Key, first_key
from bsk_torch.sim.access import LOOKAHEAD, AccessTable, Places, Windows
from bsk_torch.sim.component import Bus, Component, collect
from bsk_torch.sim.dyn import hub
from bsk_torch.sim.dyn.models import DynamicsModel
from bsk_torch.sim.eclipse import EclipseTable
from bsk_torch.sim.fsw.models import IDLE, FSWModel
from bsk_torch.sim.fsw.modes import ALWAYS_RESET, FLAGS
from bsk_torch.sim.orbit import Arcs, spans_for
from bsk_torch.sim.params import Arguments, merge, nearest
from bsk_torch.sim.run import run
from bsk_torch.sim.span import SPAN, Solver, pole_matrix
from bsk_torch.sim.tick import ARC_ORBIT, Tick, make_step
from bsk_torch.sim.world import WORLD_SLOTS, ground_stations, station_arrays
from bsk_torch.vec3 import Vec3

ORBITS = ("arc", "integrated")

MARGIN = 3 * SPAN
"""Seconds that arcs reach beyond what is asked for, so that look-ahead rarely has to extend them."""

KEPT = SPAN
"""Seconds of the past that an arc keeps when it moves on."""

LONGEST_TICK = 60.0


def whole_nanoseconds(seconds: float) -> int:
    """Seconds on Basilisk's clock."""
    return int(seconds * 1e9 + 0.5)


class World:
    """What surrounds the spacecraft at the present time of each environment."""

    def __init__(self, simulator: Simulator) -> None:
        """Bind the world to a simulation."""
        self.simulator = simulator

    @property
    def et(self) -> Tensor:
        """Present time, [N] ET seconds past J2000, float64."""
        return self.simulator.arcs.et + self.simulator.sim_time

    @property
    def PN(self) -> Tensor:
        """DCM from N to the Earth-fixed frame, [N, 3, 3]."""
        return earth_orientation(self.et).to(self.simulator.dtype)

    @property
    def omega_PN_N(self) -> Tensor:
        """Rate of the Earth-fixed frame, [N, 3] rad/s in N."""
        pole = pole_matrix(self.et)
        return (pole.z.stack() * EARTH_ROTATION_RATE).to(self.simulator.dtype)

    @property
    def r_sun_N(self) -> Tensor:
        """Sun relative to the Earth, [N, 3] m in N."""
        return sun_position(self.et).to(self.simulator.dtype)

    @property
    def sun_direction_N(self) -> Tensor:
        """Direction from the Earth to the Sun, [N, 3] in N."""
        r = sun_position(self.et)
        return (r / r.norm(dim=-1, keepdim=True)).to(self.simulator.dtype)

    @property
    def stations(self) -> tuple[str, ...]:
        """Names of the ground stations, in the order of their indices."""
        data = self.simulator.world_args.given.get("groundStationsData", ())
        return tuple(f"GroundStation{s.get('name', k)}" for k, s in enumerate(data))


class Simulator:
    """The simulation of N environments with one satellite each.

    State lives in ``pack`` [C, N]; ``ticks`` [N] counts ticks since each environment's reset, ``mode`` [N] indexes the mode
    table. Look-ahead is in ``eclipses`` and, where there are ground stations, ``access``.
    """

    def __init__(
        self,
        dyn_type: type[DynamicsModel],
        fsw_type: type[FSWModel],
        sat_args: Mapping[str, Any],
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
    ) -> None:
        """Build the tick and check the arguments with trial draws; :meth:`reset` fills the state.

        Args:
            dyn_type: Dynamics model.
            fsw_type: Flight-software model.
            sat_args: Arguments of both by name.
            world_args: Arguments of the world by name.
            num_envs: Number of environments N.
            device: Where everything lives.
            dtype: Type of state and parameters.
            sim_rate: Length of a tick, s.
            horizon: Seconds for which windows are generated at reset.
            orbit: ``"arc"``, ``"integrated"``, or None for what the dynamics model says.
            backend: ``"compiled"`` or ``"eager"``.
            segment: Seconds by which look-ahead windows are extended.
            max_time: Longest finite time limit, to check the ephemeris' coverage.
        """
        self.num_envs, self.device, self.dtype = num_envs, device, dtype
        self.h_ns, self.orbit = whole_nanoseconds(sim_rate), orbit or dyn_type.orbit
        if self.orbit not in ORBITS:
            raise ValueError(f"orbit={self.orbit!r} must be one of {list(ORBITS)}, or None for the model's own")
        if not 0 < self.h_ns * NANO <= LONGEST_TICK:
            raise ValueError(f"sim_rate={sim_rate:g} s must lie in (0, {LONGEST_TICK:g}]")
        self.max_time = max_time
        self._parts(dyn_type, fsw_type, sat_args, world_args)
        self._layout(backend)
        self._storage(horizon, segment, backend)

    # -- construction -------------------------------------------------------------------------------------------------

    def _parts(self, dyn_type: Any, fsw_type: Any, sat_args: Mapping[str, Any], world_args: Mapping[str, Any]) -> None:
        world_parts = collect(reversed(dyn_type.__mro__), "world_components")
        self.world_args = Arguments(world_parts, world_args, "world_args")
        stations = self.world_args.given.get("groundStationsData")
        if stations:
            count = ground_stations(len(stations))
            world_parts = tuple(count if part.slot == "ground_stations" else part for part in world_parts)
        own = (*dyn_type.all_components(), *fsw_type.all_components())
        self.sat_args = Arguments(own, sat_args, "sat_args")
        self.parts = tuple(sorted((*world_parts, *own), key=lambda part: part.order))
        self.modes, self.commands = fsw_type.all_modes(), fsw_type.all_commands()
        self.mode_names = tuple(self.modes)

    def _layout(self, backend: str) -> None:
        trial = self.draw(first_key(min(2, self.num_envs)))
        random = {name for args in (self.sat_args, self.world_args) for name in args.table if args.is_random(name)}
        self.drawn = {name: value for name, value in trial.items() if not isinstance(value, Tensor)}
        params = merge(trial, self.parts, "prepare")
        shared = {name for name, value in params.items() if len(value) == 1}
        if self.num_envs == 1:
            shared = self._independent_of(random, shared, trial)
        on_arc = self.orbit == "arc"
        parts = tuple(self._scheduled(part, on_arc) for part in self._running(on_arc))
        self.tick = Tick(parts, shared, h=self.h, on_arc=on_arc, backend=backend, dtype=self.dtype)
        self.step_function = make_step(self.tick, self.device)
        self.shared = self.tick.shared.rows(params, 1).to(self.device, self.dtype)

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
        n = self.num_envs
        self.pack = torch.zeros(self.tick.state.size, n, device=self.device, dtype=self.dtype)
        self.own = torch.zeros(self.tick.own.size, n, device=self.device, dtype=self.dtype)
        self.ticks = torch.zeros(n, dtype=torch.int64, device=self.device)
        self.mode, self.all_rows = torch.zeros_like(self.ticks), torch.arange(n, device=self.device)
        self.world = World(self)
        self.arcs = Arcs(n, spans_for(horizon + MARGIN), Solver(self.h, backend, self.device))
        self.eclipses = EclipseTable(self.arcs)
        self.access: AccessTable | None = None
        if "groundStationsData" in self.world_args.table:
            arrays = station_arrays(self.world_args.draw(first_key(1)))
            r_P = arrays["station_positions"].view(3, -1).mT.contiguous().to(self.device)
            self.access = AccessTable(self.arcs, Places(r_P, arrays["station_sin_elevations"][0].to(self.device)), segment)
        on = [[float(flag in self.modes[name].on) for name in self.mode_names] for flag in FLAGS]
        self.flag_table = torch.tensor(on, device=self.device, dtype=self.dtype)

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

    def draw(self, key: Key) -> dict[str, Any]:
        """Arguments of world and satellite for episodes of the key's environments; raises before anything has changed."""
        values = {**self.world_args.draw(key), **self.sat_args.draw(key)}
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

    def reset(self, rows: Tensor, values: dict[str, Any], duration: Tensor) -> None:
        """Start ``rows`` [n] anew from drawn ``values``; windows are generated for ``duration`` [n] s."""
        n = len(rows)
        self.pack[:, rows] = self._rows(self.tick.state, merge(values, self.parts, "initial"), n)
        self.own[:, rows] = self._rows(self.tick.own, merge(values, self.parts, "prepare"), n)
        self.ticks[rows], self.mode[rows] = 0, self.mode_names.index(IDLE)
        self._remember(rows, values)
        r, v = (x.expand(n, 3).to(self.device) for x in hub.initial_orbit(values))
        too_short = self.arcs.length < float(duration.max())
        while self.arcs.length < float(duration.max()):
            self.arcs.grow()
        self.arcs.reset(rows, values["utc_init"].expand(n).to(self.device), r, v)
        self._first_tick(rows)
        self.eclipses.sampled[rows] = duration
        self.eclipses.known[rows] = 0.0
        self.eclipses.refresh(self.all_rows if too_short else rows)
        if self.access is not None:
            self.access.reset(rows, duration)

    def adopt(self, rows: Tensor, other: Simulator) -> None:
        """Take over the episodes that ``other``, a simulation of the same make, holds in ``rows`` [n]."""
        while other.arcs.length < self.arcs.length:
            other.arcs.grow()
            other.eclipses.refresh(other.all_rows)
        self.pack[:, rows], self.own[:, rows] = other.pack[:, rows], other.own[:, rows]
        self.ticks[rows], self.mode[rows] = other.ticks[rows], other.mode[rows]
        self._remember(rows, {name: v[rows] if isinstance(v, Tensor) else v for name, v in other.drawn.items()})
        self.arcs.adopt(rows, other.arcs)
        self.eclipses.adopt(rows, other.eclipses)
        if self.access is not None and other.access is not None:
            self.access.until[rows] = other.access.until[rows]
            self.access.store(rows, Windows(*(table[rows] for table in other.access.windows)))

    def _first_tick(self, rows: Tensor) -> None:
        """What Basilisk's tick at time zero leaves behind: the messages of the world, and the density latched from them."""
        bus = Bus(0.0)
        flags, segment, _ = self._segment(rows, 0.0)
        packs = (self.pack[:, rows], self.shared, self.own[:, rows], flags, segment)
        layouts = (self.tick.state, self.tick.shared, self.tick.own, self.tick.flags, self.tick.segment)
        for layout, pack in zip(layouts, packs, strict=True):
            layout.put(bus, pack)
        bus.tau = torch.zeros((), dtype=self.dtype, device=self.device)
        for part in self.tick.components:
            if part.update and (part.slot in WORLD_SLOTS or part.slot == "drag"):
                part.update(bus)
        self.pack[:, rows] = torch.stack([plane.expand(len(rows)) for plane in self.tick.state.gather(bus)])

    def _rows(self, layout: Any, values: dict[str, Tensor], n: int) -> Tensor:
        return layout.rows(values, n).to(self.device, self.dtype)

    def _remember(self, rows: Tensor, values: dict[str, Any]) -> None:
        """Keep the drawn arguments where satellites and users find them."""
        for name, value in values.items():
            if not isinstance(value, Tensor):
                self.drawn[name] = value
                continue
            if name not in self.drawn:
                shape = (self.num_envs, *value.shape[1:])
                self.drawn[name] = torch.zeros(shape, dtype=self.dtype, device=self.device)
            self.drawn[name][rows] = value.to(self.device, self.dtype)

    # -- commands -----------------------------------------------------------------------------------------------------

    def check_command(self, command: str) -> None:
        """Raise ValueError for a command that the flight software does not know."""
        if command not in self.commands:
            raise ValueError(f"fsw_action={command!r} is not a command of the flight software; {nearest(command, self.commands)}")

    def mode_index(self, command: str) -> Tensor:
        """Index into the mode table, [N], that a command means for each environment."""
        entry = self.commands[command]
        table = torch.tensor([self.mode_names.index(name) for name in entry.modes], device=self.device)
        choice = self.drawn[entry.choice].long() if entry.choice else torch.zeros_like(self.ticks)
        return table[choice]

    def command(self, rows: Tensor, mode: Tensor) -> None:
        """Enter ``mode`` [N] where ``rows`` [N] is true: switch tasks and devices and reset what the mode resets."""
        self.mode = torch.where(rows, mode, self.mode)
        fields = {name for row in self.modes.values() for name in row.resets} | set(ALWAYS_RESET)
        for name in sorted(fields & set(self.tick.state.fields)):
            values = [row.resets.get(name, ALWAYS_RESET.get(name)) for row in self.modes.values()]
            resets = torch.tensor([v is not None for v in values], device=self.device)[mode] & rows
            value = torch.tensor([v or 0.0 for v in values], device=self.device, dtype=self.dtype)[mode]
            where = self.tick.state.slices[name]
            self.pack[where] = torch.where(resets, value, self.pack[where])

    # -- running ------------------------------------------------------------------------------------------------------

    def _segment(self, rows: Tensor, start: float) -> tuple[Tensor, Tensor, Tensor]:
        """Flags, segment pack and tick counters of ``rows`` for the segment of a step; see :func:`bsk_torch.sim.run.run`."""
        time = self.sim_time[rows] + start
        et = self.arcs.et[rows] + time
        r_sun, v_sun = sun_state(et)
        pole = pole_matrix(et).stack().flatten(1)
        parts = [r_sun, v_sun, earth_angles(et)[2].unsqueeze(-1), pole]
        if self.orbit == "arc":
            nodes, first = self.arcs.nodes(rows, time, 3)
            parts += [nodes.flatten(1), (first - time).unsqueeze(-1)]
        return self.flag_table[:, self.mode[rows]], torch.cat(parts, 1).mT.to(self.dtype).contiguous(), self.ticks[rows]

    def run(self, ticks: Tensor) -> None:
        """Advance every environment by its number of ticks ``ticks`` [N]; zero leaves it untouched."""
        self.reach(self.sim_time + ticks * self.h)
        with torch.no_grad():
            self.pack = run(self.step_function, self.pack, self.shared, self.own, self._segment, ticks, self.h_ns)
        self.ticks = self.ticks + ticks

    def reach(self, time: Tensor) -> None:
        """Make every arc cover ``time`` [N]: move it on, or make all longer where it would forget too much."""
        missing = torch.ceil((time - self.arcs.end) / SPAN).clamp(min=0)
        if not bool(missing.any()):
            return
        room = torch.floor((self.sim_time - KEPT - self.arcs.start) / SPAN).clamp(min=0)
        longer = int((missing - room).max().clamp(min=0))
        for _ in range(longer):
            self.arcs.grow()
        missing = (missing - longer).clamp(min=0)
        for spans in range(1, int(missing.max()) + 1):
            self.arcs.extend(torch.nonzero(missing >= spans).squeeze(-1), 1)
        changed = torch.ones_like(missing) if longer else missing
        self.eclipses.refresh(torch.nonzero(changed).squeeze(-1))

    # -- look-ahead ---------------------------------------------------------------------------------------------------

    def next_eclipse(self) -> tuple[Tensor, Tensor]:
        """Next start and end of an eclipse, [N] s since reset; see :meth:`bsk_torch.sim.eclipse.EclipseTable.query`."""
        time = self.sim_time
        self.reach(self.eclipses.needs(self.all_rows, time))
        return self.eclipses.query(self.all_rows, time)

    def next_windows(self, count: int) -> Windows:
        """The ``count`` windows that close next, [N, count]; RuntimeError where there is none within the look-ahead."""
        access, time = cast("AccessTable", self.access), self.sim_time
        for _ in range(LOOKAHEAD):
            short = access.short(self.all_rows, time, count)
            rows = torch.nonzero(short).squeeze(-1)
            if not len(rows):
                break
            self.reach(torch.where(short, access.until + access.segment, torch.zeros_like(time)))
            access.extend(rows, time[rows])
            self.eclipses.sampled = torch.maximum(self.eclipses.sampled, access.until)
        none = torch.nonzero(access.short(self.all_rows, time, 1)).squeeze(-1).tolist()
        if none:
            raise RuntimeError(
                f"no station sees the satellite of environments {none[:5]} within {LOOKAHEAD * access.segment:g} s; add stations "
                "to world_args['groundStationsData'] or lower gsMinimumElevation"
            )
        return access.next(self.all_rows, time, count)

    def read(self, name: str) -> Tensor:
        """A field of the state, [N] or [N, width]."""
        view = self.tick.state.view(self.pack, name)
        return view.mT.clone() if view.ndim == 2 else view.clone()
