"""Access windows of satellites from element sets over places on the ground, without an environment."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from bsk_torch.astro.earth_rotation import sidereal_time_1982
from bsk_torch.astro.element_sets import ElementSet
from bsk_torch.astro.frames import rotate_z
from bsk_torch.astro.geodetic import axis_shift
from bsk_torch.sim.access.passes.passes import GroundTrack, PassSearch
from bsk_torch.sim.access.visibility.kernels import make_visibility
from bsk_torch.sim.access.windows.search import BEFORE_SEARCH, BEHIND_SEARCH
from bsk_torch.sim.orbit.grid import PLAN_STEP
from bsk_torch.sim.places import Sites
from bsk_torch.vec3 import Vec3

LEAD = math.ceil(max(BEFORE_SEARCH, BEHIND_SEARCH) / PLAN_STEP)
"""Samples of the ground track beyond both ends of the search."""


def ground_windows(
    satellites: Sequence[ElementSet],
    r_LP_P: Tensor,
    et: float,
    seconds: float,
    min_elevation: float,
    backend: str = "compiled",
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Yield the windows of each satellite over places on the WGS84 ellipsoid: places, opening and closing times, [m] each.

    Positions are SGP4's, every 30 s, interpolated in between. Times are s after ``et``; windows in progress at either end are
    cut there. They are sorted by opening time.

    Args:
        satellites: Element sets.
        r_LP_P: Positions of the places in ITRF, [P, 3] m.
        et: ET at the start, s.
        seconds: Length of the search, s.
        min_elevation: Least elevation above the horizon of the ellipsoid, rad.
        backend: ``"compiled"``, or ``"eager"``.

    Raises:
        ValueError: For an element set that is too old, or of which SGP4 has no state at a time.
    """
    steps = torch.arange(-LEAD, math.ceil(seconds / PLAN_STEP) + LEAD + 1, dtype=torch.float64) * PLAN_STEP
    angle = sidereal_time_1982(et + steps)
    cos, sin = torch.cos(angle), torch.sin(angle)
    sines = torch.full((1, len(r_LP_P)), math.sin(min_elevation), dtype=torch.float64)
    sites = Sites(r_LP_P.unsqueeze(0), sines, axis_shift(Vec3.of(r_LP_P)).unsqueeze(0))
    visibility, start = make_visibility(backend, torch.device("cpu")), steps[:1]
    for elements in satellites:
        elements.check_age(torch.tensor([et, et + seconds], dtype=torch.float64))
        r_BP_P = rotate_z(Vec3.of(elements.teme_states(et + steps)[0]), cos, sin).stack().unsqueeze(0)
        found = PassSearch(visibility, GroundTrack(r_BP_P, start), sites).passes()
        opens, closes = found.open.clamp(min=0.0), found.close.clamp(max=seconds)
        kept = torch.nonzero(opens < closes).squeeze(-1)
        kept = kept[torch.argsort(opens[kept], stable=True)]
        yield found.place[kept], opens[kept], closes[kept]
