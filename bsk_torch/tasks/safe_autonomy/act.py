"""Action that sets the force of the thrusters of a deputy close to a chief."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import function, number
from bsk_torch.act.base import Decision
from bsk_torch.act.continuous import ContinuousAction
from bsk_torch.tasks.safe_autonomy.assurance import Assurance, Deputies
from bsk_torch.tasks.safe_autonomy.dyn import LinearMotionDynModel

if TYPE_CHECKING:
    from bsk_torch.sats.bound import BoundSatellite


NOTICED = 0.01
"""Change of a force that counts as an intervention, N."""


class HeldThrust(ContinuousAction):
    """Thrust with a constant force: three numbers, N along the axes of the chief's Hill frame (radial, along-track, normal).

    Components beyond ``max_thrust`` are reduced to it. The satellite's dynamics must include
    :class:`~bsk_torch.tasks.safe_autonomy.LinearMotionDynModel`. Run-time assurance then changes forces that would be unsafe
    (:mod:`bsk_torch.tasks.safe_autonomy.assurance`), also while a policy is trained: rewards are those of the forces exerted.
    The memory ``interventions`` of the satellite counts the actions changed by more than 0.01 N.
    """

    def __init__(
        self,
        name: str = "held_thrust",
        max_thrust: float = 1.0,
        duration: float | None = None,
        assurance: Assurance | None = None,
    ) -> None:
        """Thrust for some time.

        Args:
            name: Name of the entry.
            max_thrust: Maximum of each component, N.
            duration: Time for which the force is constant, s; None for one tick.
            assurance: Filter of forces, such as ``assurance.Barriers(assurance.DOCKING)``: a function of deputies, forces
                [N, 3] N and their duration, s, that returns safe forces; None for none.

        Raises:
            ValueError: For a number that is not positive and finite, or a filter that is not a function.
        """
        super().__init__(name)
        self.max_thrust = number(f"action {name!r}: max_thrust", max_thrust, 0.0, unit="N", above=True)
        self.duration = None if duration is None else number(f"action {name!r}: duration", duration, 0.0, unit="s", above=True)
        self.assurance = None if assurance is None else function("assurance", assurance, "deputies, forces and seconds")

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`ContinuousAction.link_satellite`; ValueError for other dynamics."""
        super().link_satellite(satellite)
        if not isinstance(satellite.dynamics, LinearMotionDynModel):
            model = type(satellite.dynamics).__name__
            raise ValueError(f"HeldThrust {self.name!r} needs LinearMotionDynModel; {satellite.name} has {model}")
        if self.assurance is not None:
            satellite.simulator.memory.declare("interventions", 0, low=0)

    @override
    def bounds(self) -> tuple[Tensor, Tensor]:
        high = torch.full((3,), self.max_thrust, dtype=torch.float64)
        return -high, high

    @override
    def names(self) -> list[str]:
        return ["force_H_x", "force_H_y", "force_H_z"]

    @override
    def decide(self, action: Tensor, mask: Tensor) -> Decision:
        duration = self.satellite.simulator.h if self.duration is None else self.duration
        force_H = wish = action.clamp(-self.max_thrust, self.max_thrust)
        if self.assurance is not None:
            force_H = self.assurance(Deputies.of(self.satellite, self.max_thrust), wish, duration)
        command = torch.cat([force_H, (force_H - wish).square().sum(1, keepdim=True)], 1)
        return self.enter("drift", torch.full_like(action[:, 0], duration), command)

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """See :meth:`ContinuousAction.begin`: set the force, and count interventions."""
        simulator, command = self.satellite.simulator, cast(Tensor, decision.command)
        simulator.write("force_H", mask, command[:, :3])
        if self.assurance is not None:
            memory = simulator.memory
            memory["interventions"] = memory["interventions"] + (mask & (command[:, 3] > NOTICED**2))
