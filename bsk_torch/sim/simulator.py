"""Simulation of the satellites of one type: parameters, state, commands and runs."""

from __future__ import annotations

import functools
import logging
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import torch
from torch import Tensor

from bsk_torch._checks import no_gradient
from bsk_torch.astro.earth_rotation import EARTHS
from bsk_torch.codegen.kernel import Kernel, Samples
from bsk_torch.constants import NANO
from bsk_torch.rand import Key
from bsk_torch.sim.access.lookahead import LookAhead
from bsk_torch.sim.access.visibility.kernels import make_visibility
from bsk_torch.sim.access.visibility.planned import take_rows
from bsk_torch.sim.access.windows.search import AccessWindows
from bsk_torch.sim.arguments.values import merge, nearest
from bsk_torch.sim.assembly.composition import commanded_by
from bsk_torch.sim.assembly.satellite_type import SatelliteType
from bsk_torch.sim.component import Values, asked
from bsk_torch.sim.draw_table import DrawTable
from bsk_torch.sim.dyn import hub
from bsk_torch.sim.dyn.events import ENDINGS, notice_image
from bsk_torch.sim.environment.world import ANTENNA_TICK
from bsk_torch.sim.faults.coming import drawn_again
from bsk_torch.sim.faults.component import SLOT, severities
from bsk_torch.sim.fsw.manoeuvre import burn
from bsk_torch.sim.fsw.models import IDLE
from bsk_torch.sim.fsw.target import VERTICAL
from bsk_torch.sim.orbit.arcs import Arcs
from bsk_torch.sim.orbit.kernel_solver import make_solver
from bsk_torch.sim.places.base import PlaceKinds, place_kinds
from bsk_torch.sim.readout.observables import Observer
from bsk_torch.sim.satellite_state import SatelliteState
from bsk_torch.sim.state import StateTable
from bsk_torch.sim.tick.runners import RunInputs, TickLoop, ticks_at_once
from bsk_torch.sim.tick.trace import Trace, TrackSource, no_samples

logger = logging.getLogger(__name__)

MANY_TICKS = 5000  # ticks with `backend="eager"` after which a warning tells what they cost

EAGER = (
    "more than %d ticks with backend='eager', which is for debugging: compiled kernels, the default, are about 300 times as fast"
)


class Checkpoint(NamedTuple):
    """A state of rows of a simulation to which they can be rewound."""

    planes: Tensor  # fields of the components, [C, n]
    ticks: Tensor  # ticks since reset, [n]
    rows: Tensor | None  # the rows, [n] indices; None for all


class Simulator:
    """The simulation of the satellites of one type in ``num_envs`` environments, ``count`` of them in each.

    ``state`` is all that belongs to the current episodes; satellite k of environment e is row ``e * count + k``. Runs leave
    traces where it ``records``. Events that end an action, where it ``has_events``, end runs, too, unless it ``ends_apart``.
    Satellites contend for antennas of stations where it is ``contended``.
    ``sources`` supply the ``tracks`` that components read, by name; none in the tick at time zero.
    """

    def __init__(
        self,
        satellite_type: SatelliteType,
        num_envs: int,
        *,
        horizon: float,
        scenario_state: DrawTable | None = None,
        places: PlaceKinds = lambda tables: {},
    ) -> None:
        """Make room for the state of satellites, with windows for ``horizon`` s generated at reset; :meth:`reset` fills it.

        ``scenario_state`` are the draws of the scenario, and ``places`` returns the kinds of places that it declares.
        """
        options, usage, arguments = satellite_type.options, satellite_type.usage, satellite_type.arguments
        self.num_envs, self.count, self.device = num_envs, satellite_type.arguments.count, options.device
        self.columns, self.stops, self.followed = usage.columns, usage.stops, usage.followed
        self.orbit, self.has_tank, self.h_ns = satellite_type.orbit, satellite_type.has_tank, satellite_type.h_ns
        self.h = self.h_ns * NANO
        self.mode_names, self.flag_table = satellite_type.mode_names, satellite_type.flag_table
        self.scenario_state = DrawTable(num_envs, 1, self.device) if scenario_state is None else scenario_state
        self.type, self.tick, self.runners = satellite_type, satellite_type.tick, satellite_type.runners
        self.uniform, self.records = satellite_type.uniform, bool(self.tick.recorded)
        self._recorded_planes = torch.tensor(self.tick.recorded_planes, dtype=torch.int64, device=self.device)
        self._endings = [name for name in ENDINGS if name in self.tick.state.fields]
        self.has_events = bool(self._endings)
        self.ends_apart = self.has_events and not self.stops
        self.contended = ANTENNA_TICK in self.tick.state.fields
        self.state = SatelliteState(
            self.tick.state,
            self.tick.own,
            satellite_type.trial,
            num_envs=num_envs,
            count=self.count,
            device=self.device,
            h_ns=self.h_ns,
            modes=len(self.mode_names),
            overwritten=dict(pair for part in self.tick.components for pair in part.overwrites),
        )
        earth = EARTHS[arguments.world_args.given.get("earthRotation", "IAU_EARTH")]
        self.lookahead = LookAhead(
            num_envs,
            self.count,
            make_solver(self.h, options.backend, self.device, satellite_type.gravity_degree, earth),
            make_visibility(options.backend, self.device),
            place_kinds(
                arguments.parts,
                arguments.world_args,
                self.scenario_state,
                self.state.arguments,
                places,
                satellite_type.instruments,
                arguments.sat_args.given.get(VERTICAL, "radius"),
                earth,
            ),
            horizon=horizon,
            segment=usage.segment,
            compat=satellite_type.compat,
            blind=self.orbit == "free",
            sampled=satellite_type.sampled,
            maneuvers=self.has_tank and (options.replan or self.orbit == "arc"),
            replans=self.has_tank and options.replan,
        )
        self.state.add("lookahead", self.lookahead)
        self.sources: dict[str, TrackSource] = {}
        self.observer = Observer(self.state, self.lookahead.flight, options.backend)
        stations = satellite_type.arguments.world_args.given.get("groundStationsData", ())
        self.world = satellite_type.world_type(self.state, self.lookahead.flight, stations)

    def change(self, satellite_type: SatelliteType) -> None:
        """Take another type of the same satellites, from :meth:`SatelliteType.changed`; present episodes continue."""
        old, uniform, parameters = self.tick, self.uniform, self.state.parameters
        self.type, self.tick, self.runners = satellite_type, satellite_type.tick, satellite_type.runners
        self.uniform = satellite_type.uniform
        if self.tick is not old:
            rows = [
                uniform[old.shared.slices[name]].expand(-1, self.state.rows)
                if name in old.shared.fields
                else parameters[old.own.slices[name]]
                for name in self.tick.own.fields
            ]
            self.state.parameters = torch.cat(rows)

    # -- reset --------------------------------------------------------------------------------------------------------

    def reset(
        self, envs: Tensor, values: Values, duration: Tensor, followed: Mapping[str, Samples] = MappingProxyType({})
    ) -> None:
        """Start new episodes in ``envs`` [n] from drawn ``values``, with windows for ``duration`` [n] s.

        ``state.reset`` must have been called, and the scenario's draws written to ``scenario_state`` before. ``followed`` are the
        traces of the satellites that this one follows, which have been reset.
        """
        state, rows = self.state, self.state.rows_of(envs)
        n = len(rows)
        state.planes[:, rows] = self.tick.state.rows(merge(values, self.type.arguments.parts, "initial"), n).to(self.device)
        state.parameters[:, rows] = self.tick.own.rows(merge(values, self.type.arguments.parts, "prepare"), n).to(self.device)
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
        is_solved = solved.flatten()
        self.lookahead.solve(rows[is_solved], *(value[is_solved] for value in start))
        self.lookahead.repeat_rows(rows[~is_solved], source[~is_solved])

    def _first_tick(self, rows: Tensor, followed: Mapping[str, Samples]) -> None:
        """Run Basilisk's tick at time zero in ``rows`` [n]; ``followed`` are traces of all rows."""
        state = self.state
        planes, sources = state.planes[:, rows], {name: take_rows(trace, rows) for name, trace in followed.items()}
        inputs = self._inputs(sources, rows, None)  # satellites that are not present have finite fields, too
        self.runners.first_tick(planes, torch.ones_like(rows), **inputs)
        state.planes[:, rows] = planes

    # -- faults ------------------------------------------------------------------------------------------------------

    def strike(self, fault: str, rows: Tensor) -> None:
        """Let a declared fault begin now in ``rows`` [n], unless it acts there already; ValueError for one not declared."""
        declared = self.state.argument("faults") or ()
        names = [each.name for each in declared]
        if fault not in names:
            advice = nearest(fault, names) if names else "this satellite has none"
            raise ValueError(
                f"fault {fault!r} is not declared, so the tick has no room for it; {advice}. Declare it when the environment is "
                "built, such as sat_args={'faults': [faults.wheel_torque(0)]}, which alone never happens"
            )
        state, k = self.state, names.index(fault)
        acts = severities(declared, state.all_arguments, state.ticks, self.h_ns)[rows, k] > 0.0
        rows = rows[~acts]
        self._set_faults(rows, {declared[k].drawn("at"): state.sim_time[rows]})

    def draw_faults_again(self, envs: Tensor, key: Key) -> None:
        """Draw again which faults are still to come in the episodes ``envs`` [n]; see :mod:`bsk_torch.sim.faults.coming`.

        ValueError for drawn values that are not allowed.
        """
        declared = self.state.argument("faults") or ()
        if not declared:
            return
        rows = (envs.unsqueeze(-1) * self.count + torch.arange(self.count, device=self.device)).flatten()
        values, ticks = self._arguments_of(rows), self.state.ticks[rows].cpu()
        self._set_faults(rows, drawn_again(declared, values, ticks, self.h_ns, key, self.type.arguments.draw_some))

    def _arguments_of(self, rows: Tensor) -> dict[str, object]:
        arguments = self.state.all_arguments.items()
        return {name: value[rows].cpu() if isinstance(value, Tensor) else value for name, value in arguments}

    def _set_faults(self, rows: Tensor, values: Mapping[str, Tensor]) -> None:
        """Set arguments [n, ...] of faults of ``rows`` [n], and the parameters of the tick that follow from them."""
        state = self.state
        for name, value in values.items():
            state.arguments[name][rows] = value.to(self.device)
        state.arguments.touch()
        [(acting, part_values)] = asked(
            (part for part in self.type.arguments.parts if part.slot == SLOT), self._arguments_of(rows)
        )
        acting.check(part_values)  # type: ignore[misc]
        for name, value in acting.prepare(part_values).items():  # type: ignore[misc]
            planes = value.flatten(1).mT.expand(-1, len(rows))
            state.parameters[self.tick.own.slices[name]].index_copy_(1, rows, planes.to(self.device))
        state.touch()

    # -- commands -----------------------------------------------------------------------------------------------------

    def check_command(self, command: str) -> None:
        """Raise ValueError for a command that the flight software does not have, or whose modes or argument do not exist."""
        if command not in self.type.commands:
            having = commanded_by(command)
            advice = f"add {' or '.join(having)} to fsw_type" if having else nearest(command, self.type.commands)
            raise ValueError(f"fsw_action={command!r}: the flight software has no such command; {advice}")
        entry, table = self.type.commands[command], self.type.arguments.sat_args.table
        for mode in entry.modes:
            if mode not in self.mode_names:
                raise ValueError(f"command {command!r} enters the unknown mode {mode!r}; {nearest(mode, self.mode_names)}")
        choices = {name: len(arg.choices) for name, arg in table.items() if arg.kind == "choice"}
        if entry.choice is not None and choices.get(entry.choice) != len(entry.modes):
            raise ValueError(
                f"command {command!r} has choice={entry.choice!r}; it must be an argument of kind 'choice' with as many choices "
                f"as the command has modes, {len(entry.modes)}"
            )

    def mode_index(self, command: str) -> Tensor:
        """Return the index into the mode table, [N], that a command means for each row."""
        entry = self.type.commands[command]
        if entry.choice is None:
            return torch.full_like(self.state.ticks, self.mode_names.index(entry.modes[0]))
        table = torch.tensor([self.mode_names.index(name) for name in entry.modes], device=self.device)
        return table[self.state.arguments[entry.choice].long()]

    def command(self, rows: Tensor, mode: Tensor) -> None:
        """Enter ``mode`` [N] where ``rows`` [N] is true: switch tasks and devices and reset the fields that the mode resets."""
        state = self.state
        state.mode = torch.where(rows, mode, state.mode)
        planes, resets, values = self.type.resets
        where = resets[:, mode] & rows
        state.planes[planes] = torch.where(where, values[:, mode], state.planes[planes])
        state.touch()

    def check_tank(self, title: str) -> None:
        """Raise ValueError for satellites that cannot change their velocity; ``title`` names the action."""
        if not self.has_tank:
            raise ValueError(
                f"{title} changes the velocity of a satellite without a tank; compose its flight software with one, "
                "such as fsw_type = (fsw.MagicOrbitalManeuverFSWModel, fsw.ImagingFSWModel)"
            )

    def thrust(self, rows: Tensor, dv_N: Tensor) -> None:
        """Change the velocity of satellites at once, at the current time; what the tank is not good for is left out.

        The message of the present keeps the velocity before the maneuver until the next tick. A second maneuver at the same
        time is added to the first; under ``compat="bsk_rl"`` it replaces it, though both are paid for.

        Args:
            rows: Satellites that maneuver, [N] bool; those with a change of zero count, too.
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
        flown_N, remaining, exceeds = burn(dv_N.double(), state.read("dv_available"))
        infinite, clipped = rows & ~torch.isfinite(dv_N).all(-1), rows & exceeds
        any_infinite, any_clipped = torch.stack([infinite.any(), clipped.any()]).tolist()
        if any_infinite:
            row = int(torch.nonzero(infinite)[0])
            raise ValueError(f"thrust(rows, dv_N): dv_N[{row}] is {dv_N[row].tolist()} m/s; it must be finite")
        if any_clipped and self.type.arguments.is_new("tank"):
            row = int(torch.nonzero(clipped)[0])
            logger.warning(
                "dv_N[%d] requests %g m/s but %g m/s remain; clipped, and the satellite is marked dead; this is logged once",
                row,
                float(dv_N[row].norm()),
                float(state.read("dv_available")[row]),
            )
        before = state.read("delta_v_N")
        after = torch.where(rows.unsqueeze(-1), flown_N + (0.0 if self.type.compat else before), before)
        state.write("dv_available", rows, remaining)
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

    # -- reading ------------------------------------------------------------------------------------------------------

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
        """Satellites that take part in their episodes, [N]; None if all do in all."""
        return self.state.__dict__.get("present")

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
        """Return an argument of the current episodes, [N] or [N, width], or a constant."""
        return self.state.argument(name)

    def of_env(self, table: Tensor) -> Tensor:
        """Return values [num_envs, ...] of the episodes for each of their satellites, [N, ...]."""
        return self.state.of_env(table)

    def look_up(self, table: Tensor, place: Tensor) -> Tensor:
        """Return entries [N, n, ...] of a table [num_envs, P, ...] of the episodes for places [N, n]."""
        return self.state.look_up(table, place)

    # -- running ------------------------------------------------------------------------------------------------------

    def trace(self, ticks: int, rows: Tensor | None = None) -> Trace:
        """Return a trace for a run of ``rows`` [n], or all, of at most so many ticks from now on, with its first record."""
        state = self.state
        trace = Trace.room(self.tick.recorded, state.ticks if rows is None else state.ticks[rows], ticks)
        planes = state.planes if rows is None else state.planes[:, rows]
        trace.table[:, 0] = planes[self._recorded_planes].mT
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
            rows: The rows of whole environments, [n] indices in ascending order (default: all).
        """
        state, present = self.state, self._present_of(rows)
        if self.records and trace is None:
            trace = self.trace(int(ticks.max()), rows)
        if isinstance(self.runners.run, Kernel) and int(ticks.max()) > (most := ticks_at_once(len(ticks))):
            if may_rewind:
                self._reach(ticks, rows, present)
            return self._run_in_pieces(ticks, most, trace, followed, rows)
        longest = self._reach(ticks, rows, present)
        planes = state.planes if rows is None else state.planes[:, rows]
        written = None if trace is None else trace.table[:, 1:]
        inputs, run = self._inputs(followed, rows, present), self.runners.run
        known: dict[str, Any] = {"longest": longest} if isinstance(run, TickLoop) else {}
        flown = run(planes, ticks, expected_ticks=expected, written=written, **inputs, **known)
        many = isinstance(run, TickLoop) and run.ticks_run > MANY_TICKS
        if many and self.type.options.backend == "eager" and self.type.arguments.is_new("eager"):
            logger.warning(EAGER, MANY_TICKS)
        passed = flown if present is None else torch.where(present, flown, 0)
        if rows is None:
            state.ticks = state.ticks + passed
        else:
            state.planes[:, rows] = planes
            state.ticks = state.ticks.index_add(0, rows, passed)
        state.touch()
        return flown

    def fly(self, ticks: Tensor, most: int, late: bool) -> None:
        """Advance all rows by ``ticks`` [N], at most by ``most``, where no event ends runs and nothing is traced.

        The clock is the caller's. Arcs are solved further if they are ``late``.
        """
        kernel = self.runners.run
        assert isinstance(kernel, Kernel)
        if most > ticks_at_once(len(ticks)):
            self.run(ticks)
            return
        if late:
            self._reach(ticks, None, None)
        state = self.state
        tracks = self.lookahead.flight.tracks(self.tick.arc_tracks)
        kernel.fly(
            state.planes, ticks, tracks, self.uniform, state.parameters, state.mode, self.flag_table, state.ticks, self.h_ns
        )
        state.touch()

    def _present_of(self, rows: Tensor | None) -> Tensor | None:
        present = self.present
        return present if present is None or rows is None else present[rows]

    def _reach(self, ticks: Tensor, rows: Tensor | None, present: Tensor | None) -> int:
        """Solve arcs as far as runs of ``rows`` by ``ticks`` [n] may go; of satellites that are not present, to now.

        Return the most ticks of a row that is present. This is all that a run has to know of a device, read at once.
        """
        state = self.state
        further = ticks if present is None else torch.where(present, ticks, 0)
        if rows is not None:
            further = torch.zeros_like(state.ticks).index_copy(0, rows, further)
        now = state.sim_time
        time = now + further.double() * state.h
        longest, *short = torch.stack([further.max(), *self.lookahead.short_of(time)]).tolist()
        self.lookahead.reach_in_flight(time, now, short)
        for source in self.sources.values():
            source.reach(time)
        return int(longest)

    def _inputs(self, followed: Mapping[str, Samples], rows: Tensor | None, present: Tensor | None) -> RunInputs:
        """Return what a run of ``rows`` [n], or all, reads apart from their fields; ``followed`` are traces of these rows."""
        state, tracks = self.state, [*self.lookahead.flight.tracks(self.tick.arc_tracks)]
        for track in self.tick.supplied:
            source = self.sources.get(track.name)
            tracks.append(no_samples(track, state.rows, self.device) if source is None else source.samples())
        own, mode, ticks = state.parameters, state.mode, state.ticks
        if rows is not None:
            own, mode, ticks = own[:, rows], mode[rows], ticks[rows]
            tracks = [take_rows(track, rows) for track in tracks]
        if self.tick.followed:  # between those of arcs and of components
            at = len(self.tick.arc_tracks)
            tracks[at:at] = [followed[name] for name in self.tick.followed]
        return {
            "tracks": tracks,
            "shared": self.uniform,
            "own": own,
            "mode": mode,
            "flags": self.flag_table,
            "ticks": ticks,
            "nanoseconds": self.h_ns,
            "lockstep": self.count,
            "present": present,
        }

    def _run_in_pieces(
        self, ticks: Tensor, most: int, trace: Trace | None, followed: Mapping[str, Samples], rows: Tensor | None
    ) -> Tensor:
        """Run ``ticks`` [n], at most ``most`` at once: Python handles signals, such as Ctrl-C, between two calls of a kernel."""
        flown, remaining, done = torch.zeros_like(ticks), ticks, 0
        while int(remaining.max()) > 0:
            part = None if trace is None else trace.after(done)
            ran, stopped = self._run_piece(remaining.clamp(max=most - 1), remaining, part, followed, rows)
            done += most - 1
            flown = flown + ran
            remaining = torch.where(stopped, 0, remaining - ran)
        return flown

    def _run_piece(
        self, piece: Tensor, remaining: Tensor, trace: Trace | None, followed: Mapping[str, Samples], rows: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """Run ``piece`` [n] of the ``remaining`` [n] ticks; return the number of ticks done, and whether they were stopped.

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
        ran = self.run(torch.minimum(piece + 1, remaining), None, False, trace, followed, rows)
        goes_on = ran > piece
        self.rewind(checkpoint, goes_on)
        self.run(torch.where(goes_on, piece, 0), None, False, trace, followed, rows)
        return torch.where(goes_on, piece, ran), ~goes_on

    def replay(self, start: Checkpoint, since: Tensor, ticks: Tensor, planes: Tensor, followed: Mapping[str, Samples]) -> Tensor:
        """Run the rows of a checkpoint again, and return their ``planes`` [w] on the way, [n, P, w]; the state does not change.

        ``start``, which is used up, lies ``since`` [n] ticks after reset, also of satellites that are not present. ``ticks``
        [n, P] since reset are those at which fields are read, in ascending order; what is read at earlier ones than those
        before is meaningless. ``followed`` are traces of other satellites that components read, by slot.
        """
        fields, now, inputs = start.planes, since, self._inputs(followed, start.rows, self._present_of(start.rows))
        values = fields.new_empty(*ticks.shape, len(planes))
        written = None
        for p, goal in enumerate(ticks.unbind(1)):
            counts = (goal - now).clamp(min=0)
            inputs["ticks"] = now
            if self.records:
                written = fields.new_empty(len(now), int(counts.max()), len(self.tick.recorded_planes))
            self.runners.run(fields, counts, written=written, **inputs)
            now = now + counts
            values[:, p] = fields[planes].mT
        return values

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
        number = functools.reduce(torch.add, [self.state.read(name) for name in self._endings])
        return number if rows is None else number[rows]
