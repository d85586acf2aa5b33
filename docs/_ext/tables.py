"""What pages can ask for with ``<!-- generated: NAME ARGUMENTS -->``; see ``generated.py``."""

from __future__ import annotations

from collections.abc import Callable

from docs._ext import listings, results, truth

TABLES: dict[str, Callable[..., str]] = {**listings.TABLES, **results.TABLES, **truth.TABLES}
"""Functions that return Markdown, by name."""
