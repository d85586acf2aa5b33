"""
Shielded training
=================

A rule masks or replaces dangerous actions, in training and in tests.

On the command line::

    python examples/bsk_rl/training_with_shield.py --shield mask --iterations 50 --num-envs 256
    python examples/bsk_rl/training_with_shield.py --shield replacement --penalty -0.1

The problem of bsk_rl's page "Shielded training with action masking and action replacement". Comments mark lines that differ from
it. The page wraps one environment; here, the satellite's ``legal_actions`` returns the mask, and a TorchRL transform replaces
actions.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import torch
from aeos import Density, s_hat_H
from rllib_training import Show, train
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Transform, TransformedEnv

from bsk_torch import (  # bsk_rl: from bsk_rl import act, data, obs, sats, scene
    SatelliteTasking,
    act,
    data,
    obs,
    rand,
    sats,
    scene,
)

# bsk_rl: orbitalMotion.MU_EARTH * 1e9, orbitalMotion.REQ_EARTH * 1e3
from bsk_torch.constants import MU_EARTH, R_EARTH
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.sim import dyn, fsw  # bsk_rl: from bsk_rl.sim import dyn, fsw

ALTITUDE = 800e3  # m
PERIOD = 2 * math.pi * math.sqrt((R_EARTH + ALTITUDE) ** 3 / MU_EARTH)
"""Of the orbit, s; bsk_rl: orbital_period(...), in bsk_rl after 1.3.8."""

ORBIT = 5700.0
"""Norm of the times of eclipses and passes, s."""

CHARGE, DOWNLINK, DESAT = 0, 1, 2
"""Actions that are not images."""


class EarthObserver(sats.ImagingSatellite):  # bsk_rl: CustomSatComposed
    """Charges, downlinks, slows its wheels down, or images one of the next 32 targets."""

    observation_spec = [
        obs.SatProperties(
            dict(prop="omega_BN_B", norm=0.03),
            dict(prop="c_hat_H"),
            dict(prop="r_BN_P", norm=R_EARTH),
            dict(prop="v_BN_P", norm=7616.5),
            dict(prop="battery_charge_fraction"),
            dict(prop="storage_level_fraction"),
            dict(prop="wheel_speeds_fraction"),
            dict(prop="s_hat_H", fn=s_hat_H),
        ),
        obs.OpportunityProperties(
            # bsk_rl after 1.3.8: norm=None, the orbital period
            dict(prop="opportunity_open", norm=ORBIT),
            dict(prop="opportunity_close", norm=ORBIT),
            type="ground_station",
            n_ahead_observe=1,
        ),
        obs.Eclipse(norm=ORBIT),
        Density(intervals=20, norm=5),
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="r_LB_H", norm=R_EARTH),
            dict(prop="target_angle", norm=math.pi / 2),
            dict(prop="target_angle_rate", norm=0.03),
            dict(prop="opportunity_open", norm=300.0),
            dict(prop="opportunity_close", norm=300.0),
            type="target",
            n_ahead_observe=32,
        ),
    ]
    action_spec = [
        act.Charge(duration=60.0),
        act.Downlink(),
        act.Desat(duration=60.0),
        act.Image(n_ahead_image=32),
    ]
    dyn_type = dyn.FullFeaturedDynModel
    fsw_type = fsw.SteeringImagerFSWModel


# bsk_rl: class WrapperActionMasking(ObservationWrapper)
class ShieldedObserver(EarthObserver):
    """Restricts ``action_mask`` to the actions allowed by the rule."""

    def legal_actions(self) -> Tensor:
        """Return [N, 35] booleans."""
        return allowed(self)


def power_requirement(
    eclipse_start: Tensor, eclipse_end: Tensor, min_power: float = 0.25
) -> Tensor:
    """Return the charge required in sunlight, as a fraction of the capacity, [N]; more if an eclipse starts soon.

    Times are in orbits; the battery charges, and drains in eclipse, by its capacity in an orbit.
    """
    draw = torch.remainder(eclipse_end - eclipse_start, 1.0)
    return min_power + torch.where(draw < eclipse_start, 0.0, draw - eclipse_start)


# bsk_rl: power_shielding_function(obs, act, indexes)
def allowed(satellite: Any, rw_threshold: float = 0.7) -> Tensor:
    """Return the actions allowed by the rule, [N, 35]: only charging if charge is required, only desaturation, or all."""
    start, end = (
        (time - satellite.simulator.sim_time) / ORBIT
        for time in satellite.next_eclipse()
    )
    sunlit = ~(end < start)
    low = sunlit & (
        satellite.dynamics.battery_charge_fraction < power_requirement(start, end)
    )
    fast = ~low & (
        satellite.dynamics.wheel_speeds_fraction.abs().amax(1) > rw_threshold
    )
    names = satellite.action_description
    return act.allow_only(names, "action_charge", where=low) & act.allow_only(
        names, "action_desat", where=fast
    )


# bsk_rl: class WrapperPostPosed(WrapperActionLogging, ActionWrapper, RewardWrapper)
class Replacement(Transform):
    """Replaces a forbidden action by the action allowed by the rule, with a penalty.

    Attributes:
        interferences: Number of replaced actions.
    """

    def __init__(self, penalty: float = 0.0) -> None:
        """``penalty`` is added to the reward of steps whose action was replaced."""
        super().__init__()
        self.penalty, self.interferences = penalty, 0

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        mask = allowed(self.parent.base_env.satellite)
        action = tensordict["action"]
        self.replaced = ~mask.gather(1, action.unsqueeze(1))
        self.interferences += int(self.replaced.sum())
        return tensordict.set(
            "action",
            torch.where(self.replaced.squeeze(1), mask.int().argmax(1), action),
        )

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        next_tensordict["reward"] = (
            next_tensordict["reward"] + self.penalty * self.replaced
        )
        return next_tensordict


GENERAL: dict[str, Any] = dict(
    # bsk_rl: lambda: random_orbit(alt=ALTITUDE, i=45)
    oe=rand.random_orbit(a=6371 + 800.0, i=45.0, omega=0.0),
    imageAttErrorRequirement=0.01,
    imageRateErrorRequirement=0.01,
    u_max=0.4,
    K1=0.25,
    K3=3.0,
    servo_P=150 / 5,
    omega_max=math.radians(5.0),
    imageTargetMinimumElevation=math.atan(800 / 500),
    rwBasePower=20,
    transmitterPacketSize=0,
    dataStorageCapacity=2 * 8e6 * 25,  # fifty images
    # bsk_rl: lambda: np.random.randint(0, 0.99 * 2 * 8e6 * 25)
    storageInit=rand.Uniform(0.0, 0.99 * 2 * 8e6 * 25),
)

BATTERY = 80.0 * 3600 * 2  # W s

LIMITED = dict(
    batteryStorageCapacity=BATTERY,
    # bsk_rl: lambda: np.random.uniform(0.4, 1.0) * 80.0 * 3600 * 2
    storedCharge_Init=rand.Uniform(0.4 * BATTERY, BATTERY),
    maxWheelSpeed=1500,
    # bsk_rl: lambda: np.random.uniform(-750, 750, 3)
    wheelSpeeds=rand.Uniform(-750.0, 750.0, 3),
)

CASES: dict[str, tuple[dict[str, Any], float]] = {
    "no_failure_penalty": (LIMITED, 0.0),
    "failure_penalty": (LIMITED, -10.0),
    "inf_power": (
        dict(
            batteryStorageCapacity=1000 * BATTERY,
            storedCharge_Init=990 * BATTERY,
            maxWheelSpeed=15000,
            # bsk_rl: lambda: np.random.uniform(-1, 1, 3)
            wheelSpeeds=rand.Uniform(-1.0, 1.0, 3),
        ),
        0.0,
    ),
}
"""Arguments, and reward for dying."""


def make(
    num_envs: int = 1,
    sat_args: dict[str, Any] | None = None,
    case: str = "no_failure_penalty",
    masked: bool = False,
    **options: Any,
) -> SatelliteTasking:
    """Return ``num_envs`` episodes of a case of :data:`CASES`; ``sat_args`` and ``options`` replace its own.

    With ``masked``, ``action_mask`` excludes actions forbidden by the rule.
    """
    own, penalty = CASES[case]
    kind = ShieldedObserver if masked else EarthObserver
    defaults = dict(
        # or scene.CityTargets, which takes one number
        scenario=scene.UniformTargets((100, 3000)),
        rewarder=data.UniqueImageReward(),
        time_limit=math.floor(3 * PERIOD),
        failure_penalty=penalty,
        sim_rate=0.5,
        max_step_duration=300.0,
    )
    return SatelliteTasking(
        satellite=kind("EarthObserving", sat_args=GENERAL | own | (sat_args or {})),
        num_envs=num_envs,  # bsk_rl: one episode
        **(defaults | options),
    )


def main() -> None:
    """Train with a shield."""
    parser = argparse.ArgumentParser(description="Train with a shield.")
    parser.add_argument(
        "--shield", default="mask", choices=["none", "mask", "replacement"]
    )
    parser.add_argument(
        "--penalty", type=float, default=-0.1, help="reward of a replaced action"
    )
    parser.add_argument("--case", default="no_failure_penalty", choices=CASES)
    parser.add_argument("--num-envs", type=int, default=64, help="episodes at once")
    parser.add_argument(
        "--iterations", type=int, default=20, help="number of training batches"
    )
    parser.add_argument(
        "--rollout", type=int, default=16, help="decisions per episode in a batch"
    )
    parser.add_argument("--n-targets", type=int, default=1000)
    parser.add_argument(
        "--time-limit",
        type=float,
        default=math.floor(3 * PERIOD),
        help="length of an episode, s",
    )
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of the learning curve; needs the extra viz",
    )
    options = parser.parse_args()
    env = make(
        options.num_envs,
        case=options.case,
        masked=options.shield == "mask",
        scenario=scene.UniformTargets(options.n_targets),
        time_limit=options.time_limit,
        backend=options.backend,
        seed=0,
    )
    shield, show = Replacement(options.penalty), Show()
    config = PPOConfig(
        num_envs=options.num_envs,
        rollout=options.rollout,
        gamma=0.997,  # per second, as on the page
        lmbda=0.95,
        clip=0.2,
        gradient_norm=0.5,
        entropy=0.0,
    )
    train(
        TransformedEnv(env, shield) if options.shield == "replacement" else env,
        config,
        options.iterations,
        show,
    )
    print("replaced actions:", shield.interferences)
    show.draw(options.figure, "reward", "alive", "entropy")


if __name__ == "__main__":
    main()
