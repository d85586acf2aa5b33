"""Models from several classes, and what the parts of a simulation require of one another."""

from __future__ import annotations

import dis
import functools
import inspect
import types
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

from bsk_torch.sim.component import Component, replaced
from bsk_torch.sim.dyn.models import DynamicsModel
from bsk_torch.sim.fsw.models import FSWModel
from bsk_torch.sim.world import WorldModel

Class = TypeVar("Class", bound=type)


class Home(NamedTuple):
    """Where models of a kind are listed: the attribute, the kind in messages, an example, and the name of composed classes."""

    attribute: str
    kind: str
    example: str
    composed: str


HOMES: dict[type, Home] = {
    DynamicsModel: Home("dyn_type", "dynamics model", "dyn_type = (dyn.ImagingDynModel, dyn.LOSCommDynModel)", "Dyn"),
    FSWModel: Home("fsw_type", "flight-software model", "fsw_type = fsw.ImagingFSWModel", "FSW"),
    WorldModel: Home("world_type", "world model", "world_type=(world.EclipseWorldModel, world.GroundStationWorldModel)", "World"),
}


def compose(models: object, base: Class, owner: str = "") -> Class:
    """Return the class that a model class, or a tuple or list of them, stands for.

    Members of the first of several classes win. Duplicates, and classes of which others are subclasses, are left out; ``base``,
    ``DynamicsModel``, ``FSWModel`` or ``WorldModel``, comes last. A single remaining class is used directly. TypeError for an
    entry that is not a model of the kind, or classes that Python cannot order; ``owner`` names what the user gave it to.
    """
    parts = tuple(models) if isinstance(models, tuple | list) else (models,)
    for part in parts:
        _check_part(part, base, owner)
    try:
        return _composed((*parts, base), base)
    except TypeError as error:
        names = ", ".join(part.__name__ for part in parts)
        raise TypeError(f"{_title(base, owner)} = ({names}) cannot be composed: {error}") from error


def _title(base: type, owner: str) -> str:
    return f"{owner}.{HOMES[base].attribute}" if owner else HOMES[base].attribute


def _check_part(part: object, base: type, owner: str) -> None:
    title = _title(base, owner)
    if inspect.isclass(part) and issubclass(part, base):
        return
    for other, place in HOMES.items():
        if inspect.isclass(part) and issubclass(part, other):
            raise TypeError(f"{title} holds {part.__name__}, which is a {place.kind}; list it in {place.attribute}")
    if isinstance(part, tuple(HOMES)):
        raise TypeError(f"{title} holds an object of {type(part).__name__}; write the class, without parentheses after its name")
    raise TypeError(f"{title} holds {part!r}, which is no {HOMES[base].kind}; write classes like {HOMES[base].example}")


@functools.cache
def _composed(parts: tuple[type, ...], base: type) -> Any:
    unique = tuple(dict.fromkeys(parts))
    bases = [part for part in unique if not any(part is not other and issubclass(other, part) for other in unique)]
    if len(bases) == 1:
        return bases[0]
    names = ", ".join(part.__name__ for part in bases)
    return types.new_class(f"{HOMES[base].composed}({names})", tuple(bases))


def world_of(dyn_type: type[DynamicsModel], world_type: type[WorldModel] | None = None) -> type[WorldModel]:
    """Return the world model of satellites: the given one, or what their dynamics model requires.

    TypeError if the given one lacks a world model that the dynamics model requires.
    """
    required = dyn_type.all_required_worlds()
    if world_type is None:
        return compose(required, WorldModel)
    for model in required:
        if not issubclass(world_type, model):
            raise TypeError(
                f"world_type={world_type.__name__} lacks {model.__name__}, which dynamics model {dyn_type.__name__} requires; "
                f"write world_type=(..., world.{model.__name__}), or leave world_type out: it follows from the satellites"
            )
    return world_type


def world_components(dyn_type: type[DynamicsModel], world_type: type[WorldModel] | None = None) -> tuple[Component, ...]:
    """Return the components of the world of satellites in the order of a tick; TypeError as for :func:`world_of`."""
    parts = world_of(dyn_type, world_type).components_for(dyn_type.all_required_worlds())
    required = (part for cls in reversed(dyn_type.__mro__) for part in vars(cls).get("world_components", ()))
    return replaced((*parts, *required))


def check_required_dyn(dyn_type: type[DynamicsModel], fsw_type: type[FSWModel]) -> None:
    """Raise TypeError for a dynamics model without the devices that the flight software commands."""
    for model in fsw_type.all_required_dyn():
        if not issubclass(dyn_type, model):
            raise TypeError(
                f"flight software {fsw_type.__name__} requires dynamics model {model.__name__}, which is not among the bases of "
                f"{dyn_type.__name__}; write dyn_type = (dyn.{model.__name__}, ...)"
            )


def _models(condition: Callable[[type], bool], *bases: type) -> list[str]:
    """Return the package's models for which a condition holds, as users write them."""
    models = ((base, cls) for base in bases for cls in _subclasses(base))
    return [
        f"{HOMES[base].attribute.removesuffix('_type')}.{cls.__name__}"
        for base, cls in models
        if cls.__module__.startswith("bsk_torch.sim.") and condition(cls)
    ]


def providers(name: str) -> Sequence[str]:
    """Return the package's models whose components write the message, field or parameter ``name``."""
    return _models(lambda cls: any(name in written(part) for part in vars(cls).get("components", ())), *HOMES)


def provided_by(name: str) -> str:
    """Return advice for a model that lacks the message, field or parameter ``name``."""
    models = providers(name)
    return f"{' or '.join(models)} provides it" if models else "list a Component that provides it, too"


def having(name: str) -> Sequence[str]:
    """Return the package's models that define the property or method ``name``."""
    return _models(lambda cls: name in vars(cls), DynamicsModel, FSWModel)


def commanded_by(command: str) -> Sequence[str]:
    """Return the package's flight-software models that bring a command."""

    def commands(cls: type) -> bool:
        return bool(vars(cls).get("modes", {}).get(command)) or command in vars(cls).get("commands", {})

    return _models(commands, FSWModel)


def _subclasses(base: type) -> list[type]:
    children: list[type] = type.__subclasses__(base)
    return list(dict.fromkeys([base, *(cls for child in children for cls in _subclasses(child))]))


def written(component: Component) -> set[str]:
    """Return the names that a component provides: its fields, its parameters, and what the code of its update assigns."""
    names = {field.name for field in (*component.state, *component.params)}
    code = getattr(component.update, "__code__", None)
    stores = () if code is None else dis.get_instructions(code)
    names |= {"allocation"} if component.allocation else set()
    return names | {step.argval for step in stores if step.opname == "STORE_ATTR"}
