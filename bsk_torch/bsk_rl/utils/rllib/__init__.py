"""Environments for RLlib; counterpart of ``bsk_rl.utils.rllib``.

Where RLlib is installed, importing this module registers ``"SatelliteTasking-RLlib"`` and ``"ConstellationTasking-RLlib"``: their
``env_config`` has the arguments of the environment, ``episode_data_callback`` and ``satellite_data_callback``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NoReturn

from bsk_torch.bsk_rl.gym import ConstellationTasking, SatelliteTasking
from bsk_torch.bsk_rl.utils.rllib.callbacks import EpisodeDataParallelWrapper, EpisodeDataWrapper
from bsk_torch.wrappers.rllib import HAS_RLLIB, split, unpack_config

__all__ = ["load_torch_mlp_policy", "unpack_config"]


def load_torch_mlp_policy(policy_path: object, policy_name: str = "default_agent") -> NoReturn:
    """Raise ImportError: a checkpoint of RLlib's is loaded by RLlib."""
    raise ImportError(
        "load_torch_mlp_policy is not in bsk_torch: write RLModule.from_checkpoint of Ray, as examples/ppo_rllib.py does"
    )


def satellite_tasking(env_config: Mapping[str, object]) -> EpisodeDataWrapper:
    """Return a ``SatelliteTasking`` with metrics, from RLlib's ``env_config``."""
    arguments, callbacks = split(env_config)
    return EpisodeDataWrapper(SatelliteTasking(**arguments), **callbacks)


def constellation_tasking(env_config: Mapping[str, object]) -> object:
    """Return a ``ConstellationTasking`` with metrics, as RLlib wants it, from its ``env_config``."""
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv

    arguments, callbacks = split(env_config)
    return ParallelPettingZooEnv(EpisodeDataParallelWrapper(ConstellationTasking(**arguments), **callbacks))


if HAS_RLLIB:
    from ray.tune.registry import register_env

    register_env("SatelliteTasking-RLlib", satellite_tasking)
    register_env("ConstellationTasking-RLlib", constellation_tasking)
