"""Names: hints for wrong ones that users write, and names made of those of classes."""

from __future__ import annotations

import difflib
import re
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import TypeVar

from bsk_torch._rooms import resolve

Name = TypeVar("Name", bound=str)

CLOSE, NEAR = 0.5, 0.1
"""Least similarity of names that are suggested, 1 for equal ones, and how much less than that of the closest it may be."""


SAME = (
    ("charge", "storedCharge_Init", "battery_charge", "battery_charge_fraction"),
    ("storage", "storageInit", "storage_level", "storage_level_fraction"),
    ("Omega_WB_B", "wheelSpeeds", "wheel_speeds", "wheel_speeds_fraction"),
    ("sigma_BN", "sigma_init"),
    ("omega_BN_B", "omega_init"),
    ("r_BN_N", "rN", "oe", "orbit"),
    ("v_BN_N", "vN"),
)
"""Names of one quantity: field of the state, argument of its start, properties."""


def same(name: str) -> tuple[str, ...]:
    """Return the other names of a quantity."""
    return tuple(other for names in SAME if name in names for other in names if other != name)


def nearest(name: str, names: Iterable[str]) -> str:
    """Return a hint: other names of the quantity, the closest names, or all if none is close; ``names`` are valid."""
    names = list(map(str, names))
    if alike := [other for other in same(name) if other in names]:
        return f"did you mean {' or '.join(map(repr, alike))}?"
    by_lower = {k.lower(): k for k in names}
    ratios = {k: difflib.SequenceMatcher(None, name.lower(), k).ratio() for k in by_lower}
    least = max(CLOSE, max(ratios.values(), default=0.0) - NEAR)
    close = [by_lower[k] for k in sorted(ratios, key=lambda k: -ratios[k]) if ratios[k] >= least][:3]
    return f"did you mean {' or '.join(map(repr, close))}?" if close else f"valid names: {', '.join(sorted(by_lower.values()))}"


def one_of(title: str, value: Name, names: Collection[str]) -> Name:
    """Return one of ``names`` that a user chose; ValueError, with the nearest one, for anything else."""
    if not isinstance(value, str) or value not in names:
        raise ValueError(f"{title}={value!r} must be one of {list(names)}; {nearest(str(value), names)}")
    return value


def check_unique(names: Sequence[str], what: str) -> None:
    """Raise ValueError if some of the ``names`` of listed parts, ``what`` in messages, are equal."""
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"sat_args: {names.count(name)} {what} are named {name!r}; give each another name")


LONGEST_NAME = 100
"""Most characters of the name of a satellite."""


def name_fault(name: str) -> str:
    """Return why a text cannot be the name of a satellite; an empty string for a name.

    Names are those of catalogs, with spaces, hyphens and brackets.
    """
    if not name or name != name.strip():
        return "must not be empty, nor begin or end with a space"
    if not name.isprintable():
        return "has characters that cannot be shown"
    return f"has {len(name)} characters; at most {LONGEST_NAME} are possible" if len(name) > LONGEST_NAME else ""


def snake(name: str) -> str:
    """Return the name of a class in lower case with underscores."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


def lazy(package: str, modules: Mapping[str, Sequence[str]]) -> Callable[[str], object]:
    """Return the ``__getattr__`` of a package that imports attributes when they are first read (PEP 562).

    ``modules`` are the names of the attributes by the module of the package that has them.
    """
    homes = {name: module for module, names in modules.items() for name in names}

    def read(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}; {nearest(name, homes)}")
        value: object = resolve(f"{package}.{homes[name]}:{name}")
        setattr(sys.modules[package], name, value)
        return value

    return read
