"""
Agile Earth observation
=======================

Three sets of observations with unlimited power, and one with a battery to manage.

On the command line::

    python examples/bsk_rl/aeos.py S3 --num-envs 4
    python examples/bsk_rl/aeos.py power --num-envs 4

The problems of bsk_rl's page "Agile Earth-Observing Satellite Environment". Comments mark lines that differ from it. The presets
``AEOS-v1`` and ``AEOSPower-v1`` are similar, with other parameters.
"""

# sphinx_gallery_thumbnail_path = "_static/readme/AEOS-v1.png"

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

# bsk_rl: from bsk_rl import SatelliteTasking, ...
from bsk_torch import SatelliteTasking, act, data, obs, rand, sats, scene
from bsk_torch.constants import R_EARTH  # bsk_rl: orbitalMotion.REQ_EARTH * 1e3
from bsk_torch.sim import fsw  # bsk_rl: from bsk_rl.sim import fsw

ORBIT = (dict(prop="r_BN_P", norm=R_EARTH), dict(prop="v_BN_P", norm=7616.5))
IN_EARTH = (dict(prop="omega_BP_P", norm=0.03), dict(prop="c_hat_P"), *ORBIT)
IN_HILL = (dict(prop="omega_BH_H", norm=0.03), dict(prop="c_hat_H"), *ORBIT)
WHERE_AND_WHEN = (
    dict(prop="priority"),
    dict(prop="r_LB_H", norm=800 * 1e3),
    dict(prop="target_angle", norm=math.pi / 2),
    dict(prop="target_angle_rate", norm=0.03),
    dict(prop="opportunity_open", norm=300.0),
    dict(prop="opportunity_close", norm=300.0),
)

SETS: dict[str, tuple[Any, Any]] = {
    "S1": (IN_EARTH, (dict(prop="priority"), dict(prop="r_LP_P", norm=R_EARTH))),
    "S2": (IN_HILL, (dict(prop="priority"), dict(prop="r_LB_H", norm=R_EARTH))),
    "S3": (IN_HILL, WHERE_AND_WHEN),
}
"""Observed properties of the satellite and of each target, by the page's names."""


def free_satellite(
    observation: str, n_ahead: int = 32, include_time: bool = False
) -> type[sats.ImagingSatellite]:
    """Return a satellite with one of the :data:`SETS` of observations; bsk_rl: satellite_generator(observation, ...)."""
    own, targets = SETS[observation]

    class FreeSatellite(sats.ImagingSatellite):
        """Images one of the next targets."""

        observation_spec = [
            obs.SatProperties(*own),
            obs.OpportunityProperties(*targets, type="target", n_ahead_observe=n_ahead),
            *([obs.Time()] if include_time else []),
        ]
        action_spec = [act.Image(n_ahead_image=n_ahead)]
        fsw_type = fsw.SteeringImagerFSWModel

    return FreeSatellite


class Density(obs.Observation):
    """Sums of the priorities of targets whose next window closes in each of the next intervals."""

    def __init__(
        self, interval_duration: float = 60 * 3, intervals: int = 10, norm: float = 3.0
    ) -> None:
        """Sum over ``intervals`` of ``interval_duration`` seconds each, and divide by ``norm``."""
        super().__init__("obs")  # bsk_rl: super().__init__()
        self.interval_duration, self.intervals, self.norm = (
            interval_duration,
            intervals,
            norm,
        )

    def worth(self) -> Tensor:
        """What is summed, [environments, T]."""
        return self.satellite.scenario.priority

    def get_obs(self) -> Tensor:
        """Return [N, intervals]."""
        simulator = self.satellite.simulator
        until = simulator.sim_time + (self.intervals + 1) * self.interval_duration
        # bsk_rl: satellite.calculate_additional_windows(...); satellite.upcoming_opportunities_dict(types="target")
        _, close = self.satellite.next_opportunities("target", until=until)  # [N, T] s
        interval = (close - simulator.sim_time.unsqueeze(1)) / self.interval_duration
        # bsk_rl: [sum(rewards[time_bins == i]) for i in range(self.intervals)]
        number = interval.clamp(0.0, float(self.intervals)).long()
        sums = torch.zeros(len(close), self.intervals + 1, dtype=close.dtype)
        return (
            sums.scatter_add(1, number, simulator.of_env(self.worth()).to(close.dtype))[
                :, : self.intervals
            ]
            / self.norm
        )


def wheel_speed_3(satellite: Any) -> Tensor:
    """Speeds of the wheels, [N, 3]."""
    # bsk_rl: np.array(sat.dynamics.wheel_speeds[0:3]) / 630
    return satellite.dynamics.wheel_speeds / 630


def s_hat_H(satellite: Any) -> Tensor:
    """Direction of the Sun from the satellite in the Hill frame, [N, 3]."""
    dynamics = satellite.dynamics
    # bsk_rl: world.gravFactory.spiceObject.planetStateOutMsgs[...] - r_BN_N
    r_SB_N = dynamics.world.r_SN_N - dynamics.r_BN_N
    # bsk_rl: rv2HN(r_BN_N, v_BN_N) @ r_SB_N
    r_SB_H = (dynamics.HN @ r_SB_N.unsqueeze(-1)).squeeze(-1)
    return r_SB_H / r_SB_H.norm(dim=-1, keepdim=True)  # bsk_rl: np.linalg.norm(r_SB_H)


def power_satellite(
    n_ahead: int = 32, include_time: bool = False
) -> type[sats.ImagingSatellite]:
    """Return a satellite that also charges; bsk_rl: power_sat_generator(n_ahead, include_time)."""

    class PowerSatellite(sats.ImagingSatellite):
        """Images one of the next targets, or charges."""

        observation_spec = [
            obs.SatProperties(
                *IN_HILL,
                dict(prop="battery_charge_fraction"),
                dict(prop="wheel_speed_3", fn=wheel_speed_3),
                dict(prop="s_hat_H", fn=s_hat_H),
            ),
            obs.OpportunityProperties(
                *WHERE_AND_WHEN, type="target", n_ahead_observe=n_ahead
            ),
            # bsk_rl after 1.3.8: norm=None, the orbital period
            obs.Eclipse(norm=5700.0),
            Density(intervals=20, norm=5),
            *([obs.Time()] if include_time else []),
        ]
        action_spec = [act.Image(n_ahead_image=n_ahead), act.Charge()]
        fsw_type = fsw.SteeringImagerFSWModel

    return PowerSatellite


SAT_ARGS: dict[str, Any] = dict(
    imageAttErrorRequirement=0.01,
    imageRateErrorRequirement=0.01,
    batteryStorageCapacity=80.0 * 3600 * 100,
    storedCharge_Init=80.0 * 3600 * 100.0,
    dataStorageCapacity=200 * 8e6 * 100,
    u_max=0.4,
    imageTargetMinimumElevation=math.atan(800 / 500),
    K1=0.25,
    K3=3.0,
    omega_max=math.radians(5),
    servo_Ki=5.0,
    servo_P=150 / 5,
    # bsk_rl: lambda: random_orbit(alt=800)
    oe=rand.random_orbit(a=6371 + 800.0, omega=0.0),
)

SAT_ARGS_POWER = SAT_ARGS | dict(
    batteryStorageCapacity=120.0 * 3600,
    # bsk_rl: lambda: 120.0 * 3600 * np.random.uniform(0.4, 1.0)
    storedCharge_Init=rand.Uniform(0.4 * 120.0 * 3600, 120.0 * 3600),
    rwBasePower=20.4,
    instrumentPowerDraw=-10,
    thrusterPowerDraw=-30,
    nHat_B=[0, 0, -1],
    # bsk_rl: lambda: np.random.uniform(-2000, 2000, 3)
    wheelSpeeds=rand.Uniform(-2000.0, 2000.0, 3),
    desatAttitude="nadir",
)


def make(
    variant: str = "S3",
    num_envs: int = 1,
    sat_args: dict[str, Any] | None = None,
    **options: Any,
) -> SatelliteTasking:
    """Return ``num_envs`` episodes of a variant, S1, S2, S3 or power; ``sat_args`` and ``options`` replace its own."""
    power = variant == "power"
    kind, arguments = (
        (power_satellite(), SAT_ARGS_POWER)
        if power
        else (free_satellite(variant), SAT_ARGS)
    )
    defaults = dict(
        scenario=scene.UniformTargets(3000),  # or scene.CityTargets(3000)
        rewarder=data.UniqueImageReward(),
        sim_rate=0.5,
        max_step_duration=300.0,
        time_limit=5700.0 * 5,
        failure_penalty=0.0,
        terminate_on_time_limit=True,
    )
    return SatelliteTasking(
        satellite=kind(name="EO1", sat_args=arguments | (sat_args or {})),
        num_envs=num_envs,  # bsk_rl: one episode
        **(defaults | options),
    )


def main() -> None:
    """Take five random actions."""
    parser = argparse.ArgumentParser(description="Image targets at random.")
    parser.add_argument("variant", nargs="?", default="S3", choices=[*SETS, "power"])
    parser.add_argument("--num-envs", type=int, default=4, help="episodes at once")
    parser.add_argument(
        "--time-limit", type=float, default=5 * 5700.0, help="length of an episode, s"
    )
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of the first episode at the end; needs the extra viz",
    )
    options = parser.parse_args()
    env = make(
        options.variant,
        options.num_envs,
        time_limit=options.time_limit,
        backend=options.backend,
        seed=0,
    )
    td = env.reset()
    for _ in range(5):
        td = env.rand_step(td)["next"]  # bsk_rl: env.step(env.action_space.sample())
        print(
            "rewards",
            td["reward"].squeeze(1).tolist(),
            "after",
            td["duration"].squeeze(1).tolist(),
            "s",
        )
    if options.figure is not None:
        from PIL import Image

        Image.fromarray(env.render(rows=0).numpy()).save(options.figure)


if __name__ == "__main__":
    main()
