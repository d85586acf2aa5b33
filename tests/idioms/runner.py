"""Runs lines of bsk_rl programs as they stand, with the names of bsk_rl standing for those of bsk_torch.

An idiom is a pair: the literal line, and a check of what it gives. Files ``test_*.py`` of this folder list idioms by area.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import bsk_torch
from bsk_torch import act, comm, data, obs, sats, scene
from bsk_torch.sim import dyn, fsw

Check = Callable[[Any], object]
Idiom = tuple[str, Check]

NAMES: dict[str, Any] = {
    "bsk_rl": bsk_torch,
    "np": np,
    "act": act,
    "comm": comm,
    "data": data,
    "obs": obs,
    "sats": sats,
    "scene": scene,
    "dyn": dyn,
    "fsw": fsw,
    "SatelliteTasking": bsk_torch.SatelliteTasking,
    "ConstellationTasking": bsk_torch.ConstellationTasking,
    "per_environment": bsk_torch.per_environment,
}
"""What a bsk_rl program has imported."""


def run(line: str, **names: Any) -> Any:
    """Return the value of an expression of a bsk_rl program; ``names`` are further names that it uses."""
    return eval(line, {**NAMES, **names})


def title(idiom: Idiom) -> str:
    """Name of an idiom in pytest's output."""
    return idiom[0]
