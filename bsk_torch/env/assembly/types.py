"""Grouping of satellites by type; one simulation holds all satellites of a type."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence

from bsk_torch.rand import MOST_SATELLITES
from bsk_torch.sats.satellite import Satellite
from bsk_torch.sim.arguments.values import alike, is_fixed, nearest
from bsk_torch.sim.names import name_fault

OWN = ("name", "sat_args_generator")
"""Attributes that may differ between satellites of one type."""


def check_names(satellites: Sequence[Satellite]) -> list[str]:
    """Return the names of the satellites; ValueError for none or too many satellites, or invalid or repeated names."""
    if not satellites:
        raise ValueError("satellites is empty; an environment needs at least one satellite")
    if len(satellites) > MOST_SATELLITES:
        raise ValueError(f"satellites has {len(satellites)} entries; at most {MOST_SATELLITES} are possible")
    for satellite in satellites:
        if not isinstance(satellite, Satellite):
            raise TypeError(
                f"satellites holds {satellite!r}, which is not a satellite; write MySatellite('Name'), with parentheses"
            )
    names = [satellite.name for satellite in satellites]
    for name in names:
        if fault := name_fault(name):
            raise ValueError(f"name={name!r} {fault}")
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"satellites has several called {twice}; every satellite needs a unique name")
    return names


def same_type(a: Satellite, b: Satellite) -> bool:
    """Return whether two satellites differ only in their names and the values of variable arguments."""
    if type(a) is not type(b):
        return False
    options, others = ({n: v for n, v in vars(x).items() if n not in OWN} for x in (a, b))
    if options.keys() != others.keys() or not all(alike(options[name], others[name]) for name in options):
        return False
    if a.sat_args_generator is b.sat_args_generator:
        return True
    table = type(a).default_sat_args().rows
    first, second = ({name: x.sat_args_generator.get(name, arg.default) for name, arg in table.items()} for x in (a, b))
    # where None stands for no value, something is not built
    built = (name for name, arg in table.items() if arg.missing is None and None not in arg.choices and arg.kind != "orbit")
    if any((first[name] is None) != (second[name] is None) for name in built):
        return False
    return all(alike(first[name], second[name]) for name, arg in table.items() if is_fixed(arg))


def grouped(satellites: Sequence[Satellite], group_of: Callable[[str], Hashable]) -> list[list[int]]:
    """Return the indices of the satellites of each type, in order of first appearance.

    Satellites for which ``group_of`` returns different values, by their names, are of different types.
    """
    types: list[list[int]] = []
    for k, satellite in enumerate(satellites):
        for columns in types:
            first = satellites[columns[0]]
            if group_of(first.name) == group_of(satellite.name) and same_type(first, satellite):
                columns.append(k)
                break
        else:
            types.append([k])
    return types


def check_world(world_args: Iterable[str], tables: Iterable[Iterable[str]]) -> None:
    """Raise KeyError for an argument unknown to the worlds of all satellites."""
    names = {name for group in tables for name in group}
    for name in world_args:
        if name not in names:
            raise KeyError(f"world_args[{name!r}] is unknown; {nearest(str(name), names)}")
