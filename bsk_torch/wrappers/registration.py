"""Presets by name in Gymnasium's registry."""

from __future__ import annotations

from typing import Any, get_type_hints

import gymnasium

from bsk_torch.env import ConstellationTasking
from bsk_torch.presets import PRESETS

MODULE = "bsk_torch.wrappers"

ONE = {"entry_point": f"{MODULE}.gymnasium:GymEnv", "vector_entry_point": f"{MODULE}.gymnasium:GymVectorEnv"}
"""Entry points of presets with one satellite."""

MANY = {"entry_point": f"{MODULE}.general:GymJointEnv"}
"""Entry point of constellations, which have one agent under Gymnasium."""


def register() -> None:
    """Register every preset as ``bsk_torch/<name>`` for ``gymnasium.make`` and ``gymnasium.make_vec``; repeated calls do nothing.

    Options of the preset pass through: ``gymnasium.make_vec("bsk_torch/NadirScan-v1", num_envs=64, backend="eager")``.
    Constellations have one agent for all satellites; :func:`bsk_torch.wrappers.pettingzoo.parallel_env` has one for each.
    """
    for name, preset in PRESETS.items():
        env_id = f"bsk_torch/{name}"
        if env_id not in gymnasium.registry:
            views: dict[str, Any] = MANY if get_type_hints(preset)["return"] is ConstellationTasking else ONE
            gymnasium.register(env_id, **views, kwargs={"core": name})
