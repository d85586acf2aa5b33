"""Targets of another scenario with more drawn values, such as clouds or errors of their places."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from torch import Tensor
from typing_extensions import override

from bsk_torch.rand import Key
from bsk_torch.scene.targets import TargetScenario

if TYPE_CHECKING:
    from bsk_torch.sats.fleet import SatelliteFleet
    from bsk_torch.sim.places import Places, PlaceTables


class OverlaidTargets(TargetScenario):
    """Base class of scenarios that add values to the targets of another one; subclasses extend ``draw`` and ``_bounds``."""

    targets: TargetScenario

    def __init__(self, targets: TargetScenario) -> None:
        """Take positions and priorities from ``targets``; ValueError for another scenario, or one that adds the same values."""
        if not isinstance(targets, TargetScenario):
            raise ValueError(f"targets={targets!r} must be a scenario of point targets, such as scene.UniformTargets(300)")
        within: TargetScenario | None = targets
        while isinstance(within, OverlaidTargets):
            if isinstance(within, type(self)) or isinstance(self, type(within)):
                raise ValueError(
                    f"targets={targets!r} has a {type(within).__name__} already, whose values {type(self).__name__} would replace"
                )
            within = within.targets
        self.targets, self.most_targets = targets, targets.most_targets

    @property
    @override
    def calls_user(self) -> bool:
        return self.targets.calls_user

    @property
    @override
    def varies_population(self) -> bool:
        return self.targets.varies_population

    @override
    def present(self, key: Key, names: Sequence[str]) -> Tensor:
        return self.targets.present(key, names)

    @property
    @override
    def target_names(self) -> list[str]:
        return self.targets.target_names

    @override
    def names(self, row: int) -> list[str]:
        return self.targets.names(row)

    def place_kinds(self, tables: PlaceTables) -> Mapping[str, Places]:
        """See :meth:`Scenario.place_kinds`; the places of the other scenario."""
        return self.targets.place_kinds(tables)

    def draw(self, key: Key) -> dict[str, Tensor]:
        """See :class:`TargetScenario`; the values of the other scenario."""
        return self.targets.draw(key)

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        return self.targets._bounds()

    # -- in an environment --------------------------------------------------------------------------------------------

    @override
    def link(self, fleet: SatelliteFleet) -> None:
        self.targets = copy.copy(self.targets)  # environments that share this scenario each link their own
        self.targets.link(fleet)
        super().link(fleet)

    @property
    @override
    def priority(self) -> Tensor:
        return self.targets.priority

    @property
    @override
    def available(self) -> Tensor:
        return self.targets.available

    @override
    def reset(self, rows: Tensor) -> None:
        super().reset(rows)
        self.targets.reset(rows)

    @override
    def after_step(self, sim_time: Tensor) -> None:
        super().after_step(sim_time)
        self.targets.after_step(sim_time)

    @override
    def _forget_draws(self, rows: Tensor) -> None:
        super()._forget_draws(rows)
        self.targets._forget_draws(rows)

    @override
    def _forget_time(self) -> None:
        super()._forget_time()
        self.targets._forget_time()

    @override
    def _keep_time(self) -> None:
        super()._keep_time()
        self.targets._keep_time()
