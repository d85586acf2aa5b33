"""
MaskablePPO with Stable-Baselines3
==================================

Train with sb3-contrib, and compare the policy with random actions and rules on unseen episodes.

Install Stable-Baselines3 with: pip install 'bsk_torch[sb3]'

On the command line::

    python examples/ppo_sb3.py
    python examples/ppo_sb3.py --preset AEOSPower-v1 --gamma 0.95 --rollout 32 --num-envs 256

To benchmark the model::

    python examples/ppo_sb3.py --out runs/sb3
    bsk-torch bench examples.ppo_sb3:entrant,runs/sb3 rule --presets NadirScan-v1

Stable-Baselines3 discounts per decision: a step of one minute is discounted as much as one of three minutes. bsk_torch.rl and
examples/ppo_cleanrl.py discount per second.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import torch
from sb3_contrib import MaskablePPO
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
from tensordict.nn import TensorDictModule
from torch import Tensor

from bsk_torch import SatelliteTasking
from bsk_torch.presets import make
from bsk_torch.rl.evaluation import FRESH, compare, comparison_table
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


def make_model(options: argparse.Namespace, env: VecNormalize) -> MaskablePPO:
    """Return MaskablePPO with the settings of :mod:`bsk_torch.rl.training.ppo` where supported."""
    rate = options.learning_rate
    return MaskablePPO(
        "MlpPolicy",
        env,
        learning_rate=LinearSchedule(rate, LEAST * rate, 1.0),
        n_steps=options.rollout,
        batch_size=min(2048, options.num_envs * options.rollout),
        n_epochs=8,
        gamma=options.gamma,
        ent_coef=0.01,
        policy_kwargs={"net_arch": [64, 64]},
        seed=options.seed,
        device="cpu",
        verbose=1,
    )


def as_policy(model: MaskablePPO, env: VecNormalize) -> TensorDictModule:
    """Return the model's most probable actions as a policy for :func:`bsk_torch.rl.evaluation.evaluate`."""

    def choose(observation: Tensor, action_mask: Tensor) -> Tensor:
        seen = env.normalize_obs(observation.numpy())
        actions, _ = model.predict(
            seen, deterministic=True, action_masks=action_mask.numpy()
        )
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


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description="Train with sb3-contrib's MaskablePPO."
    )
    parser.add_argument(
        "--preset",
        default="NadirScan-v1",
        help="single-satellite preset with vector observations",
    )
    parser.add_argument(
        "--steps", type=int, default=2_000_000, help="number of training decisions"
    )
    parser.add_argument("--num-envs", type=int, default=1024, help="episodes at once")
    parser.add_argument(
        "--rollout",
        type=int,
        default=16,
        help="decisions per episode between two updates",
    )
    parser.add_argument(
        "--learning-rate",
        type=float,
        default=2.5e-3,
        help="initial value; decreases linearly",
    )
    parser.add_argument(
        "--gamma", type=float, default=0.999, help="discount per decision"
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
    return parser.parse_args()


def main() -> None:
    """Train, save, evaluate."""
    options = arguments()
    torch.set_num_threads(1)
    world = {"backend": options.backend} | (
        {} if options.time_limit is None else {"time_limit": options.time_limit}
    )
    env = make_env(options, world)
    model = make_model(options, env)
    begin = time.perf_counter()
    model.learn(options.steps, log_interval=10, callback=MetricsCallback())
    seconds = time.perf_counter() - begin
    out = (
        options.out
        or Path("runs") / f"{options.preset}_sb3_{datetime.now():%Y%m%d-%H%M%S}"
    )
    out.mkdir(parents=True, exist_ok=True)
    model.save(out / "model.zip")
    env.save(str(out / "normalize.pkl"))
    fresh = make(options.preset, num_envs=options.episodes, **world)
    policy = as_policy(model, env)
    print(comparison_table(compare({"MaskablePPO": policy}, fresh, options.seed)))
    print(
        f"{model.num_timesteps} decisions in {seconds:.0f} s; model and observation statistics saved in {out}"
    )
    if options.figure is not None:
        from bsk_torch.viz.episodes import draw, record

        draw(
            record(
                policy,
                make(options.preset, num_envs=1, **world),
                seed=options.seed + FRESH,
            ),
            options.figure,
            "MaskablePPO",
        )


if __name__ == "__main__":
    main()
