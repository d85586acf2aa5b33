"""Recordings: fields of chosen satellites at the ticks of runs, switched on and off between steps.

A recording changes nothing about a run. All rows run as ever; what the recorded ones were at the ticks in between is found by
running them again, with the same kernel, from where the run began: from one recorded tick to the next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor

from bsk_torch.codegen.kernel import Samples
from bsk_torch.constants import NANO
from bsk_torch.sim.fleet import Fleet
from bsk_torch.sim.names import nearest
from bsk_torch.sim.readout.observables import Function, Moments, as_tensor, now_on_tensors
from bsk_torch.sim.simulator import Checkpoint

NO_TICK = -1  # number of a tick that is not recorded
KEYS = ("env", "episode", "tick", "time")  # entries of recorded data other than fields


class _Chunk(NamedTuple):
    """Records of n episodes at P ticks."""

    envs: Tensor  # environments, [n]
    episodes: Tensor  # numbers of their episodes, [n]
    ticks: Tensor  # ticks since reset, [n, P]; NO_TICK where there is no record
    values: Tensor  # fields of the recorded satellites, [n, P, S, W]


class _Type(NamedTuple):
    """What is recorded of the satellites of one type."""

    k: int
    numbers: Tensor  # the recorded satellites, by their numbers within the type, [s]
    places: Tensor  # their places among all recorded satellites, [s, 1]
    planes: Tensor  # planes of the type's state, [w]
    columns: Tensor  # places of these planes among the recorded numbers of a satellite, [w]
    properties: tuple[tuple[Function, slice], ...]  # observables computed from the state, with their places among these numbers


class Recording:
    """Fields of satellites at ticks of the current episodes and those that follow, until :meth:`stop`.

    Also a context, which stops it. Records are made at ends of ticks whose number since reset is a multiple of ``every``; that
    of tick zero shows an episode's beginning. M is the number of records, S that of recorded satellites.

    Attributes:
        fields: Names of the recorded fields.
        satellites: Names of the recorded satellites.
        envs: Recorded environments, [n].
        every: Ticks from one record to the next.
    """

    def __init__(
        self,
        fleet: Fleet,
        fields: Sequence[str],
        envs: Tensor,
        every: int,
        satellites: Sequence[str],
        properties: Sequence[Mapping[str, Function]],
    ) -> None:
        """Record from now on; see :meth:`bsk_torch.env.base.Tasking.record`.

        ``fields`` are names of fields of the state, or of observables: ``properties`` are those of each type of satellites, by
        name. ValueError for a field that none of the ``satellites`` has.
        """
        self.fleet, self.fields, self.satellites = fleet, tuple(fields), tuple(satellites)
        self.envs, self.every = envs, every
        of_type: dict[int, list[tuple[int, int]]] = {}
        for place, name in enumerate(self.satellites):
            k, number = fleet.place_of(name)
            of_type.setdefault(k, []).append((number, place))
        layouts = {k: fleet.simulators[k].tick.state for k in of_type}
        widths_of = dict[str, int]()  # types of satellites may have different numbers of wheels
        for layout in layouts.values():
            widths_of |= {name: max(part.width, widths_of.get(name, 0)) for name, part in layout.fields.items()}
        user_functions = {
            k: {name: properties[k][name] for name in self.fields if name in properties[k] and name not in widths_of}
            for k in of_type
        }
        for k, functions in user_functions.items():
            read = fleet.simulators[k].observer.read
            widths = {name: read(function)[:1].numel() for name, function in functions.items()}
            widths_of |= {name: max(width, widths_of.get(name, 0)) for name, width in widths.items()}
        for name in self.fields:
            if name not in widths_of:
                those, names = ", ".join(self.satellites), (*widths_of, *(name for k in of_type for name in properties[k]))
                raise ValueError(
                    f"fields has {name!r}, neither a field of the state nor a property of {those}; {nearest(name, names)}"
                )
        ends = torch.tensor([widths_of[name] for name in self.fields]).cumsum(0).tolist()
        self._slices = {name: slice(end - widths_of[name], end) for name, end in zip(self.fields, ends, strict=True)}
        self._columns = [fleet.names.index(name) for name in self.satellites]
        self._width, self._types = ends[-1], list[_Type]()
        for k, pairs in of_type.items():
            having = [name for name in self.fields if name in layouts[k].fields]
            planes = [plane for name in having for plane in _range(layouts[k].slices[name])]
            columns = [column for name in having for column in _range(self._slices[name])[: layouts[k].fields[name].width]]
            numbers, places = zip(*pairs, strict=True)
            index = [torch.tensor(part, dtype=torch.int64, device=fleet.device) for part in (numbers, places, planes, columns)]
            placed = tuple((function, self._slices[name]) for name, function in user_functions[k].items())
            self._types.append(_Type(k, index[0], index[1].unsqueeze(-1), index[2], index[3], placed))
        self._chunks: list[_Chunk] = []
        self._data: TensorDict | None = None
        self._starts: dict[int, Checkpoint] = {}
        fleet.recordings.append(self)
        self.begin(envs)

    # -- what env and fleet call --------------------------------------------------------------------------------------

    def begin(self, envs: Tensor) -> None:
        """Record the present of the episodes ``envs`` [n], which have begun or been restored, where they are recorded."""
        envs = envs[torch.isin(envs, self.envs)]
        if len(envs):
            ticks = self.fleet.ticks[envs]
            number = torch.where(ticks % self.every == 0, ticks, NO_TICK).unsqueeze(1)
            values = self._blank(len(envs), 1)
            for kind in self._types:
                state = self.fleet.simulators[kind.k].state
                rows = state.rows_of(envs)
                self._fill(values, kind, rows, number, state.planes[:, rows][self._needed(kind)].mT.unsqueeze(1))
            self._add(envs, number, values)

    def prepare(self, envs: Tensor | None) -> Tensor:
        """Note where a run of the episodes ``envs`` [n], or all, begins; return the places of the recorded ones among them."""
        if envs is None:
            where = self.envs
        else:
            place = torch.full_like(self.fleet.all_envs, NO_TICK)
            place[envs] = torch.arange(len(envs), device=envs.device)
            where = place[self.envs]
            where = where[where >= 0]
        recorded = where if envs is None else envs[where]
        for kind in self._types:
            simulator = self.fleet.simulators[kind.k]
            self._starts[kind.k] = simulator.checkpoint(simulator.state.rows_of(recorded))
        return where

    def add(self, envs: Tensor, ticks: Tensor, followed: Mapping[int, Mapping[str, Samples]]) -> None:
        """Record a run of the recorded episodes ``envs`` [n] by ``ticks`` [n] from where :meth:`prepare` was called.

        ``followed`` are traces of other satellites that the rows of each type read, by slot.
        """
        since = self.fleet.ticks[envs] - ticks
        first = since // self.every + 1
        most = int(((since + ticks) // self.every - first).max()) + 1 if len(envs) else 0
        if most < 1:
            return
        number = (first.unsqueeze(1) + torch.arange(most, device=envs.device)) * self.every
        number = torch.where(number <= (since + ticks).unsqueeze(1), number, NO_TICK)
        values = self._blank(len(envs), most)
        for kind in self._types:
            simulator = self.fleet.simulators[kind.k]
            of_env = simulator.state.of_env
            replayed = simulator.replay(self._starts[kind.k], of_env(since), of_env(number), self._needed(kind), followed[kind.k])
            self._fill(values, kind, simulator.state.rows_of(envs), number, replayed)
        self._add(envs, number, values)

    def _needed(self, kind: _Type) -> Tensor:
        """Return the planes from which records of a type are made: those of the fields, or all for properties."""
        state = self.fleet.simulators[kind.k].state
        return torch.arange(len(state.planes), device=state.device) if kind.properties else kind.planes

    def _blank(self, n: int, ticks: int) -> Tensor:
        shape = n, ticks, len(self.satellites), self._width
        return torch.full(shape, torch.nan, dtype=torch.float64, device=self.fleet.device)

    def _fill(self, values: Tensor, kind: _Type, rows: Tensor, ticks: Tensor, planes: Tensor) -> None:
        """Write the fields and properties of a type into values [n, P, S, W].

        ``planes`` [n * count, P, w] are those of its ``rows`` [n * count] at ``ticks`` [n, P] since reset; all of the state,
        for types with properties.
        """

        def put(table: Tensor, columns: Tensor) -> None:
            each = table.view(len(values), len(table) // len(values), *table.shape[1:])[:, kind.numbers]
            values[:, :, kind.places, columns] = each.transpose(1, 2)

        put(planes[..., kind.planes] if kind.properties else planes, kind.columns)
        if not kind.properties:
            return
        simulator, (n, count) = self.fleet.simulators[kind.k], planes.shape[:2]
        time = simulator.state.of_env(ticks).clamp(min=0).flatten() * simulator.h
        moments = Moments(rows.repeat_interleave(count), time, planes.flatten(0, 1).mT)
        now = now_on_tensors(simulator.state, simulator.lookahead.flight, moments)
        for function, where in kind.properties:
            table = as_tensor(function(now)).reshape(n, count, -1)
            put(table, torch.arange(where.start, where.stop, device=table.device)[: table.shape[-1]])

    def _add(self, envs: Tensor, ticks: Tensor, values: Tensor) -> None:
        present = self.fleet.present
        if present is not None:
            values = torch.where(present[envs][:, self._columns].view(len(envs), 1, -1, 1), values, torch.nan)
        state = self.fleet.state
        episodes = state["episode"][envs] if "episode" in state else torch.zeros_like(envs)
        self._chunks.append(_Chunk(envs, episodes, ticks, values))
        self._data = None

    # -- what users read ----------------------------------------------------------------------------------------------

    @property
    def data(self) -> TensorDict:
        """All records, [M]: ``env``, ``episode``, ``tick``, ``time`` s, and the fields, by environment and then in order of time.

        A field of one number is [M, S], one of several [M, S, width]; without the S where environments have one satellite. It is
        NaN for satellites whose models do not have it, and for those that are not present.
        """
        if self._data is None:
            self._data = self._joined()
        return self._data

    def take(self) -> TensorDict:
        """Return :attr:`data`, and forget it: what is returned next has been recorded later."""
        data, self._chunks, self._data = self.data, [], None
        return data

    def of(self, env: int, episode: int | None = None) -> TensorDict:
        """Return the records of one episode of an environment (default: the last recorded one); KeyError if there are none."""
        data = self.data
        data = data[data["env"] == env]
        if episode is None and len(data):
            episode = int(data["episode"][-1])
        data = data[data["episode"] == episode]
        if not len(data):
            which = "" if episode is None else f"episode {episode} of "
            raise KeyError(f"nothing of {which}environment {env} has been recorded; recorded are {self.envs.tolist()!s:.60}")
        return data

    @property
    def time(self) -> Tensor:
        """Time of each record since reset, [M] s."""
        return self.data["time"]

    def __getitem__(self, name: str) -> Tensor:
        """Return a field of all records; see :attr:`data`. KeyError for one that is not recorded, with the nearest one."""
        if name not in (*KEYS, *self.fields):
            raise KeyError(f"{name!r} is not recorded; {nearest(name, (*KEYS, *self.fields))}")
        return self.data[name]

    @property
    def nbytes(self) -> int:
        """Bytes of what has been recorded and not been taken."""
        return sum(part.nbytes for chunk in self._chunks for part in chunk)

    def _joined(self) -> TensorDict:
        none = self.envs[:0]
        chunks = self._chunks or [_Chunk(none, none, none.unsqueeze(1), self._blank(0, 1))]
        is_filled = [chunk.ticks != NO_TICK for chunk in chunks]
        pairs = list(zip(chunks, is_filled, strict=True))
        envs, episodes = (
            torch.cat([part.unsqueeze(1).expand(here.shape)[here] for part, here in zip(parts, is_filled, strict=True)])
            for parts in ([chunk.envs for chunk in chunks], [chunk.episodes for chunk in chunks])
        )
        order = envs.argsort(stable=True)
        ticks = torch.cat([chunk.ticks[here] for chunk, here in pairs])[order]
        values = torch.cat([chunk.values[here] for chunk, here in pairs])[order]
        values = values[:, 0] if self.fleet.size == 1 else values
        time = (ticks * self.fleet.simulators[0].h_ns).double() * NANO  # rounded as the clock is
        fields = {name: values[..., where] for name, where in self._slices.items()}
        fields = {name: value[..., 0] if value.shape[-1] == 1 else value for name, value in fields.items()}
        index = {"env": envs[order], "episode": episodes[order], "tick": ticks, "time": time}
        return TensorDict(index | fields, [len(time)])

    # -- until when ---------------------------------------------------------------------------------------------------

    def stop(self) -> None:
        """Record no more; what has been recorded stays."""
        if self in self.fleet.recordings:
            self.fleet.recordings.remove(self)

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()

    def __repr__(self) -> str:
        named = f"{list(self.fields)} of {', '.join(self.satellites)}"
        return f"Recording({named}, every={self.every}, {len(self.envs)} environments)"


def _range(where: slice) -> range:
    return range(where.start, where.stop)
