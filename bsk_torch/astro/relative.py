"""Places, Hill frames and relative motion of NumPy arrays or tensors, under the names of BSK-RL's utilities.

Vectors are the last dimension, [..., 3]; the others broadcast. Results are tensors if an argument is one, else NumPy arrays, in
float64.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import torch
from torch import Tensor

from bsk_torch.astro.attitude import dcm_to_mrp
from bsk_torch.astro.orbit import hill_frame, hill_rate, hill_to_inertial
from bsk_torch.vec3 import Vec3

__all__ = ["cd2hill", "elevation", "fibonacci_sphere", "hill2cd", "lla2ecef", "rv2HN", "rv2omega"]

Numeric: TypeAlias = "float | Sequence[object] | np.ndarray | Tensor"
"""Numbers, sequences of them, arrays or tensors."""

GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
"""Angle between neighbors on Fibonacci's spiral, rad."""


def like(results: Tensor, *arguments: Numeric) -> Any:
    """Return ``results`` as a tensor if one of the ``arguments`` is, else as an array, or a number without dimensions."""
    return results if any(isinstance(value, Tensor) for value in arguments) else results.numpy()[()]


def float64(*values: Numeric) -> list[Tensor]:
    """Return numbers, sequences, arrays or tensors as float64 tensors."""
    return [torch.as_tensor(np.asarray(x) if not isinstance(x, Tensor) else x, dtype=torch.float64) for x in values]


def vectors(*values: Numeric) -> list[Vec3]:
    """Return vectors [..., 3]; ValueError for another last dimension."""
    tensors = float64(*values)
    for tensor in tensors:
        if not tensor.ndim or tensor.shape[-1] != 3:
            raise ValueError(f"a vector has shape {list(tensor.shape)}; it must be [3] or [..., 3]")
    return [Vec3.of(tensor) for tensor in tensors]


def elevation(r_sat: Numeric, r_target: Numeric) -> Any:
    """Return the elevation of satellites above the horizon of places, rad [...].

    ``pi / 2 - arccos(r_L . (r_S - r_L) / (|r_L| |r_S - r_L|))``

    Args:
        r_sat: Positions of satellites, [..., 3].
        r_target: Positions of places in the same frame and unit, [..., 3].
    """
    satellite, place = vectors(r_sat, r_target)
    away = satellite - place
    return like(0.5 * math.pi - torch.arccos(place.dot(away) / (place.norm() * away.norm())), r_sat, r_target)


def lla2ecef(lat: Numeric, long: Numeric, radius: Numeric) -> Any:
    """Return Earth-fixed positions of places on a sphere, [..., 3] in the unit of ``radius``.

    Args:
        lat: Latitude, degrees [...].
        long: Longitude, degrees [...].
        radius: Distance from the center [...].
    """
    up, east, r = torch.broadcast_tensors(*float64(lat, long, radius))
    up, east = torch.deg2rad(up), torch.deg2rad(east)
    unit = [torch.cos(up) * torch.cos(east), torch.cos(up) * torch.sin(east), torch.sin(up)]
    return like(r.unsqueeze(-1) * torch.stack(unit, -1), lat, long, radius)


def rv2HN(r_N: Numeric, v_N: Numeric) -> Any:
    """Return the DCM [HN] of the Hill frame, [..., 3, 3]: radial, along the track, and orbit normal.

    Args:
        r_N: Position, [..., 3].
        v_N: Velocity, [..., 3].
    """
    return like(hill_frame(*vectors(r_N, v_N)).stack(), r_N, v_N)


def rv2omega(r_N: Numeric, v_N: Numeric) -> Any:
    """Return the angular velocity omega_HN of the Hill frame, rad/s in N, [..., 3]: ``r x v / |r|^2``.

    Args:
        r_N: Position, m [..., 3].
        v_N: Velocity, m/s [..., 3].
    """
    r, v = vectors(r_N, v_N)
    return like((r.cross(v) / r.dot(r)).stack(), r_N, v_N)


def cd2hill(rc_N: Numeric, vc_N: Numeric, rd_N: Numeric, vd_N: Numeric) -> tuple[Any, Any]:
    """Return position, m, and velocity, m/s, of a deputy relative to a chief in the chief's Hill frame, [..., 3] each.

    ``rho = [HN] (r_D - r_C)`` and ``rho' = [HN] (v_D - v_C) - omega_HN x rho``: the velocity as seen in the rotating frame.

    Args:
        rc_N: Position of the chief, m [..., 3].
        vc_N: Velocity of the chief, m/s [..., 3].
        rd_N: Position of the deputy, m [..., 3].
        vd_N: Velocity of the deputy, m/s [..., 3].
    """
    r_C, v_C, r_D, v_D = vectors(rc_N, vc_N, rd_N, vd_N)
    HN, rate = hill_frame(r_C, v_C), hill_rate(r_C, v_C)
    rho = HN @ (r_D - r_C)
    velocity = HN @ (v_D - v_C) - Vec3(-rho.y * rate, rho.x * rate, torch.zeros_like(rho.z))
    arguments = (rc_N, vc_N, rd_N, vd_N)
    return like(rho.stack(), *arguments), like(velocity.stack(), *arguments)


def hill2cd(rc_N: Numeric, vc_N: Numeric, rho_H: Numeric, rho_deriv_H: Numeric) -> tuple[Any, Any]:
    """Return inertial position, m, and velocity, m/s, of a deputy, [..., 3] each: the inverse of :func:`cd2hill`.

    Args:
        rc_N: Position of the chief, m [..., 3].
        vc_N: Velocity of the chief, m/s [..., 3].
        rho_H: Relative position in the chief's Hill frame, m [..., 3].
        rho_deriv_H: Relative velocity as seen in that frame, m/s [..., 3].
    """
    arguments = (rc_N, vc_N, rho_H, rho_deriv_H)
    r, v = hill_to_inertial(*vectors(*arguments))
    return like(r.stack(), *arguments), like(v.stack(), *arguments)


def fibonacci_sphere(n_points: int) -> np.ndarray:
    """Return points spread over the unit sphere along Fibonacci's spiral, [n_points, 3]."""
    if n_points < 1:
        raise ValueError(f"n_points={n_points} must be at least 1")
    z, angle = np.linspace(1.0 / n_points - 1.0, 1.0 - 1.0 / n_points, n_points), GOLDEN_ANGLE * np.arange(n_points)
    return np.stack([np.sqrt(1.0 - z * z) * np.cos(angle), np.sqrt(1.0 - z * z) * np.sin(angle), z], -1)


def aligned_with_hill(r_N: Numeric, v_N: Numeric) -> tuple[Tensor, Tensor, Tensor]:
    """Return attitude sigma_BN [3] and rate omega_HN_B [3] rad/s of a body whose axes are those of the Hill frame, and [HN]."""
    r, v = vectors(r_N, v_N)
    zero = torch.zeros_like(r.x)
    HN = hill_frame(r, v)
    return dcm_to_mrp(HN).stack(), torch.stack([zero, zero, hill_rate(r, v)], -1), HN.stack()
