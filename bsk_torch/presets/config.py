"""Presets in configurations of TorchRL's recipes, like those for other libraries in ``torchrl.trainers.algorithms.configs``.

A recipe names a preset in its YAML file::

    defaults:
      - env@training_env: bsk_torch
    training_env:
      name: NadirScan-v1
      num_envs: 64
      options: {time_limit: 5700.0}

after ``bsk_torch.presets.config.register()``; ``hydra.utils.instantiate(cfg.training_env)`` then returns the environment.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from omegaconf import MISSING

from bsk_torch.presets import make


@dataclass
class PresetEnvConfig:
    """Configuration of a preset's environment.

    Attributes:
        name: One of :data:`bsk_torch.presets.PRESETS`.
        num_envs: Number of episodes.
        seed: Seed of all draws; None for a random one.
        device: Device of the simulation.
        backend: ``"compiled"`` or ``"eager"``.
        options: Further arguments of the preset, such as ``time_limit``.
    """

    name: str = MISSING
    num_envs: int = 1
    seed: int | None = None
    device: str = "cpu"
    backend: str = "compiled"
    options: dict[str, Any] = field(default_factory=dict)
    _partial_: bool = False
    _target_: str = "bsk_torch.presets.config.make_env"


def make_env(name: str, options: Mapping[str, object] | None = None, **arguments: object) -> Any:
    """Return the environment of a :class:`PresetEnvConfig`; see :func:`bsk_torch.make`."""
    return make(name, **arguments, **(options or {}))


def register(group: str = "env", name: str = "bsk_torch") -> None:
    """Add :class:`PresetEnvConfig` to Hydra's store of TorchRL configurations; ImportError without Hydra."""
    try:
        from hydra.core.config_store import ConfigStore
    except ImportError as error:
        raise ImportError("recipes of TorchRL are configured with Hydra: pip install hydra-core") from error
    ConfigStore.instance().store(group=group, name=name, node=PresetEnvConfig)
