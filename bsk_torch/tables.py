"""Tables that fit the terminal."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bsk_torch._text import visible

WIDE = 240
"""Characters in a line of files and pipes, which have no width."""


def line_width() -> int:
    """Return the characters that a line of results may have: those of the terminal, or of the variable COLUMNS."""
    console = Console()
    return console.width if console.is_terminal or os.environ.get("COLUMNS") else WIDE


def print_table(
    rows: Sequence[Mapping[str, str]],
    title: str = "",
    expendable: Sequence[str] = (),
    left: Sequence[str] = (),
    whole: Sequence[str] = (),
) -> None:
    """Print a table that fits the terminal.

    Args:
        rows: Cells by column, in the order of the first row that has them. Columns without any text are left out.
        title: Headline.
        expendable: Columns to leave out where the terminal is too narrow, the first one first. A line below names them.
        left: Columns with left-aligned text.
        whole: Columns whose cells are never broken.
    """
    console = Console(width=line_width())
    columns = list(dict.fromkeys(name for row in rows for name, cell in row.items() if cell))
    order = [name for name in expendable if name in columns]
    dropped: list[str] = []
    unbroken = console.options.update(max_width=10 * WIDE)
    while order and console.measure(_table(rows, columns, title, left, whole), options=unbroken).maximum > console.width:
        dropped.append(order.pop(0))
        columns.remove(dropped[-1])
    console.print(_table(rows, columns, title, left, whole))
    if dropped:
        console.print(_cell(f"not shown in {console.width} columns: {', '.join(dropped)}"))


def _table(
    rows: Sequence[Mapping[str, str]], columns: Sequence[str], title: str, left: Sequence[str], whole: Sequence[str]
) -> Table:
    table = Table(title=_cell(title) if title else None, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for name in columns:
        table.add_column(_cell(name), justify="left" if name in left else "right", overflow="fold", no_wrap=name in whole)
    for row in rows:
        table.add_row(*(_cell(row.get(name, "")) for name in columns))
    return table


def _cell(text: str) -> Text:
    """Return text without markup and hidden characters; line feeds stay, which the table's lines surround."""
    return Text(visible(text))
