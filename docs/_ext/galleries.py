"""Settings of sphinx-gallery: its folders and links; ``docs/gallery.py``, where it exists, says how programs are executed."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

SOURCES = {"tutorials": "_tutorials", "../examples": "gallery"}
"""Folders of programs, and the folders that their pages go to."""


def sources(docs: Path) -> dict[str, str]:
    """Return the folders of programs that have a header."""
    return {source: to for source, to in SOURCES.items() if any((docs / source).glob("GALLERY_HEADER.*"))}


def extensions(docs: Path) -> list[str]:
    """Return sphinx-gallery where there are programs."""
    return ["sphinx_gallery.gen_gallery"] if sources(docs) else []


def settings(docs: Path, execute: bool) -> dict[str, Any]:
    """Return sphinx-gallery's settings."""
    own = importlib.import_module("docs.gallery").SETTINGS if (docs / "gallery.py").exists() else {}
    return own | {
        "examples_dirs": list(sources(docs)),
        "gallery_dirs": list(sources(docs).values()),
        "plot_gallery": execute,
        "only_warn_on_example_error": False,
        "download_all_examples": False,
        "show_signature": False,
        "write_computation_times": False,  # a page that loads scripts from elsewhere
        "backreferences_dir": None,
    }
