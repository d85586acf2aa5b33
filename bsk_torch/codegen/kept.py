"""Compiled functions that a process keeps, so that what is built again is not traced again.

Tracing and printing a tick takes longer than all else of building an environment. Only functions of the package are kept: those
of users may read globals that change between two environments, such as a constant in a cell of a notebook.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from types import FunctionType
from typing import Generic, TypeVar

PACKAGE = __name__.partition(".")[0]

Value = TypeVar("Value")


class Kept(Generic[Value]):
    """The most recent values, by key."""

    def __init__(self, most: int) -> None:
        self.most = most
        self._values: dict[Hashable, Value] = {}

    def get(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return the value of a key, which ``make`` returns the first time."""
        value = self._values.pop(key) if key in self._values else make()
        self._values[key] = value  # at the end: the first is the one that has not been used for longest
        while len(self._values) > self.most:
            del self._values[next(iter(self._values))]
        return value


def of_package(functions: Iterable[Callable[..., object]]) -> bool:
    """Return whether all functions, and those that they enclose, are the package's: what they compute cannot change."""
    for function in functions:
        if not isinstance(function, FunctionType) or function.__module__.partition(".")[0] != PACKAGE:
            return False
        if not of_package(cell.cell_contents for cell in function.__closure__ or () if callable(cell.cell_contents)):
            return False
    return True
