"""Orders of candidates among resident space objects (RSO), for :class:`~bsk_torch.tasks.objects.RSOTargets`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch.astro.eclipse import illumination
from bsk_torch.tasks.objects.outlook import LIT, expected_rate
from bsk_torch.vec3 import Vec3

if TYPE_CHECKING:
    from bsk_torch.sats.bound import BoundSatellite
    from bsk_torch.tasks.objects.scene import RSOTargets

START = 40.0
"""Time for an image in the direction of the instrument, s; among 20, 40 and 80 s, that with the best returns in Services-v1."""

PER_DEGREE = 1.0
"""Additional time for each degree from this direction, s."""


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
