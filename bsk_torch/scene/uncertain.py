"""Targets whose places are known only within an error."""

from __future__ import annotations

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.rand import Key
from bsk_torch.scene.draws import Numbers, calls_user, check_numbers, draw_numbers, horizontal
from bsk_torch.scene.overlaid import OverlaidTargets
from bsk_torch.scene.targets import TargetScenario
from bsk_torch.sim.orbit.arcs import FARTHEST

LARGEST = 1e5
"""Largest standard deviation of an error, m."""


class UncertainTargets(OverlaidTargets):
    """Targets of another scenario that lie near the places where they are believed to be.

    Satellites point at the believed places, of which they compute windows. The true place lies at the same distance from the
    Earth's center, farther along the surface by two independent normal errors in perpendicular directions, each with the standard
    deviation ``sigma``. It is drawn once for an episode. :class:`bsk_torch.data.FootprintImageReward` pays for images that show
    it.
    """

    def __init__(self, targets: TargetScenario, sigma: Numbers = 3000.0) -> None:
        """ValueError for a wrong argument. Numbers are drawn for each target in each episode; see :class:`UniformTargets`.

        Args:
            targets: Scenario that draws believed positions and priorities of the targets.
            sigma: Standard deviation of the error in each of two directions, m, up to 100,000.
        """
        super().__init__(targets)
        check_numbers("sigma", sigma, self.most_targets, low=0.0, high=LARGEST, unit="m")
        self.sigma = sigma

    @property
    @override
    def calls_user(self) -> bool:
        return super().calls_user or calls_user(self.sigma)

    def draw(self, key: Key) -> dict[str, Tensor]:
        """See :class:`TargetScenario`; adds ``location_sigma`` [n or 1, T] m and ``true_r_LP_P`` [n, T, 3] m."""
        drawn, t = super().draw(key), self.most_targets
        sigma = draw_numbers("sigma", self.sigma, key.named("location_sigma"), t, low=0.0, high=LARGEST, unit="m")
        error = sigma.unsqueeze(-1) * key.named("location_error").normal(2 * t).view(-1, t, 2)
        return drawn | {"location_sigma": sigma, "true_r_LP_P": displaced(drawn["target_r_LP_P"], error)}

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        return super()._bounds() | {"location_sigma": (0.0, LARGEST), "true_r_LP_P": (-FARTHEST, FARTHEST)}

    @property
    def location_sigma(self) -> Tensor:
        """Standard deviation of the error of each place in each of two directions, [N, T] m."""
        return self.drawn("location_sigma")

    @property
    def true_r_LP_P(self) -> Tensor:
        """True Earth-fixed positions, [N, T, 3] m; for rewards, not for observations."""
        return self.drawn("true_r_LP_P")


def displaced(r: Tensor, error: Tensor) -> Tensor:
    """Return places ``r`` [..., 3] m, moved by ``error`` [..., 2] m along great circles in two perpendicular directions."""
    one, other = horizontal(r)
    along = error[..., :1] * one + error[..., 1:] * other
    angle = error.norm(dim=-1, keepdim=True) / r.norm(dim=-1, keepdim=True)
    return r * angle.cos() + along * torch.sinc(angle / torch.pi)
