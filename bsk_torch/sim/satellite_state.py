"""The state of the satellites of one type: fields of the components, parameters, arguments and memory."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor

from bsk_torch._checks import no_gradient
from bsk_torch.constants import NANO
from bsk_torch.sim.access.lookahead import LookAhead
from bsk_torch.sim.component import Layout, UserArguments, Values
from bsk_torch.sim.names import nearest, same
from bsk_torch.sim.state import StateTable, described, look_up

LAST_TICK = 2**53  # largest number of a tick: the tick counts in float64


class ArgumentState(StateTable):
    """Drawn arguments of satellites and world, [rows, ...] each by name, as views of one tensor: rows are copied at once."""

    values: Tensor  # all arguments as planes, [C, rows] float64

    def __init__(self, num_envs: int, count: int, device: torch.device, trial: Mapping[str, Tensor]) -> None:
        """Make room for arguments like those of a ``trial`` draw, [n or 1] or [n or 1, width] each."""
        super().__init__(num_envs, count, device)
        self.places: dict[str, slice | int] = {}
        self.shapes: dict[str, tuple[int, ...]] = {}
        first = 0
        for name, value in trial.items():
            width = value[0].numel()
            self.places[name] = first if value.ndim == 1 else slice(first, first + width)
            self.shapes[name] = tuple(value.shape[1:])
            first += width
        self.declare("values", None, first, planes=True, low=-math.inf)

    def __getitem__(self, name: str) -> Tensor:
        if name not in self.places:
            raise KeyError(f"no argument is called {name!r}; {nearest(name, self.places)}")
        place, shape = self.places[name], self.shapes[name]
        if not isinstance(place, slice):
            return self.values[place]
        numbers = self.values[place].mT
        return numbers if len(shape) == 1 else numbers.unflatten(-1, shape)

    def __contains__(self, name: object) -> bool:
        return name in self.places

    def __iter__(self) -> Iterator[str]:
        return iter(self.places)


class Clock(NamedTuple):
    """Times since reset [rows], s, of a tensor of ticks, and how often both had been written to in place."""

    ticks: Tensor
    time: Tensor
    versions: tuple[int, int]


@functools.lru_cache(maxsize=32)
def _owners(episodes: int, count: int, device: torch.device) -> Tensor:
    """Return the episode of every row, [episodes * count]; it is only read."""
    with torch.inference_mode(False):
        return torch.arange(episodes, device=device).repeat_interleave(count)


class SatelliteState(StateTable):
    """State of ``count`` satellites in each of ``num_envs`` episodes: satellite k of episode e is row ``e * count + k``.

    The table ``arguments`` has the drawn arguments of satellites and world, ``constants`` those that are not numbers, the same
    for all rows, and ``memory`` tensors that actions, rewarders and users declare, [rows, ...]. A tick lasts ``h`` s.
    """

    planes: Tensor  # fields of the components, [C, rows] float64; see read
    parameters: Tensor  # parameters of ticks that differ between rows, [C, rows] float64
    ticks: Tensor  # ticks since reset, [rows]
    mode: Tensor  # index into the mode table, [rows]

    def __init__(
        self,
        layout: Layout,
        parameters: Layout,
        arguments: UserArguments,
        *,
        num_envs: int,
        count: int,
        device: torch.device,
        h_ns: int,
        modes: int,
        overwritten: Mapping[str, str] | None = None,
    ) -> None:
        """Make room for the fields and parameters of two layouts, and for arguments like those of a trial draw.

        ``modes`` is the length of the mode table; ``overwritten`` are fields that cannot be written, with advice; see
        :class:`~bsk_torch.sim.component.Component`.
        """
        super().__init__(num_envs, count, device)
        self.layout, self.h_ns, self.h, self.overwritten = layout, h_ns, h_ns * NANO, dict(overwritten or {})
        self.declare("planes", None, layout.size, planes=True)
        self.declare("parameters", None, parameters.size, planes=True)
        self.declare("ticks", 0, low=0, high=LAST_TICK)
        self.declare("mode", 0, low=0, high=modes - 1)
        numbers = {name: value for name, value in arguments.items() if isinstance(value, Tensor)}
        self.constants = {name: value for name, value in arguments.items() if name not in numbers}
        self.arguments, self.memory = ArgumentState(num_envs, count, device, numbers), StateTable(num_envs, count, device)
        self.add("arguments", self.arguments)
        self.add("memory", self.memory)
        self._clock: Clock | None = None
        self._argument_planes: dict[tuple[str, ...], tuple[int, Tensor]] = {}

    @property
    def sim_time_ns(self) -> Tensor:
        """Time since reset, [rows] nanoseconds."""
        return self.ticks * self.h_ns

    @property
    def sim_time(self) -> Tensor:
        """Time since reset, [rows] s, float64."""
        ticks, clock = self.ticks, self._clock
        if clock is None or clock.ticks is not ticks or clock.versions != (ticks._version, clock.time._version):
            time = (ticks * self.h_ns).double() * NANO
            if ticks.is_inference() or time.is_inference():  # which do not tell whether they were written to
                return time
            clock = self.__dict__["_clock"] = Clock(ticks, time, (ticks._version, time._version))
        return clock.time

    def set_clock(self, ticks: Tensor, time: Tensor) -> None:
        """Set the ticks since reset, [rows], and the same in s, float64; :meth:`touch` is the caller's."""
        self.put(ticks=ticks)
        self.__dict__["_clock"] = Clock(ticks, time, (ticks._version, time._version))

    def described(self, title: str) -> Iterator[str]:
        """See :meth:`StateTable.described`: the fields of the components; arguments and results of searches are left out."""
        yield title
        for name, field in self.layout.fields.items():
            others = same(name)
            starts = [other for other in others if other in self.arguments]
            read = [other for other in others if other not in self.arguments and other not in ("rN", "vN", "oe")]
            links = [*(f"argument: {start}" for start in starts), *([f"properties: {', '.join(read)}"] if read else [])]
            unit = "" if field.unit == "-" else field.unit
            yield described(
                name, unit, self.layout.view(self.planes, name), "; ".join([*([field.doc] if field.doc else []), *links])
            )
        yield from self.memory.described(f"{title}.memory")

    def read(self, name: str) -> Tensor:
        """Return a field of the components, [rows] or [rows, width]; KeyError for a name that none declares."""
        if name not in self.layout.fields:
            raise KeyError(f"the satellite has no field {name!r}; {nearest(name, self.layout.fields)}")
        part = self.planes[self.layout.slices[name]]
        return part[0].clone() if len(part) == 1 else part.mT.clone()

    def write(self, name: str, rows: Tensor, value: Tensor) -> None:
        """Set a field of the components to ``value`` [rows] or [rows, width] where the mask ``rows`` is true.

        Raises:
            KeyError: For a name that no component declares.
            ValueError: For a field that every tick recomputes, so that what is written is lost, a value of a wrong shape, or one
                that requires a gradient.
        """
        if name in self.overwritten:
            raise ValueError(f"write({name!r}) would be lost in the next tick: {self.overwritten[name]}")
        no_gradient(f"value of write({name!r}, rows, value)", value)
        if name not in self.layout.fields:
            raise KeyError(f"the satellite has no field {name!r}; {nearest(name, self.layout.fields)}")
        where, width = self.layout.slices[name], self.layout.fields[name].width
        if not isinstance(value, Tensor) or value.numel() != self.rows * width or value.shape[0] != self.rows:
            description = f"of shape {list(value.shape)}" if isinstance(value, Tensor) else repr(value)
            wanted = [self.rows] if width == 1 else [self.rows, width]
            raise ValueError(f"value of write({name!r}, rows, value) is {description}; it must be a tensor of shape {wanted}")
        planes = self.planes[where]
        torch.where(rows, value if value.ndim == 1 else value.reshape(self.rows, -1).mT, planes, out=planes)
        self.touch()

    def check_relations(self, path: str) -> None:
        """See :meth:`StateTable.check_relations`: limits of the components' fields, and arcs that cover the present."""
        limits = torch.tensor(self.layout.limits, dtype=torch.float64, device=self.device)
        planes = self.planes.mT
        wrong = ~(planes.abs() <= limits)
        for name, where in self.layout.slices.items() if bool(wrong.any()) else ():
            limit = f"it must lie in [{-self.layout.fields[name].limit:g}, {self.layout.fields[name].limit:g}]"
            self.refuse(f"{path}{name}", planes[:, where], wrong[:, where], limit)
        ahead = self.tables["lookahead"]
        assert isinstance(ahead, LookAhead)
        ahead.check_time(path, self.sim_time)
        epoch = self.tables["arguments"]["utc_init"]
        self.refuse(f"{path}lookahead.arcs.et", ahead.arcs.et, ahead.arcs.et != epoch, "it must be the argument utc_init")

    def set_arguments(self, rows: Tensor, values: Mapping[str, object]) -> None:
        """Keep the drawn arguments [1, ...] or [n, ...] of ``rows`` [n]."""
        for name, value in values.items():
            if isinstance(value, Tensor):
                self.arguments[name][rows] = value.to(self.device)
            else:
                self.constants[name] = value
        self.arguments.touch()

    def argument(self, name: str) -> Any:
        """Return an argument of the current episodes, [rows] or [rows, width], or a constant; KeyError for an unknown name."""
        if name in self.arguments:
            return self.arguments[name]
        if name in self.constants:
            return self.constants[name]
        names = [*self.arguments, *self.constants]
        raise KeyError(f"no argument is called {name!r}; {nearest(name, names)}")

    @property
    def all_arguments(self) -> Values:
        """Arguments of the current episodes by name, [rows, ...] each, and the constants."""
        return {name: self.arguments[name] for name in self.arguments} | self.constants

    def argument_planes(self, names: tuple[str, ...]) -> Tensor:
        """Return arguments of the current episodes as planes [C, rows]."""
        version, planes = self._argument_planes.get(names, (-1, self.planes))
        if version != self.arguments.version:
            planes = torch.cat([self.arguments[name].reshape(self.rows, -1) for name in names], 1).mT.contiguous()
            self._argument_planes[names] = self.arguments.version, planes
        return planes

    def of_env(self, table: Tensor) -> Tensor:
        """Return values [N, ...] of the episodes for each of their satellites, [rows, ...]."""
        return table if self.count == 1 else table.index_select(0, _owners(len(table), self.count, self.device))

    def look_up(self, table: Tensor, place: Tensor) -> Tensor:
        """Return entries [rows, n, ...] of a table [N, P, ...] of the episodes for places [rows, n]."""
        return look_up(table, place)
