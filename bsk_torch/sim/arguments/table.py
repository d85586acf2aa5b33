"""Tables of the arguments that components declare, as users read them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from bsk_torch.rand import Distribution
from bsk_torch.sim.component import Component, UserArguments
from bsk_torch.sim.names import nearest

EMPTY: Mapping[str, object] = {}


class ArgumentTable(dict[str, Any]):
    """Default arguments by name, shown as a table with unit and meaning.

    Attributes:
        rows: The declared arguments by name.
        here: Values of an environment that differ from the defaults. They are shown first, and are no values of the dictionary.
    """

    def __init__(self, components: Iterable[Component], overrides: UserArguments = EMPTY, title: str = "sat_args") -> None:
        """Collect the arguments of components, with ``overrides`` of defaults; KeyError, with ``title``, for unknown ones."""
        self.rows, self.here = {arg.name: arg for component in components for arg in component.args}, dict[str, object]()
        super().__init__({name: arg.default for name, arg in self.rows.items()})
        for name, value in overrides.items():
            if name not in self:
                raise KeyError(f"{title}[{name!r}] is unknown; {nearest(name, self)}")
            self[name] = value

    def beside(self, values: Mapping[str, object]) -> ArgumentTable:
        """Show next to the defaults the ``values`` of an environment that differ from them; return this table."""
        listed = {name: values[name] for name in self if name in values}
        self.here = {name: value for name, value in listed.items() if short(value) != short(self[name])}
        return self

    def cells(self) -> list[dict[str, str]]:
        """Return a row for each argument, those of :attr:`here` first; ``default`` is empty if it is the value ``here``."""
        rows = []
        for arg in sorted(self.rows.values(), key=lambda arg: arg.name not in self.here):
            value, default = self.here.get(arg.name, self[arg.name]), self[arg.name] if arg.name in self.here else ""
            cells = {"argument": arg.name, "here": short(value), "default": short(default), "unit": arg.unit, "meaning": arg.doc}
            rows.append(cells)
        return rows

    def __repr__(self) -> str:
        lines = self.cells()
        if self.here:
            lines.insert(0, {name: name for name in lines[0]})
        else:
            lines = [{name: cell for name, cell in line.items() if name != "default"} for line in lines]
        widths = {name: max(len(line[name]) for line in lines) for name in lines[0]} if lines else {}
        return "\n".join("  ".join(cell.ljust(widths[name]) for name, cell in line.items()).rstrip() for line in lines)


def short(value: object) -> str:
    """Return a value as tables show it: ground stations by their number, distributions without what is None."""
    if isinstance(value, tuple) and value and isinstance(value[0], dict):
        return f"{len(value)} stations"
    if isinstance(value, Distribution) and is_dataclass(value):
        settings = {field.name: getattr(value, field.name) for field in fields(value) if field.repr}
        plain = ("low", "high", "mean", "std")  # of Uniform and Normal, whose first arguments are clear without names
        parts = (f"{'' if name in plain else f'{name}='}{short(part)}" for name, part in settings.items() if part is not None)
        return f"{type(value).__name__}({', '.join(parts)})"
    if isinstance(value, tuple):
        return f"({', '.join(map(short, value))})"
    return f"{value:g}" if isinstance(value, float) else str(value)
