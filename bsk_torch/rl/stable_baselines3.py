"""Discounts per second for Stable-Baselines3, which discounts per decision."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from bsk_torch.rl.durations import estimate_advantages, rewards_at_start

__all__ = ["DiscountPerSecond", "DurationReplayBuffer"]

try:
    from stable_baselines3.common.buffers import ReplayBuffer
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
    from stable_baselines3.common.type_aliases import ReplayBufferSamples
    from stable_baselines3.common.utils import obs_as_tensor
    from stable_baselines3.common.vec_env import VecNormalize
except ImportError as error:
    raise ImportError("DiscountPerSecond is a callback of Stable-Baselines3: pip install 'bsk_torch[sb3]'") from error


class DiscountPerSecond(BaseCallback):
    """Makes PPO, MaskablePPO and A2C discount per second, with rewards at the end of steps.

    After each rollout, it replaces advantages and value targets by those of
    :func:`~bsk_torch.rl.durations.estimate_advantages`. The model has ``gamma=1.0``: Stable-Baselines3 adds gamma times the value
    of the last state to the reward of a truncated episode, and with 1 both are discounted over the step, as they should be.

    Example:
        >>> MaskablePPO("MlpPolicy", env, gamma=1.0).learn(100_000, callback=DiscountPerSecond(0.99999))
    """

    def __init__(self, gamma: float) -> None:
        """Discount by ``gamma`` per second."""
        super().__init__()
        self.gamma_per_second = gamma

    def _on_training_start(self) -> None:
        if not isinstance(self.model, OnPolicyAlgorithm) or self.model.gamma != 1.0:
            raise ValueError(
                f"DiscountPerSecond needs PPO, MaskablePPO or A2C with gamma=1.0, not {type(self.model).__name__} with "
                f"gamma={self.model.gamma}; for DQN there is DurationReplayBuffer"
            )

    def _on_rollout_start(self) -> None:
        self._seconds: list[list[float]] = []

    def _on_step(self) -> bool:
        self._seconds.append([info["duration"] for info in self.locals["infos"]])
        return True

    def _on_rollout_end(self) -> None:
        buffer = self.locals["rollout_buffer"]
        value = torch.as_tensor(buffer.values)
        with torch.no_grad():
            last = self.model.policy.predict_values(obs_as_tensor(self.locals["new_obs"], self.model.device))
        done = torch.as_tensor(np.vstack([buffer.episode_starts[1:], self.locals["dones"]])).bool()
        advantage, target = estimate_advantages(
            torch.as_tensor(buffer.rewards),
            torch.tensor(self._seconds, dtype=torch.float64),
            value,
            torch.cat([value[1:], last.view(1, -1).cpu()]),
            done,
            done,
            gamma=self.gamma_per_second,
            lmbda=buffer.gae_lambda,
            time_dim=0,
        )
        buffer.advantages[:], buffer.returns[:] = advantage.numpy(), target.numpy()


class DurationReplayBuffer(ReplayBuffer):
    """Replay buffer of observation vectors with which DQN discounts per second, with rewards at the end of steps.

    The model's own ``gamma`` is not used.

    Example:
        >>> kept = dict(replay_buffer_class=DurationReplayBuffer, replay_buffer_kwargs={"gamma": 0.9999})
        >>> DQN("MlpPolicy", env, **kept).learn(100_000)
    """

    def __init__(self, *args: object, gamma: float, **options: object) -> None:
        """Discount by ``gamma`` per second; other arguments are those of Stable-Baselines3."""
        super().__init__(*args, **options)
        self.gamma = gamma
        self.discounts = np.zeros_like(self.rewards)

    def add(self, obs: Any, next_obs: Any, action: Any, reward: Any, done: Any, infos: list[dict[str, Any]]) -> None:
        """Keep a step of all episodes, whose rewards are discounted to its beginning."""
        seconds = torch.tensor([info["duration"] for info in infos], dtype=torch.float64)
        self.discounts[self.pos] = (self.gamma**seconds).numpy()
        earned = rewards_at_start(torch.as_tensor(reward), seconds, self.gamma)
        super().add(obs, next_obs, action, earned.numpy(), done, infos)

    def _get_samples(self, batch_inds: np.ndarray, env: VecNormalize | None = None) -> ReplayBufferSamples:
        at = batch_inds, np.random.randint(0, self.n_envs, len(batch_inds))
        columns = (
            self._normalize_obs(self.observations[at], env),
            self.actions[at],
            self._normalize_obs(self.next_observations[at], env),
            (self.dones[at] * (1.0 - self.timeouts[at])).reshape(-1, 1),
            self._normalize_reward(self.rewards[at].reshape(-1, 1), env),
            self.discounts[at].reshape(-1, 1),
        )
        return ReplayBufferSamples(*(self.to_torch(column) for column in columns))
