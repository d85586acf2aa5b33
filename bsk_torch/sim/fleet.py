"""All satellites of a batch of episodes, of whatever types: what is drawn for them together, and how they fly side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor

from bsk_torch.rand import Key
from bsk_torch.sim.memory import Memory
from bsk_torch.sim.params import Overrides
from bsk_torch.sim.simulator import Checkpoint, Simulator

if TYPE_CHECKING:
    from bsk_torch.sats.satellite import Satellite

NEVER = 2**62
"""Number of a tick that does not come."""


class Drawn(NamedTuple):
    """What n episodes start from: what the scenario asks, and the arguments of each simulation."""

    asked: dict[str, Tensor]
    values: list[dict[str, Any]]


class Fleet:
    """The satellites of ``num_envs`` episodes, S in each, simulated type by type.

    Attributes:
        simulators: One simulation for each type of satellite.
        columns: Where the satellites of each type stand among the S of an episode, [count] each.
        names: Name of every satellite.
        parts: The satellites of each type as agents see them, once an environment has bound them.
        memory: What episodes remember, [N, ...] each.
        since: Ticks since reset at the start of the present step, [N].
        inert: Satellites that have died and left the episode, [N, S].
    """

    parts: tuple[Satellite, ...]

    def __init__(self, simulators: Sequence[Simulator], names: Sequence[str]) -> None:
        """Put simulations of the same environments together; the first one keeps what the scenario draws."""
        self.simulators, self.names = tuple(simulators), list(names)
        first = self.simulators[0]
        self.num_envs, self.size, self.device = first.num_envs, len(names), first.device
        self.columns = tuple(torch.tensor(part.columns, device=self.device) for part in self.simulators)
        order = torch.cat(self.columns)
        self._order = None if torch.equal(order, torch.arange(self.size, device=self.device)) else order.argsort()
        self.memory = Memory(self.num_envs, self.device)
        self.since = torch.zeros(self.num_envs, dtype=torch.int64, device=self.device)
        self.inert = torch.zeros(self.num_envs, self.size, dtype=torch.bool, device=self.device)
        self.all_envs = torch.arange(self.num_envs, device=self.device)

    # -- reading ------------------------------------------------------------------------------------------------------

    @property
    def tables(self) -> dict[str, Tensor]:
        """What the scenario has drawn for the present episodes, [N, ...] each."""
        return self.simulators[0].tables

    @property
    def h(self) -> float:
        """Length of a tick, s."""
        return self.simulators[0].h

    @property
    def ticks(self) -> Tensor:
        """Ticks since reset, [N]."""
        first = self.simulators[0]
        return first.ticks if first.count == 1 else first.ticks.view(self.num_envs, -1)[:, 0]

    @property
    def sim_time(self) -> Tensor:
        """Time since reset, [N] s."""
        first = self.simulators[0]
        return first.sim_time if first.count == 1 else first.sim_time.view(self.num_envs, -1)[:, 0]

    def joined(self, parts: Sequence[Tensor]) -> Tensor:
        """What each type's rows [N * count, ...] hold, by episode and satellite, [N, S, ...]."""
        if self.size == 1:
            return parts[0].unsqueeze(1)
        views = [part.reshape(self.num_envs, -1, *part.shape[1:]) for part in parts]
        whole = views[0] if len(views) == 1 else torch.cat(views, 1)
        return whole if self._order is None else whole[:, self._order]

    def rows_of(self, part: int, table: Tensor) -> Tensor:
        """Rows [N * count, ...] of one type from a table [N, S, ...]."""
        mine = table if len(self.simulators) == 1 and self._order is None else table[:, self.columns[part]]
        return mine.flatten(0, 1)

    def each(self, read: Callable[[Satellite], Tensor], missing: float = 0.0) -> Tensor:
        """What ``read`` gives for every satellite, [N, S, ...]; ``missing`` for types without such an attribute.

        Raises:
            AttributeError: Where no type has it.
        """
        if len(self.parts) == 1:
            return self.joined([read(self.parts[0])])
        found: list[Tensor | None] = []
        lacking: AttributeError | None = None
        for part in self.parts:
            try:
                found.append(read(part))
            except AttributeError as error:
                found.append(None)
                lacking = error
        there = [value for value in found if value is not None]
        if not there:
            raise lacking or AttributeError("there are no satellites")
        blank = there[0].new_full((1, *there[0].shape[1:]), missing)
        return self.joined(
            [
                blank.expand(simulator.size, *blank.shape[1:]) if value is None else value
                for value, simulator in zip(found, self.simulators, strict=True)
            ]
        )

    # -- episodes -----------------------------------------------------------------------------------------------------

    def draw(self, key: Key, randomize: Callable[[Key], Mapping[str, tuple[Sequence[int], Tensor]]] | None = None) -> Drawn:
        """What the episodes of the key's environments start from; raises before anything has changed.

        ``randomize`` draws arguments for satellites of all types: by name, the satellites [c] and their values [n, c, ...].
        """
        asked = self.simulators[0].scene(key)
        given = {} if randomize is None else randomize(key)
        world: dict[str, Any] = {}
        values = []
        for simulator in self.simulators:
            around = simulator.world_args.draw(key, world)
            world |= around
            values.append(simulator.draw(key, asked, around, share(given, simulator.columns)))
        return Drawn(asked, values)

    def rows(self, part: int, envs: Tensor) -> Tensor:
        """Rows of one type's simulation that belong to the episodes ``envs`` [n], [n * count]."""
        count = self.simulators[part].count
        if count == 1:
            return envs
        return (envs.unsqueeze(-1) * count + torch.arange(count, device=envs.device)).flatten()

    def reset(self, envs: Tensor, drawn: Drawn, durations: Sequence[Tensor]) -> None:
        """Start the episodes ``envs`` [n] anew; windows are generated for ``durations``, [n] s for each type."""
        for k, (simulator, values, duration) in enumerate(zip(self.simulators, drawn.values, durations, strict=True)):
            seconds = duration if simulator.count == 1 else duration.repeat_interleave(simulator.count)
            simulator.reset(self.rows(k, envs), values, seconds, drawn.asked if simulator.owns_tables else None)
        self.memory.reset(envs)

    def adopt(self, envs: Tensor, other: Fleet) -> None:
        """Take over the episodes that ``other``, a fleet of the same make, holds in ``envs`` [n]."""
        for k, (mine, theirs) in enumerate(zip(self.simulators, other.simulators, strict=True)):
            mine.adopt(self.rows(k, envs), theirs)
        self.memory.reset(envs)

    # -- running ------------------------------------------------------------------------------------------------------

    def run(self, ticks: Tensor, left: Tensor, orders: Sequence[Tensor | None]) -> list[Tensor | None]:
        """Advance every episode by at most ``ticks`` [N], or to the first event that ends a step.

        Types without such events fly last. Where a later one of two types ends a step early, the earlier one flies again.

        Args:
            ticks: Number of ticks until the step ends in any case, [N].
            left: Number of ticks until the episode ends, [N]; its clock then stops before events of that instant are looked at.
            orders: About how many ticks it will be, for each type [N * count]; a matter of speed only.

        Returns:
            Which satellites of each type had an event that was looked at, [N * count] booleans; None for types without events.
        """
        order = sorted(range(len(self.simulators)), key=lambda k: not self.simulators[k].stops)
        before = [simulator.events if simulator.has_events else None for simulator in self.simulators]
        ends, ran, checkpoints = ticks, {}, {}
        for k in order:
            part = self.simulators[k]
            if not part.stops:
                continue
            checkpoints[k] = part.checkpoint() if len(order) > 1 else None
            ends = ran[k] = self._flown(k, ends, orders[k])
        for k, checkpoint in checkpoints.items():
            if checkpoint is not None:
                self._fly_again(k, checkpoint, ran[k], ends)
        seen: list[Tensor | None] = []
        for k, (part, start) in enumerate(zip(self.simulators, before, strict=True)):
            if start is None:
                seen.append(None)
                if k not in ran:
                    self._flown(k, ends, None)
                continue
            cut = (ends >= left) & (ends > 0)
            events = part.events if k in ran else self._noted(k, ends, cut)
            seen.append((events > start) & ~part.of_env(cut) if k in ran else events > start)
        return seen

    def _fly_again(self, part: int, checkpoint: Checkpoint, ran: Tensor, ends: Tensor) -> None:
        """Take one type back to where it was, in the episodes in which it ``ran`` [N] beyond ``ends`` [N]; fly it to there."""
        beyond, simulator = ran > ends, self.simulators[part]
        if bool(beyond.any()):
            simulator.rewind(checkpoint, simulator.of_env(beyond))
            self._flown(part, torch.where(beyond, ends, 0), None)

    def _noted(self, part: int, ticks: Tensor, cut: Tensor) -> Tensor:
        """Fly one type whose events end no step; the events that were looked at, [N * count]: not those of a last tick."""
        simulator = self.simulators[part]
        if not bool(cut.any()):
            self._flown(part, ticks, None)
            return simulator.events
        self._flown(part, ticks - cut.long(), None)
        events = simulator.events
        self._flown(part, cut.long(), None)
        return torch.where(simulator.of_env(cut), events, simulator.events)

    def _flown(self, part: int, ticks: Tensor, order: Tensor | None) -> Tensor:
        simulator = self.simulators[part]
        flown = simulator.run(simulator.of_env(ticks), order)
        return flown if simulator.count == 1 else flown.view(self.num_envs, -1)[:, 0].contiguous()

    @property
    def bytes_per_env(self) -> int:
        """Bytes that the tensors of one environment take now."""
        shared = sum(table.nbytes for table in self.tables.values()) + self.memory.nbytes
        return sum(simulator.bytes_per_env for simulator in self.simulators) + shared // self.num_envs


def share(given: Mapping[str, tuple[Sequence[int], Tensor]], columns: Sequence[int]) -> Overrides:
    """What concerns the satellites ``columns`` of one type, numbered within the type."""
    mine = {}
    for name, (satellites, values) in given.items():
        pairs = [(columns.index(s), k) for k, s in enumerate(satellites) if s in columns]
        if pairs:
            within, where = (torch.tensor(side) for side in zip(*pairs, strict=True))
            mine[name] = within, values[:, where]
    return mine
