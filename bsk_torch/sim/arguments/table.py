"""Tables of the arguments that components declare, as users read them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from bsk_torch.sim.component import Component
from bsk_torch.sim.names import nearest

EMPTY: Mapping[str, Any] = {}


class ArgumentTable(dict[str, Any]):
    """Default arguments by name, shown as a table with unit and meaning."""

    def __init__(self, components: Iterable[Component], overrides: Mapping[str, Any] = EMPTY, title: str = "sat_args") -> None:
        """Collect the arguments of ``components``, with the values of ``overrides`` in place of their defaults.

        Raises:
            KeyError: For an override that is not an argument; ``title`` is the name of the dictionary in the message.
        """
        self.rows = {arg.name: arg for component in components for arg in component.args}
        super().__init__({name: arg.default for name, arg in self.rows.items()})
        for name, value in overrides.items():
            if name not in self:
                raise KeyError(f"{title}[{name!r}] is unknown; {nearest(name, self)}")
            self[name] = value

    def __repr__(self) -> str:
        """Return one line for each argument."""
        lines = [(arg.name, short(self[arg.name]), arg.unit, arg.doc) for arg in self.rows.values()]
        widths = [max((len(line[k]) for line in lines), default=0) for k in range(3)]
        return "\n".join("  ".join((*(text.ljust(w) for text, w in zip(line, widths, strict=False)), line[3])) for line in lines)


def short(value: Any) -> str:
    """Return a value as tables show it: ground stations by their number."""
    if isinstance(value, tuple) and value and isinstance(value[0], dict):
        return f"{len(value)} stations"
    return f"{value:g}" if isinstance(value, float) else str(value)
