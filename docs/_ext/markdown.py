"""Tables and blocks of Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table; a cell without anything is an error."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for row in rows:
        cells = [cell.replace("|", r"\|").replace("\n", " ").strip() for cell in row]
        if len(cells) != len(head) or not all(cells):
            raise ValueError(f"empty cells, or not as many as columns: {cells}")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def block(text: str, language: str = "text") -> str:
    """Return a fenced block."""
    return f"```{language}\n{text.strip()}\n```"


def code(text: str) -> str:
    """Return code within a line; several of them where a text has commas."""
    return f"`{text}`"


def short(value: float) -> str:
    """Return a small number in two digits, such as 1.4e-10, and 0 for zero."""
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return "0" if value == 0 else f"{mantissa}e{int(exponent)}" if int(exponent) else mantissa


def whole(value: float) -> str:
    """Return a number without digits after the point, with commas."""
    return f"{value:,.0f}"


def digits(value: float, count: int = 2) -> str:
    """Return a number with at least ``count`` significant digits, without powers of ten."""
    return whole(value) if abs(value) >= 10**count else f"{value:.{count}g}"
