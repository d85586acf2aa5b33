"""Base class of discrete actions, and the discrete action space that a satellite's ``action_spec`` forms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, cast

import torch
from torch import Tensor

from bsk_torch._checks import number, text
from bsk_torch.sats.bound import BoundSatellite, link_entry
from bsk_torch.sim.fsw.models import FSWModel
from bsk_torch.sim.hooks import check_class, check_tensor, defined_first, is_of_package, overrides
from bsk_torch.sim.state import StateTable

HOOKS = (
    *("n_actions", "n_negative_actions", "target_actions", "link_satellite", "names"),
    *("table", "decide", "begin", "end", "mask", "aimed_at", "offers"),
)
"""Members of :class:`Action` that subclasses may define."""

LONGEST = 1e9
"""Duration of an action ended only by another event, s; longer durations are reduced to it."""


SHORTEST = 1e-9
"""Shortest duration of an action, s: clocks count nanoseconds, and a step of no length would never end an episode."""


def positive_duration(title: str, duration: object, name: str, default: float) -> float:
    """Return the duration of the action ``name``, s; ``default`` for None, and at most ``default``."""
    if duration is None:
        return default
    return min(number(f"action {name!r}: {title}", duration, SHORTEST, unit="s", finite=False, none=True), default)


DTYPES = (torch.int64, torch.bool, torch.float64, torch.int64, torch.float64)
"""Types of the first fields of a :class:`Decision`, which have one number per row."""


class Decision(NamedTuple):
    """Commands of the actions of one step, [N] each.

    Attributes:
        mode: Index of the flight mode to enter, int64.
        retask: Whether to enter it, bool; otherwise the current mode continues.
        duration: Time after which the action ends, s.
        key: Number that identifies the action, int64; an action with the key of the previous one repeats it.
        expected: Expected time until an event ends the action, at most ``duration``, s. It is used only to sort rows for speed.
        command: Value passed from ``decide`` of an action to its ``begin``, [N, ...], or None; in ``end`` of a continuous action,
            the ended action, [N, A].
    """

    mode: Tensor
    retask: Tensor
    duration: Tensor
    key: Tensor
    expected: Tensor
    command: Tensor | None = None


def check_decision(title: str, decision: Decision, rows: int) -> None:
    """Raise TypeError unless every command of a hook's decision is a tensor [rows] of its dtype."""
    if not isinstance(decision, Decision):
        raise TypeError(f"{title}.decide(...) returns {decision!r}; it must return an act.Decision")
    for field, value, dtype in zip(Decision._fields, decision, DTYPES, strict=False):
        check_tensor(f"{title}.decide(...).{field}", value, (rows,), dtype)


def checked_durations(title: str, decision: Decision, acts: Tensor, satellite: BoundSatellite) -> Decision:
    """Return a decision with durations of at most :data:`LONGEST` where ``acts`` [N] holds, and that elsewhere."""
    for name, seconds in (("duration", decision.duration), ("expected", decision.expected)):
        wrong = acts & ~(seconds >= SHORTEST)
        if bool(wrong.any()):
            row = int(torch.nonzero(wrong)[0])
            raise ValueError(
                f"{title}.decide(...).{name} is {float(seconds[row])} s for {satellite.title(row)}; it must be at least "
                f"{SHORTEST} s"
            )
    duration, expected = (torch.where(acts, s, LONGEST).clamp(max=LONGEST) for s in (decision.duration, decision.expected))
    return decision._replace(duration=duration, expected=expected)


def check_modes(title: str, mode: Tensor, acts: Tensor, names: Sequence[str]) -> None:
    """Raise ValueError for modes [N] that are not the numbers of ``names`` where ``acts`` [N] holds."""
    wrong = acts & ((mode < 0) | (mode >= len(names)))
    if bool(wrong.any()):
        raise ValueError(
            f"{title}.mode is {int(mode[wrong][0])}; it must be from 0 to {len(names) - 1}, such as that of "
            "simulator.mode_index('charge')"
        )


class ActionTable(NamedTuple):
    """Commands of A actions, constant until the next reset.

    Attributes:
        mode: Index of the flight mode of each action, [N, A] int64.
        reset: Whether a repeated action enters its mode again, [A] bool.
        duration: Time after which each action ends, [A] float64, s.
    """

    mode: Tensor
    reset: Tensor
    duration: Tensor

    def decision(self, column: Tensor, action: Tensor, previous: Tensor) -> Decision:
        """Return the commands of the actions in ``column`` [N] of the table; ``action`` and ``previous`` are their keys, [N]."""
        duration = self.duration[column]
        mode = self.mode.gather(1, column.unsqueeze(1)).squeeze(1)
        return Decision(mode, (action != previous) | self.reset[column], duration, action, duration)


class Entry:
    """An entry of an ``action_spec``. N is the number of satellites of the type.

    Attributes:
        name: Name of the entry.
        satellite: The satellites, once an environment has been built.
        fsw_type: Flight software added to the satellite's by the action; None for none.
        begins: Whether :meth:`begin` has anything to do for this satellite, where a class defines it.
    """

    satellite: BoundSatellite
    fsw_type: type[FSWModel] | None = None
    begins = True

    def __init__(self, name: str) -> None:
        """Name the entry."""
        self.name = text("name", name)

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """Prepare for a satellite; called once when an environment is built.

        Overriding methods call ``super().link_satellite(satellite)`` first, and raise ValueError for a satellite that lacks
        something needed by the action.
        """
        self.satellite = satellite

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """Called after the entry's actions have been commanded, in the rows ``mask`` [N] bool."""

    def end(self, mask: Tensor, decision: Decision, event: Tensor) -> None:
        """Called after the entry's actions have ended within an episode, in the rows ``mask`` [N] bool.

        Args:
            mask: Rows in which a duration or an event has ended an action of the entry.
            decision: Current mode, duration and key of the actions; ``retask`` equals the rows in which an action has ended.
            event: Whether an event ended the action, [N] bool, and not its duration.
        """


class Action(Entry):
    """``n_actions`` consecutive numbers of the discrete action space.

    Subclasses define :meth:`table` if their commands are constant until the next reset, and :meth:`decide` otherwise; the other
    hooks are optional. All hooks of a subclass are called in every environment.

    Attributes:
        n_actions: Number of actions.
        first_is_legal: Whether :meth:`mask` always allows the first action; then rows need no check for a legal one.
    """

    n_actions: int = 1
    first_is_legal: bool = False
    by_index: bool = True  # whether some of the checked actions may be negative

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        if "table" in vars(cls) and "decide" in vars(cls):
            raise TypeError(f"{cls.__name__} defines both table() and decide(), but only one would be called; define one")
        check_class(cls, Action, HOOKS)

    @property
    def n_negative_actions(self) -> int:
        """Number of additional actions -1, -2, ... accepted by the entry; 0 by default."""
        return 0

    @property
    def target_actions(self) -> range:
        """Numbers, within the entry, of the actions that choose among targets, in their observed order; none by default."""
        return range(0)

    def names(self) -> list[str]:
        """Return the names of the entry's actions, ``n_actions`` of them."""
        return [self.name] if self.n_actions == 1 else [f"{self.name}_{k}" for k in range(self.n_actions)]

    def table(self) -> ActionTable:
        """Return the commands of the entry's actions until the next reset, with A = ``n_actions``."""
        raise NotImplementedError(f"{type(self).__name__} must implement table() or decide(index, mask, action, previous)")

    def decide(self, index: Tensor, mask: Tensor, action: Tensor, previous: Tensor) -> Decision:
        """Return the commands of the entry's actions (default: those of :meth:`table`).

        Args:
            index: Number of the action within the entry, [N] int64, from 0 to ``n_actions`` - 1.
            mask: Whether the entry's action is executed now, [N] bool; the commands of other rows are ignored.
            action: Number of the action in the whole action space, [N] int64.
            previous: Key of the previous action, [N] int64; -1 for none.
        """
        return self.table().decision(index, action, previous)

    def aimed_at(self) -> Tensor | None:
        """Return the target that each satellite has chosen last with the entry, [N] int64, -1 for none; None without targets."""
        return None

    def offers(self) -> tuple[Tensor, Tensor] | None:
        """Return the targets of the entry's :attr:`target_actions`, and when their windows open; None without targets.

        Targets are [N, n] int64, -1 for none, and times [N, n] float64 s, NaN where there are no windows.
        """
        return None

    def mask(self) -> Tensor:
        """Return which of the entry's actions are legal now, [N, n_actions] bool (default: all)."""
        ticks = self.satellite.simulator.ticks
        return torch.ones(len(ticks), self.n_actions, dtype=torch.bool, device=ticks.device)


class ActionBuilder:
    """The discrete action space of a satellite type: the entries of its ``action_spec``, numbered in order.

    Entries with commands constant until the next reset are looked up in one table. Only the others are called in every step, and
    only hooks overridden by a subclass are called.

    Attributes:
        n_negative_actions: Number of additional legal negative actions.
        some_legal: Whether an entry always allows its first action.
        keys: The key of each action, [n_actions], if several entries give one command; None if keys are action numbers.
    """

    def __init__(self, spec: Sequence[Action], satellite: BoundSatellite) -> None:
        """Link every entry to the satellite."""
        for entry in spec:
            _link(entry, satellite)
        self.entries, self.satellite = tuple(spec), satellite
        sizes, negative = [entry.n_actions for entry in spec], [entry.n_negative_actions for entry in spec]
        self.n_actions, self.n_negative_actions = sum(sizes), max(negative)
        self._starts = [sum(sizes[:k]) for k in range(len(sizes))]
        self._takes_negative = next((k for k, number in enumerate(negative) if number), -1)
        numbered = list(enumerate(self.entries))
        self._fixed = [k for k, entry in numbered if defined_first(entry, "table", "decide") == "table"]
        self._deciding = [k for k, _ in numbered if k not in self._fixed]
        self._beginning, self._ending, self._masking = (
            [k for k, entry in numbered if overrides(entry, Action, hook)] for hook in ("begin", "end", "mask")
        )
        self._beginning = [k for k in self._beginning if self.entries[k].begins]
        self.some_legal = any(entry.first_is_legal for entry in self.entries)
        self._all_legal = torch.ones_like(satellite.simulator.ticks, dtype=torch.bool).unsqueeze(1).expand(-1, self.n_actions)
        longest = [LONGEST if k in self._fixed else torch.inf for k, size in enumerate(sizes) for _ in range(size)]
        self._longest = torch.tensor(longest, dtype=torch.float64, device=self._all_legal.device)
        self._table, self._table_draws = cast("ActionTable | None", None), -1
        self.keys = self._shared_keys()
        self._commands: dict[int, Tensor | None] = {}

    def _shared_keys(self) -> Tensor | None:
        """Return the key of each action, [n_actions], if several entries give one command; None if keys are action numbers.

        An action that repeats the command of the last one continues it, regardless of their durations: the command
        is the key. Scans with different instruments do not continue one another.
        """
        first: dict[tuple[str, int | None], int] = {}
        keys = list(range(self.n_actions))
        for k in self._fixed:
            command = getattr(self.entries[k], "fsw_action", None)
            if command is not None and self.entries[k].n_actions == 1:
                same = command, getattr(self.entries[k], "variant", None)
                keys[self._starts[k]] = first.setdefault(same, self._starts[k])
        shared = keys != list(range(self.n_actions))
        return torch.tensor(keys, device=self._all_legal.device) if shared else None

    @property
    def is_table(self) -> bool:
        """Whether all commands are those of :meth:`table`, and no entry hears of them."""
        return not (self._deciding or self._beginning or self._ending or self.n_negative_actions)

    @property
    def hears_ends(self) -> bool:
        """Whether :meth:`end` does anything."""
        return bool(self._ending)

    @property
    def description(self) -> list[str]:
        """Names of all actions in order."""
        return [name for entry in self.entries for name in entry.names()]

    def title(self, action: Tensor) -> str:
        """Return the name of an action, a number without dimensions."""
        return self.description[int(action)] if action >= 0 else "a target by its index"

    def checked(self, action: Tensor, acts: Tensor | None) -> Tensor:
        """Return a copy of the actions [N] as int64, with 0 if they are ignored."""
        n, negative, action = self.n_actions, self.n_negative_actions, action.to(torch.int64, copy=True)
        action = action if acts is None else torch.where(acts, action, 0)
        low, high = torch.stack(torch.aminmax(action)).tolist()
        if negative:  # of some row: the entry need not ask the device again
            self.entries[self._takes_negative].by_index = low < 0
        if low < -negative or high >= n:
            row = int(torch.nonzero((action < -negative) | (action >= n))[0])
            names = ", ".join(f"{k}: {name}" for k, name in enumerate(self.description))
            more = f", and -1 to {-negative} for a target by its index" if negative else ""
            raise ValueError(f"action {int(action[row])} of {self.satellite.title(row)} is out of range; legal are {names}{more}")
        return action

    def declare(self, task: StateTable) -> None:
        """Declare the actions in progress in the table of tasks."""
        task.declare("action", 0, low=-self.n_negative_actions, high=self.n_actions - 1)

    def offers(self) -> tuple[Tensor, Tensor]:
        """Return the targets of all actions and when their windows open, [N, n_actions]; see :meth:`Action.offers`."""
        target = torch.full_like(self._all_legal, -1, dtype=torch.int64)
        opens = torch.full_like(target, torch.nan, dtype=torch.float64)
        for start, entry in zip(self._starts, self.entries, strict=True):
            part, offer = entry.target_actions, entry.offers()
            if part and offer is not None:
                columns = slice(start + part.start, start + part.stop)
                target[:, columns], opens[:, columns] = offer
        return target, opens

    def entry_of(self, action: int | Tensor) -> int:
        """Return the number of the entry to which an action belongs."""
        action = int(action)
        return self._takes_negative if action < 0 else max(k for k, start in enumerate(self._starts) if start <= action)

    def table(self) -> ActionTable:
        """Return the tables of all entries side by side; actions of entries without a table have infinite durations there."""
        draws = self.satellite.simulator.state.arguments.version
        if self._table is not None and self._table_draws == draws:
            return self._table
        tables = [self._checked_table(k) if k in self._fixed else self._open_table(k) for k in range(len(self.entries))]
        mode, reset, duration = (torch.cat(parts, -1) for parts in zip(*tables, strict=True))
        whole = ActionTable(mode, reset, duration.minimum(self._longest))
        self._table, self._table_draws = whole, draws  # a reset may draw other arguments that change modes
        return whole

    def _open_table(self, k: int) -> ActionTable:
        """Return a table of the k-th entry, for rows filled in by :meth:`decide`."""
        forever = self._longest.new_full((self.entries[k].n_actions,), torch.inf)
        mode = torch.zeros(len(self._all_legal), len(forever), dtype=torch.int64, device=forever.device)
        return ActionTable(mode, torch.zeros_like(forever, dtype=torch.bool), forever)

    def _checked_table(self, k: int) -> ActionTable:
        """Return the table of the k-th entry."""
        entry, table = self.entries[k], self.entries[k].table()
        if not isinstance(table, ActionTable):
            raise TypeError(f"{type(entry).__name__}.table() returns {table!r}; it must return an act.ActionTable")
        n = entry.n_actions
        wanted = ((len(self._all_legal), n), torch.int64), ((n,), torch.bool), ((n,), torch.float64)
        for field, value, (shape, dtype) in zip(ActionTable._fields, table, wanted, strict=True):
            check_tensor(f"{type(entry).__name__}.table().{field}", value, shape, dtype)
        if self._table is None and not bool((table.duration >= SHORTEST).all()):  # once: a wait for the device
            raise ValueError(
                f"{type(entry).__name__}.table().duration is {table.duration.tolist()}; it must be at least {SHORTEST} s"
            )
        if self._table is None or not is_of_package(type(entry)):
            everywhere = torch.ones_like(table.mode, dtype=torch.bool)
            check_modes(f"{type(entry).__name__}.table()", table.mode, everywhere, self.satellite.simulator.mode_names)
        return table

    def _rows_of(self, k: int, action: Tensor, among: Tensor) -> Tensor:
        """Return in which rows ``among`` some, [N] bool, a checked ``action`` [N] belongs to the k-th entry, [N] bool."""
        if len(self.entries) == 1:
            return among
        first = self._starts[k]
        mask = (action >= first) & (action < first + self.entries[k].n_actions)
        return (mask | (action < 0) if k == self._takes_negative else mask) & among

    def decide(self, action: Tensor, previous: Tensor, acts: Tensor) -> Decision:
        """Return the commands of ``action`` [N] after actions with the keys ``previous`` [N].

        Commands of rows outside ``acts`` [N] bool are undefined.
        """
        if len(self._deciding) == len(self.entries) == 1:
            return self._decided(0, acts, action, previous)
        column = action.clamp(min=0) if self.n_negative_actions else action
        key = action if self.keys is None else torch.where(action < 0, action, self.keys[column])
        decision = self.table().decision(column, key, previous)
        for k in self._deciding:
            part, mask = self._decided(k, acts, action, previous), self._rows_of(k, action, acts)
            self._commands[k] = part.command
            decision = _merged(mask, part, decision)
        return decision

    def _decided(self, k: int, acts: Tensor, action: Tensor, previous: Tensor) -> Decision:
        """Return the commands of the k-th entry, [N]; TypeError unless each is a tensor [N] of the right dtype."""
        entry, rows = self.entries[k], self._rows_of(k, action, acts)
        index = (action - self._starts[k]).clamp(0, entry.n_actions - 1)
        decision = entry.decide(index, rows, action, previous)
        check_decision(type(entry).__name__, decision, len(action))
        if is_of_package(type(entry)):
            return decision
        title = type(entry).__name__
        check_modes(f"{title}.decide(...)", decision.mode, rows, self.satellite.simulator.mode_names)
        mode = torch.where(rows, decision.mode, 0)
        return checked_durations(title, decision._replace(mode=mode), rows, self.satellite)

    def begin(self, action: Tensor, acts: Tensor, decision: Decision) -> None:
        """Notify entries that their actions, of ``action`` [N], have been commanded in the rows ``acts`` [N] bool."""
        for k in self._beginning:
            commands = decision if decision.command is not None else decision._replace(command=self._commands.get(k))
            self.entries[k].begin(self._rows_of(k, action, acts), commands)

    def end(self, action: Tensor, ended: Tensor, decision: Decision, event: Tensor) -> None:
        """Notify entries that their actions have ``ended`` [N] bool, by an ``event`` [N] bool or by their duration."""
        for k in self._ending:
            self.entries[k].end(self._rows_of(k, action, ended), decision, event)

    def mask(self) -> Tensor:
        """Return which actions are legal now, [N, n_actions] bool; a view, to be read only."""
        if not self._masking:
            return self._all_legal
        parts = []
        for start, (k, entry) in zip(self._starts, enumerate(self.entries), strict=True):
            part = self._all_legal[:, start : start + entry.n_actions]
            if k in self._masking:
                wanted, part = part, entry.mask()
                check_tensor(f"{type(entry).__name__}.mask()", part, wanted.shape, torch.bool)
            parts.append(part)
        return torch.cat(parts, -1)


def _merged(mask: Tensor, new: Decision, old: Decision) -> Decision:
    pairs = ((getattr(new, name), getattr(old, name)) for name in Decision._fields[: len(DTYPES)])
    return Decision(*(torch.where(mask, one, other) for one, other in pairs))


def _link(entry: Action, satellite: BoundSatellite) -> None:
    """Link an entry; raise if linking failed, or if its numbers and names of actions are inconsistent."""
    title = type(entry).__name__
    link_entry(entry, satellite)
    for name, low in (("n_actions", 1), ("n_negative_actions", 0)):
        number = getattr(entry, name)
        if isinstance(number, bool) or not isinstance(number, int) or number < low:
            raise ValueError(f"{title}.{name} is {number!r}; it must be an integer of at least {low}")
    names = entry.names()
    listed = isinstance(names, list | tuple) and all(isinstance(name, str) for name in names)
    if not listed or len(names) != entry.n_actions:
        raise ValueError(f"{title}.names() returns {names!r}; it must return n_actions={entry.n_actions} names")
