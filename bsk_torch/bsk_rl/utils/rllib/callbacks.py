"""Metrics at the end of episodes; counterpart of ``bsk_rl.utils.rllib.callbacks``; the wrappers need no Ray."""

from __future__ import annotations

from typing import Any

import gymnasium
from pettingzoo.utils import BaseParallelWrapper

from bsk_torch.bsk_rl.older import advising
from bsk_torch.wrappers import metrics
from bsk_torch.wrappers.rllib import HAS_RLLIB

__all__ = ["EpisodeDataLogger", "EpisodeDataParallelWrapper", "EpisodeDataWrapper", "WrappedEpisodeDataCallbacks"]

RESETS_OF_RLLIB = 3
"""Resets before the end of the first episode, by RLlib's checks; nothing is logged there."""

RAY = "needs RLlib, which wants its own environment: pip install 'ray[rllib]==2.60.0'"

WITHOUT = {
    "WrappedEpisodeDataCallbacks": RAY,
    "EpisodeDataCallbacks": "is deprecated in bsk_rl: wrap the environment in EpisodeDataWrapper",
    "MultiagentEpisodeDataCallbacks": "is deprecated in bsk_rl: wrap the environment in EpisodeDataParallelWrapper",
}
"""Names of bsk_rl that may be missing, and what to do."""


class EpisodeDataLogger(metrics.EpisodeDataLogger):
    """Passes the metrics of an episode to RLlib's logger when the next episode starts; base of the two wrappers below.

    Metrics are those of ``episode_data_callback(env)``, those of ``satellite_data_callback(env, satellite)`` under names such as
    ``EO1/imaged``, and the means of these over the satellites, ``mean/imaged``.
    """

    logs_to_skip = RESETS_OF_RLLIB

    def log_data_on_reset(self) -> None:
        """Give the metrics of the current moment to the logger, if there is one."""
        if self.metrics_logger is not None:
            self.log()

    def reset(self, **kwargs: object) -> Any:
        """Give the metrics of the episode that has ended to the logger, and begin the next one."""
        if self.logs_to_skip > 0:
            self.logs_to_skip -= 1
        else:
            self.log_data_on_reset()
        return self.env.reset(**kwargs)


class EpisodeDataWrapper(EpisodeDataLogger, gymnasium.Wrapper[object, object, object, object]):
    """Metrics of a Gymnasium environment; see :class:`EpisodeDataLogger`."""


class EpisodeDataParallelWrapper(EpisodeDataLogger, BaseParallelWrapper):
    """Metrics of a PettingZoo environment; see :class:`EpisodeDataLogger`."""


if HAS_RLLIB:
    from bsk_torch.wrappers.rllib import WrappedEpisodeDataCallbacks

__getattr__ = advising(__name__, WITHOUT)
