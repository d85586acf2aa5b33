"""What pages can ask for with ``<!-- generated: NAME ARGUMENTS -->``; see ``docs/fill.py``."""

from __future__ import annotations

from collections.abc import Callable

from docs._ext import (
    aeossp,
    aeossp_flown,
    bounds,
    listings,
    on_basilisk,
    orbits,
    policies,
    results,
    speed,
    suites,
    truth,
    weaknesses,
)

MODULES = (
    *(listings, results, speed, on_basilisk, policies, weaknesses, bounds, suites, truth),
    *(aeossp, aeossp_flown, orbits),
)

TABLES: dict[str, Callable[..., str]] = {name: function for module in MODULES for name, function in module.TABLES.items()}
"""Functions that return Markdown, by name."""
