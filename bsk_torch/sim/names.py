"""Hints for wrong names that users write."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a hint that names the valid names closest to a wrong one."""
    by_lower = {str(k).lower(): str(k) for k in known}
    close = [by_lower[k] for k in difflib.get_close_matches(name.lower(), by_lower, n=3, cutoff=0.5)]
    return f"did you mean {' or '.join(map(repr, close))}?" if close else f"valid names: {', '.join(sorted(by_lower.values()))}"
