"""What imagers see of the objects of a catalog at a decision: their order as candidates, and properties of the first ones.

The rules are those of space-to-space imaging on Basilisk.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.eclipse import illumination
from bsk_torch.astro.orbit import hill_frame
from bsk_torch.vec3 import Vec3

LOWEST, HIGHEST = -21.0, 90.0
"""Elevations, degrees above the local horizontal of the imager, between which objects come first, by their elevation."""

BEHIND = 1e3
"""Rank of an object at no distance that does not come first; above all elevations."""


class Candidates(NamedTuple):
    """Objects among which n satellites choose, in their order."""

    place: Tensor  # numbers of the objects, [n, k]; 0 for those that do not exist
    exists: Tensor  # whether there is an object, [n, k]


def in_order(r_TN_N: Tensor, r_BN_N: Tensor, eligible: Tensor) -> Candidates:
    """Return the eligible objects T of n satellites B in the order of candidates, all of them.

    First come those with an elevation in [LOWEST, HIGHEST], in ascending order, then the others by distance. The elevation is
    ``asin(rho . r / (|rho| |r|))`` with ``rho = r_TN - r_BN`` and ``r = r_BN``. Whether the Earth is in the way does not matter.

    Args:
        r_TN_N: Positions of the objects, [3, n, G] m.
        r_BN_N: Positions of the satellites, [n, 3] m.
        eligible: Objects that can be chosen, [n, G].
    """
    r = Vec3(*r_BN_N.mT.unsqueeze(-1))
    rho = Vec3(*r_TN_N) - r
    distance = rho.norm()
    sine = rho.dot(r) / (distance * r.norm())
    elevation = torch.rad2deg(torch.asin(sine.clamp(-1.0, 1.0)))
    first = (elevation >= LOWEST) & (elevation <= HIGHEST)
    return ranked(torch.where(first, elevation, BEHIND + distance), eligible)


def ranked(rank: Tensor, eligible: Tensor) -> Candidates:
    """Return the eligible objects in ascending order of their ranks; those of infinite rank do not exist. [n, G] each."""
    in_turn, place = torch.where(eligible, rank, math.inf).sort(stable=True)
    exists = torch.isfinite(in_turn)
    return Candidates(torch.where(exists, place, 0), exists)


class Views(NamedTuple):
    """Properties of objects T as satellites B see them, [n, k] or [n, k, 3] each.

    Attributes:
        target_elevation_angle: Angle above the local horizontal, degrees.
        rel_pos_vector_r_BR_H: ``r_TN - r_BN`` in the Hill frame of the satellite, m.
        rel_vel_vector_v_BR_H: ``v_TN - v_BN``, a difference of inertial velocities, in the same frame, m/s.
        angle_to_target: Angle between the axis of the instrument and the direction to the object, degrees.
        target_distance: Distance, m.
        target_illumination_factor: Visible fraction of the Sun at the position of the object one tick ago.
    """

    target_elevation_angle: Tensor
    rel_pos_vector_r_BR_H: Tensor
    rel_vel_vector_v_BR_H: Tensor
    angle_to_target: Tensor
    target_distance: Tensor
    target_illumination_factor: Tensor


class Moment(NamedTuple):
    """Satellites at a decision, [n, 3] each, in N: position, m, velocity, m/s, axis of the instrument, and the Sun, m."""

    r_BN_N: Tensor
    v_BN_N: Tensor
    axis_N: Tensor
    r_SN_N: Tensor


def views(r_TN_N: Tensor, v_TN_N: Tensor, before_N: Tensor, at: Moment) -> Views:
    """Return what satellites see of objects.

    Args:
        r_TN_N: Positions of the objects, [n, k, 3] m.
        v_TN_N: Velocities of the objects, [n, k, 3] m/s.
        before_N: Positions of the objects one tick ago, [n, k, 3] m.
        at: The satellites.
    """
    r, v = at.r_BN_N.unsqueeze(1), at.v_BN_N.unsqueeze(1)
    rho, distance = r_TN_N - r, (r_TN_N - r).norm(dim=-1)
    HN = hill_frame(Vec3.of(at.r_BN_N), Vec3.of(at.v_BN_N)).stack()
    sine = (rho * r).sum(-1) / (distance * r.norm(dim=-1))
    cosine = (rho * at.axis_N.unsqueeze(1)).sum(-1) / distance
    light = illumination(Vec3.of(before_N), Vec3.of(at.r_SN_N.unsqueeze(1).expand_as(before_N)))
    return Views(
        torch.rad2deg(torch.asin(sine.clamp(-1.0, 1.0))),
        rho @ HN.mT,
        (v_TN_N - v) @ HN.mT,
        torch.rad2deg(torch.acos(cosine.clamp(-1.0, 1.0))),
        distance,
        light,
    )
