"""RLlib's configurations: ``env_config``, registered names, callbacks.

Importing this module registers ``"SatelliteTasking-RLlib"`` and
``"ConstellationTasking-RLlib"`` with RLlib where it is installed. Their ``env_config`` has the arguments of the environment, and
``episode_data_callback`` and ``satellite_data_callback`` of :mod:`bsk_torch.wrappers.metrics`.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

from bsk_torch.env import ConstellationTasking, GeneralSatelliteTasking, SatelliteTasking
from bsk_torch.wrappers.general import GymJointEnv
from bsk_torch.wrappers.gymnasium import GymEnv
from bsk_torch.wrappers.metrics import EpisodeDataParallelWrapper, EpisodeDataWrapper
from bsk_torch.wrappers.pettingzoo import PettingZooEnv

__all__ = ["constellation_tasking", "satellite_tasking", "unpack_config"]

VIEWS: dict[type, object] = {GeneralSatelliteTasking: GymJointEnv, ConstellationTasking: PettingZooEnv, SatelliteTasking: GymEnv}
"""View of one episode of each environment, which RLlib's runners step."""

CALLBACKS = ("episode_data_callback", "satellite_data_callback")

HAS_RLLIB = all(map(find_spec, ("ray", "tree")))
"""Whether RLlib is installed; Ray without it lacks the second package."""

RAY = "needs Ray, which wants its own environment: pip install 'ray[rllib]==2.60.0'"


def unpack_config(env: type) -> type:
    """Return a class that RLlib makes: ``config.environment(env=unpack_config(SatelliteTasking), env_config=...)``.

    Args:
        env: One of bsk_torch's environments, of which one episode in its Gymnasium or PettingZoo view is made; or any class,
            which then gets the entries of ``env_config`` as arguments.
    """
    view = VIEWS.get(env)

    class Unpacked(view or env):  # type: ignore[misc]
        def __init__(self, env_config: Mapping[str, object]) -> None:
            super().__init__(*([env] if view else []), **env_config)

    Unpacked.__name__ = Unpacked.__qualname__ = f"{env.__name__}_Unpacked"
    Unpacked.__doc__ = f"{env.__name__} made with a dictionary of its arguments."
    return Unpacked


def satellite_tasking(env_config: Mapping[str, object]) -> EpisodeDataWrapper:
    """Return one episode of a ``SatelliteTasking`` with metrics, from RLlib's ``env_config``, which is not modified."""
    arguments, callbacks = split(env_config)
    return EpisodeDataWrapper(GymEnv(SatelliteTasking, **arguments), **callbacks)


def constellation_tasking(env_config: Mapping[str, object]) -> object:
    """Return one episode of a ``ConstellationTasking`` with metrics, as RLlib wants it; ImportError without Ray."""
    try:
        from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
    except ImportError as error:
        raise ImportError(f"ConstellationTasking-RLlib {RAY}") from error
    arguments, callbacks = split(env_config)
    return ParallelPettingZooEnv(EpisodeDataParallelWrapper(PettingZooEnv(ConstellationTasking, **arguments), **callbacks))


def split(env_config: Mapping[str, object]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the arguments of an environment, and the functions of its metrics, among those of RLlib's ``env_config``."""
    arguments = dict(env_config)
    return arguments, {name: arguments.pop(name) for name in CALLBACKS if name in arguments}


if HAS_RLLIB:
    from ray.rllib.callbacks.callbacks import RLlibCallback
    from ray.tune.registry import register_env

    register_env("SatelliteTasking-RLlib", satellite_tasking)
    register_env("ConstellationTasking-RLlib", constellation_tasking)

    class WrappedEpisodeDataCallbacks(RLlibCallback):
        """Gives RLlib's logger to the wrappers of :mod:`bsk_torch.wrappers.metrics` in each environment."""

        def on_environment_created(self, *, env: object = None, metrics_logger: object = None, **_: object) -> None:
            """Pass the logger on; RLlib calls this."""
            each = [env.par_env] if hasattr(env, "par_env") else getattr(env, "envs", [env])
            for one in each:
                while not hasattr(one, "set_metrics_logger"):
                    one = one.env  # below RLlib's and Gymnasium's wrappers
                one.set_metrics_logger(metrics_logger)
