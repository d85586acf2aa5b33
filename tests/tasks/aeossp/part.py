"""A part of a case of aeossp_standard with what the benchmark's verifier says about it, by scripts/recorders/record_aeossp.py.

The case is of github.com/Mtrya/astro-reason (MIT license, copyright 2026 OpenMOSS-Team); places are of GeoNames (CC BY 4.0).
"""

from pathlib import Path

PART = Path(__file__).with_name("data")


def part(name: str) -> bytes:
    """Content of one of its files."""
    return (PART / name).read_bytes()


FILES = {name: part(name) for name in ("mission.yaml", "satellites.yaml", "tasks.yaml")}
