"""Types of observations: torch's or NumPy's."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import torch

LARGEST = 1e10
"""Types of observations hold numbers up to this: in float16 all from 65520 on are infinite."""

DEFAULT = torch.float32
"""Type where neither the environment nor a satellite names one."""


def as_dtype(given: Any) -> torch.dtype | None:
    """Return a floating-point type of torch from one of torch or NumPy (``np.float32``, ``"float32"``), or None for None."""
    if given is None:
        return None
    found = given
    if not isinstance(given, torch.dtype):
        try:
            found = torch.from_numpy(np.empty(0, np.dtype(given))).dtype
        except (TypeError, ValueError):
            found = None
    if found is None or not found.is_floating_point or torch.finfo(found).max < LARGEST:
        raise ValueError(
            f"dtype={given!r} must be a floating-point type, such as torch.float32 or np.float64, that holds positions in m"
        )
    return found


def common_dtype(given: Any, satellites: Iterable[Any]) -> torch.dtype:
    """Return the type of observations of an environment: ``given`` or, if None, the one that its satellites name."""
    if (own := as_dtype(given)) is not None:
        return own
    named = {satellite.name: satellite.dtype for satellite in satellites if satellite.dtype is not None}
    if len(set(named.values())) > 1:
        each = ", ".join(f"{name}: {dtype}" for name, dtype in named.items())
        raise ValueError(f"satellites have observations of different types ({each}); an environment has one: pass dtype= to it")
    return next(iter(named.values()), DEFAULT)
