"""Metrics of finished episodes: numbers that a function of the user's reads from the environment at the end of each.

The wrappers that collect them need no Ray. For TorchRL there is :class:`EpisodeMetrics`, and
:class:`~bsk_torch.wrappers.stable_baselines3.SB3VecEnv` and :class:`~bsk_torch.wrappers.GymVectorEnv` take ``metrics=``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import numpy as np
import torch
from pettingzoo.utils import BaseParallelWrapper
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from bsk_torch.env.base import Tasking

__all__ = ["EpisodeDataLogger", "EpisodeDataParallelWrapper", "EpisodeDataWrapper", "EpisodeMetrics"]

EpisodeCallback = Callable[[Any], Mapping[str, float]]
"""Returns metrics of an episode from its environment, the view of one episode."""

SatelliteCallback = Callable[[Any, Any], Mapping[str, float]]
"""Returns metrics of a satellite from the environment and the satellite."""

BatchCallback = Callable[[Any], Mapping[str, Any]]
"""Returns metrics [N] of all episodes from the batched environment."""

METRICS = "metrics"
"""Entry of infos and tensordicts that holds metrics."""

WINDOW = 100
"""Number of episodes over which RLlib averages metrics."""


class EpisodeDataLogger:
    """Collects the metrics of an episode when it ends; base of the two wrappers below.

    Metrics are those of ``episode_data_callback(env)``, those of ``satellite_data_callback(env, satellite)`` under names such as
    ``EO1/imaged``, and the means of these over the satellites, ``mean/imaged``. The last step of an episode returns them as
    ``info["metrics"]``; the logger of :meth:`set_metrics_logger`, RLlib's, gets them then, too.
    """

    env: Any
    metrics_logger: Any = None

    def __init__(
        self,
        env: Any,
        episode_data_callback: EpisodeCallback | None = None,
        satellite_data_callback: SatelliteCallback | None = None,
    ) -> None:
        super().__init__(env)  # type: ignore[call-arg]  # a wrapper follows in the order of bases
        callbacks = {"episode_data_callback": episode_data_callback, "satellite_data_callback": satellite_data_callback}
        for name, callback in callbacks.items():
            if callback is not None and not callable(callback):
                raise TypeError(f"{name}={callback!r} must be a function, or None")
        self.episode_data_callback, self.satellite_data_callback = episode_data_callback, satellite_data_callback

    def set_metrics_logger(self, metrics_logger: object) -> None:
        """Let a logger of RLlib's, whose method is ``log_value(name, value, ...)``, get the metrics."""
        self.metrics_logger = metrics_logger

    def collect(self) -> dict[str, float]:
        """Return the metrics of the current moment by name."""
        view = self.env.unwrapped
        metrics = dict(self.episode_data_callback(view)) if self.episode_data_callback else {}
        if self.satellite_data_callback:
            pairs = ((satellite.name, self.satellite_data_callback(view, satellite)) for satellite in view.satellites)
            parts = {name: {key: float(value) for key, value in values.items()} for name, values in pairs}
            metrics |= {f"{name}/{key}": value for name, values in parts.items() for key, value in values.items()}
            keys = dict.fromkeys(key for values in parts.values() for key in values)
            metrics |= {
                f"mean/{key}": float(np.mean([values[key] for values in parts.values() if key in values])) for key in keys
            }
        return {name: float(value) for name, value in metrics.items()}

    def log(self) -> dict[str, float]:
        """Give the metrics to the logger, if there is one, and return them."""
        metrics = self.collect()
        if self.metrics_logger is not None:
            for name, value in metrics.items():
                self.metrics_logger.log_value(name, value, reduce="mean", window=WINDOW)
        return metrics


class EpisodeDataWrapper(EpisodeDataLogger, gymnasium.Wrapper[object, object, object, object]):
    """Metrics of the episodes of a Gymnasium view; see :class:`EpisodeDataLogger`.

    Example:
        >>> env = gymnasium.make("bsk_torch/NadirScan-v1", backend="eager", time_limit=60.0)
        >>> env = EpisodeDataWrapper(env, lambda env: {"reward": sum(env.rewarder.cum_reward.values())})
    """

    def step(self, action: object) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step; the last info of an episode has ``metrics``."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            info[METRICS] = self.log()
        return observation, reward, terminated, truncated, info


class EpisodeDataParallelWrapper(EpisodeDataLogger, BaseParallelWrapper):
    """Metrics of the episodes of a PettingZoo view; see :class:`EpisodeDataLogger`."""

    def step(self, actions: object) -> tuple[Any, ...]:
        """Step; when the last agent leaves, the last infos of all remaining agents have ``metrics``."""
        had = bool(self.env.agents)
        results = self.env.step(actions)
        if had and not self.env.agents:
            metrics = self.log()
            for info in results[4].values():
                info[METRICS] = metrics
        return results


class EpisodeMetrics(Transform):
    """TorchRL's transform that writes metrics of the current moment into ``("next", "metrics")``, [N, 1] each by name.

    They are computed in every step; at the end of an episode, where ``("next", "done")`` is true, they are those of the episode.

    Example:
        >>> env = bsk_torch.make("NadirScan-v1", num_envs=2, backend="eager", time_limit=60.0)
        >>> env = env.append_transform(EpisodeMetrics(lambda env: {"charge": env.satellite.dynamics.battery_charge_fraction}))
        >>> env.rollout(2)["next", "metrics", "charge"].shape
        torch.Size([2, 1, 1])
    """

    def __init__(self, metrics: BatchCallback) -> None:
        """Read the metrics of ``metrics(env)``, a function of the batched environment that returns values [N] by name."""
        super().__init__()
        self.metrics = metrics

    def _values(self) -> TensorDict:
        core: Any = self.parent.base_env  # type: ignore[union-attr]
        values = read_metrics(self.metrics, core)
        return TensorDict({name: value.unsqueeze(-1) for name, value in values.items()}, core.batch_size, device=core.device)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return tensordict_reset.set(METRICS, self._values())

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set(METRICS, self._values())

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the metrics; the environment must have been reset once, so that there is something to read."""
        values, shape = self._values(), observation_spec.shape
        parts = {name: Unbounded((*shape, 1), dtype=value.dtype, device=value.device) for name, value in values.items()}
        observation_spec[METRICS] = Composite(parts, shape=shape)
        return observation_spec


def read_metrics(metrics: BatchCallback, core: Tasking) -> dict[str, Tensor]:
    """Return the metrics of a batch, [N] float64 each by name; TypeError for values of another shape."""
    n, values = core.num_envs, {}
    for name, value in metrics(core).items():
        numbers = torch.as_tensor(value, device=core.device).to(torch.float64, copy=True)
        if numbers.shape != (n,):
            raise TypeError(
                f"metrics(env)[{name!r}] has shape {list(numbers.shape)}; it must be [{n}], one number for each episode"
            )
        values[name] = numbers
    return values
