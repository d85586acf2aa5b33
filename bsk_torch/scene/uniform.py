"""Targets spread uniformly over the Earth."""

from __future__ import annotations

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.constants import R_EARTH
from bsk_torch.rand import Key, Uniform
from bsk_torch.scene.draws import (
    Count,
    Numbers,
    calls_user,
    check_numbers,
    check_radius,
    columns_for,
    count_range,
    draw_exists,
    draw_numbers,
    on_sphere,
)
from bsk_torch.scene.targets import TargetScenario
from bsk_torch.sim.hooks import check_class

AT_ONCE = 1 << 16
"""Targets whose positions are computed at once: temporary tensors that leave the processor's cache take twice as long."""


class UniformTargets(TargetScenario):
    """Targets drawn uniformly by area from a sphere in every episode.

    For other layouts, subclasses define :meth:`places`.
    """

    @override
    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_class(cls, UniformTargets, ("places",))

    def __init__(self, n_targets: Count, priority_distribution: Numbers | None = None, radius: float = R_EARTH) -> None:
        """ValueError for a wrong argument.

        Args:
            n_targets: Number of targets, or a range (low, high) from which the number is drawn in each episode. ``high`` is
                exclusive. Without targets, satellites that look for targets raise RuntimeError, unless they are built with
                ``may_see_nothing=True``.
            priority_distribution: Priority of each target: a number, a distribution, or a callable without arguments
                called for each target; None for uniform in [0, 1).
            radius: Distance of the targets from the Earth's center, m.
        """
        self.low, self.end = count_range("n_targets", n_targets)
        self.most_targets = columns_for(self.end)
        self.priority_distribution = Uniform() if priority_distribution is None else priority_distribution
        check_numbers("priority_distribution", self.priority_distribution, self.most_targets)
        self.radius = check_radius("radius", radius)

    @property
    @override
    def calls_user(self) -> bool:
        return calls_user(self.priority_distribution)

    @override
    def draw(self, key: Key) -> dict[str, Tensor]:
        exists = self.draw_exists(key)
        named = key.named("target_priority")
        priority = draw_numbers("priority_distribution", self.priority_distribution, named, self.most_targets)
        return {**self.places(key), "target_priority": priority * exists, "target_exists": exists}

    def draw_exists(self, key: Key) -> Tensor:
        """Draw the number of targets; return 1.0 for the columns of targets, 0.0 for padding, [n or 1, T]."""
        return draw_exists(key.named("target_count"), self.low, self.end)

    def places(self, key: Key) -> dict[str, Tensor]:
        """Draw positions: return ``target_r_LP_P`` [n or 1, T, 3] m, and optionally further values of the targets, by name."""
        u = key.named("target_r_LP_P").uniform(2 * self.most_targets)
        blocks = u.view(len(key), -1, 2).split(max(1, AT_ONCE // self.most_targets))
        return {"target_r_LP_P": torch.cat([self.radius * on_sphere(block) for block in blocks])}
