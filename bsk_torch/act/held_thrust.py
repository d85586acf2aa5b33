"""Action that sets the force of the thrusters of a deputy close to a chief."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import torch
from torch import Tensor

from bsk_torch._checks import number
from bsk_torch.act.base import Decision
from bsk_torch.act.continuous import ContinuousAction
from bsk_torch.sim.dyn.linear_motion import LinearMotionDynModel

if TYPE_CHECKING:
    from bsk_torch.sats.bound import BoundSatellite


class HeldThrust(ContinuousAction):
    """Thrust with a constant force: three numbers, N along the axes of the chief's Hill frame (radial, along-track, normal).

    Components beyond ``max_thrust`` are reduced to it. The satellite's dynamics must include
    :class:`~bsk_torch.sim.dyn.LinearMotionDynModel`.
    """

    def __init__(self, name: str = "held_thrust", max_thrust: float = 1.0, duration: float | None = None) -> None:
        """Thrust for some time.

        Args:
            name: Name of the entry.
            max_thrust: Maximum of each component, N.
            duration: Time for which the force is constant, s; None for one tick.

        Raises:
            ValueError: For a number that is not positive and finite.
        """
        super().__init__(name)
        self.max_thrust = number(f"action {name!r}: max_thrust", max_thrust, 0.0, unit="N", above=True)
        self.duration = None if duration is None else number(f"action {name!r}: duration", duration, 0.0, unit="s", above=True)

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`ContinuousAction.link_satellite`; ValueError for other dynamics."""
        super().link_satellite(satellite)
        if not isinstance(satellite.dynamics, LinearMotionDynModel):
            model = type(satellite.dynamics).__name__
            raise ValueError(f"HeldThrust {self.name!r} needs dyn.LinearMotionDynModel; {satellite.name} has {model}")

    def bounds(self) -> tuple[Tensor, Tensor]:
        """See :meth:`ContinuousAction.bounds`."""
        high = torch.full((3,), self.max_thrust, dtype=torch.float64)
        return -high, high

    def names(self) -> list[str]:
        """See :meth:`ContinuousAction.names`."""
        return ["force_H_x", "force_H_y", "force_H_z"]

    def decide(self, action: Tensor, mask: Tensor) -> Decision:
        """See :meth:`ContinuousAction.decide`."""
        duration = self.satellite.simulator.h if self.duration is None else self.duration
        force_H = action.clamp(-self.max_thrust, self.max_thrust)
        return self.enter("drift", torch.full_like(action[:, 0], duration), force_H)

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """See :meth:`ContinuousAction.begin`: set the force."""
        self.satellite.simulator.write("force_H", mask, cast(Tensor, decision.command))
