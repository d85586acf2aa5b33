"""Trainings by the kind of environment: PPO for one satellite, MAPPO or IPPO for constellations."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

from bsk_torch.env import ConstellationTasking
from bsk_torch.presets import PRESETS
from bsk_torch.rl.marl.mappo import LOSSES, MAPPOConfig, MAPPOTraining
from bsk_torch.rl.training.config import CONFIG, PPOConfig, load_config, read_settings
from bsk_torch.rl.training.recipes import configure, recipe_of
from bsk_torch.rl.training.trainer import Training
from bsk_torch.sim.arguments.values import nearest

PPO = "ppo"
"""Algorithm for one satellite."""

ALGORITHMS = (PPO, *LOSSES)
"""Algorithms by which policies are trained."""


def is_constellation(preset: str) -> bool:
    """Return whether a preset has many satellites; False for a name that is not one of the presets."""
    return preset in PRESETS and inspect.signature(PRESETS[preset], eval_str=True).return_annotation is ConstellationTasking


def configure_run(preset: str, algorithm: str | None = None, network: str | None = None, **changes: Any) -> PPOConfig:
    """Return the configuration of a training, with the recipe for the environment if there is one.

    Args:
        preset: Name of the environment.
        algorithm: One of :data:`ALGORITHMS`; None for ``"ppo"`` with one satellite and ``"mappo"`` with many.
        network: See :class:`PPOConfig`; None for ``"mlp"`` with one satellite and ``"attention"`` with many.
        **changes: Fields of :class:`PPOConfig` or :class:`MAPPOConfig` that differ from the recipe.

    Raises:
        ValueError: For an unknown algorithm or network, or one that does not fit the environment.
    """
    many = is_constellation(preset)
    algorithm = algorithm or ("mappo" if many else PPO)
    if algorithm not in ALGORITHMS:
        raise ValueError(f"algorithm={algorithm!r} must be one of {', '.join(ALGORITHMS)}; {nearest(algorithm, ALGORITHMS)}")
    if many == (algorithm == PPO):
        has, fitting = ("many satellites", " or ".join(LOSSES)) if many else ("one satellite", PPO)
        raise ValueError(f"algorithm={algorithm!r} does not train {preset}, which has {has}; use {fitting}")
    if not many:
        return configure(preset, network or "mlp", **changes)
    network = network or "attention"
    recipe, options = recipe_of(preset, network, changes.pop("options", {}))
    if "as_set" in inspect.signature(PRESETS[preset]).parameters:
        options = {"as_set": True} | options
    return MAPPOConfig(preset, network=network, algorithm=algorithm, options=options, **(recipe | changes))


def algorithm_of(config: PPOConfig) -> str:
    """Return the algorithm of a configuration, one of :data:`ALGORITHMS`."""
    return config.algorithm if isinstance(config, MAPPOConfig) else PPO


def read_config(folder: Path) -> PPOConfig:
    """Return the configuration of the run in a folder; ValueError if it is not one of this version."""
    path = folder / CONFIG
    return load_config(path, MAPPOConfig if "algorithm" in read_settings(path) else PPOConfig)


def training_of(config: PPOConfig, out: Path, resume: bool = False) -> Training:
    """Return the training of a configuration; see :class:`~bsk_torch.rl.training.trainer.Training` for arguments and errors."""
    return (MAPPOTraining if isinstance(config, MAPPOConfig) else Training)(config, out, resume)
