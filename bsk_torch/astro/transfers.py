"""Transfers between points about a chief: maneuvers and paths for many targets and durations at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.linear_motion import LinearMotion
from bsk_torch.vec3 import Mat3, Vec3

SMALLEST = 1e-30
"""Least divisor: squares of distances, m^2, or of speeds, below which there is no direction."""

__all__ = ["Transfers", "closest", "transfers"]


class Transfers(NamedTuple):
    """Transfers of N deputies to D targets in K durations, in the chief's Hill frame.

    Attributes:
        dv: Maneuvers that begin them, components [K, D, N] m/s; rows stand last, so that operations run along them.
        cost: Maneuvers that would take them to the target, [N, D, K] m/s: the lengths of ``dv`` where that is not limited;
            infinite where none does.
        motion: Motion of deputies up to the arrival.
        start: Positions at the maneuver, components [N] m.
        velocity: Velocities before it, components [N] m/s.
    """

    dv: Vec3
    cost: Tensor
    motion: LinearMotion
    start: Vec3
    velocity: Vec3

    @property
    def samples(self) -> int:
        """Number S of the moments, evenly spaced up to the arrival, at which paths are known."""
        return len(self.motion.time)

    def position(self, moment: int) -> Tensor:
        """Return positions at a moment, [N, D, K, 3] m."""
        return self._at(moment).stack().permute(2, 1, 0, 3)

    def manoeuvre(self, chosen: Tensor) -> Tensor:
        """Return the maneuvers [N, 3] m/s of transfers ``d * K + k``, [N]."""
        durations, targets = self.dv.x.shape[:2]
        place = (chosen % durations * targets + torch.div(chosen, durations, rounding_mode="floor")).unsqueeze(0)
        return self.dv.map(lambda x: x.flatten(0, 1).gather(0, place).squeeze(0)).stack()

    def rows(self, first: int, step: int) -> Transfers:
        """Return the transfers of every so many-th deputy from the first one on."""
        return self.some(slice(first, None, step))

    def some(self, rows: Tensor | slice) -> Transfers:
        """Return the transfers of some deputies, by their numbers."""
        dv, start, velocity = (vector.map(lambda x: x[..., rows]) for vector in (self.dv, self.start, self.velocity))
        return Transfers(dv, self.cost[rows], self.motion.some(rows), start, velocity)

    def along(self, motion: LinearMotion) -> Transfers:
        """Return the same maneuvers with paths over another duration, that of a motion with K = 1."""
        K = len(self.dv.x)
        matrices = motion.mapped(lambda x: x.expand(-1, K, -1))
        return self._replace(motion=LinearMotion(*matrices, motion.time.expand(-1, K)))

    def distances(self) -> tuple[Tensor, Tensor]:
        """Return the smallest and the largest distance from the chief on each path, [N, D, K] m each."""
        none = self.start.stack().new_empty(len(self.start.x), 0, 3)
        nearest, farthest = self.extremes(none, none)
        return nearest[:, 0], farthest

    def apart(self, rho: Tensor, velocity: Tensor) -> Tensor:
        """Return the smallest distance on each path from deputies that drift on, [N, O, D, K] m.

        Args:
            rho: Their positions, [N, O, 3] m.
            velocity: Their velocities as seen in the Hill frame, [N, O, 3] m/s.
        """
        return self._distances(rho, velocity)[0]

    def extremes(self, rho: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        """Return the smallest distances from the chief, then from deputies that drift on, and the largest from the chief.

        Args:
            rho: Positions of the O deputies, [N, O, 3] m.
            velocity: Their velocities as seen in the Hill frame, [N, O, 3] m/s.

        Returns:
            Smallest distances, [N, 1 + O, D, K] m, and largest ones, [N, D, K] m.
        """
        chief = torch.zeros_like(self.start.stack()).unsqueeze(1)
        return self._distances(torch.cat([chief, rho], 1), torch.cat([chief, velocity], 1))

    def _distances(self, rho: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        """Return the smallest distances from deputies, [N, O, D, K] m, and the largest from the first one, [N, D, K] m."""
        deputies = [Vec3.of(each.transpose(0, 1).unsqueeze(1)) for each in (rho, velocity)]
        before = (self.start - deputies[0]).map(lambda x: x.unsqueeze(2))
        square = before.dot(before)
        nearest = torch.full((rho.shape[1], *self.dv.x.shape), torch.inf, dtype=rho.dtype, device=rho.device)
        farthest = square[0].expand_as(self.dv.x)
        for moment in range(self.samples):  # few, and each a batch: all at once would take that many times the memory
            now = self._at(moment, deputies)
            square, last = _dot(now, now), square
            nearest = torch.minimum(nearest, _closest(before, now, last))
            farthest = torch.maximum(farthest, square[0])
            before = now
        return torch.sqrt(nearest).permute(3, 0, 2, 1), _rows_first(torch.sqrt(farthest))

    def _at(self, moment: int, deputies: Sequence[Vec3] = ()) -> Vec3:
        """Return positions at a moment, components [K, D, N] m; [O, K, D, N] relative to others, [O, 1, N], that drift on."""
        motion = self.motion
        drift = motion.at(moment, self.start, self.velocity)
        if deputies:
            drift = drift - motion.at(moment, *deputies)
        rv = Mat3(*(row.map(lambda x: x[moment].unsqueeze(1)) for row in motion.rv))
        return Vec3(*(_dot(row, self.dv, start.unsqueeze(-2)) for start, row in zip(drift, rv, strict=True)))


def transfers(motion: LinearMotion, rho: Tensor, velocity: Tensor, targets: Tensor, most: Tensor | None = None) -> Transfers:
    """Return transfers by the linear relative motion: ``rho' = rv^-1 (target - rr rho)``.

    No velocity leads to a target where ``rv`` is singular, on circular orbits after multiples of half a period: such transfers
    cost an infinity, and have no maneuver.

    Args:
        motion: Motion of deputies, for N chiefs and K durations.
        rho: Positions of deputies, [N, 3] m.
        velocity: Their velocities in the Hill frame, [N, 3] m/s.
        targets: Targets in the Hill frame of the arrival, [D, 3] m.
        most: Largest maneuvers, [N] m/s; larger ones are scaled down to it, and their paths miss the target.
    """
    start, before = Vec3.of(rho), Vec3.of(velocity)
    missed = Vec3.of(targets.unsqueeze(1)) - motion.at(-1, start, before).map(lambda x: x.unsqueeze(1))
    rv = Mat3(*(row.map(lambda x: x[-1].unsqueeze(1)) for row in motion.rv))
    dv = rv.solve(missed)
    cost = dv.norm()
    exists = torch.isfinite(cost)
    cost = torch.where(exists, cost, torch.inf)
    dv = dv.map(lambda x: torch.where(exists, x, 0.0))
    if most is not None:
        dv = dv * (most / cost.clamp(min=SMALLEST)).clamp(max=1.0)
    return Transfers(dv, _rows_first(cost), motion, start, before)


def closest(a: Vec3, b: Vec3) -> Tensor:
    """Return the square of the smallest distance of straight lines from a to b from the origin."""
    return _closest(a, b, _dot(a, a))


def _closest(a: Vec3, b: Vec3, square: Tensor) -> Tensor:
    """Return :func:`closest` for a known ``square`` of the distance of a."""
    way = b - a
    along, length = _dot(a, way), _dot(way, way)
    part = (along / length.clamp(min=SMALLEST)).neg_().clamp_(0.0, 1.0)
    # |a + part way|^2, which rounding must not make negative
    return torch.addcmul(square, part, torch.addcmul(along + along, part, length)).clamp_(min=0.0)


def _dot(a: Vec3, b: Vec3, start: Tensor | None = None) -> Tensor:
    """Return the scalar product, plus ``start``, with fewer passes over the memory than that of :class:`Vec3`."""
    first = a.x * b.x if start is None else torch.addcmul(start, a.x, b.x)
    return torch.addcmul(torch.addcmul(first, a.y, b.y), a.z, b.z)


def _rows_first(values: Tensor) -> Tensor:
    """Return values [K, D, N] as [N, D, K]."""
    return values.permute(2, 1, 0)
