"""Action that commands an attitude."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.act.base import Decision
from bsk_torch.act.continuous import ContinuousAction
from bsk_torch.sim.fsw.setpoint import ATTITUDE_MRP, AttitudeSetpointFSWModel


class AttitudeSetpoint(ContinuousAction):
    """Turn to an attitude, and hold it: the action is sigma_RN, the MRP of the reference R relative to N.

    The reference is inertially fixed and stays until the next action. With reaction wheels, the control law turns the satellite
    the short way around. Components up to one allow MRPs longer than one, which represent the same attitudes. A satellite without
    actuators has the attitude of the reference after one tick, and reports the MRP as given, even if longer than one.
    """

    fsw_type = AttitudeSetpointFSWModel

    def __init__(self, name: str = "attitude_act", control_period: float = 60.0) -> None:
        """Last ``control_period`` seconds; ValueError unless it is positive and finite."""
        super().__init__(name)
        self.control_period = number(f"action {name!r}: control_period", control_period, 0.0, unit="s", above=True)

    def bounds(self) -> tuple[Tensor, Tensor]:
        """See :meth:`ContinuousAction.bounds`: -1 and 1."""
        one = torch.ones(3, dtype=torch.float64)
        return -one, one

    @override
    def names(self) -> list[str]:
        return ["mrp_1", "mrp_2", "mrp_3"]

    @override
    def decide(self, action: Tensor, mask: Tensor) -> Decision:
        return self.enter(ATTITUDE_MRP, torch.full_like(action[:, 0], self.control_period), action)

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """See :meth:`ContinuousAction.begin`: set the reference."""
        self.satellite.simulator.write("sigma_RN", mask, cast(Tensor, decision.command))
