"""What imagers can expect of images of objects of a catalog: how long they take, and what is seen when they end."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.constants import MU_EARTH
from bsk_torch.tasks.objects.candidates import Moment
from bsk_torch.vec3 import Vec3

START = 40.0
"""Time for an image in the direction of the instrument, s."""

PER_ROOT = 8.0
"""Additional time for a turn, s per square root of a degree; flown images of Services-v1 take this time on average."""

PASSES = 2
"""How often the turn is computed: its end depends on where the object is then."""


LIT = 0.5
"""Least visible fraction of the Sun at an object that is worth an image."""


class Outlook(NamedTuple):
    """What can be expected of images of objects by satellites, [n, k] each.

    Attributes:
        expected_duration: Time until the end of the image, s.
        expected_elevation_angle: Angle of the object above the local horizontal then, degrees.
        expected_illumination_factor: Visible fraction of the Sun at the object then.
        expected_in_sight: 1 where the satellite sees the object past the Earth and within its range then, else 0.
    """

    expected_duration: Tensor
    expected_elevation_angle: Tensor
    expected_illumination_factor: Tensor
    expected_in_sight: Tensor


class ImageEnd(NamedTuple):
    """Ends of images: time until then, [n, k] s, and positions of objects and satellites then, [n, k] m in N."""

    duration: Tensor
    r_TN_N: Vec3
    r_BN_N: Vec3


def coast(r_N: Vec3, v_N: Vec3, seconds: Tensor) -> Vec3:
    """Return positions [...] m after ``seconds`` [...] on circles, without perturbations.

    Args:
        r_N: Positions, [...] m; they and the velocities may be those on an ellipse, for a fraction of an orbit.
        v_N: Velocities, [...] m/s.
        seconds: Times, [...] s.
    """
    square = r_N.dot(r_N)
    rate = (MU_EARTH / (square * square.sqrt())).sqrt()
    phase = rate * seconds
    return r_N * phase.cos() + v_N * (phase.sin() / rate)


def elevation(r_TN_N: Vec3, r_BN_N: Vec3) -> Tensor:
    """Return angles of objects T above the local horizontal of satellites B, [...] degrees, for positions [...]."""
    rho = r_TN_N - r_BN_N
    sine = rho.dot(r_BN_N) / (rho.norm() * r_BN_N.norm())
    return torch.rad2deg(torch.asin(sine.clamp(-1.0, 1.0)))


def image_end(r_TN_N: Vec3, v_TN_N: Vec3, at: Moment) -> ImageEnd:
    """Return when images of objects are expected to end that satellites begin now, and where both are then.

    An image takes ``START + PER_ROOT * sqrt(angle)``, with the angle in degrees from the present axis of the instrument to the
    direction to the object at the end.

    Args:
        r_TN_N: Positions of the objects, [n, k] m.
        v_TN_N: Velocities of the objects, [n, k] m/s.
        at: The satellites.
    """
    r_BN_N, v_BN_N, axis_N = (Vec3.of(part.unsqueeze(1)) for part in (at.r_BN_N, at.v_BN_N, at.axis_N))
    end = ImageEnd(torch.zeros_like(r_TN_N.x), r_TN_N, r_BN_N)
    for _ in range(PASSES):
        rho = end.r_TN_N - end.r_BN_N
        cosine = rho.dot(axis_N) / rho.norm()
        duration = START + PER_ROOT * torch.rad2deg(torch.acos(cosine.clamp(-1.0, 1.0))).sqrt()
        end = ImageEnd(duration, coast(r_TN_N, v_TN_N, duration), coast(r_BN_N, v_BN_N, duration))
    return end


def expected_rate(priority: Tensor, outlook: Outlook) -> Tensor:
    """Return the priority [n, k] that images bring per second; 0 for objects that will be in the dark or out of sight."""
    good = (outlook.expected_in_sight > 0.0) & (outlook.expected_illumination_factor >= LIT)
    return torch.where(good, priority / outlook.expected_duration, 0.0)
