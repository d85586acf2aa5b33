"""Actions that change the velocity of a satellite impulsively."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number, text
from bsk_torch.act.base import Decision
from bsk_torch.act.continuous import ContinuousAction
from bsk_torch.astro.orbit import hill_frame
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sim.fsw.setpoint import HOLD_INERTIAL, InertialHoldFSWModel
from bsk_torch.vec3 import Vec3

SHORTEST = 2
"""Minimum length of a drift, ticks."""


def length(dv: Tensor) -> Tensor:
    """Return the lengths [N] of vectors [N, 3]; for float32 vectors, rounded once."""
    return dv.double().square().sum(-1).sqrt().to(dv.dtype)


def shortened(dv: Tensor, longest: float | Tensor) -> Tensor:
    """Return velocity changes [N, 3] of at most ``longest`` [N]: ``dv <- dv / |dv| longest`` where ``|dv| > longest``."""
    most = torch.as_tensor(longest, dtype=dv.dtype, device=dv.device)
    size = length(dv)
    over = size > most
    scaled = dv / torch.where(over, size, 1.0).unsqueeze(-1) * most.unsqueeze(-1)
    return torch.where(over.unsqueeze(-1), scaled, dv)


class ImpulsiveThrust(ContinuousAction):
    """Change the velocity by dv_N, m/s in N, and drift for a time, s: four numbers.

    Velocity changes longer than ``max_dv``, including the corners of the action space, are scaled down to it; the tank may allow
    less. The drift lasts at least two ticks and at most ``max_drift_duration``. The satellite's flight software must include
    :class:`~bsk_torch.sim.fsw.MagicOrbitalManeuverFSWModel`.

    Without ``fsw_action``, the satellite turns to the attitude of N during the drift, or immediately if it has no actuators.

    With ``compat="bsk_rl"``, float32 actions are executed in float32, as in NumPy: the drift may end a tick late, and the content
    of the tank is rounded.
    """

    fsw_type = InertialHoldFSWModel

    def __init__(
        self,
        name: str = "thrust_act",
        max_dv: float = math.inf,
        max_drift_duration: float = math.inf,
        fsw_action: str | None = None,
    ) -> None:
        """Thrust, then drift.

        Args:
            name: Name of the entry.
            max_dv: Maximum velocity change, m/s.
            max_drift_duration: Maximum drift, s.
            fsw_action: Flight-software command during the drift, such as ``"nadir_scan"``, or ``"action_nadir_scan"``.
        """
        super().__init__(name)
        title = f"action {self.name!r}: "
        self.max_dv = number(f"{title}max_dv", max_dv, 0.0, unit="m/s", above=True, finite=False)
        self.max_drift_duration = number(
            f"{title}max_drift_duration", max_drift_duration, 0.0, unit="s", above=True, finite=False
        )
        self.fsw_action = HOLD_INERTIAL if fsw_action is None else text("fsw_action", fsw_action)

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`ContinuousAction.link_satellite`; ValueError without a tank, or for an unknown command."""
        super().link_satellite(satellite)
        simulator = satellite.simulator
        simulator.check_tank(f"{type(self).__name__} {self.name!r}")
        if self.fsw_action not in simulator.type.commands:
            self.fsw_action = self.fsw_action.removeprefix("action_")
        simulator.check_command(self.fsw_action)
        if self.max_drift_duration <= self.min_drift_duration:
            raise ValueError(
                f"action {self.name!r}: max_drift_duration={self.max_drift_duration:g} must be more than {SHORTEST} ticks, "
                f"{self.min_drift_duration:g} s, the minimum length of a drift"
            )

    @property
    def min_drift_duration(self) -> float:
        """Shortest drift, s: two ticks."""
        return SHORTEST * self.satellite.simulator.h

    def bounds(self) -> tuple[Tensor, Tensor]:
        """See :meth:`ContinuousAction.bounds`: of each component of dv_N, and of the drift."""
        high = torch.tensor([self.max_dv] * 3 + [self.max_drift_duration], dtype=torch.float64)
        low = -high
        low[3] = self.min_drift_duration
        return low, high

    @override
    def names(self) -> list[str]:
        return ["dV_N_x", "dV_N_y", "dV_N_z", "duration"]

    def change_of_velocity(self, dv: Tensor) -> Tensor:
        """Return the first three numbers of actions as velocity changes in N, [N, 3] m/s."""
        return dv

    @property
    def is_single(self) -> bool:
        """Whether the actions of the current step are executed in float32."""
        return self.given_dtype == torch.float32 and self.satellite.simulator.type.compat

    @override
    def decide(self, action: Tensor, mask: Tensor) -> Decision:
        action = action.float() if self.is_single else action
        dv_N = shortened(self.change_of_velocity(action[:, :3]), self.max_dv)
        drift = action[:, 3].clamp(self.min_drift_duration, self.max_drift_duration)
        duration = self._until_event(drift) if self.is_single else drift
        return self.enter(self.fsw_action, duration, dv_N)

    def _until_event(self, drift: Tensor) -> Tensor:
        """Return the seconds [N] to the event of a drift [N] in float32, whose time is a whole number of ns in float32, too."""
        simulator = self.satellite.simulator
        now_ns = simulator.state.sim_time_ns
        end_ns = (simulator.sim_time.float() + drift) * 1e9 + 0.5
        return ((end_ns.double().floor() - now_ns.double()) * 1e-9).clamp(min=simulator.h)

    @override
    def begin(self, mask: Tensor, decision: Decision) -> None:
        simulator, dv_N = self.satellite.simulator, decision.command
        assert dv_N is not None
        if not self.is_single:
            simulator.thrust(mask, dv_N)
            return
        available = simulator.read("dv_available").float()
        dv_N = shortened(dv_N, available)
        simulator.thrust(mask, dv_N.double())
        remaining = (available - length(dv_N)).clamp(min=0.0)
        simulator.write("dv_available", mask, remaining.double())


class ImpulsiveThrustHill(ImpulsiveThrust):
    """As :class:`ImpulsiveThrust`, with the velocity change in the Hill frame of a chief: radial, along-track, normal.

    The chief is any satellite of the episode, including the acting one; its frame is taken before any maneuver at the same time.
    """

    def __init__(
        self,
        chief_name: str,
        name: str = "thrust_act",
        max_dv: float = math.inf,
        max_drift_duration: float = math.inf,
        fsw_action: str | None = None,
    ) -> None:
        """See :class:`ImpulsiveThrust`; ``chief_name`` is the name of the chief."""
        super().__init__(name, max_dv, max_drift_duration, fsw_action)
        self.chief_name = text("chief_name", chief_name)

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`ImpulsiveThrust.link_satellite`; ValueError for an unknown chief."""
        super().link_satellite(satellite)
        try:
            self._place = satellite.fleet.place_of(self.chief_name)
        except KeyError as error:
            raise ValueError(f"action {self.name!r}: chief_name={error.args[0]}") from None

    @property
    def is_single(self) -> bool:
        """See :attr:`ImpulsiveThrust.is_single`: never, since the frame is in float64."""
        return False

    def change_of_velocity(self, dv: Tensor) -> Tensor:
        """See :meth:`ImpulsiveThrust.change_of_velocity`: ``dv_N = [NH] dv_H``."""
        HN = hill_frame(*(Vec3.of(vector) for vector in self.chief_state()))
        return (HN.mT @ Vec3.of(dv)).stack()

    def chief_state(self) -> tuple[Tensor, Tensor]:
        """Return the chief's position, m, and velocity, m/s, in N for each satellite, [N, 3] each."""
        k, member = self._place
        chief = self.satellite.fleet.simulators[k].state
        r_CN_N, v_CN_N = (
            self.satellite.simulator.of_env(chief.read(name).view(chief.num_envs, chief.count, 3)[:, member])
            for name in ("r_BN_N", "v_BN_N")
        )
        return r_CN_N, v_CN_N
