"""
Time-discounted GAE
===================

Discount per second, so that longer decisions are discounted more.

On the command line::

    python examples/bsk_rl/time_discounted_gae.py --iterations 100 --num-envs 256

The problem of bsk_rl's page "Time-Discounted GAE": ``rllib_training.py`` without the time as an observation. Comments mark lines
that differ from the page. With a discount gamma per second, a step of t seconds and rewards at the end of steps, values satisfy::

    V = E[gamma^t (r + V')]

This is the default of ``bsk_torch.rl``; the decay lambda is per decision, as in bsk_rl.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rllib_training import SAT_ARGS, ScanningSatellite, Show, task, train

from bsk_torch import SatelliteTasking
from bsk_torch.rl.training.config import PPOConfig


class TimelessSatellite(ScanningSatellite):
    """Does not observe the time."""

    observation_spec = ScanningSatellite.observation_spec[:-1]


def make(
    num_envs: int = 1, sat_args: dict[str, Any] | None = None, **options: Any
) -> SatelliteTasking:
    """Return ``num_envs`` episodes of the problem; ``sat_args`` and ``options`` replace its own."""
    satellite = TimelessSatellite("Scanner1", sat_args=SAT_ARGS | (sat_args or {}))
    # bsk_rl: one episode
    return SatelliteTasking(
        satellite=satellite, num_envs=num_envs, **(task() | options)
    )


def main() -> None:
    """Train."""
    parser = argparse.ArgumentParser(description="Learn with a discount per second.")
    parser.add_argument("--num-envs", type=int, default=64, help="episodes at once")
    parser.add_argument(
        "--iterations", type=int, default=20, help="number of training batches"
    )
    parser.add_argument(
        "--rollout", type=int, default=16, help="decisions per episode in a batch"
    )
    parser.add_argument(
        "--time-limit", type=float, default=28500.0, help="length of an episode, s"
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
        # per second; bsk_rl: gamma=0.999, which TimeDiscountedGAEPPOTorchLearner takes to the power of d_ts
        gamma=0.99999,
        # bsk_rl: config.training(learner_class=TimeDiscountedGAEPPOTorchLearner)
        reward_time="end",
        lmbda=0.95,
        clip=0.1,
        gradient_norm=0.5,
    )
    env = make(
        options.num_envs, time_limit=options.time_limit, backend=options.backend, seed=0
    )
    show = Show()
    train(env, config, options.iterations, show)  # bsk_rl: tune.run("PPO", ...)
    show.draw(options.figure, "reward", "alive", "entropy")


if __name__ == "__main__":
    main()
