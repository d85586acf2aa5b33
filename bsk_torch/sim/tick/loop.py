"""One simulated tick of one satellite type: the function to compile.

Inside a tick every quantity is a plane, one number of every environment. The same source runs on tensors [n], eagerly or through
inductor, and on symbolic planes, which become one loop in C++ (:mod:`bsk_torch.codegen`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.gravity import DEGREE
from bsk_torch.codegen.ir import Loop
from bsk_torch.codegen.kernel import Kernel
from bsk_torch.codegen.trace import Tracer
from bsk_torch.constants import NANO
from bsk_torch.sim.component import Bus, Component, Field, Layout, Track, neighbours
from bsk_torch.sim.dyn.forces.drag import check_force
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, put_track
from bsk_torch.sim.orbit.arcs import ARC, follow_arc
from bsk_torch.sim.tick.own_updates import WatchedBus, check_read, update_checked
from bsk_torch.sim.tick.trace import recorded

_ON_ARC = "the orbit was computed in advance; pass orbit='integrated' to the environment"

ARC_ORBIT = Component(slot="orbit", update=follow_arc, overwrites=(("r_BN_N", _ON_ARC), ("v_BN_N", _ON_ARC)))


class Inputs(NamedTuple):
    """Planes that a tick starts from; ``records`` holds those of every track, ``tau`` the seconds since their first record."""

    state: Sequence[object]
    shared: Sequence[object]
    own: Sequence[object]
    flags: Sequence[object]
    records: Sequence[Sequence[object]]
    tau: Sequence[object]
    ticks: object


class Tick:
    """The tick of a list of components, and the layouts of its packs.

    ``shared`` are the parameters that all environments have in common, ``own`` those that differ. ``dtype`` is the type of
    attitude and flight software. Where the tick ``stops``, a component may write the mask ``bus.stop``: rows in which it holds
    end their run with this tick.
    """

    def __init__(
        self,
        components: Sequence[Component],
        shared: set[str],
        h_ns: int,
        on_arc: bool,
        dtype: torch.dtype,
        opaque_field: bool,
        stops: bool = False,
        followed: Mapping[str, Sequence[Field]] = MappingProxyType({}),
        flags: Iterable[str] = (),
        gravity_degree: int = DEGREE,
    ) -> None:
        """Lay out the packs of ``components``, which are in the order of a tick of ``h_ns`` nanoseconds.

        ``followed`` are the fields that satellites record which components follow; see :mod:`bsk_torch.sim.tick.trace`. ``flags``
        are what modes may switch on, those that the components declare aside. ``gravity_degree`` is that of the Earth's field
        where orbits are not solved in advance.
        """
        params = [field for component in components for field in component.params]
        self.components, self.h_ns, self.dtype, self.opaque_field = components, h_ns, dtype, opaque_field
        self.on_arc, self.gravity_degree = on_arc, gravity_degree
        self.stops = stops and any(component.stops for component in components)
        self.state = Layout(field for component in components for field in component.state)
        self.shared = Layout(field for field in params if field.name in shared)
        self.own = Layout(field for field in params if field.name not in shared)
        declared = (flag for component in components for flag in component.flags)
        self.flags = Layout(Field(name) for name in dict.fromkeys((*flags, *declared)))
        self.followed, self.recorded = followed, recorded(components)
        self.arc_tracks: tuple[Track, ...] = (EPHEMERIS_TRACK, ARC) if on_arc else (EPHEMERIS_TRACK,)
        # bus.<name>[0] has the fields of a satellite that this one follows
        traces = (Track(name, h_ns * NANO, tuple(fields), count=1) for name, fields in followed.items())
        self.supplied = tuple({track.name: track for component in components for track in component.tracks}.values())
        self.tracks = (*self.arc_tracks, *traces, *self.supplied)

    def with_shared(self, shared: set[str]) -> Tick:
        """Return the tick in which only the parameters ``shared`` are the same for all environments."""
        options = self.h_ns, self.on_arc, self.dtype, self.opaque_field, self.stops, self.followed, self.flags.fields
        return Tick(self.components, shared, *options, self.gravity_degree)

    @property
    def functions(self) -> list[Callable[..., object]]:
        """Functions that the tick calls."""
        holders = [held for part in self.components for held in (part.effector, part.allocation) if held is not None]
        updates = [part.update for part in self.components if part.update is not None]
        return [*updates, *(value for held in holders for value in vars(held).values() if callable(value))]

    @property
    def identity(self) -> Hashable:
        """Equal for ticks that compute the same; it holds for as long as one of them exists, which keeps its functions."""
        fields = [(tuple(p.state), tuple(p.params), tuple(p.records)) for p in self.components]
        parts = tuple(
            (p.slot, id(p.update), p.effector, p.allocation, p.stops, p.at_start, *f)
            for p, f in zip(self.components, fields, strict=True)
        )
        field = None if self.on_arc else self.gravity_degree
        options = self.h_ns, field, self.dtype, self.opaque_field, self.stops, tuple(self.flags.fields)
        return parts, options, frozenset(self.shared.fields), self.tracks

    def bus(self, inputs: Inputs, h_ns: int | None = None) -> Bus:
        """Return the bus at the start of a tick."""
        degree = None if self.on_arc else self.gravity_degree
        bus = Bus(self.h_ns if h_ns is None else h_ns, self.dtype, self.opaque_field, degree)
        packs = (self.state, inputs.state), (self.shared, inputs.shared), (self.own, inputs.own), (self.flags, inputs.flags)
        for layout, planes in packs:
            layout.put(bus, planes)
        for track, planes, tau in zip(self.tracks, inputs.records, inputs.tau, strict=True):
            put_track(bus, track, planes, tau)
        bus.ticks = inputs.ticks
        bus.effectors = tuple(part.effector for part in self.components if part.effector)
        for part in self.components:
            if part.allocation:
                bus.allocation = part.allocation
        return bus

    def advance(self, inputs: Inputs, checked: bool = False) -> tuple[list[Any], Any]:
        """Return the planes of the state at the end of the tick, and the mask of rows that end their run with it, or None.

        Updates are ``checked`` as :mod:`bsk_torch.sim.tick.own_updates` describes.
        """
        bus = self.bus(inputs)
        if checked:
            self._update_checked(bus)
        else:
            _update(bus, self.components)
        check_force(bus, self.on_arc)
        stop = bus.stop if self.stops and bus.has("stop") else None
        if stop is not None and stop.dtype is not torch.bool:
            raise TypeError(f"bus.stop has numbers of type {stop.dtype}; it must be a mask, which a comparison makes")
        return self.state.gather(bus), stop

    def wake(self, inputs: Inputs) -> list[Any]:
        """Return the state's planes after Basilisk's tick at time zero: messages of the world, and values latched from it."""
        bus = self.bus(inputs, h_ns=0)
        _update(bus, [component for component in self.components if component.at_start])
        return self.state.gather(bus)

    def _update_checked(self, bus: Bus) -> None:
        watched = WatchedBus.__new__(WatchedBus)
        watched.__dict__ = bus.__dict__  # one bus under two classes
        watched.watch()
        for component in self.components:
            update_checked(watched, component)
        check_read(watched, (*self.state.fields, *(name for name in ("stop",) if self.stops)))
        del bus.__dict__["unread"]

    def check_updates(self, state: Tensor, shared: Tensor, own: Tensor) -> None:
        """Run the components once on tensors: state [C, n], parameters [C, 1] and [C, n].

        MissingMessageError for a component that reads what none writes, with the name and the component's slot; TypeError for
        an update of a user's component that cannot be used.
        """
        n = state.shape[1]
        tables = [state.new_zeros(n, track.count, track.width) for track in self.tracks]
        flags, zero = state.new_zeros(self.flags.size, n), state.new_zeros(n)
        self.advance(self.inputs(state, shared, own, flags, tables, [zero] * len(tables), zero), checked=True)

    @property
    def schedule(self) -> tuple[str, ...]:
        """Slots of the components that run in the tick, in their order."""
        return tuple(component.slot for component in self.components if component.update is not None)

    def inputs(
        self,
        state: Tensor,
        shared: Tensor,
        own: Tensor,
        flags: Tensor,
        tables: Sequence[Tensor],
        starts: Sequence[Tensor],
        ticks: Tensor,
    ) -> Inputs:
        """Return the inputs of tick ``ticks`` [n] from packs [C, n], tables [n, R, C] of the tracks and their starts [n], s."""
        time, rows = ticks * self.h_ns / 1e9, torch.arange(state.shape[1], device=state.device)  # divided, as in kernels
        records, taus = [], []
        for track, table, begin in zip(self.tracks, tables, starts, strict=True):
            nodes, tau = neighbours(track, table, rows, time - begin)
            records.append(nodes.flatten(1).unbind(-1))
            taus.append(tau)
        pairs = (self.state, state), (self.shared, shared), (self.own, own), (self.flags, flags)
        packs = [
            [plane if exact else plane.to(self.dtype) for plane, exact in zip(pack.unbind(0), layout.exact, strict=True)]
            for layout, pack in pairs
        ]
        return Inputs(packs[0], packs[1], packs[2], packs[3], records, taus, ticks)

    def step(
        self,
        state: Tensor,
        shared: Tensor,
        own: Tensor,
        flags: Tensor,
        ticks: Tensor,
        end: Tensor,
        *tracks: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Return the state [C, n] after one tick, and the new ``end`` [n]; rows whose time is up keep both, bit for bit.

        Shared parameters are [C, 1], own ones and flags [C, n]. ``ticks`` [n] is the number of this tick since reset, ``end``
        [n] that of each row's last one, both float64. ``tracks`` are records [n, R, C] of each track, then the times [n], s
        since reset, of the first records of each.
        """
        tables, starts = tracks[: len(self.tracks)], tracks[len(self.tracks) :]
        planes, stop = self.advance(self.inputs(state, shared, own, flags, tables, starts, ticks))
        runs = ticks <= end
        after = [torch.where(runs, new.to(old.dtype), old) for new, old in zip(planes, state.unbind(0), strict=True)]
        return torch.stack(after), end if stop is None else torch.where(runs & stop, ticks, end)

    def trace(self, wakes: bool = False) -> Loop:
        """Return the traced tick, or that at time zero; UntraceableError for tensor code that has no kernel."""
        program = Tracer()

        def pack(source: str, layout: Layout) -> list[object]:
            dtypes = (torch.float64 if exact else self.dtype for exact in layout.exact)
            return [program.input(source, k, dtype=dtype) for k, dtype in enumerate(dtypes)]

        def records(t: int, track: Track) -> list[object]:
            return [program.input("track", t, k) for k in range(track.count * track.width)]

        inputs = Inputs(
            pack("state", self.state),
            pack("shared", self.shared),
            pack("own", self.own),
            pack("flag", self.flags),
            [records(t, track) for t, track in enumerate(self.tracks, 1)],
            [program.input("tau", t) for t in range(1, len(self.tracks) + 1)],
            program.input("ticks_now"),
        )
        if wakes:
            return Loop(program, self.wake(inputs), self.tracks, clock="start")
        planes, stop = self.advance(inputs, checked=True)
        return Loop(program, planes, self.tracks, [planes[k] for k in self.recorded_planes], stop=stop)

    @functools.cached_property
    def recorded_planes(self) -> list[int]:
        """Planes of the state that every tick records."""
        return [k for f in self.recorded for k in range(self.state.slices[f.name].start, self.state.slices[f.name].stop)]

    def kernel(self, wakes: bool = False, lockstep: int = 1) -> Kernel:
        """Return the kernel of :meth:`trace`, built for groups of ``lockstep`` rows that end together."""
        return Kernel("first tick" if wakes else "tick", self.trace(wakes), lockstep)


def _update(bus: Bus, components: Sequence[Component]) -> None:
    for component in components:
        if component.update:
            component.update(bus)
