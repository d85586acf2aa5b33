"""Quintic Hermite interpolation between orbit nodes."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from bsk_torch.vec3 import Vec3


class Node(NamedTuple):
    """Position, m, velocity, m/s, and acceleration, m/s^2, at one time."""

    r: Vec3
    v: Vec3
    a: Vec3


def quintic_position(s: Tensor, step: float, start: Node, end: Node) -> Vec3:
    """Position at the fraction s of the interval of ``step`` seconds between two nodes.

    The quintic that matches both nodes; for a low orbit and 60 s its error is below 0.02 mm.
    """
    s3 = s * s * s
    rise = s3 * (10.0 + s * (-15.0 + 6.0 * s))
    v0 = (s + s3 * (-6.0 + s * (8.0 - 3.0 * s))) * step
    v1 = s3 * (-4.0 + s * (7.0 - 3.0 * s)) * step
    a0 = (0.5 * s * s + s3 * (-1.5 + s * (1.5 - 0.5 * s))) * (step * step)
    a1 = s3 * (0.5 + s * (-1.0 + 0.5 * s)) * (step * step)
    return start.r + (end.r - start.r) * rise + start.v * v0 + end.v * v1 + start.a * a0 + end.a * a1


def quintic_velocity(s: Tensor, step: float, start: Node, end: Node) -> Vec3:
    """Velocity: derivative of :func:`quintic_position`."""
    s2 = s * s
    rise = s2 * (30.0 + s * (-60.0 + 30.0 * s)) / step
    v0 = 1.0 + s2 * (-18.0 + s * (32.0 - 15.0 * s))
    v1 = s2 * (-12.0 + s * (28.0 - 15.0 * s))
    a0 = (s + s2 * (-4.5 + s * (6.0 - 2.5 * s))) * step
    a1 = s2 * (1.5 + s * (-4.0 + 2.5 * s)) * step
    return (end.r - start.r) * rise + start.v * v0 + end.v * v1 + start.a * a0 + end.a * a1
