"""Modules of Basilisk that have no counterpart here, and what to write in place of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn

COMPONENT = (
    "a part of a spacecraft or of the world is a Component, listed in components= of a model: docs/how_to/own_component.md"
)

SPACECRAFT = "docs/how_to/spacecraft.md"

ATMOSPHERE = "the atmosphere is exponential, with planetRadius, baseDensity and scaleHeight of world_args"

INSTEAD = {
    **dict.fromkeys(("exponentialAtmosphere", "msisAtmosphere", "tabularAtmosphere"), ATMOSPHERE),
    **dict.fromkeys(("reactionWheelStateEffector", "simIncludeRW"), f"wheels= of sat_args describes wheels: {SPACECRAFT}"),
    **dict.fromkeys(
        ("thrusterDynamicEffector", "simIncludeThruster"), f"thrusters= of sat_args describes thrusters: {SPACECRAFT}"
    ),
    **dict.fromkeys(("simpleSolarPanel",), f"panels= of sat_args describes solar panels: {SPACECRAFT}"),
    **dict.fromkeys(("facetDragDynamicEffector", "dragDynamicEffector"), f"facets= of sat_args describes surfaces: {SPACECRAFT}"),
    **dict.fromkeys(("vizSupport", "vizInterface"), "'bsk-torch view' shows environments in the browser"),
    **dict.fromkeys(("groundLocation",), "groundStationsData of world_args lists ground stations"),
    **dict.fromkeys(("simIncludeGravBody", "spacecraft"), "Sun, Earth and hub are always simulated; sat_args has their numbers"),
}
"""Modules by name, and what their users write."""


def advising(module: str) -> Callable[[str], NoReturn]:
    """Return ``__getattr__`` of a package of Basilisk's, which tells what to write in place of a module."""

    def find(name: str) -> NoReturn:
        if name.startswith("_"):
            raise AttributeError(name)
        instead = f"{INSTEAD[name]}. Otherwise, " if name in INSTEAD else ""
        raise ImportError(f"Basilisk's {module}.{name} is not simulated here: {instead}{COMPONENT}")

    return find
