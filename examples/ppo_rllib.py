"""
PPO with RLlib
==============

Train through Gymnasium's vector entry point, and compare the policy with random actions and rules on unseen episodes.

RLlib requires an older Gymnasium, so install it in a separate virtual environment::

    pip install 'ray[rllib]==2.60.0'
    python examples/ppo_rllib.py

To benchmark the trained module::

    python examples/ppo_rllib.py --out runs/rllib
    bsk-torch bench examples.ppo_rllib:entrant,runs/rllib rule --presets NadirScan-v1

RLlib handles episodes as Python objects, one decision after the other, and discounts per decision: a step of one minute is
discounted as much as one of three minutes.

The documentation does not execute this program, because its dependencies conflict with the others; ``scripts/test.sh --rllib``
tests it. A run of 100,000 decisions printed this:

.. literalinclude:: /../examples/recorded/ppo_rllib.txt
   :language: text

.. image:: /../examples/recorded/ppo_rllib.png
   :alt: Return of the last episodes over the decisions of this run
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers.vector import NormalizeObservation
from ray.rllib.algorithms.algorithm import Algorithm
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core import DEFAULT_MODULE_ID
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.rllib.core.rl_module.rl_module import RLModule, RLModuleSpec
from ray.rllib.examples.rl_modules.classes.action_masking_rlm import (
    ActionMaskingTorchRLModule,
)
from ray.tune import register_env
from tensordict.nn import TensorDictModule
from torch import Tensor

from bsk_torch import SatelliteTasking
from bsk_torch.presets import make
from bsk_torch.rl.evaluation import FRESH, compare, comparison_table

# sphinx_gallery_thumbnail_path = '../examples/recorded/ppo_rllib.png'

NAME = "bsk_torch"
"""Name of the environment in RLlib."""

LEAST = 0.05
"""Final fraction of the learning rate."""


class MaskedObservations(gymnasium.vector.VectorWrapper):
    """Adds ``info["action_mask"]`` to the observations, as expected by RLlib's masking module."""

    def __init__(self, env: gymnasium.vector.VectorEnv) -> None:
        """Wrap a vector environment with discrete actions."""
        super().__init__(env)
        mask = spaces.Box(0.0, 1.0, (env.single_action_space.n,), np.float32)
        parts = {"action_mask": mask, "observations": env.single_observation_space}
        self.single_observation_space = spaces.Dict(parts)
        self.observation_space = batch_space(
            self.single_observation_space, env.num_envs
        )

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """See :meth:`gymnasium.vector.VectorEnv.reset`."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._masked(observation, info), info

    def step(
        self, actions: Any
    ) -> tuple[dict[str, Any], Any, Any, Any, dict[str, Any]]:
        """See :meth:`gymnasium.vector.VectorEnv.step`."""
        observation, *results, info = self.env.step(actions)
        return self._masked(observation, info), *results, info

    def _masked(
        self, observation: np.ndarray, info: dict[str, Any]
    ) -> dict[str, np.ndarray]:
        return {
            "action_mask": info["action_mask"].astype(np.float32),
            "observations": observation,
        }


def make_vector(context: Mapping[str, Any]) -> MaskedObservations:
    """Return RLlib's environment: ``num_envs`` episodes of ``preset`` in one simulation, with normalized observations."""
    options = dict(context)
    env_id = f"bsk_torch/{options.pop('preset')}"
    env = gymnasium.make_vec(env_id, vectorization_mode="vector_entry_point", **options)
    return MaskedObservations(NormalizeObservation(env))


def make_algorithm(options: argparse.Namespace, world: dict[str, Any]) -> Algorithm:
    """Return PPO in this process, with the settings of :mod:`bsk_torch.rl.training.ppo` where supported."""
    model = DefaultModelConfig(
        fcnet_hiddens=[64, 64], fcnet_activation="tanh", vf_share_layers=False
    )
    batch = options.num_envs * options.rollout
    config = (
        PPOConfig()
        .environment(NAME, env_config={"preset": options.preset, **world})
        .env_runners(
            num_env_runners=0,
            num_envs_per_env_runner=options.num_envs,
            rollout_fragment_length=options.rollout,
            gym_env_vectorize_mode="vector_entry_point",
        )
        .learners(num_learners=0)
        .rl_module(
            rl_module_spec=RLModuleSpec(
                module_class=ActionMaskingTorchRLModule, model_config=model
            )
        )
        .training(
            gamma=options.gamma,
            lambda_=0.95,
            lr=[
                [0, options.learning_rate],
                [options.steps, LEAST * options.learning_rate],
            ],
            train_batch_size_per_learner=batch,
            minibatch_size=min(512, batch),
            num_epochs=8,
            clip_param=0.2,
            entropy_coeff=0.01,
            use_kl_loss=False,
            vf_clip_param=float("inf"),
            grad_clip=0.5,
        )
        .debugging(seed=options.seed)
    )
    return config.build_algo()


def as_policy(
    module: RLModule, mean: np.ndarray, variance: np.ndarray
) -> TensorDictModule:
    """Return the module's most probable actions as a policy for :func:`bsk_torch.rl.evaluation.evaluate`."""

    def choose(observation: Tensor, action_mask: Tensor) -> Tensor:
        seen = (observation - torch.as_tensor(mean)) / torch.as_tensor(
            variance + 1e-8
        ).sqrt()
        batch = {
            Columns.OBS: {
                "observations": seen.float(),
                "action_mask": action_mask.float(),
            }
        }
        return module.forward_inference(batch)[Columns.ACTION_DIST_INPUTS].argmax(-1)

    return TensorDictModule(
        choose, in_keys=["observation", "action_mask"], out_keys=["action"]
    )


def entrant(
    preset: str, make: Callable[..., Any], folder: str
) -> tuple[Any, TensorDictModule] | None:
    """Enter the module of a checkpoint in ``bsk-torch bench``; None for presets with other spaces."""
    path = Path(folder).absolute()
    module = RLModule.from_checkpoint(
        path / "learner_group" / "learner" / "rl_module" / DEFAULT_MODULE_ID
    )
    env, kept = make(), np.load(path / "normalize.npz")
    if not isinstance(env, SatelliteTasking):
        return None
    seen, actions = (
        env.observation_spec["observation"],
        env.satellite.action_description,
    )
    if (
        tuple(seen.shape[1:]) != kept["mean"].shape
        or len(actions) != module.action_space.n
    ):
        return None
    return env, as_policy(module, kept["mean"], kept["variance"])


def train(algorithm: Algorithm, steps: int) -> None:
    """Train for at least ``steps`` decisions, and print progress."""
    begin, done = time.perf_counter(), 0
    while done < steps:
        report = algorithm.train()["env_runners"]
        done = int(report["num_env_steps_sampled_lifetime"])
        recent = report.get("episode_return_mean", float("nan"))
        print(
            f"{done:>9} steps, {time.perf_counter() - begin:4.0f} s: return {recent:.3f}",
            flush=True,
        )


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description="Train with RLlib's PPO.")
    parser.add_argument(
        "--preset",
        default="NadirScan-v1",
        help="single-satellite preset with vector observations",
    )
    parser.add_argument(
        "--steps", type=int, default=400_000, help="number of training decisions"
    )
    parser.add_argument("--num-envs", type=int, default=64, help="episodes at once")
    parser.add_argument(
        "--rollout",
        type=int,
        default=64,
        help="decisions per episode between two updates",
    )
    parser.add_argument(
        "--learning-rate",
        type=float,
        default=1e-3,
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
        "--out",
        type=Path,
        help="folder for the checkpoint (default: a new one in runs/)",
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
    register_env(NAME, make_vector)
    algorithm = make_algorithm(options, world)
    train(algorithm, options.steps)
    out = (
        options.out
        or Path("runs") / f"{options.preset}_rllib_{datetime.now():%Y%m%d-%H%M%S}"
    )
    algorithm.save_to_path(out.absolute())
    # below RLlib's wrapper and the mask
    seen = algorithm.env_runner.env.env.env.obs_rms
    np.savez(out / "normalize.npz", mean=seen.mean, variance=seen.var)
    fresh = make(options.preset, num_envs=options.episodes, **world)
    policy = as_policy(algorithm.get_module(), seen.mean, seen.var)
    print(comparison_table(compare({"RLlib PPO": policy}, fresh, options.seed)))
    print(f"checkpoint and observation statistics saved in {out}")
    if options.figure is not None:
        from bsk_torch.viz.episodes import draw, record

        draw(
            record(
                policy,
                make(options.preset, num_envs=1, **world),
                seed=options.seed + FRESH,
            ),
            options.figure,
            "RLlib PPO",
        )
    algorithm.stop()


if __name__ == "__main__":
    main()
