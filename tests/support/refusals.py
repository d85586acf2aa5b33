"""Tables of wrong calls: what each must raise, and the names and values that its message must contain.

A table pins neither the wording of a message nor its order, so that messages are free to improve.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple


class Refusal(NamedTuple):
    """A wrong call, the exception that it must raise, and what the exception's message must name."""

    call: Callable[[], object]
    error: type[BaseException] | tuple[type[BaseException], ...]
    names: tuple[str, ...]


def refusal(call: Callable[[], object], error: type[BaseException] | tuple[type[BaseException], ...], *names: object) -> Refusal:
    """A row of a table; ``names`` are the argument, the value and the allowed values, as text or as what prints so."""
    return Refusal(call, error, tuple(str(name) for name in names))


def check_refusals(*table: Refusal | Iterable[Refusal]) -> None:
    """Make every call of some rows, or tables of rows; fails once, with a line for each that does not raise what it must."""
    rows = [row for part in table for row in ([part] if isinstance(part, Refusal) else part)]
    assert rows, "a table without rows checks nothing"
    failures = [f"{_place(row.call)}: {fault}" for row in rows if (fault := _fault(row))]
    assert not failures, "\n".join(failures)


def _place(call: Callable[[], object]) -> str:
    """Line of a call, with the values that its row of a loop has bound."""
    return f"line {call.__code__.co_firstlineno}{f' {call.__defaults__!r:.200}' if call.__defaults__ else ''}"


def _fault(row: Refusal) -> str | None:
    """What is wrong with the result of a call, or None."""
    try:
        result = row.call()
    except row.error as error:
        missing = [name for name in row.names if name not in str(error)]
        return f"the message does not name {', '.join(missing)}: {error}" if missing else None
    except Exception as error:
        return f"raises {type(error).__name__}: {error}"
    return f"raises nothing and returns {result!r:.200}"
