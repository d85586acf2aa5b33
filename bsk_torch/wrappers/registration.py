"""Presets by name in Gymnasium's registry."""

from __future__ import annotations

import gymnasium

from bsk_torch.presets import PRESETS

MODULE = "bsk_torch.wrappers.gymnasium"


def register() -> None:
    """Register every preset as ``bsk_torch/<name>`` for ``gymnasium.make`` and ``gymnasium.make_vec``; again does nothing.

    Options of the preset pass through: ``gymnasium.make_vec("bsk_torch/NadirScan-v1", num_envs=64, backend="eager")``.
    """
    for name in PRESETS:
        env_id = f"bsk_torch/{name}"
        if env_id not in gymnasium.registry:
            gymnasium.register(
                env_id, entry_point=f"{MODULE}:GymEnv", vector_entry_point=f"{MODULE}:GymVectorEnv", kwargs={"core": name}
            )
