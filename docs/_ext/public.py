"""The public names of bsk_torch: what ``__all__`` of the modules in ``docs/api/modules.txt`` lists."""

from __future__ import annotations

import ast
import importlib
import inspect
import itertools
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

FIELD = "Alias for field number"
"""Beginning of what NamedTuple says of its fields, which the docstring of the class describes."""

TABLE = Path(__file__).parents[1] / "api" / "modules.txt"


@dataclass(frozen=True)
class Name:
    """A public name: the module that has its page, and what it is."""

    module: str
    name: str
    value: Any

    @property
    def full(self) -> str:
        """Name with its module."""
        return f"{self.module}.{self.name}"

    @property
    def kind(self) -> str:
        """``module``, ``class``, ``function`` or ``data``."""
        if inspect.ismodule(self.value):
            return "module"
        if inspect.isclass(self.value):
            return "class"
        return "function" if inspect.isroutine(self.value) else "data"

    @property
    def documentation(self) -> str:
        """Docstring; that of data is the string after its assignment, in the module that has one."""
        if self.kind != "data":
            return inspect.getdoc(self.value) or ""
        found = (_after_assignment(module, self) for module in list(sys.modules.values()))
        return next(filter(None, found), "")

    @property
    def members(self) -> list[str]:
        """Public attributes that a class defines itself, with their own docstrings."""
        found = []
        for name, value in vars(self.value).items():
            function = value.fget if isinstance(value, property) else getattr(value, "__func__", value)
            if not name.startswith("_") and (inspect.isroutine(function) or hasattr(type(value), "__get__")):
                text = inspect.getdoc(value) or ""
                found += [name] if text and not text.startswith(FIELD) else []
        return found


@dataclass(frozen=True)
class Module:
    """A public module: the names with a page here, and those that have theirs under another module."""

    name: str
    own: list[Name] = field(default_factory=list)
    others: list[Name] = field(default_factory=list)

    @property
    def summary(self) -> str:
        """First sentence of its docstring."""
        return (inspect.getdoc(importlib.import_module(self.name)) or "").partition("\n")[0]

    def of(self, kind: str) -> list[Name]:
        """Own names of a kind."""
        return [name for name in self.own if name.kind == kind]


@cache
def _statements(module: ModuleType) -> list[ast.stmt]:
    return ast.parse(inspect.getsource(module)).body


def _after_assignment(module: ModuleType, name: Name) -> str:
    """Return the string after the assignment of a name in a module of the package, or nothing."""
    if not (getattr(module, "__name__", "").startswith("bsk_torch") and vars(module).get(name.name, module) is name.value):
        return ""
    body = _statements(module)
    for statement, following in itertools.pairwise(body):
        targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
        if any(isinstance(target, ast.Name) and target.id == name.name for target in targets):
            text = following.value if isinstance(following, ast.Expr) else None
            return inspect.cleandoc(text.value) if isinstance(text, ast.Constant) and isinstance(text.value, str) else ""
    return ""


def sections(table: Path = TABLE) -> dict[str, list[Module]]:
    """Return the modules by section, as ``docs/api/modules.txt`` has them."""
    found: dict[str, list[Module]] = {}
    first: dict[tuple[str, int], Name] = {}
    for line in (line.strip() for line in table.read_text().splitlines()):
        if line.startswith("["):
            found[line.strip("[]")] = []
        elif line and not line.startswith("#"):
            found[list(found)[-1]].append(_read(line, first))
    return found


def modules() -> Iterator[Module]:
    """Yield all modules."""
    for group in sections().values():
        yield from group


def _read(module: str, first: dict[tuple[str, int], Name]) -> Module:
    loaded = importlib.import_module(module)
    entry = Module(module)
    for name in loaded.__all__:
        item = Name(module, name, getattr(loaded, name))
        before = first.setdefault((name, id(item.value)), item)
        (entry.own if before is item else entry.others).append(before)
    return entry
