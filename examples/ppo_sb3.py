"""
MaskablePPO and DQN with Stable-Baselines3
==========================================

Train with a discount per second, and compare the policy with random actions and rules on unseen episodes.

Install Stable-Baselines3 with: pip install 'bsk_torch[sb3]'

On the command line::

    python examples/ppo_sb3.py
    python examples/ppo_sb3.py --preset AEOSPower-v1 --gamma 0.997 --rollout 32 --num-envs 256
    python examples/ppo_sb3.py --algorithm dqn

To benchmark the model::

    python examples/ppo_sb3.py --out runs/sb3
    bsk-torch bench examples.ppo_sb3:entrant,runs/sb3 rule --presets NadirScan-v1

Stable-Baselines3 discounts per decision: a step of one minute is discounted as much as one of three minutes. A callback and a
replay buffer of bsk_torch discount per second instead. DQN ignores masks.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import torch
from sb3_contrib import MaskablePPO
from stable_baselines3 import DQN
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
from tensordict.nn import TensorDictModule
from torch import Tensor

from bsk_torch import SatelliteTasking
from bsk_torch.presets import make
from bsk_torch.rl.evaluation import FRESH, compare, comparison_table
from bsk_torch.rl.stable_baselines3 import DiscountPerSecond, DurationReplayBuffer
from bsk_torch.wrappers.stable_baselines3 import MetricsCallback, SB3VecEnv

LEAST = 0.05
"""Final fraction of the learning rate."""


def metrics(env: Any) -> dict[str, Any]:
    """Return numbers [N] by name, logged by MetricsCallback at the end of each episode (``episode/charge``)."""
    return {"charge": env.satellite.dynamics.battery_charge_fraction}


def make_env(options: argparse.Namespace, world: dict[str, Any]) -> VecNormalize:
    """Return the training environment, with recorded returns and normalized observations."""
    return VecNormalize(
        VecMonitor(
            SB3VecEnv(options.preset, options.num_envs, metrics=metrics, **world)
        ),
        norm_reward=False,
    )


def make_model(options: argparse.Namespace, env: VecNormalize) -> BaseAlgorithm:
    """Return MaskablePPO with the settings of :mod:`bsk_torch.rl.training.ppo`, or DQN."""
    common = dict(
        policy_kwargs={"net_arch": [64, 64]}, seed=options.seed, device="cpu", verbose=1
    )
    rate = options.learning_rate
    schedule = LinearSchedule(rate, LEAST * rate, 1.0)
    if options.algorithm == "dqn":
        return DQN(
            "MlpPolicy",
            env,
            learning_rate=schedule,
            buffer_size=500_000,
            learning_starts=8192,
            batch_size=512,
            train_freq=1,
            gradient_steps=4,
            target_update_interval=200 * options.num_envs,
            exploration_initial_eps=0.5,
            exploration_final_eps=0.02,
            exploration_fraction=0.5,
            replay_buffer_class=DurationReplayBuffer,
            replay_buffer_kwargs={"gamma": options.gamma},
            **common,
        )
    return MaskablePPO(
        "MlpPolicy",
        env,
        learning_rate=schedule,
        n_steps=options.rollout,
        batch_size=min(2048, options.num_envs * options.rollout),
        n_epochs=8,
        gamma=1.0,  # DiscountPerSecond discounts
        ent_coef=0.01,
        **common,
    )


def train(options: argparse.Namespace) -> tuple[BaseAlgorithm, VecNormalize]:
    """Train; return the model, and the environment with the statistics of observations."""
    env = make_env(options, world(options))
    model = make_model(options, env)
    callbacks: list[BaseCallback] = [MetricsCallback()]
    if options.algorithm == "ppo":
        callbacks.append(DiscountPerSecond(options.gamma))
    model.learn(options.steps, log_interval=options.log_interval, callback=callbacks)
    return model, env


def world(options: argparse.Namespace) -> dict[str, Any]:
    """Return arguments of the preset."""
    limit = {} if options.time_limit is None else {"time_limit": options.time_limit}
    return {"backend": options.backend} | limit


def as_policy(model: BaseAlgorithm, env: VecNormalize) -> TensorDictModule:
    """Return the model's most probable actions as a policy for :func:`bsk_torch.rl.evaluation.evaluate`."""

    def choose(observation: Tensor, action_mask: Tensor) -> Tensor:
        seen = env.normalize_obs(observation.numpy())
        masks = (
            {"action_masks": action_mask.numpy()}
            if isinstance(model, MaskablePPO)
            else {}
        )
        actions, _ = model.predict(seen, deterministic=True, **masks)
        return torch.as_tensor(actions)

    return TensorDictModule(
        choose, in_keys=["observation", "action_mask"], out_keys=["action"]
    )


def entrant(
    preset: str, make: Callable[..., Any], folder: str
) -> tuple[Any, TensorDictModule] | None:
    """Enter the model of a folder in ``bsk-torch bench``; None for presets with other spaces."""
    model, env = MaskablePPO.load(Path(folder) / "model.zip", device="cpu"), make()
    if not isinstance(env, SatelliteTasking):
        return None
    seen = SB3VecEnv(env)
    if (seen.observation_space, seen.action_space) != (
        model.observation_space,
        model.action_space,
    ):
        return None
    return env, as_policy(
        model, VecNormalize.load(str(Path(folder) / "normalize.pkl"), seen)
    )


SETTINGS = {
    "ppo": dict(learning_rate=2.5e-3, gamma=0.99999, num_envs=256, log_interval=10),
    "dqn": dict(learning_rate=1e-3, gamma=0.9999, num_envs=256, log_interval=2000),
}
"""Defaults that differ between algorithms; DQN counts episodes between two lines of the log."""


def arguments(line: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse the command line, or ``line``."""
    parser = argparse.ArgumentParser(
        description="Train with Stable-Baselines3 and sb3-contrib."
    )
    parser.add_argument("--algorithm", default="ppo", choices=SETTINGS)
    parser.add_argument(
        "--preset",
        default="NadirScan-v1",
        help="single-satellite preset with vector observations",
    )
    parser.add_argument(
        "--steps", type=int, default=2_000_000, help="number of training decisions"
    )
    parser.add_argument("--num-envs", type=int, help="episodes at once")
    parser.add_argument(
        "--rollout",
        type=int,
        default=32,
        help="decisions per episode between two updates of PPO",
    )
    parser.add_argument(
        "--learning-rate", type=float, help="initial value; decreases linearly"
    )
    parser.add_argument("--gamma", type=float, help="discount per second")
    parser.add_argument(
        "--log-interval",
        type=int,
        help="rollouts, or episodes of DQN, between two lines of the log",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--episodes", type=int, default=1024, help="unseen episodes per evaluation"
    )
    parser.add_argument(
        "--time-limit",
        type=float,
        help="length of an episode, s (default: the preset's)",
    )
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--out", type=Path, help="folder for the model (default: a new one in runs/)"
    )
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of an episode; needs the extra viz",
    )
    parser.set_defaults(**SETTINGS[parser.parse_known_args(line)[0].algorithm])
    return parser.parse_args(line)


def main() -> None:
    """Train, save, evaluate."""
    options = arguments()
    torch.set_num_threads(1)
    begin = time.perf_counter()
    model, env = train(options)
    seconds = time.perf_counter() - begin
    out = (
        options.out
        or Path("runs") / f"{options.preset}_sb3_{datetime.now():%Y%m%d-%H%M%S}"
    )
    out.mkdir(parents=True, exist_ok=True)
    model.save(out / "model.zip")
    env.save(str(out / "normalize.pkl"))
    fresh = make(options.preset, num_envs=options.episodes, **world(options))
    policy, name = as_policy(model, env), type(model).__name__
    print(comparison_table(compare({name: policy}, fresh, options.seed)))
    print(
        f"{model.num_timesteps} decisions in {seconds:.0f} s; model and observation statistics saved in {out}"
    )
    if options.figure is not None:
        from bsk_torch.viz.episodes import draw, record

        draw(
            record(
                policy,
                make(options.preset, num_envs=1, **world(options)),
                seed=options.seed + FRESH,
            ),
            options.figure,
            name,
        )


if __name__ == "__main__":
    main()
