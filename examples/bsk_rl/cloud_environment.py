"""
Cloudy targets
==============

The reward of an image increases with clear sky over the target, but only a forecast is observed beforehand.

On the command line::

    python examples/bsk_rl/cloud_environment.py --num-envs 4

The problem of bsk_rl's page "Cloud Environment". Comments mark lines that differ from it. On the page, every target is an object
with attributes; here, an attribute is a table [N, T] of all targets of all environments.
"""

# sphinx_gallery_thumbnail_path = "_static/readme/CloudyAEOS-v1.png"

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

# bsk_rl: from bsk_rl import act, obs, sats
from bsk_torch import NO_ACTION, ConstellationTasking, act, obs, rand, sats, scene
from bsk_torch.astro.frames import angle_between
from bsk_torch.constants import R_EARTH  # bsk_rl: orbitalMotion.REQ_EARTH * 1e3

# bsk_rl: from bsk_rl.data.unique_image_data import UniqueImageData, ...
from bsk_torch.data import UniqueImageReward

# bsk_rl: from bsk_rl.scene.targets import UniformTargets
from bsk_torch.scene import CloudyTargets, UniformTargets
from bsk_torch.sim import dyn, fsw  # bsk_rl: from bsk_rl.sim import dyn, fsw, world


class CustomDynModel(dyn.FullFeaturedDynModel):
    """Adds an angle."""

    @property
    def solar_angle_norm(self) -> Tensor:
        """Between the side opposite to the instrument and the Sun, over pi, [N]."""
        # bsk_rl: np.matmul(np.transpose(self.BN), np.array([0, 0, -1]))
        panels_N = -self.BN[:, 2]
        # bsk_rl: np.arccos(np.dot(...)) / np.pi
        return angle_between(panels_N, self.world.sun_direction_N) / torch.pi


class CustomSatComposed(sats.ImagingSatellite):
    """Charges for a minute, or images one of the next 32 targets."""

    observation_spec = [
        obs.SatProperties(
            dict(prop="omega_BP_P", norm=0.03),
            dict(prop="c_hat_P"),
            dict(prop="r_BN_P", norm=R_EARTH),
            dict(prop="v_BN_P", norm=7616.5),
            dict(prop="battery_charge_fraction"),
            dict(prop="solar_angle_norm"),
        ),
        obs.OpportunityProperties(
            dict(prop="opportunity_open", norm=5700),
            dict(prop="opportunity_close", norm=5700),
            type="ground_station",
            n_ahead_observe=1,
        ),
        obs.Eclipse(),
        obs.OpportunityProperties(
            dict(prop="priority"),
            # bsk_rl: dict(fn=lambda sat, opp: opp["object"].cloud_cover_forecast), cloud_cover_sigma likewise
            dict(
                fn=lambda sat, opp: sat.simulator.look_up(
                    sat.scenario.cloud_forecast, opp.place
                )
            ),
            dict(
                fn=lambda sat, opp: sat.simulator.look_up(
                    sat.scenario.drawn("cloud_forecast_sigma"), opp.place
                )
            ),
            type="target",
            n_ahead_observe=32,
        ),
        obs.Time(),
    ]
    action_spec = [act.Charge(duration=60.0), act.Image(n_ahead_image=32)]
    dyn_type = CustomDynModel
    fsw_type = fsw.SteeringImagerFSWModel


STORE = 20 * 8e6 * 100

SAT_ARGS: dict[str, Any] = dict(
    oe=rand.random_orbit(),  # bsk_rl: random_orbit
    imageAttErrorRequirement=0.01,
    imageRateErrorRequirement=0.01,
    batteryStorageCapacity=80.0 * 3600 * 2,
    # bsk_rl: lambda: np.random.uniform(0.4, 1.0) * ...
    storedCharge_Init=rand.Uniform(0.4 * 80 * 3600 * 2, 80.0 * 3600 * 2),
    u_max=0.2,
    K1=0.5,
    nHat_B=[0, 0, -1],
    imageTargetMinimumElevation=math.radians(45),
    rwBasePower=20,
    maxWheelSpeed=1500,
    # bsk_rl: lambda: np.random.randint(0, 0.01 * dataStorageCapacity)
    storageInit=rand.Uniform(0.0, 0.01 * STORE),
    # bsk_rl: lambda: np.random.uniform(-1, 1, 3)
    wheelSpeeds=rand.Uniform(-1.0, 1.0, 3),
)


# bsk_rl: class CloudTargets(UniformTargets), which regenerates targets with three attributes
class CloudTargets(CloudyTargets):
    """Targets under clouds, with the Earth's average cover."""

    mu_data = 0.6740208166434426

    def __init__(self, targets: scene.targets.TargetScenario) -> None:
        """Put ``targets`` under clouds."""
        super().__init__(
            targets,
            cover=rand.Uniform(0.0, 2 * self.mu_data),
            forecast_sigma=rand.Uniform(0.01, 0.05),
        )


# bsk_rl: three classes, of data, store and rewarder
class CloudImagingPercentReward(UniqueImageReward):
    """Pays for images that are not cloud covered, by a function of priority and cover.

    Counters: ``cloud_free`` and ``cloud_covered`` [N, S], the numbers of images of either kind.
    """

    def __init__(
        self,
        reward_fn: Callable[[Tensor, Tensor, Tensor], Tensor],
        threshold: float = 0.7,
    ) -> None:
        """Pay ``reward_fn(priority, cover, count)``, [N, S] each, where the cover is at most ``threshold``."""
        super().__init__()
        self.paid_by, self.threshold = reward_fn, threshold

    def link(self, scenario: Any, fleet: Any) -> None:
        """Declare the counters."""
        super().link(scenario, fleet)
        for name in ("cloud_free", "cloud_covered"):
            self.memory.declare(name, 0, fleet.size)

    def counts(self) -> dict[str, Tensor]:
        """Add the counters."""
        return super().counts() | {
            name: self.memory[name] for name in ("cloud_free", "cloud_covered")
        }

    # bsk_rl: compare_log_states and calculate_reward
    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        """Return the reward of each satellite for an image that it has ``taken`` of ``target``, [N, S] each."""
        super().value(target, taken)  # notes what has been imaged
        priority, cover = (
            table.gather(1, target)
            for table in (self.scenario.priority, self.scenario.cloud_cover)
        )
        free = taken & (cover <= self.threshold)
        for name, which in (("cloud_free", free), ("cloud_covered", taken & ~free)):
            self.memory[name] = self.memory[name] + which
        reward = self.paid_by(priority, cover, self.sharers(target, free))
        return torch.where(free, reward, torch.zeros_like(reward))


def linear(priority: Tensor, cover: Tensor, count: Tensor) -> Tensor:
    """Return the reward: zero at the threshold, the priority under a clear sky; shared by simultaneous images."""
    return priority / count * (1 - cover / 0.7)


def make(
    num_envs: int = 1,
    sat_args: dict[str, Any] | None = None,
    largest_forecast: float | None = None,
    **options: Any,
) -> ConstellationTasking:
    """Return ``num_envs`` episodes of the problem; ``sat_args`` and ``options`` replace its own.

    Targets with a forecast above ``largest_forecast`` are hidden, as by the page's ``cloud_cover_filter`` with 0.2.
    """
    scenario = CloudTargets(UniformTargets((1000, 10_000)))
    # bsk_rl: satellite.add_access_filter(cloud_cover_filter)
    scenario.largest_forecast = largest_forecast
    defaults = dict(
        scenario=scenario,
        rewarder=CloudImagingPercentReward(linear),
        terminate_on_time_limit=True,
        sim_rate=0.5,
        max_step_duration=300.0,
        time_limit=95 * 60 * 3.0,
        failure_penalty=0.0,
    )
    # bsk_rl: gym.make("GeneralSatelliteTasking-v1", world_type=world.GroundStationWorldModel, ...
    return ConstellationTasking(
        satellites=[CustomSatComposed("EO", SAT_ARGS | (sat_args or {}))],
        num_envs=num_envs,  # bsk_rl: one episode
        joint=True,
        **(defaults | options),
    )


def main() -> None:
    """Charge, continue, image the first target, then act randomly until the time limit."""
    parser = argparse.ArgumentParser(
        description="Image targets under clouds at random."
    )
    parser.add_argument("--num-envs", type=int, default=4, help="episodes at once")
    parser.add_argument(
        "--time-limit",
        type=float,
        default=95 * 60 * 3.0,
        help="length of an episode, s",
    )
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of the first episode at the end; needs the extra viz",
    )
    options = parser.parse_args()
    env = make(
        options.num_envs, time_limit=options.time_limit, backend=options.backend, seed=1
    )
    td = env.reset()  # bsk_rl: env.reset(seed=1)
    satellite = env.fleet.satellites[0]
    print(
        "actions:",
        satellite.action_description[:3],
        "states:",
        satellite.observation_description[:3],
    )
    for action in (0, NO_ACTION, 1):  # bsk_rl: 0, None, 1
        td = env.step(td.set("action", torch.full((options.num_envs, 1), action)))[
            "next"
        ]
    total = torch.zeros(options.num_envs, 1, dtype=td["reward"].dtype)
    while not td["done"].any():
        td = env.rand_step(td)["next"]  # bsk_rl: env.step(env.action_space.sample())
        total += td["reward"]
    print("reward:", total.squeeze(1))  # bsk_rl: env.unwrapped.rewarder.cum_reward
    # bsk_rl: env.unwrapped.rewarder.data.cloud_covered, .cloud_free
    for name in ("cloud_covered", "cloud_free"):
        print(f"{name}:", env.counts()[name].squeeze(1))
    if options.figure is not None:
        from PIL import Image

        Image.fromarray(env.render(rows=0).numpy()).save(options.figure)


if __name__ == "__main__":
    main()
