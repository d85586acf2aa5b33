"""
Curriculum training
===================

During training, an increasing difficulty reduces the battery capacity and increases the disturbance torque.

On the command line::

    python examples/bsk_rl/curriculum_learning.py --curriculum direct --iterations 100 --num-envs 256

The problem of bsk_rl's page "Training with Curriculum Learning". Comments mark lines that differ from it. On the page, an
environment has one difficulty, set by an RLlib callback at the start of an episode. Here, every episode has a separate
difficulty, and ``set_sat_args`` changes future draws without rebuilding or recompiling anything.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import torch
from rllib_training import Show, train
from torch import Tensor

from bsk_torch import (  # bsk_rl: from bsk_rl import act, data, obs, sats, scene
    SatelliteTasking,
    act,
    data,
    obs,
    rand,
    sats,
    scene,
)
from bsk_torch.astro.frames import angle_between
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.sim import dyn, fsw  # bsk_rl: from bsk_rl.sim import dyn, fsw


def attitude_error_norm(satellite: Any) -> Tensor:
    """Angle between instrument and nadir over pi, [N]."""
    # bsk_rl: np.arccos(np.dot(-r_BN_P_unit, c_hat_P)) / np.pi
    return angle_between(-satellite.dynamics.r_BN_P, satellite.fsw.c_hat_P) / torch.pi


def solar_angle_norm(satellite: Any) -> Tensor:
    """Angle between solar panels and the Sun over pi, [N]."""
    # bsk_rl: np.matmul(np.transpose(sat.dynamics.BN), np.array([0, 0, -1]))
    panels_N = -satellite.dynamics.BN[:, 2]
    # bsk_rl: np.arccos(np.dot(b_N, a_hat))
    return angle_between(panels_N, satellite.dynamics.world.sun_direction_N) / torch.pi


class CustomDynamics(dyn.GroundStationDynModel, dyn.ContinuousImagingDynModel):
    """Scans and downlinks."""


class ScanningSatellite(sats.AccessSatellite):
    """Scans, charges, downlinks or slows its wheels for three minutes."""

    observation_spec = [
        obs.SatProperties(
            dict(prop="wheel_speeds_fraction"),
            dict(prop="battery_charge_fraction"),
            dict(prop="storage_level_fraction"),
            dict(prop="attitude_error_norm", fn=attitude_error_norm),
            dict(prop="solar_angle_norm", fn=solar_angle_norm),
        ),
        obs.Eclipse(norm=5700.0),  # bsk_rl after 1.3.8: norm=None, the orbital period
        obs.OpportunityProperties(
            dict(prop="opportunity_open", norm=5700.0),  # likewise
            dict(prop="opportunity_close", norm=5700.0),
            type="ground_station",
            n_ahead_observe=1,
        ),
    ]
    action_spec = [
        act.Scan(duration=180.0),
        act.Charge(duration=180.0),
        act.Downlink(duration=180.0),
        act.Desat(duration=180.0),
    ]
    dyn_type = CustomDynamics
    fsw_type = fsw.ContinuousImagingFSWModel


BATTERY, TORQUE, INTERVALS = 400 * 3600.0, 0.0002, 90
"""Nominal capacity, W s, and disturbance torque, N m, scaled by the curriculum; number of intervals in an episode."""

SAT_ARGS: dict[str, Any] = dict(
    imageAttErrorRequirement=0.1,
    imageRateErrorRequirement=0.1,
    dataStorageCapacity=5000 * 8e6,
    instrumentPowerDraw=-30.0,
    instrumentBaudRate=0.5e6,
    transmitterPowerDraw=-25.0,
    transmitterBaudRate=-112.0e6,
    rwMechToElecEfficiency=0.0,
    rwElecToMechEfficiency=0.5,
    thrusterPowerDraw=-80.0,
    rwBasePower=10.0,
    maxWheelSpeed=6000,
    desatAttitude="nadir",
    K=3.5,
    Ki=-1,
    P=17.5,
    panelEfficiency=0.2,
)

CURRICULA: dict[str, tuple[tuple[float, float], tuple[float, float]]] = {
    "constant": ((0.40, 0.40), (8.0, 8.0)),
    "direct": ((1.00, 0.40), (1.0, 8.0)),
    "inverse": ((0.40, 1.00), (8.0, 1.0)),
    "randomised": ((0.40, 1.00), (1.0, 8.0)),
}
"""First and last factor of the battery, and of the torque; bsk_rl: CL_options["direct_BT_high"] and so on."""

INITIAL_CHARGE = 0.375, 0.625
"""Range of the initial charge, of the capacity; bsk_rl: init_range_options["nominal"]."""


class Graded(rand.Distribution):
    """Numbers between two ends, by the difficulty of each episode.

    bsk_rl: functions of the difficulty in ``CL_params``, called before every reset.
    """

    def __init__(self, ends: tuple[float, float], difficulty: Tensor | None) -> None:
        """``difficulty`` is 0 to 1, [1] or [environments]; drawn in every episode if None (domain randomization)."""
        self.ends, self.difficulty = ends, difficulty

    def size(self, key: rand.Key, name: str) -> Tensor:
        """Return the number of each environment, [n]; related values share the name of a draw."""
        first, last = self.ends
        if self.difficulty is None:
            return first + (last - first) * key.named(name).uniform(1).squeeze(1)
        size = first + (last - first) * self.difficulty
        return size[key.env_id] if len(size) > 1 else size.expand(len(key))


class Battery(Graded):
    """Energy in a share of the battery's capacity, W s, [n]."""

    def __init__(
        self,
        ends: tuple[float, float],
        difficulty: Tensor | None,
        share: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        """``share`` is the range of the share."""
        super().__init__(ends, difficulty)
        self.share = share

    def draw(self, key: rand.Key) -> Tensor:
        """See :meth:`Distribution.draw`."""
        low, high = self.share
        return (
            BATTERY
            * self.size(key, "capacity")
            * (low + (high - low) * key.uniform(1).squeeze(1))
        )


class Torque(Graded):
    """A torque in a random direction, N m, [n, 3]."""

    def draw(self, key: rand.Key) -> Tensor:
        """See :meth:`Distribution.draw`."""
        vector = key.normal(3)  # bsk_rl: np.random.normal(size=3)
        return (
            TORQUE
            * self.size(key, "torque").unsqueeze(1)
            * vector
            / vector.norm(dim=1, keepdim=True)
        )


def difficult_args(difficulty: Any, curriculum: str = "direct") -> dict[str, Any]:
    """Return the arguments that depend on the difficulty, 0 to 1: a number, or one for each environment, [N]."""
    battery, torque = CURRICULA[curriculum]
    level = (
        None
        if curriculum == "randomised"
        else torch.as_tensor(difficulty, dtype=torch.float64).reshape(-1)
    )
    return dict(
        batteryStorageCapacity=Battery(battery, level),
        storedCharge_Init=Battery(battery, level, INITIAL_CHARGE),
        disturbance_vector=Torque(torque, level),
    )


def make(
    num_envs: int = 1,
    sat_args: dict[str, Any] | None = None,
    difficulty: Any = 0.0,
    curriculum: str = "direct",
    **options: Any,
) -> SatelliteTasking:
    """Return ``num_envs`` episodes of the problem; ``sat_args`` and ``options`` replace its own."""
    arguments = SAT_ARGS | difficult_args(difficulty, curriculum) | (sat_args or {})
    duration = INTERVALS * 180.0
    defaults = dict(
        scenario=scene.UniformNadirScanning(value_per_second=1 / duration),
        rewarder=data.ScanningTimeReward(),
        time_limit=duration,
        failure_penalty=-1.0,
    )
    # bsk_rl: class SatelliteTaskingCL(SatelliteTasking), with set_task(difficulty)
    return SatelliteTasking(
        satellite=ScanningSatellite("Scanner1", sat_args=arguments),
        num_envs=num_envs,  # bsk_rl: one episode
        **(defaults | options),
    )


def main() -> None:
    """Train while the difficulty grows."""
    parser = argparse.ArgumentParser(description="Learn with a curriculum.")
    parser.add_argument("--curriculum", default="direct", choices=CURRICULA)
    parser.add_argument("--num-envs", type=int, default=64, help="episodes at once")
    parser.add_argument(
        "--iterations", type=int, default=20, help="number of training batches"
    )
    parser.add_argument(
        "--rollout", type=int, default=16, help="decisions per episode in a batch"
    )
    parser.add_argument(
        "--time-limit",
        type=float,
        default=INTERVALS * 180.0,
        help="length of an episode, s",
    )
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of the learning curve; needs the extra viz",
    )
    options = parser.parse_args()
    config = PPOConfig(
        num_envs=options.num_envs,
        rollout=options.rollout,
        lmbda=0.95,
        clip=0.2,
        gradient_norm=0.5,
        entropy=0.0,
    )
    own = dict(time_limit=options.time_limit, backend=options.backend, seed=0)
    env = make(options.num_envs, curriculum=options.curriculum, **own)
    last = options.iterations * config.batch
    show = Show()

    def harder(frames: int) -> None:
        """Raise the difficulty of new episodes from 0 to 1 over the training."""
        # bsk_rl: CLCallbacks.on_episode_start, set_task
        env.set_sat_args(difficult_args(frames / last, options.curriculum))

    def tell(frames: int, report: dict[str, float]) -> None:
        """Add the curriculum."""
        arguments = env.satellite.sat_args
        battery = arguments["batteryStorageCapacity"].mean() / BATTERY
        torque = arguments["disturbance_vector"].norm(dim=-1).mean() / TORQUE
        show(frames, report | {"battery": float(battery), "torque": float(torque)})

    train(env, config, options.iterations, tell, harder)  # bsk_rl: tune.run("PPO", ...)
    show.draw(options.figure, "reward", "battery", "torque")


if __name__ == "__main__":
    main()
