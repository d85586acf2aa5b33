"""Names: hints for wrong ones that users write, and names made of those of classes."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence

CLOSE, NEAR = 0.5, 0.1
"""Least similarity of names that are suggested, 1 for equal ones, and how much less than that of the closest it may be."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a hint: the valid names that are about as close to a wrong one as the closest, or all if none is close."""
    by_lower = {str(k).lower(): str(k) for k in known}
    ratios = {k: difflib.SequenceMatcher(None, name.lower(), k).ratio() for k in by_lower}
    least = max(CLOSE, max(ratios.values(), default=0.0) - NEAR)
    close = [by_lower[k] for k in sorted(ratios, key=lambda k: -ratios[k]) if ratios[k] >= least][:3]
    return f"did you mean {' or '.join(map(repr, close))}?" if close else f"valid names: {', '.join(sorted(by_lower.values()))}"


def check_unique(names: Sequence[str], what: str) -> None:
    """Raise ValueError if some of the ``names`` of listed parts, ``what`` in messages, are equal."""
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"sat_args: {names.count(name)} {what} are named {name!r}; give each another name")


def snake(name: str) -> str:
    """Return the name of a class in lower case with underscores."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
