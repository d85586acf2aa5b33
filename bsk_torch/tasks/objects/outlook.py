"""What imagers can expect of images of objects of a catalog, and orders of candidates by it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.eclipse import illumination
from bsk_torch.constants import MU_EARTH
from bsk_torch.tasks.objects.candidates import Moment
from bsk_torch.vec3 import Vec3

if TYPE_CHECKING:
    from bsk_torch.sats.bound import BoundSatellite
    from bsk_torch.tasks.objects.scene import RSOTargets

START = 40.0
"""Time for an image in the direction of the instrument, s; among 20, 40 and 80 s, that with the best returns in Services-v1."""

PER_DEGREE = 1.0
"""Additional time for each degree from this direction, s; what orders by the present angle assume."""

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


def by_priority_per_second(scenario: RSOTargets, satellite: BoundSatellite) -> Tensor:
    """Rank objects by the priority that an image brings per second, the largest first, [n, G].

    An image of an object at an angle from the axis of the instrument is taken to last ``START + PER_DEGREE * angle``, and to be
    worth its priority if the object is lit now. Objects in the dark come next, those behind the Earth last, by their angles.
    """
    r_TN_N = satellite.of_env(scenario.r_TN_N)
    rho = r_TN_N - satellite.dynamics.r_BN_N.unsqueeze(1)
    cosine = (rho * scenario.axis_N(satellite).unsqueeze(1)).sum(-1) / rho.norm(dim=-1)
    angle = torch.rad2deg(torch.acos(cosine.clamp(-1.0, 1.0)))
    light = illumination(Vec3.of(r_TN_N), Vec3.of(satellite.simulator.world.r_SN_N.unsqueeze(1).expand_as(r_TN_N)))
    clear = scenario.in_sight(satellite, scenario.all_targets(satellite))
    rate = satellite.of_env(scenario.priority) / (START + PER_DEGREE * angle)
    return torch.where(clear, torch.where(light >= LIT, -rate, angle), 360.0 + angle)


def by_priority_per_second_ahead(scenario: RSOTargets, satellite: BoundSatellite) -> Tensor:
    """Rank objects by the priority per second that can be expected of an image, the largest first, [n, G].

    Duration, light and sight are those expected for the end of the image; see
    :class:`~bsk_torch.tasks.objects.outlook.Outlook`. Objects that will be in the dark come next, those that will be behind the
    Earth last, by their durations.
    """
    outlook = scenario.outlook(satellite, scenario.all_targets(satellite))
    rate, seconds = expected_rate(satellite.of_env(scenario.priority), outlook), outlook.expected_duration
    last = torch.where(outlook.expected_in_sight > 0.0, seconds, 360.0 + seconds)
    return torch.where(rate > 0.0, -rate, last)
