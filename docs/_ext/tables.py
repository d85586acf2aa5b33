"""Markdown made when the site is built, from benchmarks' results and from the package itself."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

DOCS = Path(__file__).parents[1]


def toctree(*entries: str) -> str:
    """Return a hidden toctree of those pages that exist."""
    found = [entry for entry in entries if any((DOCS / f"{entry}.{suffix}").exists() for suffix in ("md", "rst"))]
    return "\n".join(["```{toctree}", ":hidden:", "", *found, "```"])


TABLES: dict[str, Callable[..., str]] = {"toctree": toctree}
"""Functions by the name that pages use; see ``generated.py``."""
