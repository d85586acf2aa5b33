"""Settings of sphinx-gallery: tutorials, which the build runs, and the programs in ``examples``, which it shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

HEADERS = ("GALLERY_HEADER.rst", "GALLERY_HEADER.md", "README.rst", "README.txt")


def sources(docs: Path) -> dict[str, str]:
    """Return the folders of programs that have a header, with the folders that their pages go to."""
    candidates = {"tutorials": "_tutorials", "../examples": "gallery"}
    return {source: to for source, to in candidates.items() if any((docs / source / name).exists() for name in HEADERS)}


def extensions(docs: Path) -> list[str]:
    """Return sphinx-gallery where there are programs."""
    return ["sphinx_gallery.gen_gallery"] if sources(docs) else []


def settings(docs: Path, root: Path, execute: bool) -> dict[str, Any]:
    """Return sphinx-gallery's settings; only tutorials run, and only when they are asked to."""
    return {
        "examples_dirs": list(sources(docs)),
        "gallery_dirs": list(sources(docs).values()),
        "filename_pattern": r"[\\/]tutorials[\\/]",
        "ignore_pattern": r"__init__\.py",
        "plot_gallery": execute,
        "abort_on_example_error": False,
        "only_warn_on_example_error": False,
        "download_all_examples": False,
        "show_memory": False,
        "show_signature": False,
        "min_reported_time": 0,
        "within_subsection_order": "FileNameSortKey",
        "reference_url": {"bsk_torch": None},
        "backreferences_dir": None,
        "remove_config_comments": True,
    }
