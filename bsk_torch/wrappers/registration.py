"""Gymnasium's registry: presets by name, and environments of a user's own satellites."""

from __future__ import annotations

from typing import get_args, get_type_hints

from bsk_torch._listed import MANY, ONE, OWN, register_listed, register_once
from bsk_torch.env import ConstellationTasking
from bsk_torch.presets import PRESETS
from bsk_torch.presets.own import OwnEnvironment

__all__ = ["OWN", "register"]


def register() -> None:
    """Register presets and :data:`OWN` as ``bsk_torch/<name>`` for ``gymnasium.make`` and ``gymnasium.make_vec``.

    Options pass through: ``gymnasium.make_vec("bsk_torch/NadirScan-v1", num_envs=64, backend="eager")``.
    Constellations have one agent for all satellites; :func:`bsk_torch.wrappers.pettingzoo.parallel_env` has one for each.
    The package's presets are registered when it is imported; call this after adding one to
    :data:`~bsk_torch.presets.PRESETS`. A preset whose options change its class is registered as the first class of its
    return annotation. Repeated calls do nothing. TypeError for a user's preset without a return annotation.
    """
    register_listed()
    for name, preset in PRESETS.items():
        if isinstance(preset, OwnEnvironment):  # entered by a training or command; its name has no version
            continue
        annotation = get_type_hints(preset).get("return")
        if annotation is None:
            raise TypeError(f"preset {name!r} has no return annotation; write def {preset.__name__}(...) -> SatelliteTasking")
        usual = next(iter(get_args(annotation)), annotation)
        views = MANY if issubclass(usual, ConstellationTasking) else ONE
        register_once(f"bsk_torch/{name}", **views, kwargs={"core": name})
