"""Metrics at the end of episodes; counterpart of ``bsk_rl.utils.rllib.callbacks``; the wrappers need no Ray."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any, NoReturn

import gymnasium
import numpy as np
from pettingzoo.utils import BaseParallelWrapper

__all__ = ["EpisodeDataLogger", "EpisodeDataParallelWrapper", "EpisodeDataWrapper", "WrappedEpisodeDataCallbacks"]

EpisodeCallback = Callable[[Any], Mapping[str, float]]
"""Returns metrics of an episode from its environment."""

SatelliteCallback = Callable[[Any, Any], Mapping[str, float]]
"""Returns metrics of a satellite from the environment and the satellite."""

WINDOW = 100
"""Number of episodes over which RLlib averages metrics."""

RESETS_OF_RLLIB = 3
"""Resets before the end of the first episode, by RLlib's checks; nothing is logged there."""

RAY = "needs RLlib, which wants its own environment: pip install 'ray[rllib]==2.60.0'"

WITHOUT = {
    "WrappedEpisodeDataCallbacks": RAY,
    "EpisodeDataCallbacks": "is deprecated in bsk_rl: wrap the environment in EpisodeDataWrapper",
    "MultiagentEpisodeDataCallbacks": "is deprecated in bsk_rl: wrap the environment in EpisodeDataParallelWrapper",
}
"""Names of bsk_rl that may be missing, and what to do."""


class EpisodeDataLogger:
    """Passes the metrics of an episode to RLlib's logger when the next episode starts; base of the two wrappers below.

    Metrics are those of ``episode_data_callback(env)``, those of ``satellite_data_callback(env, satellite)`` under names such as
    ``EO1/imaged``, and the means of these over the satellites, ``mean/imaged``.
    """

    env: Any

    def __init__(
        self, episode_data_callback: EpisodeCallback | None = None, satellite_data_callback: SatelliteCallback | None = None
    ) -> None:
        """Initialize the logger.

        Args:
            episode_data_callback: Function of the environment that returns metrics; None for none.
            satellite_data_callback: Function of the environment and a satellite that returns metrics; None for none.
        """
        self.episode_data_callback = episode_data_callback or (lambda _: {})
        self.satellite_data_callback = satellite_data_callback or (lambda *_: {})
        self.metrics_logger: Any = None
        self.logs_to_skip = RESETS_OF_RLLIB

    def set_metrics_logger(self, metrics_logger: object) -> None:
        """Set the logger of the metrics, which has a method ``log_value(name, value, ...)``."""
        self.metrics_logger = metrics_logger

    def log_data_on_reset(self) -> None:
        """Give the metrics of the current moment to the logger, if there is one."""
        if self.metrics_logger is None:
            return
        env = self.env.unwrapped
        found = dict(self.episode_data_callback(env))
        each = {satellite.name: dict(self.satellite_data_callback(env, satellite)) for satellite in env.satellites}
        found |= {f"{name}/{key}": value for name, values in each.items() for key, value in values.items()}
        shared = next(iter(each.values()), {})
        found |= {f"mean/{key}": float(np.mean([values[key] for values in each.values()])) for key in shared}
        for name, value in found.items():
            self.metrics_logger.log_value(name, value, reduce="mean", window=WINDOW)

    def reset(self, **kwargs: Any) -> Any:
        """Give the metrics of the episode that has ended to the logger, and begin the next one."""
        if self.logs_to_skip > 0:
            self.logs_to_skip -= 1
        else:
            self.log_data_on_reset()
        return self.env.reset(**kwargs)


class EpisodeDataWrapper(EpisodeDataLogger, gymnasium.Wrapper[Any, Any, Any, Any]):
    """Metrics of a Gymnasium environment; see :class:`EpisodeDataLogger`."""

    def __init__(
        self,
        env: Any,
        episode_data_callback: EpisodeCallback | None = None,
        satellite_data_callback: SatelliteCallback | None = None,
    ) -> None:
        """Wrap an environment; see :class:`EpisodeDataLogger` for the functions."""
        EpisodeDataLogger.__init__(self, episode_data_callback, satellite_data_callback)
        gymnasium.Wrapper.__init__(self, env)


class EpisodeDataParallelWrapper(EpisodeDataLogger, BaseParallelWrapper):
    """Metrics of a PettingZoo environment; see :class:`EpisodeDataLogger`."""

    def __init__(
        self,
        env: Any,
        episode_data_callback: EpisodeCallback | None = None,
        satellite_data_callback: SatelliteCallback | None = None,
    ) -> None:
        """Wrap an environment; see :class:`EpisodeDataLogger` for the functions."""
        EpisodeDataLogger.__init__(self, episode_data_callback, satellite_data_callback)
        BaseParallelWrapper.__init__(self, env)


if all(map(find_spec, ("ray", "tree"))):  # Ray without RLlib lacks the latter
    from ray.rllib.callbacks.callbacks import RLlibCallback

    class WrappedEpisodeDataCallbacks(RLlibCallback):
        """Gives RLlib's logger to the wrappers of this module in each environment."""

        def on_environment_created(self, *, env: object = None, metrics_logger: object = None, **_: object) -> None:
            """See RLlib's ``RLlibCallback``."""
            each = [env.par_env] if hasattr(env, "par_env") else getattr(env, "envs", [env])
            for one in each:
                while not hasattr(one, "set_metrics_logger"):
                    one = one.env  # below RLlib's and Gymnasium's wrappers
                one.set_metrics_logger(metrics_logger)


def __getattr__(name: str) -> NoReturn:
    if name in WITHOUT:
        raise ImportError(f"bsk_rl's {name} {WITHOUT[name]}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
