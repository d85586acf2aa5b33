"""Intermediate form of kernels: values, regions, and the statements of a loop.

A :class:`Program` is a graph of values in static single assignment form. Each :class:`Value` stands for one number of every row,
and has an operation, arguments, a dtype and a lifetime. A :class:`Region` holds the values computed only where a mask
holds. Equal operations are stored once, and known results are folded (:func:`fold`) when a value is made.

:mod:`bsk_torch.codegen.trace` makes programs of tensor code, :mod:`bsk_torch.codegen.passes` turns a traced :class:`Loop` into
the statements of a :class:`LoweredLoop`, and :mod:`bsk_torch.codegen.cpp` prints that.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import torch

DTYPES = (torch.float64, torch.float32, torch.bool)
"""Types of the numbers that a kernel computes with."""

CALL, TICK = 0, -1
"""Lifetimes: a value holds for the whole call, or for one tick. A positive number t: as long as one record of track t."""

LIFETIMES = {"state": TICK, "schedule": TICK, "ticks_now": TICK, "tau": TICK, "own": CALL, "shared": CALL, "flag": CALL}
"""Lifetimes of inputs by their source; those from the source ``track`` hold for one record of their track."""


class UntraceableError(TypeError):
    """Tensor code does something that cannot be computed element by element."""


def shortest(lifetimes: Iterable[int]) -> int:
    """Return the lifetime of a value whose arguments have these ``lifetimes``; that of values from several tracks is one tick."""
    tracks = set(lifetimes) - {CALL}
    return CALL if not tracks else tracks.pop() if len(tracks) == 1 else TICK


def require_dtype(dtype: torch.dtype) -> torch.dtype:
    """Return ``dtype``; raise UntraceableError if kernels have no numbers of this type."""
    if dtype not in DTYPES:
        raise UntraceableError(f"a kernel has no numbers of type {dtype}, only {', '.join(map(str, DTYPES))}")
    return dtype


# -- the graph ---------------------------------------------------------------------------------------------------------------


@dataclass(eq=False, repr=False)
class Value:
    """One number of every row, made by a :class:`Program`.

    ``op`` is ``constant`` (``attr`` is the number), ``input`` (``attr`` is its source and its index there), ``merge`` (``args``
    are the mask, the value computed in a region and the one that holds elsewhere) or the name of an operation on ``args``.
    """

    program: Program[Any]
    op: str
    args: tuple[Value, ...]
    attr: Any
    dtype: torch.dtype
    lifetime: int
    region: Region  # the one that computes the value
    index: int  # its number in the program

    @property
    def number(self) -> Any:
        """The number of a constant, else None."""
        return self.attr if self.op == "constant" else None

    def is_input(self, *attr: object) -> bool:
        """Return whether this is an input from a source, or the input of that index."""
        return self.op == "input" and self.attr[: len(attr)] == attr


@dataclass(eq=False, repr=False)
class Region:
    """Values computed under a condition: where ``mask`` holds in some row of a block."""

    mask: Value | None  # None, as the parent, for the root of a program
    parent: Region | None
    statements: list[Value | Region] = field(default_factory=list)  # its values and the regions inside it, in their order
    values: dict[tuple[object, ...], Value] = field(default_factory=dict)
    merges: list[Value] = field(default_factory=list)  # values through which its results leave it

    def chain(self) -> Iterator[Region]:
        """This region and those around it, from the inside out."""
        region: Region | None = self
        while region is not None:
            yield region
            region = region.parent

    def require_visible(self, values: Iterable[Value]) -> None:
        """Raise UntraceableError for values that may not have been computed when this region runs."""
        inner = {value.region for value in values if value.region is not self and value.region.parent is not None}
        if inner and not inner <= set(self.chain()):
            raise UntraceableError("what is computed only where a mask holds must leave as a result of only()")


V = TypeVar("V", bound=Value)


class Program(Generic[V]):
    """A graph of values under construction; ``region`` is the one that new values join."""

    value_type: type[V] = Value  # type: ignore[assignment]

    def __init__(self) -> None:
        self.root = Region(None, None)
        self.region = self.root
        self.count = 0

    def constant(self, number: float | bool, dtype: torch.dtype) -> V:
        """Return a value that is the same everywhere, rounded to its type."""
        if dtype == torch.bool:
            number = bool(number)
        else:
            number = ctypes.c_float(number).value if dtype == torch.float32 else float(number)
        return self._intern("constant", (), number, dtype, CALL)

    def input(self, source: str, *index: int, dtype: torch.dtype = torch.float64) -> V:
        """Return a value that the kernel loads.

        Args:
            source: ``state``, ``own``, ``shared``, ``flag`` and ``schedule``: rows of the arguments of
                :meth:`bsk_torch.codegen.kernel.Kernel.__call__`; ``track``: numbers of a record; ``tau``: seconds since the
                record of a track; ``ticks_now``: number of this tick.
            *index: Number of the row; of the track (from 1 on) and of the number in its record; or of the track.
            dtype: Type as which it is loaded.

        Raises:
            ValueError: For an unknown source.
        """
        if source != "track" and source not in LIFETIMES:
            raise ValueError(f"source={source!r} must be one of {['track', *LIFETIMES]}")
        lifetime = index[0] if source == "track" else LIFETIMES[source]
        return self._intern("input", (), (source, *index), dtype, lifetime)

    def operation(self, op: str, args: tuple[Value, ...], dtype: torch.dtype) -> V:
        """Return the value ``op(args)``: its known result, an existing equal value, or a new one."""
        folded = fold(self, op, args, dtype)
        if folded is not None:
            return folded
        return self._intern(op, args, None, dtype, shortest([arg.lifetime for arg in args]))

    def cast(self, value: V, dtype: torch.dtype) -> V:
        """Return the same number as another type."""
        return value if value.dtype == dtype else self.operation("cast", (value,), dtype)

    @contextlib.contextmanager
    def branch(self, mask: Value) -> Iterator[Region]:
        """Open a region that runs where ``mask`` holds in some row; values made in this context join it."""
        outer, self.region = self.region, Region(mask, self.region)
        try:
            yield self.region
        finally:
            self.region = outer

    def merge(self, region: Region, pairs: Sequence[tuple[V, V]]) -> list[V]:
        """Add a finished region; returns the first of each pair, computed in it, where its mask holds, else the second."""
        if region.mask is None:
            raise ValueError("the root of a program has no mask and cannot be merged into another region")
        region.require_visible(inner for inner, _ in pairs)
        self.region.require_visible((region.mask, *(other for _, other in pairs)))
        self.region.statements.append(region)
        merged = []
        for inner, other in pairs:
            if inner is not other:
                inner = self._new("merge", (region.mask, inner, other), None, inner.dtype, TICK, self.region)
                region.merges.append(inner)
            merged.append(inner)
        return merged

    def _intern(self, op: str, args: tuple[Value, ...], attr: object, dtype: torch.dtype, lifetime: int) -> V:
        """Return an equal value that is visible here, or a new one; values that outlive a tick are outside of all conditions."""
        # repr distinguishes 0.0 from -0.0
        key = (op, tuple([arg.index for arg in args]), repr(attr), dtype)
        home = self.region if lifetime == TICK and op != "input" else self.root
        home.require_visible(args)
        for scope in home.chain():
            if key in scope.values:
                return scope.values[key]  # type: ignore[return-value]
        value = self._new(op, args, attr, dtype, lifetime, home)
        home.values[key] = value
        return value

    def _new(self, op: str, args: tuple[Value, ...], attr: object, dtype: torch.dtype, lifetime: int, region: Region) -> V:
        value = self.value_type(self, op, args, attr, dtype, lifetime, region, self.count)
        self.count += 1
        region.statements.append(value)
        return value


# -- results known in advance --------------------------------------------------------------------------------------------------


def _divide(a: float, b: float) -> float:
    if b != 0.0:
        return a / b
    return math.nan if a == 0.0 or math.isnan(a) else math.copysign(math.inf, a) * math.copysign(1.0, b)


ARITHMETIC: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": _divide,
    "neg": operator.neg,
    "sqrt": lambda x: math.sqrt(x) if x >= 0.0 else math.nan,
    "abs": abs,
    "minimum": min,
    "maximum": max,
    **{name: getattr(operator, name) for name in ("gt", "lt", "ge", "le", "eq", "ne")},
    "and": operator.and_,
    "or": operator.or_,
    "xor": operator.xor,
    "not": operator.not_,
    "cast": lambda x: x,
}
"""Operations whose results on constants equal those of a kernel."""

NEUTRAL = {"add": 0.0, "sub": 0.0, "mul": 1.0, "div": 1.0}
"""Right sides that change nothing but the sign of zero."""


def fold(program: Program[Any], op: str, args: tuple[Value, ...], dtype: torch.dtype) -> Any:
    """Return the value that ``op(args)`` equals, or None if it must be computed.

    Only what no rounding and no special number could contradict is folded: ``x * 0`` stays, because x may be NaN; ``x + 0`` does
    not, though it loses the sign of a negative zero.
    """
    numbers = [arg.number for arg in args]
    if op in ARITHMETIC and None not in numbers:
        return program.constant(ARITHMETIC[op](*numbers), dtype)
    if op == "where":
        return args[1] if numbers[0] is True or args[1] is args[2] else args[2] if numbers[0] is False else None
    if op == "cast":
        return _fold_cast(program, args[0], dtype)
    if op == "neg" and args[0].op == "neg":
        return args[0].args[0]
    if op in NEUTRAL and numbers[1] == NEUTRAL[op]:
        return args[0]
    if op in ("add", "mul") and numbers[0] == NEUTRAL[op]:
        return args[1]
    return None


def _fold_cast(program: Program[Any], value: Value, dtype: torch.dtype) -> object:
    """Fold the cast of a mask that was cast before, or of a choice between constants: float64 needs no float32 in between."""
    if value.op == "cast" and value.args[0].dtype == torch.bool:
        return program.cast(value.args[0], dtype)
    if value.op == "where" and None not in (value.args[1].number, value.args[2].number):
        mask, *choices = value.args
        return program.operation("where", (mask, *(program.cast(choice, dtype) for choice in choices)), dtype)
    return None


# -- loops -------------------------------------------------------------------------------------------------------------------


class TrackShape(Protocol):
    """A table [N, records, width] of which a tick reads a few neighboring records."""

    @property
    def spacing(self) -> float:
        """Seconds between records."""

    @property
    def width(self) -> int:
        """Numbers of a record."""

    @property
    def count(self) -> int:
        """Records that a tick reads."""

    @property
    def before(self) -> int:
        """Number of them that lie before the last one that has passed."""


CLOCKS = ("ticks", "start", "schedule")
"""Named clocks: the time of this tick, that of the tick at which the call starts, and the first number of the schedule."""


@dataclass(frozen=True)
class Loop:
    """A traced tick, to be repeated."""

    program: Program[Any]  # graph of all values
    outputs: Sequence[Value]  # state at the end of a tick, by rows
    tracks: Sequence[TrackShape] = ()  # tables that a tick reads, numbered from 1 on
    written: Sequence[Value] = ()  # values recorded in every tick
    clock: str | Value = "ticks"  # time at which tracks are looked up: one of CLOCKS, or a row of the state, s
    schedule: int = 0  # numbers of the schedule for each tick
    stop: Value | None = None  # mask of the rows that end with this tick

    def __post_init__(self) -> None:
        if not isinstance(self.clock, Value) and self.clock not in CLOCKS:
            raise ValueError(f"clock={self.clock!r} must be one of {list(CLOCKS)} or a row of the state")

    @property
    def records(self) -> list[int]:
        """Least number of records of each track."""
        return [track.count for track in self.tracks]

    @property
    def writes(self) -> int:
        """Numbers written in each tick."""
        return len(self.written)

    @property
    def results(self) -> list[Value]:
        """Values for whose sake all others are computed."""
        return [*self.outputs, *self.written, *([] if self.stop is None else [self.stop])]


class Variable(NamedTuple):
    """A location written more than once, or under a name other than that of a value."""

    name: str
    dtype: torch.dtype


class Define(NamedTuple):
    """Compute a value where it stands."""

    value: Value


class Declare(NamedTuple):
    """Declare a value to compute later, which may change; it holds ``initial`` until then."""

    value: Value
    initial: Value | None = None


class Update(NamedTuple):
    """Compute a declared value."""

    value: Value


class Store(NamedTuple):
    """Convert a value to the type of a variable and keep it there; with ``declare``, the variable is made, and is constant."""

    target: Variable
    value: Value | Variable
    declare: bool = False


class Branch(NamedTuple):
    """Statements that run where ``mask`` holds in some row of a block."""

    mask: Value
    body: tuple[Statement, ...]


Statement = Define | Declare | Update | Store | Branch


class Record(NamedTuple):
    """Values that hold as long as a record of a track.

    When another record is looked up, ``inputs`` are loaded and ``computed`` follow from them; ``outputs`` outlive the look-up and
    ``local`` are needed only there.
    """

    shape: TrackShape
    inputs: tuple[Value, ...]
    computed: tuple[Value, ...]
    outputs: tuple[Value, ...]
    local: tuple[Value, ...] = ()


class Carried(NamedTuple):
    """Variables that outlive a tick of blocks that run in lockstep.

    ``common`` are equal in all rows. The others belong to a block; ``initial`` are those known before its first tick.
    """

    common: tuple[Value | Variable, ...]
    initial: tuple[Value | Variable, ...]
    block: tuple[Value | Variable, ...]


@dataclass(frozen=True)
class LoweredLoop:
    """A loop as statements, ready for printing; ``stop``, ``clock`` and ``schedule`` are those of :class:`Loop`."""

    mixed: bool  # whether some value is float32: a vector then holds as many rows as floats fit a register
    loads: tuple[Value, ...]  # inputs read when a block of rows begins
    constants: tuple[Value, ...]  # values computed once in a call
    records: tuple[Record, ...]  # values that follow from a record, of each track
    body: tuple[Statement, ...]  # statements of a tick
    stop: Value | None
    written: tuple[Value | Variable, ...]  # values recorded in every tick
    results: tuple[tuple[int, Value | Variable], ...]  # rows of the state that a tick changes, and where they are at the end
    commit: tuple[Statement, ...]  # statements that pass the new state on to the next tick
    clock: str | Value
    schedule: int
    carried: Carried | None = None  # variables of a block between two ticks, where groups of rows run in lockstep
