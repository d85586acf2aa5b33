"""Rewards for images of targets whose places are uncertain."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number, switch
from bsk_torch.data.images import UniqueImageReward, identity

if TYPE_CHECKING:
    from bsk_torch.sats.bound import SatelliteFleet
    from bsk_torch.scene.base import Scenario
    from bsk_torch.scene.overlaid import UncertainTargets


class FootprintImageReward(UniqueImageReward):
    """Reward for the first image of every target, given if the image shows the true place of the target.

    An image shows what lies within ``half_angle`` of the instrument's axis when it is taken, on the side of the Earth that faces
    the satellite. Images from farther away therefore show more ground. The counter ``off_target`` [N, S] is the number of images
    that do not show their target.
    """

    scenario: UncertainTargets

    def __init__(self, half_angle: float, hide_missed: bool = True, reward_fn: Callable[[Tensor], Tensor] = identity) -> None:
        """Reward images that show their targets.

        Args:
            half_angle: Half of the angle of view, rad, at most pi / 2. Images are taken with pointing errors of up to four times
                the inverse tangent of ``imageAttErrorRequirement``, 0.04 rad by default.
            hide_missed: Whether a target is hidden after an image that does not show it, as after one that does.
            reward_fn: Function from priorities [N, S] to rewards [N, S].
        """
        super().__init__(reward_fn)
        self.half_angle = number("half_angle", half_angle, 0.0, 0.5 * math.pi, unit="rad", above=True)
        self.hide_missed = switch("hide_missed", hide_missed)

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """See :meth:`UniqueImageReward.link`; ValueError without uncertain places."""
        if not hasattr(scenario, "true_r_LP_P"):
            raise ValueError(f"FootprintImageReward needs scene.UncertainTargets; the scenario is {type(scenario).__name__}")
        super().link(scenario, fleet)
        self.memory.declare("off_target", 0, fleet.size, low=0)

    @override
    def counts(self) -> dict[str, Tensor]:
        return super().counts() | {"off_target": self.memory["off_target"]}

    def shows(self, target: Tensor) -> Tensor:
        """Return whether an image that each satellite takes now shows the true place of ``target`` [N, S], [N, S] bool."""
        place = self.scenario.look_up(self.scenario.true_r_LP_P, target)
        satellite = self.fleet.each(lambda part: part.dynamics.r_BN_P)
        axis = self.fleet.each(lambda part: part.fsw.c_hat_P)
        ray = place - satellite
        along = (ray * axis).sum(-1)
        across = torch.linalg.cross(ray, axis.to(ray)).norm(dim=-1)  # exact for small angles, where acos is not
        faces = (ray * place).sum(-1) < 0.0
        return (torch.atan2(across, along) <= self.half_angle) & faces

    @override
    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        off = taken & ~self.shows(target)
        self.memory["off_target"] = self.memory["off_target"] + off
        reward = super().value(target, taken if self.hide_missed else taken & ~off)
        return torch.where(off, torch.zeros_like(reward), reward)
