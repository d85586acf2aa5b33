"""Tables and blocks of Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

WIDEST = 88
"""Characters of a line of code that a page of 1280 pixels shows."""


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
    """Return a number in two digits: 1.4e-10, 0.39, 13, and 0 for zero."""
    if value == 0 or abs(value) >= 0.01:
        return f"{value:.2g}"
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"


def whole(value: float) -> str:
    """Return a number without digits after the point, with commas."""
    return f"{value:,.0f}"


def digits(value: float) -> str:
    """Return a number with at least two significant digits, without powers of ten."""
    return f"{value:.1f}" if abs(value) < 10 else whole(value)


def plain(value: float) -> str:
    """Return a number in the shortest form, such as 1e-6."""
    mantissa, _, exponent = f"{value:g}".partition("e")
    return f"{mantissa}e{int(exponent)}" if exponent else mantissa


def command(words: Sequence[str]) -> str:
    """Return a block with a command, split over several lines if long."""
    lines = [words[0]]
    for word in words[1:]:
        if len(lines[-1]) + len(word) > WIDEST:
            lines[-1] += " \\"
            lines.append(f"    {word}")
        else:
            lines[-1] += f" {word}"
    return block("\n".join(lines))
