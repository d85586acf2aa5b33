"""
Clouds and repeated images
==========================

Five satellites repeat images until each target has probably been seen, with a greedy rule.

On the command line::

    python examples/bsk_rl/cloud_environment_with_reimaging.py --num-envs 2

The problem of bsk_rl's page "Cloud Environment with Re-imaging", the case of the probability of success. Comments mark lines that
differ from it. On the page, every target is an object with a belief updated by the data store; here, beliefs are a table [N, T]
of all targets. Its case of single images is ``data.CloudFreeImageReward``; its network of tokens is ``as_set=True`` with
``bsk-torch train --network attention``.
"""

# sphinx_gallery_thumbnail_path = "_static/readme/AEOSConstellation-v1.png"

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from aeos import Density, s_hat_H
from torch import Tensor

# bsk_rl: from bsk_rl import ...
from bsk_torch import ConstellationTasking, act, formations, obs, rand, sats, scene
from bsk_torch.constants import R_EARTH  # bsk_rl: orbitalMotion.REQ_EARTH * 1e3

# bsk_rl: from bsk_rl.data.base import Data, DataStore, GlobalReward
from bsk_torch.data import ImageReward
from bsk_torch.sim import fsw  # bsk_rl: from bsk_rl.sim import fsw

ENOUGH = 0.95
"""Probability of success at which a target needs no further image; bsk_rl: target.reward_threshold."""

AHEAD = 40


def time_variation(seconds: Tensor, t_const: float = 30 * 60 / 5) -> Tensor:
    """Return the cloud movement since the last image, 0 to 1: 0.998 after half an hour."""
    return torch.where(
        seconds <= 0,
        torch.zeros_like(seconds),
        torch.sigmoid(2.5 * (seconds / t_const - 2.5)),
    )


def belief_update(belief: Tensor, forecast: Tensor, seconds: Tensor) -> Tensor:
    """Return the probability of success after another image, ``seconds`` after the last one; bsk_rl: [1 - b, b] as an array."""
    return 1 - (1 - belief) * (1 - (1 - forecast) * time_variation(seconds))


class CloudTargets(scene.CloudyTargets):
    """Cloudy targets with earlier images of partial success; images update the beliefs."""

    mu_data = 0.6740208166434426

    def __init__(self, targets: scene.targets.TargetScenario) -> None:
        """Put ``targets`` under clouds."""
        super().__init__(
            targets,
            cover=rand.Uniform(0.0, 2 * self.mu_data),
            forecast_sigma=rand.Uniform(0.01, 0.05),
        )

    # bsk_rl: regenerate_targets, target by target
    def draw(self, key: rand.Key) -> dict[str, Tensor]:
        """Draw the belief and the time of the last image of every target, too."""
        belief = 0.94 * key.named("belief").uniform(self.most_targets)
        previous = -5700.0 * key.named("previous").uniform(self.most_targets)
        return super().draw(key) | {
            "belief_at_start": belief,
            "previous_at_start": previous,
        }


class BeliefReward(ImageReward):  # bsk_rl: three classes, of data, store and rewarder
    """Pays for growing probabilities of success: priority times (alpha times the growth, and 1 - alpha at the threshold).

    Counters: ``reimaged`` and ``complete`` [N, S], images of targets that had one in this episode, and images that reached the
    threshold.
    """

    def __init__(self, alpha: float = 1.0) -> None:
        """``alpha`` is 0 to 1."""
        self.alpha = alpha

    def link(self, scenario: Any, fleet: Any) -> None:
        """Declare what changes: growth of beliefs since the start, and times of images."""
        super().link(scenario, fleet)
        for name, initial in (("growth", 0.0), ("imaged_at", -math.inf)):
            self.memory.declare(name, initial, scenario.most_targets)
        for name in ("reimaged", "complete"):
            self.memory.declare(name, 0, fleet.size)

    @property
    def belief(self) -> Tensor:
        """Probability of success, [N, T]."""
        return self.scenario.drawn("belief_at_start") + self.memory["growth"]

    @property
    def previous(self) -> Tensor:
        """Time of the last image, [N, T] s since reset."""
        return torch.maximum(
            self.scenario.drawn("previous_at_start"), self.memory["imaged_at"]
        )

    def counts(self) -> dict[str, Tensor]:
        """See the class."""
        return {name: self.memory[name] for name in ("reimaged", "complete")}

    # bsk_rl: satellite.add_access_filter(belief_threshold_filter)
    def selectable(self) -> Tensor:
        """Targets whose belief is below the threshold, for every satellite, [N, S, T]."""
        open_to_all = self.scenario.available & (self.belief < ENOUGH)
        return open_to_all.unsqueeze(1).expand(-1, self.fleet.size, -1)

    # bsk_rl: compare_log_states and calculate_reward
    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        """Return the reward [N, S] and update the beliefs; satellites that image a target together do so one after the other."""
        now, rewards = self.fleet.sim_time.unsqueeze(1), []
        # before the step: bsk_rl reads self.data.imaged_complete, which grows after it
        done = self.belief > ENOUGH
        # the few satellites of an episode; all episodes at once
        for k in range(self.fleet.size):
            one, takes = target[:, k : k + 1], taken[:, k : k + 1]
            forecast, priority, belief, previous, complete = (
                table.gather(1, one)
                for table in (
                    self.scenario.cloud_forecast,
                    self.scenario.priority,
                    self.belief,
                    self.previous,
                    done,
                )
            )
            after = belief_update(belief, forecast, now - previous)
            whole = (1 - self.alpha) * (after > ENOUGH)
            rewards.append(
                torch.where(
                    takes & ~complete,
                    priority * (whole + (after - belief) * self.alpha),
                    0.0,
                )
            )
            for name, new in (
                (
                    "growth",
                    after - self.scenario.drawn("belief_at_start").gather(1, one),
                ),
                ("imaged_at", now),
            ):
                table = self.memory[name]
                self.memory[name] = table.scatter(
                    1, one, torch.where(takes, new, table.gather(1, one))
                )
            self.memory["reimaged"] = _added(
                self.memory["reimaged"], k, takes & (previous >= 0)
            )
            self.memory["complete"] = _added(
                self.memory["complete"], k, takes & ~complete & (after > ENOUGH)
            )
        return torch.cat(rewards, 1)


def _added(counter: Tensor, column: int, which: Tensor) -> Tensor:
    """Return the counter [N, S] with one more in a column where ``which`` [N, 1]."""
    return counter + which * (torch.arange(counter.shape[1]) == column)


class CloudCoverDensity(Density):
    """Sums of cloud-cover forecasts over targets, by closing time of their next windows."""

    def worth(self) -> Tensor:
        """See :meth:`Density.worth`."""
        return self.satellite.scenario.cloud_forecast


def of_targets(satellite: Any, opportunities: Any, table: Tensor) -> Tensor:
    """Return the entries of a table [environments, T] for opportunities, [N, n]; bsk_rl: opp["object"].attribute."""
    return satellite.simulator.look_up(table, opportunities.place)


def belief(satellite: Any, opportunities: Any) -> Tensor:
    """Return the probability of success, [N, n]."""
    return of_targets(satellite, opportunities, satellite.rewarder.belief)


def time_since_prev_obs(satellite: Any, opportunities: Any) -> Tensor:
    """Return the time since the last image, [N, n] s."""
    return satellite.simulator.sim_time.unsqueeze(1) - of_targets(
        satellite, opportunities, satellite.rewarder.previous
    )


def forecast(satellite: Any, opportunities: Any) -> Tensor:
    """Return the forecast of the cloud cover, [N, n]."""
    return of_targets(satellite, opportunities, satellite.scenario.cloud_forecast)


def belief_expected(satellite: Any, opportunities: Any) -> Tensor:
    """Return the probability of success after an image now, [N, n]."""
    known = (
        function(satellite, opportunities)
        for function in (belief, forecast, time_since_prev_obs)
    )
    return belief_update(*known)


class BeliefSatellite(sats.ImagingSatellite):  # bsk_rl: C_F_Bayesian
    """Charges for a minute, or images one of the next 40 targets."""

    observation_spec = [
        obs.SatProperties(
            dict(prop="omega_BN_B", norm=0.03),
            dict(prop="c_hat_H"),
            dict(prop="r_BN_P", norm=R_EARTH),
            dict(prop="v_BN_P", norm=7616.5),
            dict(prop="battery_charge_fraction"),
            dict(prop="s_hat_H", fn=s_hat_H),
        ),
        obs.Eclipse(norm=5700.0),  # bsk_rl after 1.3.8: norm=None, the orbital period
        CloudCoverDensity(intervals=20, norm=5),
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="r_LB_H", norm=R_EARTH),
            dict(prop="target_angle", norm=math.pi / 2),
            dict(prop="target_angle_rate", norm=0.03),
            dict(prop="opportunity_open", norm=300.0),
            dict(prop="opportunity_close", norm=300.0),
            dict(prop="cloud_forecast", fn=forecast),
            dict(prop="belief", fn=belief, norm=1.0),
            dict(prop="time_since_prev_obs", fn=time_since_prev_obs, norm=5700.0),
            dict(prop="belief_expected", fn=belief_expected, norm=1.0),
            type="target",
            n_ahead_observe=AHEAD,
        ),
    ]
    action_spec = [act.Charge(duration=60.0), act.Image(n_ahead_image=AHEAD)]
    fsw_type = fsw.SteeringImagerFSWModel


STORE = 20 * 8e6 * 100

SAT_ARGS: dict[str, Any] = dict(
    imageAttErrorRequirement=0.01,
    imageRateErrorRequirement=0.01,
    batteryStorageCapacity=80.0 * 3600 * 2,
    # bsk_rl: lambda: np.random.uniform(0.4, 1.0) * ...
    storedCharge_Init=rand.Uniform(0.4 * 80 * 3600 * 2, 80.0 * 3600 * 2),
    u_max=0.1,
    K1=0.2,
    K3=0.5,
    servo_P=30,
    nHat_B=[0, 0, -1],
    imageTargetMinimumElevation=math.radians(45),
    rwBasePower=20,
    maxWheelSpeed=1500,
    # bsk_rl: lambda: np.random.randint(0, 0.01 * dataStorageCapacity)
    storageInit=rand.Uniform(0.0, 0.01 * STORE),
    # bsk_rl: lambda: np.random.uniform(-1, 1, 3)
    wheelSpeeds=rand.Uniform(-1.0, 1.0, 3),
    dataStorageCapacity=STORE,
)

N_SATELLITES = 5


def make(
    num_envs: int = 1,
    sat_args: Sequence[dict[str, Any]] | None = None,
    alpha: float = 1.0,
    **options: Any,
) -> ConstellationTasking:
    """Return ``num_envs`` episodes of the problem.

    ``sat_args`` of each satellite replace what would be drawn, ``options`` those of the problem.
    """
    own = [{}] * N_SATELLITES if sat_args is None else sat_args
    # bsk_rl: walker_delta_args(altitude=500.0, n_planes=1, inc=45, clustersize=5, clusterspacing=72)
    ring = formations.walker_delta_args(
        altitude=500.0, n_planes=1, inc=45.0, clustersize=5, clusterspacing=72
    )
    defaults = dict(
        scenario=CloudTargets(scene.UniformTargets((1000, 10_000))),
        rewarder=BeliefReward(alpha),
        sat_arg_randomizer=ring if sat_args is None else None,
        sim_rate=0.5,
        max_step_duration=300.0,
        time_limit=95 * 60 / 2,
        failure_penalty=0.0,
    )
    return ConstellationTasking(
        satellites=[
            BeliefSatellite(f"EO{k}", SAT_ARGS | own[k]) for k in range(N_SATELLITES)
        ],
        num_envs=num_envs,  # bsk_rl: one episode
        **(defaults | options),
    )


COEFFICIENTS = 3.504, 96.8639, 1325.3045, -23.6751, -1.681e4, -1009.7423
"""Coefficients of the polynomial predicting slew time; the page's fit."""


def greedy(env: ConstellationTasking) -> Tensor:
    """Return for every satellite the target whose belief grows most per second and priority, [N, S]; bsk_rl's rule for alpha = 1.

    bsk_rl reads the observation, name by name and satellite by satellite.
    """
    satellite = env.fleet.satellites[0]
    ahead, now = (
        satellite.find_next_opportunities(AHEAD),
        satellite.simulator.sim_time.unsqueeze(1),
    )
    angle, rate = satellite.aims(ahead)[..., 3], satellite.aims(ahead)[..., 4]
    powers = torch.ones_like(angle), angle, rate, angle**2, rate**2, angle * rate
    slew = sum(x * power for x, power in zip(COEFFICIENTS, powers, strict=True)).clamp(
        min=1e-3
    )  # type: ignore[union-attr]
    ready = torch.maximum(slew, ahead.open - now).clamp(min=1.0)
    growth = belief_expected(satellite, ahead) - belief(satellite, ahead)
    score = growth * of_targets(satellite, ahead, satellite.scenario.priority) / ready
    score = torch.where(ready > ahead.close - now, -math.inf, score)
    return 1 + score.argmax(1).view(env.fleet.num_envs, env.fleet.size)


def main() -> None:
    """Charge, then follow the greedy rule."""
    parser = argparse.ArgumentParser(
        description="Image targets until they have probably been seen."
    )
    parser.add_argument("--num-envs", type=int, default=2, help="episodes at once")
    parser.add_argument("--steps", type=int, default=5)
    parser.add_argument(
        "--time-limit", type=float, default=95 * 60 / 2, help="length of an episode, s"
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
    td = env.reset()
    total = torch.zeros(options.num_envs, N_SATELLITES)
    for k in range(options.steps):
        action = (
            torch.zeros(options.num_envs, N_SATELLITES, dtype=torch.int64)
            if k == 0
            else greedy(env)
        )
        td["agents", "action"] = action  # bsk_rl: {satellite.name: action}
        td = env.step(td)["next"]
        total += td["agents", "reward"].squeeze(2)
    print("rewards:", total.tolist())  # bsk_rl: env.unwrapped.rewarder.cum_reward
    for name, count in env.counts().items():
        print(f"{name}:", count.tolist())
    if options.figure is not None:
        from PIL import Image

        Image.fromarray(env.render(rows=0).numpy()).save(options.figure)


if __name__ == "__main__":
    main()
