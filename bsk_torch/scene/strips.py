"""Targets that are strips on the ground."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.rand import Key, Uniform
from bsk_torch.scene.draws import Numbers, calls_user, check_numbers, draw_numbers, horizontal
from bsk_torch.scene.overlaid import OverlaidTargets
from bsk_torch.scene.targets import TargetScenario
from bsk_torch.sim.orbit.arcs import FARTHEST

SHORTEST, LONGEST = 1.0, 1e7
"""Bounds of the length of a strip, m; the longest one is a quarter of the Earth's circumference."""


class StripTargets(OverlaidTargets):
    """Strips along great circles, whose middles are the targets of another scenario and whose directions are uniform.

    An instrument records a strip at a constant speed, from its start to its end; see :class:`bsk_torch.act.ImageStrip` and
    :class:`bsk_torch.data.StripImageReward`. Windows are those of the middle.
    """

    def __init__(
        self,
        targets: TargetScenario,
        length: Numbers = Uniform(50e3, 300e3),  # noqa: B008  frozen
        acquisition_speed: float = 3000.0,
    ) -> None:
        """ValueError for a wrong argument. Numbers are drawn for each target in each episode; see :class:`UniformTargets`.

        Args:
            targets: Scenario that draws middles and priorities of the strips.
            length: Length of each strip, m, from 1 to 10,000,000.
            acquisition_speed: Speed at which strips are recorded, m/s.
        """
        super().__init__(targets)
        check_numbers("length", length, self.most_targets, low=SHORTEST, high=LONGEST, unit="m")
        self.length, self.acquisition_speed = length, number("acquisition_speed", acquisition_speed, 0.0, unit="m/s", above=True)

    @property
    @override
    def calls_user(self) -> bool:
        return super().calls_user or calls_user(self.length)

    def draw(self, key: Key) -> dict[str, Tensor]:
        """See :class:`TargetScenario`; adds ``strip_length`` [n or 1, T] m and ``strip_along`` [n, T, 3] m.

        ``strip_along`` is the direction of the strip in its middle, as long as the middle's position.
        """
        drawn, t = super().draw(key), self.most_targets
        middle = drawn["target_r_LP_P"]
        length = draw_numbers("length", self.length, key.named("strip_length"), t, low=SHORTEST, high=LONGEST, unit="m")
        azimuth = 2.0 * math.pi * key.named("strip_azimuth").uniform(t).unsqueeze(-1)
        one, other = horizontal(middle)
        along = (azimuth.cos() * one + azimuth.sin() * other) * middle.norm(dim=-1, keepdim=True)
        return drawn | {"strip_length": length, "strip_along": along}

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        return super()._bounds() | {"strip_length": (SHORTEST, LONGEST), "strip_along": (-FARTHEST, FARTHEST)}

    @property
    def strip_length(self) -> Tensor:
        """Length of each strip, [N, T] m."""
        return self.drawn("strip_length")

    @property
    def strip_along(self) -> Tensor:
        """Direction of each strip in its middle, as long as the position of the middle, [N, T, 3] m, Earth-fixed."""
        return self.drawn("strip_along")

    @property
    def strip_seconds(self) -> Tensor:
        """Time in which each strip is recorded, [N, T] s."""
        return self.strip_length / self.acquisition_speed

    def ends(self) -> tuple[Tensor, Tensor]:
        """Return starts and ends of all strips, [N, T, 3] m each, Earth-fixed."""
        half = (0.5 * self.strip_length / self.r_LP_P.norm(dim=-1)).unsqueeze(-1)
        across, along = self.r_LP_P * torch.cos(half), self.strip_along * torch.sin(half)
        return across - along, across + along
