"""Gymnasium's registry: presets by name, and environments of a user's own satellites under bsk_rl's names."""

from __future__ import annotations

import sys
from typing import Any, NoReturn, get_type_hints

import gymnasium

from bsk_torch.env import ConstellationTasking, GeneralSatelliteTasking, SatelliteTasking
from bsk_torch.presets import PRESETS

MODULE = "bsk_torch.wrappers"

ONE = {"entry_point": f"{MODULE}.gymnasium:GymEnv", "vector_entry_point": f"{MODULE}.gymnasium:GymVectorEnv"}
"""Entry points of presets with one satellite."""

MANY = {"entry_point": f"{MODULE}.general:GymJointEnv"}
"""Entry point of constellations, which have one agent under Gymnasium."""


def refuse_constellation(**options: object) -> NoReturn:
    """Raise Error for ``gymnasium.make`` of agents that act on their own, which Gymnasium's interface does not have."""
    raise gymnasium.error.Error(
        "ConstellationTasking has several agents, which gymnasium.make cannot return (nor can bsk_rl's). PettingZoo's view is "
        "bsk_torch.wrappers.pettingzoo.parallel_env(bsk_torch.ConstellationTasking, satellites=[...], ...); one agent for all "
        "satellites is gymnasium.make('bsk_torch/GeneralSatelliteTasking-v1', satellites=[...], ...)"
    )


OWN: dict[str, dict[str, Any]] = {
    "SatelliteTasking-v1": {**ONE, "kwargs": {"core": SatelliteTasking}},
    "GeneralSatelliteTasking-v1": {**MANY, "kwargs": {"core": GeneralSatelliteTasking}},
    "ConstellationTasking-v1": {"entry_point": refuse_constellation, "vector_entry_point": refuse_constellation},
}
"""Environments of a user's own satellites: ``gymnasium.make("bsk_torch/SatelliteTasking-v1", satellite=..., rewarder=...)``."""


def register() -> None:
    """Register presets and :data:`OWN` as ``bsk_torch/<name>`` for ``gymnasium.make`` and ``gymnasium.make_vec``.

    Options pass through: ``gymnasium.make_vec("bsk_torch/NadirScan-v1", num_envs=64, backend="eager")``.
    Constellations have one agent for all satellites; :func:`bsk_torch.wrappers.pettingzoo.parallel_env` has one for each.

    The names of :data:`OWN` are registered without ``bsk_torch/`` too, as bsk_rl does it, unless bsk_rl has been imported: then
    they mean bsk_rl's environments, and they do from the moment on when bsk_rl is imported later. Repeated calls do nothing.

    Raises:
        TypeError: For a preset of the user's that does not say what it returns.
    """
    for name, preset in PRESETS.items():
        made = get_type_hints(preset).get("return")
        if made is None:
            raise TypeError(f"preset {name!r} does not say what it returns; write def {preset.__name__}(...) -> SatelliteTasking")
        views: dict[str, Any] = MANY if issubclass(made, ConstellationTasking) else ONE
        _register_once(f"bsk_torch/{name}", **views, kwargs={"core": name})
    for name, entry in OWN.items():
        _register_once(f"bsk_torch/{name}", **entry)
        if "bsk_rl" not in sys.modules:
            _register_once(name, **entry)


def _register_once(env_id: str, **entry: Any) -> None:
    if env_id not in gymnasium.registry:
        gymnasium.register(env_id, **entry)
