"""World models: the components of the world around the satellites.

An environment infers the world from what the dynamics models of its satellites require; ``world_type=`` of an environment adds
to it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

from bsk_torch.sim.arguments.table import ArgumentTable
from bsk_torch.sim.component import Component, collect
from bsk_torch.sim.environment import world as environment
from bsk_torch.sim.readout.hooks import check_model
from bsk_torch.sim.readout.surroundings import World

__all__ = ["AtmosphereWorldModel", "EclipseWorldModel", "GroundStationWorldModel", "MagneticFieldWorldModel", "WorldModel"]


class WorldModel(World):
    """Sun and Earth, with the gravity of both.

    Subclasses list additional ``components``; a component replaces that of a base class in the same slot. The methods and
    properties of the instance ``simulator.world`` read the current state of the world.

    With ``only_where_required``, the components of the class (but not those of its subclasses) do not act on satellites whose
    dynamics model does not require the class.
    """

    components: ClassVar[tuple[Component, ...]] = (environment.EARTH_POLE, environment.EPHEMERIS)
    only_where_required: ClassVar[bool] = False

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_model(cls, WorldModel)

    @classmethod
    def all_components(cls) -> tuple[Component, ...]:
        """Return the components of the class and its bases in the order of a tick."""
        return collect(reversed(cls.__mro__))

    @classmethod
    def default_world_args(cls, **overrides: object) -> ArgumentTable:
        """Return every argument accepted in ``world_args``, with its default or the given value.

        Raises:
            KeyError: For a value of an unknown argument.
        """
        return ArgumentTable(cls.all_components(), overrides, "world_args")

    @classmethod
    def components_for(cls, required: Iterable[type[WorldModel]]) -> tuple[Component, ...]:
        """Return the components that act on satellites whose dynamics model requires the world models ``required``."""
        needed = set().union(*(model.__mro__ for model in required))
        private = (base for base in cls.__mro__ if vars(base).get("only_where_required") and base not in needed)
        slots = {component.slot for base in private for component in vars(base).get("components", ())}
        return tuple(component for component in cls.all_components() if component.slot not in slots)


class EclipseWorldModel(WorldModel):
    """Adds the shadow of the Earth."""

    components: ClassVar[tuple[Component, ...]] = (environment.ECLIPSE,)


class AtmosphereWorldModel(WorldModel):
    """Adds an exponential atmosphere."""

    components: ClassVar[tuple[Component, ...]] = (environment.ATMOSPHERE,)


class MagneticFieldWorldModel(WorldModel):
    """Adds the Earth's magnetic field, a centered dipole that turns with the Earth."""

    components: ClassVar[tuple[Component, ...]] = (environment.MAGNETIC_FIELD,)


class GroundStationWorldModel(WorldModel):
    """Adds ground stations. Satellites see them only if their dynamics model requires them."""

    components: ClassVar[tuple[Component, ...]] = (environment.GROUND_STATIONS,)
    only_where_required: ClassVar[bool] = True
