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

from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.lanes.loop import Samples
from bsk_torch.sim.orbit import Arcs
from bsk_torch.sim.sight import View
from bsk_torch.sim.solver import make_solver

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


@pytest.fixture(scope="session", params=["eager", pytest.param("compiled", marks=pytest.mark.compiled)])
def backend(request) -> str:
    """Both ways to compute arcs and to look from them."""
    return request.param


@pytest.fixture(scope="session")
def solve_arcs() -> Callable[..., tuple[Arcs, View]]:
    """Arcs of ``spans`` hours for initial conditions as the recordings list them, and a view of the whole planned arcs."""

    def solve(initials: list[dict[str, Any]], spans: int, step: float = 1.0, backend: str = "eager") -> tuple[Arcs, View]:
        et = torch.tensor([parse_utc(initial["utc_init"]) for initial in initials], dtype=torch.float64)
        r, v = (torch.tensor([initial[name] for initial in initials], dtype=torch.float64) for name in ("rN", "vN"))
        arcs = Arcs(len(initials), spans, make_solver(step, backend, torch.device("cpu")))
        fine, epoch = arcs.reset(torch.arange(len(initials)), et, r, v), torch.zeros_like(et)
        return arcs, View(*(Samples(table, epoch) for table in (fine[:, ::2].contiguous(), arcs.sky.clone(), fine)))

    return solve


@pytest.fixture(scope="session")
def make_arcs(solve_arcs) -> Callable[..., Arcs]:
    """The arcs alone."""
    return lambda *args, **options: solve_arcs(*args, **options)[0]
