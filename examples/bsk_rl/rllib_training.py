"""
Training with episode metrics
=============================

Learn to scan the ground, charge, downlink and desaturate the wheels.

On the command line::

    python examples/bsk_rl/rllib_training.py --iterations 100 --num-envs 256

The problem of bsk_rl's page "Training with RLlib PPO". The trainer is the package's PPO, based on TorchRL, instead of RLlib's
(for RLlib, see ``examples/ppo_rllib.py``). Comments mark lines that differ from the page. ``bsk-torch train NadirScan-v1`` trains
on the same problem, with evaluation, checkpoints and figures.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torchrl.collectors import Collector

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
from bsk_torch.rl.training.ppo import Learner
from bsk_torch.sim import dyn, fsw  # bsk_rl: from bsk_rl.sim import dyn, fsw


class ScanningDownlinkDynModel(
    dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel
):
    """Scans and downlinks; adds two angles."""

    @property
    def instrument_pointing_error(self) -> Tensor:
        """Between instrument and nadir, [N] rad."""
        # bsk_rl: np.arccos(np.dot(-r_BN_P_unit, c_hat_P))
        return angle_between(-self.r_BN_P, self.satellite.fsw.c_hat_P)

    @property
    def solar_pointing_error(self) -> Tensor:
        """Between solar panels and the Sun, [N] rad."""
        nHat_B = self.satellite.sat_args["nHat_B"].unsqueeze(-1)
        # bsk_rl: np.transpose(self.BN) @ nHat_B
        nHat_N = (self.BN.mT @ nHat_B).squeeze(-1)
        # bsk_rl: world.gravFactory.spiceObject.planetStateOutMsgs[...]
        return angle_between(nHat_N, self.world.sun_direction_N)


class ScanningSatellite(sats.AccessSatellite):
    """Scans three minutes, charges two, downlinks or slows its wheels one."""

    observation_spec = [
        obs.SatProperties(
            dict(prop="storage_level_fraction"),
            dict(prop="battery_charge_fraction"),
            dict(prop="wheel_speeds_fraction"),
            dict(prop="instrument_pointing_error", norm=torch.pi),
            dict(prop="solar_pointing_error", norm=torch.pi),
        ),
        obs.OpportunityProperties(
            dict(prop="opportunity_open", norm=5700),
            dict(prop="opportunity_close", norm=5700),
            type="ground_station",
            n_ahead_observe=1,
        ),
        obs.Eclipse(norm=5700),
        obs.Time(),
    ]
    action_spec = [
        act.Scan(duration=180.0),
        act.Charge(duration=120.0),
        act.Downlink(duration=60.0),
        act.Desat(duration=60.0),
    ]
    dyn_type = ScanningDownlinkDynModel
    fsw_type = fsw.ContinuousImagingFSWModel


SAT_ARGS: dict[str, Any] = dict(
    dataStorageCapacity=5000 * 8e6,  # bit
    # bsk_rl: lambda: np.random.uniform(0.0, 0.8) * 5000 * 8e6
    storageInit=rand.Uniform(0.0, 0.8 * 5000 * 8e6),
    instrumentBaudRate=0.5 * 8e6,
    transmitterBaudRate=-50 * 8e6,
    batteryStorageCapacity=200 * 3600,  # W s
    # bsk_rl: lambda: np.random.uniform(0.3, 1.0) * 200 * 3600
    storedCharge_Init=rand.Uniform(0.3 * 200 * 3600, 200 * 3600),
    basePowerDraw=-10.0,  # W
    instrumentPowerDraw=-30.0,
    transmitterPowerDraw=-25.0,
    thrusterPowerDraw=-80.0,
    panelArea=0.25,
    imageAttErrorRequirement=0.1,
    imageRateErrorRequirement=0.1,
    # N m; bsk_rl: lambda: np.random.normal(scale=0.0001, size=3)
    disturbance_vector=rand.Normal(0.0, 1e-4, 3),
    maxWheelSpeed=6000.0,  # rpm
    # bsk_rl: lambda: np.random.uniform(-3000, 3000, 3)
    wheelSpeeds=rand.Uniform(-3000.0, 3000.0, 3),
    desatAttitude="nadir",
)
"""Data and power are limited."""

DURATION = 5 * 5700.0
"""About five orbits, s."""


def task() -> dict[str, Any]:
    """Options of the environment that are part of the problem."""
    return dict(
        scenario=scene.UniformNadirScanning(value_per_second=1 / DURATION),
        rewarder=data.ScanningTimeReward(),
        time_limit=DURATION,
        failure_penalty=-1.0,
        terminate_on_time_limit=True,
    )


def make(
    num_envs: int = 1, sat_args: dict[str, Any] | None = None, **options: Any
) -> SatelliteTasking:
    """Return ``num_envs`` episodes of the problem; ``sat_args`` and ``options`` replace its own."""
    satellite = ScanningSatellite("Scanner1", sat_args=SAT_ARGS | (sat_args or {}))
    # bsk_rl: one episode
    return SatelliteTasking(
        satellite=satellite, num_envs=num_envs, **(task() | options)
    )


class EpisodeMetrics:
    """Means over the episodes ended since the last call.

    bsk_rl calls a function of the environment, ``episode_data_callback``, whenever an episode ends. Here, many episodes end in a
    batch, and the same numbers are computed from its rows.
    """

    def __init__(self, num_envs: int, penalty: float) -> None:
        """Track ``num_envs`` environments with a failure penalty of ``penalty``."""
        self.penalty, self.reward, self.seconds = (
            penalty,
            torch.zeros(num_envs),
            torch.zeros(num_envs),
        )

    def __call__(self, batch: Any) -> dict[str, float]:
        """Return metrics of the episodes that end in a batch [N, T]."""
        following, rows = batch["next"], []
        for reward, seconds, done, truncated in zip(
            *(
                following[name].squeeze(-1).unbind(1)
                for name in ("reward", "duration", "done", "truncated")
            ),
            strict=True,
        ):
            self.reward, self.seconds = self.reward + reward, self.seconds + seconds
            rows.append(
                torch.stack([self.reward, truncated.float(), self.seconds / 5700.0], 1)[
                    done
                ]
            )
            self.reward, self.seconds = (
                self.reward.masked_fill(done, 0.0),
                self.seconds.masked_fill(done, 0.0),
            )
        ended = torch.cat(rows).double()
        if not len(ended):
            return {}
        means = dict(
            zip(
                ("reward", "alive", "orbits_complete"),
                ended.mean(0).tolist(),
                strict=True,
            )
        )
        per_orbit = (ended[:, 0] / ended[:, 2]).mean()
        return means | {
            "episodes": float(len(ended)),
            "reward_per_orbit": float(per_orbit),
        }


def train(
    env: Any,
    config: PPOConfig,
    iterations: int,
    seen: Callable[[int, dict[str, float]], None],
    before: Callable[[int], None] = lambda frames: None,
) -> Learner:
    """Learn from ``iterations`` batches of ``env``.

    Args:
        env: The environment, or a transformed one.
        config: Settings of PPO; only the network settings define the policy.
        iterations: Number of batches.
        seen: Called with the number of decisions so far and the metrics of a batch.
        before: Called with the number of decisions so far before each batch.
    """
    torch.manual_seed(config.seed)
    learner = Learner(config, env)
    actor = learner.networks.policy.select_out_keys("action", "action_log_prob")
    metrics = EpisodeMetrics(config.num_envs, env.failure_penalty)
    batches = iter(
        Collector(
            env,
            actor,
            frames_per_batch=config.batch,
            total_frames=iterations * config.batch,
        )
    )
    for k in range(iterations):
        before(k * config.batch)
        learner.anneal(k / iterations)
        batch = next(batches)
        report = metrics(batch)
        report |= learner.learn(batch)
        seen((k + 1) * config.batch, report)
    return learner


class Show:
    """Prints a line for each batch, and plots the metrics."""

    def __init__(self) -> None:
        """Start without metrics."""
        self.rows: list[tuple[int, dict[str, float]]] = []

    def __call__(self, frames: int, report: dict[str, float]) -> None:
        """Print a line."""
        print(frames, {name: round(value, 4) for name, value in report.items()})
        self.rows.append((frames, report))

    def draw(self, path: Path | None, *names: str) -> None:
        """Plot some of the metrics over the decisions to a file, unless ``path`` is None; needs the extra viz."""
        if path is None:
            return
        from bsk_torch.viz.figures import style

        figure, axes = style.panels([1.6] * len(names))
        for panel, name in zip(axes, names, strict=True):
            rows = [
                (frames, report[name]) for frames, report in self.rows if name in report
            ]
            panel.plot(*zip(*rows, strict=True), color=style.PALETTE[0])
            style.label(panel, name)
        axes[-1].set_xlabel("decisions")
        # ticks and the space for their labels are known after the first layout
        figure.draw_without_rendering()
        style.save(figure, path)


def main() -> None:
    """Train, then play an episode."""
    parser = argparse.ArgumentParser(description="Learn to scan.")
    parser.add_argument("--num-envs", type=int, default=64, help="episodes at once")
    parser.add_argument(
        "--iterations", type=int, default=20, help="number of training batches"
    )
    parser.add_argument(
        "--rollout", type=int, default=16, help="decisions per episode in a batch"
    )
    parser.add_argument(
        "--time-limit", type=float, default=DURATION, help="length of an episode, s"
    )
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure", type=Path, help="file for a figure of the learning curve"
    )
    options = parser.parse_args()
    env = make(
        options.num_envs, time_limit=options.time_limit, backend=options.backend, seed=0
    )
    # bsk_rl: PPOConfig().training(...).env_runners(...).environment(...)
    config = PPOConfig(
        num_envs=options.num_envs,
        rollout=options.rollout,
        hidden=(64, 64),  # bsk_rl: fcnet_hiddens=[512, 512]
        learning_rate=2.5e-3,  # bsk_rl: lr=0.00003, for millions of decisions
        gamma=0.99999,  # per second; bsk_rl: gamma=0.999 per decision
        lmbda=0.95,
        clip=0.1,
        gradient_norm=0.5,
    )
    show = Show()
    # bsk_rl: tune.run("PPO", ...)
    learner = train(env, config, options.iterations, show)
    rollout = env.rollout(8, learner.networks.policy, break_when_any_done=False)
    print(
        "rewards of the first episode's next steps:",
        rollout["next", "reward"][0].flatten(),
    )
    show.draw(options.figure, "reward", "alive", "entropy")


if __name__ == "__main__":
    main()
