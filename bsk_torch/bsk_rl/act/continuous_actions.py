"""Actions of real numbers."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from typing_extensions import override

from bsk_torch.bsk_rl.act.actions import Action, ActionBuilder

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite


class ContinuousActionBuilder(ActionBuilder):
    """Passes the values of an action to the only entry of the specification."""

    def __init__(self, satellite: Satellite) -> None:
        """See :class:`ActionBuilder`; AssertionError for several entries."""
        super().__init__(satellite)
        assert len(self.action_spec) == 1, "Only one continuous action is supported."

    @property
    @override
    def action_space(self) -> spaces.Box:
        return self.action_spec[0].space

    @property
    @override
    def action_description(self) -> list[str]:
        names = self.action_spec[0].action_description
        return names() if callable(names) else names  # a method in programs of bsk_rl, which calls it

    @override
    def set_action(self, action: Any) -> None:
        self.action_spec[0].set_action(action)


class ContinuousAction(Action):
    """An action given by real numbers."""

    builder_type = ContinuousActionBuilder

    def __init__(self, name: str = "discrete_act") -> None:
        super().__init__(name=name)

    @property
    @abstractmethod
    def space(self) -> spaces.Box:
        """Space of the numbers."""

    @property
    @abstractmethod
    def action_description(self) -> list[str]:
        """Names of the numbers."""


class ImpulsiveThrust(ContinuousAction):
    """Changes the velocity, m/s in N, and drifts for a time, s: four numbers."""

    def __init__(
        self,
        name: str = "thrust_act",
        max_dv: float = float("inf"),
        max_drift_duration: float = float("inf"),
        fsw_action: str | None = None,
    ) -> None:
        """Change the velocity by at most ``max_dv`` m/s, and drift for at most ``max_drift_duration`` s by ``fsw_action``."""
        super().__init__(name)
        self.max_dv, self.max_drift_duration, self.fsw_action = max_dv, max_drift_duration, fsw_action

    @property
    @override
    def space(self) -> spaces.Box:
        high = np.array([self.max_dv] * 3 + [self.max_drift_duration])
        low = np.array([-self.max_dv] * 3 + [2 * self.simulator.sim_rate])
        return spaces.Box(low=low, high=high, shape=(4,), dtype=np.float32)

    @property
    @override
    def action_description(self) -> list[str]:
        return ["dV_N_x", "dV_N_y", "dV_N_z", "duration"]

    def set_action(self, action: np.ndarray) -> None:
        """See :meth:`ContinuousAction.set_action`; lengths and durations are clamped."""
        assert len(action) == 4, "Action must have 4 elements."
        dv_N, requested = action[0:3], action[3]
        size = np.linalg.norm(dv_N)
        if size > self.max_dv:
            self.satellite.logger.info("Thrust clamped from %s m/s to %s m/s.", size, self.max_dv)
            dv_N = dv_N / size * self.max_dv
        duration = np.clip(requested, 2 * self.satellite.simulator.sim_rate, self.max_drift_duration)
        if duration != requested:
            self.satellite.logger.warning("Requested drift duration %s out of range. Clamping to %s.", requested, duration)
        self.satellite.logger.info("Thrusting with inertial dV %s with %s second drift.", dv_N, duration)
        self.satellite.fsw.action_impulsive_thrust(dv_N)
        self.satellite.update_timed_terminal_event(self.satellite.simulator.sim_time + duration)
        if self.fsw_action is not None:
            getattr(self.satellite.fsw, self.fsw_action)()
            self.satellite.logger.info("FSW action %s activated.", self.fsw_action)


class ImpulsiveThrustHill(ImpulsiveThrust):
    """Like :class:`ImpulsiveThrust`, with the velocity change in the Hill frame of a chief."""

    def __init__(self, chief_name: str, *args: Any, **kwargs: Any) -> None:
        """See :class:`ImpulsiveThrust`; ``chief_name`` is the name of the chief."""
        super().__init__(*args, **kwargs)
        self.chief_name = chief_name

    def reset_post_sim_init(self) -> None:
        """Find the chief."""
        self.chief = self.satellite.simulator.get_satellite(self.chief_name)

    @override
    def set_action(self, action: np.ndarray) -> None:
        dv_N = self.chief.dynamics.HN.T @ action[0:3]
        super().set_action(np.concatenate((dv_N, [action[3]])))


class AttitudeSetpoint(ContinuousAction):
    """Turns to an attitude relative to N, given as an MRP, and holds it."""

    def __init__(self, name: str = "attitude_act", control_period: float = 60) -> None:
        """Last ``control_period`` s."""
        super().__init__(name)
        self.control_period = control_period

    @property
    @override
    def may_hold_attitude(self) -> bool:
        return True

    @property
    @override
    def space(self) -> spaces.Box:
        return spaces.Box(low=-np.ones(3), high=np.ones(3), shape=(3,), dtype=np.float32)

    @property
    @override
    def action_description(self) -> list[str]:
        return ["mrp_1", "mrp_2", "mrp_3"]

    @override
    def set_action(self, action: np.ndarray) -> None:
        assert len(action) == 3, "Action must have 3 elements."
        self.satellite.logger.info("Setting attitude command to %s for %s seconds.", action, self.control_period)
        self.satellite.fsw.action_attitude_mrp(action)
        self.satellite.update_timed_terminal_event(self.satellite.simulator.sim_time + self.control_period)
