"""Fixtures that all tests share."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

torch.set_num_threads(1)

RECORDINGS = Path(__file__).with_name("basilisk")


@pytest.fixture(autouse=True)
def seed() -> int:
    """The global generator starts every test in the same state."""
    torch.manual_seed(20260)
    return 20260


@cache
def _recording(name: str) -> dict[str, Any]:
    with np.load(RECORDINGS / f"{name}.npz") as file:
        return {key: json.loads(file[key].item()) if file[key].dtype.kind == "U" else file[key] for key in file.files}


@pytest.fixture(scope="session")
def recording() -> Callable[[str], dict[str, Any]]:
    """Loads a recording of Basilisk by name, with its JSON entries decoded; see tests/basilisk/README.md."""
    return _recording
