"""Knowledge of a satellite about the inspection of an RSO, by region."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.astro.orbit import hill_frame
from bsk_torch.astro.relative import float64, vectors
from bsk_torch.tasks.inspection.regions import known_regions

if TYPE_CHECKING:
    from bsk_torch.sats.bound import SatelliteLike

AXES = ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0))
"""Both directions of each axis."""

FRAMES = ("chief_hill", "chief_body")


def rso_imaged_regions(
    servicer: SatelliteLike, chief: SatelliteLike, region_centers: object = AXES, frame: str = "chief_hill"
) -> Tensor:
    """Return the fraction of points in each region of the chief known by the servicer to be inspected, [N, R].

    A point belongs to the region whose center is the nearest to its position in the chief's body axes, the first of several;
    regions without points give 0. Centers in ``"chief_hill"`` turn with the chief's Hill frame, so points change regions where
    the chief's body does not turn with it. What has been communicated counts, see
    :class:`bsk_torch.tasks.inspection.RSOInspectionReward`.

    Args:
        servicer: The observing satellite.
        chief: The RSO.
        region_centers: Centers [R, 3] in the axes of ``frame``, of points at a distance of about 1; both directions of each axis
            by default.
        frame: ``"chief_hill"`` or ``"chief_body"``.

    Raises:
        ValueError: For another frame, or centers of another shape.
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
    return known_regions(inspected, _points(servicer), centers, servicer.simulator.type.options.backend == "compiled")


def _points(servicer: SatelliteLike) -> Tensor:
    """Return the positions of the points, [P, 3] m, or [N, P, 3] where they differ between episodes."""
    (r_PB_B,) = float64(servicer.scenario.r_PB_B)
    return servicer.simulator.of_env(r_PB_B) if r_PB_B.ndim == 3 else r_PB_B
