"""Points on a sphere that deputies inspect from outside while the Sun shines on them, and clusters of those left.

A point p of a sphere of radius R about the origin of the chief's Hill frame is in view of a deputy at rho where it is above the
deputy's horizon, ``p . rho / |rho| >= R^2 / |rho|``, and lit where the ray from it to the Sun does not meet the sphere. Both are
the conditions of AFRL's safe-autonomy-simulation 2.2.1 (``sims/inspection/camera.py`` and ``utils/illumination.py``, with a field
of view of 180 degrees), which starts rays 1e-5 m above the sphere.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

ABOVE = 1e-5
"""Height above the sphere at which rays to the Sun start, m."""

PER_CLUSTER = 10
"""Number of points for each cluster."""

ROUNDS, SETTLED = 50, 1e-4
"""Maximum number of rounds of k-means, and movement of centers at which it ends, as a share of the variance of the points."""


def sphere_points(count: int, radius: float) -> Tensor:
    """Return about ``count`` points on a sphere in circles of latitude, with equal areas, [P, 3] m; 99 for 100.

    M. Deserno, "How to generate equidistributed points on the surface of a sphere", 2004.
    """
    area = 4.0 * math.pi / count
    circles = round(math.pi / math.sqrt(area))
    spacing = area / (math.pi / circles)
    points = []
    for m in range(circles):
        theta = math.pi * (m + 0.5) / circles
        around = round(2.0 * math.pi * math.sin(theta) / spacing)
        phi = 2.0 * math.pi * torch.arange(around, dtype=torch.float64) / around
        across = torch.full_like(phi, math.sin(theta))
        points.append(torch.stack([across * phi.cos(), across * phi.sin(), torch.full_like(phi, math.cos(theta))], 1))
    return radius * torch.cat(points)


def dot(points: Tensor, vector: Tensor) -> Tensor:
    """Return the products of points [P, 3] and vectors [..., 3], [..., P]; bit for bit the same in every batch."""
    x, y, z = (part.unsqueeze(-1) for part in vector.unbind(-1))
    return points[:, 0] * x + points[:, 1] * y + points[:, 2] * z


def in_view(points: Tensor, radius: float, rho: Tensor) -> Tensor:
    """Return which points [P, 3] deputies at ``rho`` [..., 3] m see, [..., P] bool."""
    distance = dot(rho.new_ones(1, 3), rho.square()).sqrt()
    return dot(points, rho) / distance >= radius * radius / distance


def lit(points: Tensor, radius: float, sun: Tensor) -> Tensor:
    """Return which points [P, 3] the Sun in the direction ``sun`` [..., 3] shines on, [..., P] bool."""
    return dot(points * (1.0 + ABOVE / radius), sun) >= -math.sqrt(2.0 * radius * ABOVE + ABOVE * ABOVE)


class Clusters(NamedTuple):
    """Centers of clusters of points of N episodes, [N, K, 3] m, of which the first ``number`` [N] are used."""

    centers: Tensor
    number: Tensor

    def nearest(self, rho: Tensor) -> Tensor:
        """Return the directions of the centers nearest to deputies at ``rho`` [N, S, 3] m, [N, S, 3]; zero without clusters."""
        best = torch.full_like(rho[..., 0], math.inf)
        center = torch.zeros_like(rho)
        for k, other in enumerate(self.centers.unsqueeze(2).unbind(1)):
            gap = squares(rho - other)
            nearer = (gap < best) & (k < self.number).unsqueeze(1)
            best, center = torch.where(nearer, gap, best), torch.where(nearer.unsqueeze(-1), other, center)
        return center / squares(center).sqrt().clamp(min=1e-300).unsqueeze(-1)


def squares(vectors: Tensor) -> Tensor:
    """Return the squared lengths of vectors [..., 3], [...]."""
    x, y, z = vectors.unbind(-1)
    return x * x + y * y + z * z


def clustered(points: Tensor, chosen: Tensor, before: Clusters) -> Clusters:
    """Return the clusters of the ``chosen`` [N, P] of the points [P, 3], one for every ten, by k-means from those ``before``.

    Further centers start at the chosen points farthest from the others. Where no point is chosen, no center is used.
    """
    wanted = (chosen.sum(1) + (PER_CLUSTER - 1)) // PER_CLUSTER
    return kmeans(points, chosen, seeded(points, chosen, before, wanted))


def seeded(points: Tensor, chosen: Tensor, before: Clusters, wanted: Tensor) -> Clusters:
    """Return clusters with ``wanted`` [N] centers: the first ones of those before, and chosen points far from the others."""
    start = torch.minimum(before.number, wanted)
    rows = torch.nonzero(start < wanted).squeeze(-1)  # in flights of the rule 'seek', 6 of 1,024 in a decision
    if not len(rows):
        return Clusters(before.centers, wanted)
    start, end, mine = start[rows], wanted[rows], chosen[rows]
    gap, placed = torch.full_like(mine, math.inf, dtype=points.dtype), []
    for k, center in enumerate(before.centers[rows].unbind(1)):  # one after the other: each is far from those before
        farthest = points[gap.masked_fill(~mine, -1.0).argmax(1)]
        placed.append(torch.where(((k >= start) & (k < end)).unsqueeze(1), farthest, center))
        distance = squares(points - placed[-1].unsqueeze(1))
        gap = torch.where((k < end).unsqueeze(1), torch.minimum(gap, distance), gap)
    return Clusters(before.centers.index_copy(0, rows, torch.stack(placed, 1)), wanted)


def kmeans(points: Tensor, chosen: Tensor, start: Clusters) -> Clusters:
    """Return clusters by Lloyd's method: at most 50 rounds, until no point changes its cluster or the centers hardly move.

    The rules of scikit-learn's ``KMeans(max_iter=50)``, except that a center without points stays where it is.
    """
    centers, rows = start.centers, torch.arange(len(chosen), device=chosen.device)
    label, mine = torch.full_like(chosen, -1, dtype=torch.int64), chosen
    tolerance = SETTLED * spread(points, chosen)
    for _ in range(ROUNDS):
        now = centers[rows]
        new = nearest_center(points, now, start.number[rows]).masked_fill(~mine, -1)
        moved = means(points, new, now)
        centers = centers.index_copy(0, rows, moved)
        shift = squares(moved - now).unbind(1)
        # without those that have settled, decisions of 1,024 flights of the rule 'seek' take a quarter of the work
        goes_on = torch.nonzero((new != label).any(1) & (sum(shift) > tolerance[rows])).squeeze(-1)
        if not len(goes_on):
            break
        rows, label, mine = rows[goes_on], new[goes_on], mine[goes_on]
    return Clusters(centers, start.number)


def spread(points: Tensor, chosen: Tensor) -> Tensor:
    """Return the mean variance along the axes of the ``chosen`` [N, P] of the points [P, 3], [N] m^2."""
    share = chosen.double() / chosen.sum(1, keepdim=True).clamp(min=1)
    mean = torch.stack([(share * axis).sum(1) for axis in points.unbind(1)], 1)
    return ((share * squares(points)).sum(1) - squares(mean)) / 3.0


def nearest_center(points: Tensor, centers: Tensor, count: Tensor) -> Tensor:
    """Return the number of the center nearest to each point, of the first ``count`` [N] of ``centers`` [N, K, 3], [N, P]."""
    best = torch.full((len(centers), len(points)), math.inf, dtype=points.dtype, device=points.device)
    number = torch.zeros_like(best, dtype=torch.int64)
    half = 0.5 * squares(centers)
    for k, center in enumerate(centers.unbind(1)):  # tables of one center fit into the cache
        gap = torch.where((k < count).unsqueeze(1), half[:, k, None] - dot(points, center), math.inf)
        nearer = gap < best
        best, number = torch.where(nearer, gap, best), number.masked_fill(nearer, k)
    return number


def means(points: Tensor, label: Tensor, centers: Tensor) -> Tensor:
    """Return the mean of the points with each ``label`` [N, P], or the center [N, K, 3] where there are none."""
    found = []
    for k, center in enumerate(centers.unbind(1)):
        member = (label == k).to(points.dtype)
        size = member.sum(1, keepdim=True)
        total = torch.stack([(member * axis).sum(1) for axis in points.unbind(1)], 1)
        found.append(torch.where(size > 0.0, total / size.clamp(min=1.0), center))
    return torch.stack(found, 1)
