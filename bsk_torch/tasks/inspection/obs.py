"""Knowledge of a satellite about the inspection of an RSO, by region.

A point belongs to the region whose center is the nearest, the first of several. The same function of a point is a tick of a
kernel, and runs on tensors under the eager back end.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.astro.orbit import hill_frame
from bsk_torch.astro.relative import float64, vectors
from bsk_torch.codegen.kernel import Kernel, Samples
from bsk_torch.sim.component import Field, Track, vec
from bsk_torch.sim.orbit.builder import KernelBuilder
from bsk_torch.tasks.inspection.flags import TICK_NS
from bsk_torch.vec3 import Vec3

if TYPE_CHECKING:
    from bsk_torch.sats.bound import SatelliteLike

AXES = ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0))
"""Both directions of each axis."""

FRAMES = ("chief_hill", "chief_body")

POINTS = Track("points", 1.0, (vec("r_PB_B", "m"),), count=1)
FLAGS = Track("flags", 1.0, (Field("inspected"),), count=1)
"""What a tick of the kernel reads of a point."""

PACK = 2.0**20
"""More than there are points."""


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


def known_regions(inspected: Tensor, r_PB_B: Tensor, centers: Tensor, compiled: bool) -> Tensor:
    """Return the fraction of inspected points in each region, [N, R]; 0 for regions without points.

    Args:
        inspected: 1 for inspected points, else 0, [N, P] float64.
        r_PB_B: Positions of the points, [P, 3] or [N, P, 3] m.
        centers: Centers of the regions in the same axes, [R, 3] or [N, R, 3] m.
        compiled: Whether to use a kernel, on the CPU.
    """
    run = _run_kernel if compiled and inspected.device.type == "cpu" else _run_tensors
    hits, count = run(inspected, r_PB_B, centers.expand(len(inspected), *centers.shape[-2:]))
    return hits / count.clamp(min=1.0)


def nearest(point: Vec3, centers: Sequence[Vec3], squares: Sequence[Tensor]) -> Tensor:
    """Return the index of the center that is nearest to a point, as a number: that of the smallest ``|c|^2 - 2 p . c``."""
    least = squares[0] - 2.0 * point.dot(centers[0])
    index = torch.zeros_like(least)
    for k, (center, square) in enumerate(zip(centers[1:], squares[1:], strict=True), 1):
        distance = square - 2.0 * point.dot(center)
        index = torch.where(distance < least, float(k), index)
        least = torch.minimum(distance, least)
    return index


def _run_tensors(inspected: Tensor, r_PB_B: Tensor, centers: Tensor) -> tuple[Tensor, Tensor]:
    """Return how many points of each region are inspected, and how many there are, [N, R] each.

    Center by center: all distances at once, [N, P, R], and their ``argmin`` take longer.
    """
    vectors = [Vec3(*center.unsqueeze(-1).unbind(1)) for center in centers.unbind(1)]
    region = nearest(Vec3(*r_PB_B.unbind(-1)), vectors, [center.dot(center) for center in vectors]).long()
    # one sum for both numbers: an inspected point counts 2^20 and 1, another 1
    packed = torch.zeros_like(centers[..., 0]).scatter_add(-1, region.expand(inspected.shape), inspected * PACK + 1.0)
    hits = torch.floor(packed / PACK)
    return hits, packed - hits * PACK


@cache
def regions_kernel(regions: int) -> Kernel:
    """Return the kernel that counts points of so many regions, a point in each tick.

    The state is the number of inspected points of each region, then that of all of its points.
    """
    builder = KernelBuilder()
    hits, count = (builder.planes("state", regions, k * regions) for k in range(2))
    centers = builder.vectors("own", regions)
    squares = builder.planes("own", regions, 3 * regions)
    (inspected,) = builder.records(2, 1)
    index = nearest(Vec3(*builder.records(1, 3)), centers, squares)
    members = [index.eq(float(k)) for k in range(regions)]
    hits = [torch.where(now, before + inspected, before) for now, before in zip(members, hits, strict=True)]
    count = [torch.where(now, before + 1.0, before) for now, before in zip(members, count, strict=True)]
    return Kernel("regions of points", builder.loop([*hits, *count], [], (POINTS, FLAGS)))


def _run_kernel(inspected: Tensor, r_PB_B: Tensor, centers: Tensor) -> tuple[Tensor, Tensor]:
    (n, points), regions = inspected.shape, centers.shape[1]
    points_of = r_PB_B.unsqueeze(0) if r_PB_B.ndim == 2 else r_PB_B
    owner = torch.zeros(n, dtype=torch.int64) if r_PB_B.ndim == 2 else None
    # records are looked up half way between two
    tracks = [
        Samples(table.contiguous(), torch.full((len(table),), -0.5, dtype=torch.float64), rows)
        for table, rows in ((points_of, owner), (inspected.unsqueeze(-1), None))
    ]
    inputs = torch.cat([centers.permute(1, 2, 0).flatten(0, 1), centers.square().sum(-1).mT])
    state = torch.zeros(2 * regions, n, dtype=torch.float64)
    before = torch.full((n,), -1, dtype=torch.int64)
    regions_kernel(regions)(state, points, tracks, own=inputs.contiguous(), ticks=before, nanoseconds=TICK_NS)
    hits, count = state.view(2, regions, n).mT
    return hits, count
