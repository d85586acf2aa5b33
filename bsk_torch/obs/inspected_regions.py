"""What a satellite knows of the inspection of an RSO, region by region."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.astro.orbit import hill_frame
from bsk_torch.astro.relative import float64, like, vectors

AXES = ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0))
"""Both directions of each axis."""

FRAMES = ("chief_hill", "chief_body")

_PACK = 2.0**20
"""More than there are points."""


def rso_imaged_regions(servicer: Any, chief: Any, region_centers: Any = AXES, frame: str = "chief_hill") -> Any:
    """Return the fraction of the points of each region of the chief that the servicer knows to be inspected, [N, R].

    A point belongs to the region whose centre is the nearest to its position in the chief's body axes, the first of several;
    regions without points give 0. Centres in ``"chief_hill"`` turn with the chief's Hill frame, so points change regions where
    the chief's body does not turn with it. What has been communicated counts, see :class:`bsk_torch.data.RSOInspectionReward`.

    Args:
        servicer: The satellite that observes.
        chief: The RSO.
        region_centers: Centres [R, 3] in the axes of ``frame``, of points at a distance of about 1; both directions of each axis
            unless given.
        frame: ``"chief_hill"`` or ``"chief_body"``.

    Raises:
        ValueError: For another frame, or centres of another shape.
    """
    if frame not in FRAMES:
        raise ValueError(f"frame={frame!r} must be one of {list(FRAMES)}")
    centers = torch.as_tensor(np.asarray(region_centers, dtype=float))
    if centers.ndim != 2 or centers.shape[-1] != 3 or not len(centers):
        raise ValueError(f"region_centers has shape {list(centers.shape)}; it must be [R, 3]")
    r, v, sigma = chief.dynamics.r_BN_N, chief.dynamics.v_BN_N, chief.dynamics.sigma_BN
    (inspected,) = float64(servicer.data_store.data.inspected)
    centers = centers.to(inspected.device)
    if frame == "chief_hill":
        position, velocity, attitude = vectors(r, v, sigma)
        BN = torch.stack([row.stack() for row in mrp_to_dcm(attitude)], -2)
        HN = torch.stack([row.stack() for row in hill_frame(position, velocity)], -2)
        centers = centers @ HN @ BN.mT  # rows are c_B = [BN] [HN]^T c_H
    return like(known_regions(inspected, _points(servicer), centers), r)


def _points(servicer: Any) -> Tensor:
    """Return the positions of the points, [P, 3] m, or [N, P, 3] where they differ between episodes."""
    (r_PB_B,) = float64(servicer.scenario.r_PB_B)
    return servicer.simulator.of_env(r_PB_B) if r_PB_B.ndim == 3 else r_PB_B


def known_regions(inspected: Tensor, r_PB_B: Tensor, centers: Tensor) -> Tensor:
    """Return the fraction of inspected points in each region, [..., R].

    Args:
        inspected: 1 for inspected points, else 0, [..., P].
        r_PB_B: Positions of the points, [P, 3] or [..., P, 3] m.
        centers: Centres of the regions in the same axes, [R, 3] or [..., R, 3].
    """
    region = _nearest(r_PB_B, centers).expand(inspected.shape)
    # one sum for both numbers: inspected points count 2^20 and 1, others 1
    packed = inspected.new_zeros(*inspected.shape[:-1], centers.shape[-2]).scatter_add(-1, region, inspected * _PACK + 1.0)
    known = torch.floor(packed / _PACK)
    return known / (packed - known * _PACK).clamp(min=1.0)


def _nearest(r_PB_B: Tensor, centers: Tensor) -> Tensor:
    """Return the index of the centre that is nearest to each point, the first of several, [..., P].

    The nearest centre c of p has the smallest ``|c|^2 - 2 p . c``. Centre by centre: all distances at once, [..., P, R], and
    their ``argmin`` take three times as long.
    """
    x, y, z = r_PB_B.unbind(-1)
    doubled, squares = (-2.0 * centers).unsqueeze(-1).unbind(-3), centers.square().sum(-1).unsqueeze(-1).unbind(-2)
    least, index = None, torch.zeros((), dtype=torch.long, device=centers.device)
    for k, ((a, b, c), square) in enumerate(zip((each.unbind(-2) for each in doubled), squares, strict=True)):
        distance = (x * a).add_(y * b).add_(z * c).add_(square)
        if least is None:
            least = distance
        else:
            index = torch.where(distance < least, k, index)
            least = torch.minimum(least, distance)
    return index
