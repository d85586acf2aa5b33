"""
Faults of a reaction wheel
==========================

An imaging satellite with four wheels, one of them short of power from a time on.

On the command line::

    python examples/bsk_rl/fault_environment.py --num-envs 4
    python examples/bsk_rl/fault_environment.py --num-envs 4 --literal

The problem of bsk_rl's page "Fault Environment Example". Comments mark lines that differ from it. Five details of the page are
corrected, unless ``--literal`` is given:

- The page connects no command to its camera, which therefore takes an image in every tick, wherever it points.
- A torque of 1 N m disturbs its satellite, five times what a wheel can give, so that all die within minutes. Here it is 1e-4 N m.
- The gain that slows wheels down, 0.3 N m s, makes them oscillate at their largest torque. Here it is 0.03.
- The gains of steering are unstable in ticks of 0.5 s. Here they are stable.
- Only the first three wheels are observed and can be too fast.
"""

# sphinx_gallery_thumbnail_path = "_static/readme/AEOS-v1.png"

from __future__ import annotations

import argparse
import dataclasses
import math
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

# bsk_rl: from bsk_rl import SatelliteTasking, act, data, obs, sats, scene
from bsk_torch import SatelliteTasking, act, data, faults, obs, rand, sats, scene
from bsk_torch.astro.frames import angle_between
from bsk_torch.constants import R_EARTH, RPM  # bsk_rl: orbitalMotion.REQ_EARTH * 1e3
from bsk_torch.sim import dyn, fsw  # bsk_rl: from bsk_rl.sim import dyn, fsw
from bsk_torch.sim.component import Bus
from bsk_torch.sim.dyn.storage import partitions
from bsk_torch.sim.fsw import instrument

AXES = ([1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1])
"""Of the wheels."""


class FourWheelsDynModel(dyn.FullFeaturedDynModel):  # bsk_rl: CustomDynModel
    """Adds an angle, and the speeds of all wheels under the page's name."""

    @property
    def solar_angle_norm(self) -> Tensor:
        """Between the side opposite to the instrument and the Sun, over pi, [N]."""
        # bsk_rl: np.matmul(np.transpose(self.BN), np.array([0, 0, -1]))
        panels_N = -self.BN[:, 2]
        # bsk_rl: np.arccos(np.dot(...)) / np.pi
        return angle_between(panels_N, self.world.sun_direction_N) / torch.pi

    @dyn.observable
    def wheel_speeds_frac(now: dyn.Now) -> tuple[Tensor, ...]:
        """Speeds of the wheels over ``maxWheelSpeed``, [N, 4]."""
        return tuple(speed / (now.args.maxWheelSpeed * RPM) for speed in now.Omega_WB_B)


# -- as on the page ----------------------------------------------------------------------------------------------------------


def name_data(bus: Bus) -> None:
    """Store data as images of a target from the first image action on, and before among what was in the store."""
    # bsk_rl: instrument.nodeDataName, which only actions that image set
    bus.data_partition = torch.where(bus.location_on > 0.0, 0.0, bus.data_partition)


class ThreeSeenDynModel(FourWheelsDynModel):
    """Reads the speeds of the first three wheels only, as bsk_rl 1.3.8 does; data have the name of the last target."""

    components = (
        partitions.IMAGER.extended(update=name_data),
        partitions.PARTITIONED_STORE.extended(
            initial=lambda args: {"data_partition": torch.ones(1, dtype=torch.float64)}
        ),
    )

    @dyn.observable
    def wheel_speeds_frac(now: dyn.Now) -> tuple[Tensor, ...]:
        """Speeds of three wheels over ``maxWheelSpeed``, [N, 3]."""
        return tuple(
            speed / (now.args.maxWheelSpeed * RPM) for speed in now.Omega_WB_B[:3]
        )

    @dyn.vital
    def rw_speeds_valid(now: dyn.Now) -> Tensor:
        """Whether three wheels are slower than ``maxWheelSpeed``, [N]."""
        limit = now.args.maxWheelSpeed * RPM
        first, second, third = (torch.abs(speed) for speed in now.Omega_WB_B[:3])
        return (first < limit) & (second < limit) & (third < limit)


NO_COMMAND = dataclasses.replace(
    instrument.IMAGE_CONTROLLER,
    update=None,
    state=instrument.IMAGE_CONTROLLER.state[1:],
)
"""A controller that commands nothing; an instrument without a command is always on."""


class UnconnectedFSWModel(fsw.SteeringImagerFSWModel):
    """Connects no command to the camera."""

    # bsk_rl: _set_gateway_msgs() without super()._set_gateway_msgs()
    components = (NO_COMMAND,)


# -- the satellite -----------------------------------------------------------------------------------------------------------


class FaultySatellite(sats.ImagingSatellite):  # bsk_rl: CustomSatComposed
    """Desaturates or charges for a minute, or images one of the next 32 targets."""

    observation_spec = [
        obs.SatProperties(
            dict(prop="omega_BP_P", norm=0.03),
            dict(prop="c_hat_P"),
            dict(prop="r_BN_P", norm=R_EARTH),
            dict(prop="v_BN_P", norm=7616.5),
            dict(prop="battery_charge_fraction"),
            dict(prop="solar_angle_norm"),
            dict(prop="wheel_speeds_frac"),
        ),
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="r_LP_P", norm=R_EARTH),
            dict(prop="target_angle", norm=math.pi),
            type="target",
            n_ahead_observe=32,
        ),
        obs.Time(),
        obs.Eclipse(norm=5700),
    ]
    action_spec = [
        act.Desat(duration=60.0),
        act.Charge(duration=60.0),
        act.Image(n_ahead_image=32),
    ]
    dyn_type = FourWheelsDynModel
    fsw_type = fsw.SteeringImagerFSWModel  # bsk_rl: CustomSteeringImagerFSWModel


class LiteralSatellite(FaultySatellite):
    """The satellite as it is on the page."""

    dyn_type = ThreeSeenDynModel
    fsw_type = UnconnectedFSWModel


BATTERY = 80.0 * 3600 * 2

SAT_ARGS: dict[str, Any] = dict(
    # bsk_rl: setup_reaction_wheel_dyn_effector, _set_rw_constellation_msg, ...
    wheels=[dyn.Wheel("Honeywell_HR16", axis, 50.0) for axis in AXES],
    oe=rand.random_orbit(),  # bsk_rl: random_orbit
    imageAttErrorRequirement=0.01,
    imageRateErrorRequirement=0.01,
    batteryStorageCapacity=BATTERY,
    # bsk_rl: lambda: np.random.uniform(0.4, 1.0) * ...
    storedCharge_Init=rand.Uniform(0.4 * BATTERY, BATTERY),
    u_max=0.2,
    K1=0.3,  # bsk_rl: 0.5
    servo_P=55.0,  # bsk_rl: its default, 150
    nHat_B=[0, 0, -1],
    imageTargetMinimumElevation=math.radians(45),
    rwBasePower=20,
    maxWheelSpeed=1500,
    # bsk_rl: lambda: np.random.randint(0, 0.01 * dataStorageCapacity)
    storageInit=rand.Uniform(0.0, 1.6e8),
    # bsk_rl: lambda: np.random.uniform(-900, 900, 4)
    wheelSpeeds=rand.Uniform(-900.0, 900.0, 4),
    nullSpaceGain=0.03,  # bsk_rl: the module rwNullSpace, with OmegaGain=0.3
    # bsk_rl: lambda: random_unit_vector(), which is 1 N m
    disturbance_vector=lambda: 1e-4 * rand.random_unit_vector(),
)

LITERAL: dict[str, Any] = dict(
    K1=0.5,
    servo_P=150.0,
    nullSpaceGain=0.3,
    disturbance_vector=rand.random_unit_vector(),
)
"""Numbers of the page."""


def make(
    num_envs: int = 1,
    literal: bool = False,
    fault_chance: float = 1.0,
    fault_time: float = 0.0,
    wheel: int | None = 0,
    sat_args: dict[str, Any] | None = None,
    **options: Any,
) -> SatelliteTasking:
    """Return ``num_envs`` episodes of the problem; ``sat_args`` and ``options`` replace its own.

    With probability ``fault_chance`` the power of a ``wheel`` (0 to 3; None: of all) is at most 1 W from ``fault_time``, s, on.
    ``literal`` episodes are those of the page, without corrections.
    """
    # bsk_rl: classes FaultObject and RwPowerFault, reset_post_sim_init
    fault = faults.wheel_power(
        wheel, power=1.0, at=faults.Sometimes(fault_chance, fault_time)
    )
    arguments = SAT_ARGS | (LITERAL if literal else {}) | {"faults": [fault]}
    defaults = dict(
        scenario=scene.UniformTargets(1000),
        rewarder=data.UniqueImageReward(),
        terminate_on_time_limit=True,
        sim_rate=0.5,
        max_step_duration=300.0,
        time_limit=95 * 60 * 3.0,
        failure_penalty=0.0,
    )
    satellite = LiteralSatellite if literal else FaultySatellite
    return SatelliteTasking(
        satellite=satellite("EO", arguments | (sat_args or {})),
        num_envs=num_envs,  # bsk_rl: one episode
        **(defaults | options),
    )


def main() -> None:
    """Act randomly until an episode ends, with a fault in about one half of them."""
    parser = argparse.ArgumentParser(description="Image targets with faulty wheels.")
    parser.add_argument("--num-envs", type=int, default=4, help="episodes at once")
    parser.add_argument(
        "--literal", action="store_true", help="as on the page, without corrections"
    )
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
        options.num_envs,
        options.literal,
        fault_chance=0.5,
        time_limit=options.time_limit,
        backend=options.backend,
        seed=1,
    )
    td = env.reset()  # bsk_rl: env.reset(seed=1)
    print("actions:", env.satellite.action_description[:3])
    print("states:", env.satellite.observation_description[:3])
    total = torch.zeros(options.num_envs)
    while not td["done"].any():
        td = env.rand_step(td)["next"]  # bsk_rl: env.step(env.action_space.sample())
        total += td["reward"].squeeze(1)
    print("faults:", env.satellite.dynamics.fault_severity.squeeze(1))
    print("reward:", total)
    print("died:", td["terminated"].squeeze(1))
    if options.figure is not None:
        from PIL import Image

        Image.fromarray(env.render(rows=0).numpy()).save(options.figure)


if __name__ == "__main__":
    main()
