"""The kinds of places that the satellites of a simulation see, gathered from the models that declare them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from bsk_torch.rand import first_key
from bsk_torch.sim.arguments.values import Arguments
from bsk_torch.sim.component import Component
from bsk_torch.sim.draw_table import DrawTable
from bsk_torch.sim.instruments import Instrument
from bsk_torch.sim.places import FixedPlaces, Places, PlaceTables
from bsk_torch.sim.state import StateTable

PlaceKinds = Callable[[PlaceTables], Mapping[str, object]]
"""Function that returns kinds of places, :class:`~bsk_torch.sim.places.Places` by name."""


def place_kinds(
    parts: Sequence[Component],
    world_args: Arguments,
    scenario: DrawTable,
    arguments: StateTable,
    declared: PlaceKinds,
    instruments: Sequence[Instrument] = (),
) -> dict[str, Places]:
    """Return the places that satellites can see, by kind: those of ``parts``, and those ``declared`` by the scenario.

    The draws of the scenario are [num_envs, ...] each, the arguments of the satellites [N, ...]. TypeError for something else
    than places, ValueError for a name already in use, or places without clearances.
    """
    bringing = [part for part in parts if part.places]
    tables = PlaceTables(scenario, arguments, world_args.draw(first_key(1)) if bringing else {}, instruments)
    kinds: dict[str, Places] = {}
    sources = [(f"the component {part.slot!r}", part.places) for part in bringing]
    for owner, source in [*sources, ("the scenario", declared)]:
        for name, places in source(tables).items() if source else ():
            if not isinstance(places, Places):
                raise TypeError(f"{owner} gives places {name!r}: {places!r}; it must be a sim.places.Places")
            if name in kinds:
                raise ValueError(f"{owner} gives places {name!r}, a name already in use; other kinds are {sorted(kinds)}")
            if not places.clearances and not isinstance(places, FixedPlaces):
                raise ValueError(f"{owner} gives places {name!r} without clearances; give at least one: ClearOfEarth()")
            kinds[name] = places
    return kinds
