"""Trainings by the kind of environment: PPO for one satellite, MAPPO or IPPO for constellations."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tensordict.nn import TensorDictModuleBase

from bsk_torch.env import ConstellationTasking
from bsk_torch.presets import PRESETS, make
from bsk_torch.rl.marl.mappo import LOSSES, MAPPOConfig, MAPPOTraining
from bsk_torch.rl.networks.plans import check_network
from bsk_torch.rl.training.config import CONFIG, PPOConfig, load_config, read_settings
from bsk_torch.rl.training.recipes import recipe_of
from bsk_torch.rl.training.trainer import Training
from bsk_torch.sim.arguments.values import nearest

PPO = "ppo"
"""Algorithm for one satellite."""

ALGORITHMS = (PPO, *LOSSES)
"""Algorithms by which policies are trained."""


def is_constellation(preset: str, options: Mapping[str, Any] | None = None) -> bool:
    """Return whether a preset has many satellites; False for a name that is not one of the presets.

    A preset without a return annotation is built with ``options`` to find its class.
    """
    if preset not in PRESETS:
        return False
    made = inspect.signature(PRESETS[preset], eval_str=True).return_annotation
    if made is inspect.Signature.empty:
        return isinstance(make(preset, **({"num_envs": 1, "backend": "eager"} | dict(options or {}))), ConstellationTasking)
    return isinstance(made, type) and issubclass(made, ConstellationTasking)


def configure(preset: str, network: str | None = None, algorithm: str | None = None, **changes: Any) -> PPOConfig:
    """Return the configuration of a training, with the recipe for the environment if there is one.

    Args:
        preset: Name of the environment.
        network: See :class:`PPOConfig`; None for ``"mlp"`` with one satellite and ``"attention"`` with many.
        algorithm: One of :data:`ALGORITHMS`; None for ``"ppo"`` with one satellite and ``"mappo"`` with many.
        **changes: Fields of :class:`PPOConfig` or :class:`MAPPOConfig` that differ from the recipe.

    Raises:
        ValueError: For an unknown algorithm or network, or one that does not fit the environment.
    """
    many = is_constellation(preset, changes.get("options"))
    algorithm, network = algorithm or ("mappo" if many else PPO), network or ("attention" if many else "mlp")
    check_network(network)
    if algorithm not in ALGORITHMS:
        raise ValueError(f"algorithm={algorithm!r} must be one of {', '.join(ALGORITHMS)}; {nearest(algorithm, ALGORITHMS)}")
    if many == (algorithm == PPO):
        has, fitting = ("many satellites", " or ".join(LOSSES)) if many else ("one satellite", PPO)
        raise ValueError(f"algorithm={algorithm!r} does not train {preset}, which has {has}; use {fitting}")
    recipe, options = recipe_of(preset, network, changes.pop("options", {}))
    has_sets = preset not in PRESETS or "as_set" in inspect.signature(PRESETS[preset]).parameters
    if network == "attention" and not has_sets and not many:
        raise ValueError(f"network='attention' does not fit {preset}, which observes no set of targets; use network='mlp'")
    if network == "attention" and has_sets:
        options = {"as_set": True} | options
    settings = {"network": network, "options": options} | recipe | changes
    return MAPPOConfig(preset, algorithm=algorithm, **settings) if many else PPOConfig(preset, **settings)


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


def train(config: PPOConfig, out: Path) -> TensorDictModuleBase:
    """Train a policy and leave it in folder ``out`` alongside its logs and configuration.

    Returns:
        The policy: writes ``action`` into a tensordict with ``observation`` and ``action_mask``. For a constellation it is the
        policy of one satellite, or a ``GroupPolicies``; :func:`~bsk_torch.rl.marl.shared` applies it to all satellites.

    Raises:
        ValueError: For an environment that the algorithm of the configuration does not train.
    """
    many = is_constellation(config.preset, config.options)
    if config.preset in PRESETS and many != isinstance(config, MAPPOConfig):
        has, kind = ("many satellites", "MAPPOConfig") if many else ("one satellite", "PPOConfig")
        raise ValueError(f"{config.preset} has {has}, and is trained by a {kind}; configure({config.preset!r}, ...) makes it")
    return training_of(config, out).run()


def resume(out: Path) -> TensorDictModuleBase:
    """Resume the run in folder ``out``, which an interruption or the end of its budget has left."""
    return training_of(read_config(out), out, resume=True).run()
