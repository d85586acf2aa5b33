"""Passes: from the graph of a traced tick to the statements of a loop.

:func:`lower` is the whole way: dead code is left out (:func:`live_values`), values are put where they are computed as rarely as
their lifetime allows, regions become branches (:func:`statements`), and the new state is passed on to the next tick, at its end
or, for groups of rows that run in lockstep, in its course (:func:`schedule_stores`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import torch

from bsk_torch.codegen.ir import (
    CALL,
    TICK,
    Branch,
    Carried,
    Declare,
    Define,
    Loop,
    LoweredLoop,
    Record,
    Region,
    Statement,
    Store,
    Update,
    Value,
    Variable,
)

LOADED = ("state", "own", "flag", "shared")
"""Sources of the inputs read when a block of rows begins, in the order in which they are."""

CLOCK_VARIABLES = ("start", "base", "from", "until")
"""Variables of each track: its start, the time of its record, and between which times the record is the one to read."""


def lower(loop: Loop, lockstep: bool = False) -> LoweredLoop:
    """Turn a loop into statements.

    Args:
        loop: A traced tick; the rows of a loop in lockstep need a stop, and write rows of the new state only.
        lockstep: Whether groups of rows end together, in the tick in which the first of them stops.
    """
    live = live_values(loop)
    changes = changed(loop.outputs)
    scheduled = [Define(value) for value in live if value.is_input("schedule")]
    body: list[Statement] = [*scheduled, *statements(loop.program.root, set(live))]
    records = [_record(t, shape, live) for t, shape in enumerate(loop.tracks, 1)]
    results: list[tuple[int, Value | Variable]] = list(changes)
    carried, commit = None, _commit(live, changes)
    written: tuple[Value | Variable, ...] = tuple(loop.written)
    if lockstep:
        if not set(loop.written) <= set(loop.outputs):  # other values do not outlast a tick
            raise ValueError("a kernel whose rows run in lockstep writes rows of the new state only")
        outliving = read_elsewhere(live, loop.results)
        records = [_split(record, outliving) for record in records]
        copies, stores, variables = carried_state(live, changes)
        body, commit = schedule_stores([*copies, *body], stores), []
        results = list(zip((k for k, _ in changes), variables, strict=True))
        carried = _carried(live, outliving, records, variables)
        replacements = {value: variable for (_, value), variable in zip(changes, variables, strict=True)}
        written = tuple(replacements.get(value, value) for value in loop.written)
    inputs = [value for value in live if value.op == "input"]
    return LoweredLoop(
        mixed=any(value.dtype == torch.float32 for value in live),
        loads=tuple(value for source in LOADED for value in inputs if value.is_input(source)),
        constants=tuple(value for value in live if value.lifetime == CALL and value.op not in ("input", "constant")),
        records=tuple(records),
        body=tuple(body),
        stop=loop.stop,
        written=written,
        results=tuple(results),
        commit=tuple(commit),
        clock=loop.clock,
        schedule=loop.schedule,
        carried=carried,
    )


# -- dead code ---------------------------------------------------------------------------------------------------------------


def live_values(loop: Loop) -> list[Value]:
    """Values on which the results of a loop depend, in the order in which they are computed.

    UntraceableError for a result computed under a condition only.
    """
    loop.program.root.require_visible(loop.results)
    live: set[Value] = set()
    pending = [*loop.results, *([loop.clock] if isinstance(loop.clock, Value) else [])]
    while pending:
        value = pending.pop()
        if value not in live:
            live.add(value)
            pending += value.args
    return [value for value in _values(loop.program.root) if value in live]


def _values(region: Region) -> Iterator[Value]:
    for item in region.statements:
        if isinstance(item, Region):
            yield from _values(item)
        else:
            yield item


# -- regions -----------------------------------------------------------------------------------------------------------------


def statements(region: Region, live: set[Value]) -> list[Statement]:
    """Return statements for the live values of a region that hold for one tick; others are computed elsewhere."""
    body: list[Statement] = []
    for item in region.statements:
        if isinstance(item, Region):
            body += _branch(item, live)
        elif item in live and item.lifetime == TICK and item.op not in ("input", "constant", "merge"):
            body.append(Define(item))
    return body


def _branch(region: Region, live: set[Value]) -> list[Statement]:
    """Return a region as a branch, before which its results get their values elsewhere; none if no result is live."""
    merges = [value for value in region.merges if value in live]
    if not merges or region.mask is None:
        return []
    body = (*statements(region, live), *(Update(value) for value in merges))
    return [*(Declare(value, value.args[2]) for value in merges), Branch(region.mask, body)]


# -- lifetimes ---------------------------------------------------------------------------------------------------------------


def _record(t: int, shape: object, live: Iterable[Value]) -> Record:
    """Return the values that hold as long as a record of track t; all are kept."""
    values = tuple(value for value in live if value.lifetime == t and value.op != "constant")
    inputs = tuple(value for value in values if value.op == "input")
    return Record(shape, inputs, tuple(value for value in values if value.op != "input"), values)  # type: ignore[arg-type]


def read_elsewhere(live: Iterable[Value], results: Iterable[Value]) -> set[Value]:
    """Return the results and the arguments of values of another lifetime, which outlast the tick that computed them."""
    return {arg for value in live for arg in value.args if arg.lifetime != value.lifetime} | set(results)


def uniform_values(live: Iterable[Value]) -> set[Value]:
    """Return the values that are equal in all rows; arguments stand before the values that depend on them."""
    uniform: set[Value] = set()
    for value in live:
        if value.op == "constant" or value.is_input("shared") or (value.args and all(arg in uniform for arg in value.args)):
            uniform.add(value)
    return uniform


# -- state -------------------------------------------------------------------------------------------------------------------


def changed(outputs: Sequence[Value]) -> list[tuple[int, Value]]:
    """Return the rows of the state that a tick changes, and their new values."""
    return [(k, value) for k, value in enumerate(outputs) if not value.is_input("state", k)]


def _read_rows(live: Iterable[Value]) -> dict[int, Variable]:
    return {value.attr[1]: _row("state", value.attr[1], value) for value in live if value.is_input("state")}


def _row(name: str, k: int, like: Value) -> Variable:
    return Variable(f"{name}_{k}", like.dtype)


def _commit(live: Iterable[Value], changes: Sequence[tuple[int, Value]]) -> list[Statement]:
    """Pass the new state on at the end of a tick: copies first, because rows may trade places."""
    rows = _read_rows(live)
    moved = [(Variable(f"new_{k}", rows[k].dtype), rows[k], value) for k, value in changes if k in rows]
    return [*(Store(copy, value, declare=True) for copy, _, value in moved), *(Store(row, copy) for copy, row, _ in moved)]


def carried_state(live: Iterable[Value], changes: Sequence[tuple[int, Value]]) -> tuple[list[Store], list[Store], list[Variable]]:
    """Return the new state of rows in lockstep, kept for the next tick or the end.

    ``state_k`` is what the next tick reads of row k. Where no tick reads just the new value, because it reads nothing or another
    type, ``out_k`` keeps it for the end.

    Returns:
        Copies that a tick begins with, of rows that become the new value of other rows; stores of the new values; and where
        each of them is at the end.
    """
    rows = _read_rows(live)
    copies: list[Store] = []
    stores: list[Store] = []
    variables: list[Variable] = []
    for k, value in changes:
        new: Value | Variable = value
        if value.is_input("state"):
            new = _row("new", k, value)
            copies.append(Store(new, value, declare=True))
        exact = k in rows and rows[k].dtype == value.dtype
        variables.append(rows[k] if exact else _row("out", k, value))
        stores += [] if exact else [Store(variables[-1], new)]
        stores += [Store(rows[k], new)] if k in rows else []
    return copies, stores, variables


def schedule_stores(body: Sequence[Statement], stores: Iterable[Store]) -> list[Statement]:
    """Put each store behind the last statement that computes its value or reads what it overwrites.

    A tick has more values than there are registers. A value stored at once frees its register; one stored at the
    end of the tick would be spilled in the meantime and read again. Stores are never put into a branch.
    """
    last_read: dict[str, int] = {}
    computed: dict[Value | Variable, int] = {}
    for i, statement in enumerate(body):
        last_read |= {f"state_{value.attr[1]}": i for value in reads(statement) if value.is_input("state")}
        computed |= dict.fromkeys(writes(statement), i)
    after: list[list[Statement]] = [[] for _ in range(len(body) + 1)]
    for store in stores:
        after[max(last_read.get(store.target.name, -1), computed.get(store.value, -1)) + 1].append(store)
    return [*after[0], *(each for i, statement in enumerate(body) for each in (statement, *after[i + 1]))]


def reads(statement: Statement) -> Iterator[Value]:
    """Return the values that a statement reads."""
    if isinstance(statement, Define | Update):
        yield from statement.value.args
    elif isinstance(statement, Declare):
        yield from () if statement.initial is None else (statement.initial,)
    elif isinstance(statement, Store):
        yield from (statement.value,) if isinstance(statement.value, Value) else ()
    else:
        yield statement.mask
        for inner in statement.body:
            yield from reads(inner)


def writes(statement: Statement) -> Iterator[Value | Variable]:
    """Values and variables that a statement sets."""
    if isinstance(statement, Branch):
        for inner in statement.body:
            yield from writes(inner)
    else:
        yield statement.target if isinstance(statement, Store) else statement.value


# -- lockstep ----------------------------------------------------------------------------------------------------------------


def _split(record: Record, outliving: set[Value]) -> Record:
    """Return a record of which only the values are kept that ticks read."""
    outputs = tuple(value for value in record.outputs if value in outliving)
    return record._replace(outputs=outputs, local=tuple(value for value in record.outputs if value not in outliving))


def _carried(live: Sequence[Value], outliving: set[Value], records: Sequence[Record], variables: Sequence[Variable]) -> Carried:
    """Return the variables that a block keeps while other blocks of its tile run the same tick."""
    uniform = uniform_values(live)
    constants = [v for v in live if v.lifetime == CALL and v.op != "constant" and v in outliving]
    initial: tuple[Value | Variable, ...] = (
        Variable("ticks_start", torch.float64),
        *(value for value in live if value.is_input("state")),
        *(value for value in constants if value not in uniform),
        *(Variable(f"{name}_{t}", torch.float64) for t in range(1, len(records) + 1) for name in CLOCK_VARIABLES),
    )
    results = (variable for variable in variables if variable.name.startswith("out_"))
    return Carried(
        common=tuple(value for value in constants if value in uniform),
        initial=initial,
        block=(*initial, *(value for record in records for value in record.outputs), *results),
    )
