"""Satellites that manoeuvre, for tests."""

from typing import Any

import torch

from bsk_torch import SatelliteTasking, act, data, obs, sats, scene
from bsk_torch.sim import dyn, fsw

MU = 3.986004415e14
RADIUS = 6.9e6
R_N = [RADIUS, 0.0, 0.0]
V_N = [0.0, 0.8 * (MU / RADIUS) ** 0.5, 0.6 * (MU / RADIUS) ** 0.5]
"""A circular orbit at an inclination of 36.9 degrees."""


class Kick(act.Drift):
    """Drift for a minute after a manoeuvre of 1 m/s along the velocity."""

    change = 1.0

    def __init__(self) -> None:
        super().__init__("kick", duration=60.0)
        self.reset_task = True

    def link_satellite(self, satellite: sats.Satellite) -> None:
        """See ``Action.link_satellite``."""
        super().link_satellite(satellite)
        satellite.simulator.check_tank(f"act.{type(self).__name__}()")

    def begin(self, mask: torch.Tensor, decision: act.base.Decision) -> None:
        """See ``Action.begin``."""
        simulator = self.satellite.simulator
        v_N = simulator.read("v_BN_N")
        simulator.thrust(mask, v_N / v_N.norm(dim=-1, keepdim=True) * self.change)


class Mover(sats.Satellite):
    """A spacecraft without actuators that manoeuvres."""

    dyn_type = dyn.DynamicsModel
    fsw_type = fsw.MagicOrbitalManeuverFSWModel
    observation_spec = (
        obs.SatProperties({"prop": "dv_available"}, {"prop": "thrust_count"}, {"prop": "r_BN_N"}, {"prop": "v_BN_N"}),
        obs.Time(),
    )
    action_spec = (act.Drift(duration=60.0), Kick())


class Imager(sats.ImagingSatellite):
    """A spacecraft that takes images and manoeuvres."""

    dyn_type = (dyn.ImagingDynModel, dyn.GroundStationDynModel)
    fsw_type = (fsw.MagicOrbitalManeuverFSWModel, fsw.ImagingFSWModel)
    observation_spec = (
        obs.SatProperties({"prop": "dv_available"}, {"prop": "r_BN_P"}),
        obs.OpportunityProperties({"prop": "opportunity_open"}, {"prop": "opportunity_close"}, n_ahead_observe=4),
        obs.OpportunityProperties({"prop": "opportunity_open"}, type="ground_station", n_ahead_observe=1),
        obs.Eclipse(norm=5700.0),
        obs.Time(),
    )
    action_spec = (act.Drift(duration=60.0), Kick(), act.Image(n_ahead_image=4))


START = dict(oe=None, rN=R_N, vN=V_N)


def make(num_envs: int = 1, kind: type[sats.Satellite] = Mover, sat_args: Any = None, **options: Any) -> SatelliteTasking:
    """Return an environment of one manoeuvring satellite."""
    imaging = issubclass(kind, sats.ImagingSatellite)
    defaults = dict(
        scenario=scene.UniformTargets(100) if imaging else None,
        rewarder=data.UniqueImageReward() if imaging else data.NoReward(),
        dtype=torch.float64,
        backend="eager",
        seed=1,
        time_limit=20000.0,
    )
    return SatelliteTasking(kind("sat", {**START, **(sat_args or {})}), num_envs=num_envs, **(defaults | options))


def every(env: SatelliteTasking) -> torch.Tensor:
    """Return the mask of all satellites."""
    return torch.ones(env.simulator.state.rows, dtype=torch.bool)


def push(env: SatelliteTasking, *dv_N: float, rows: torch.Tensor | None = None) -> None:
    """Change the velocity of satellites by the same vector, m/s in N."""
    n = env.simulator.state.rows
    env.simulator.thrust(every(env) if rows is None else rows, torch.tensor(dv_N, dtype=torch.float64).expand(n, 3))


def step(env: SatelliteTasking, td: Any, *actions: int, mask: Any = None) -> Any:
    """Take actions; the outputs of the step."""
    given = td.empty().set("action", torch.tensor(actions).expand(env.num_envs))
    if mask is not None:
        given = given.set("_step", torch.tensor(mask).view(-1, 1))
    return env.step(given)["next"]
