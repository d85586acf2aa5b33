"""Changes of ``sat_args`` and ``world_args`` between episodes, and the dictionaries in which users set them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from bsk_torch.rand import as_value
from bsk_torch.sim.arguments.sources import Member, expand
from bsk_torch.sim.arguments.values import Arguments
from bsk_torch.sim.assembly.satellite_type import SatelliteType
from bsk_torch.sim.names import nearest

WORLD = None
"""Stands for the world instead of the index of a satellite."""


class Change(NamedTuple):
    """A new value of one argument."""

    satellite: int | None  # index of the satellite; None for the world
    name: str  # name of the argument
    value: object  # the value, as given in sat_args or world_args
    envs: tuple[int, ...] | None  # indices of the changed episodes in the draws; None for all


def of_satellites(args: Any, names: Sequence[str], envs: tuple[int, ...] | None) -> list[Change]:
    """Return the changes specified by ``args``: arguments of all satellites, or dictionaries by name of the satellite."""
    if not (isinstance(args, Mapping) and any(name in names for name in args)):
        arguments = expand(args, "sat_args")
        return [Change(k, name, value, envs) for k in range(len(names)) for name, value in arguments.items()]
    for name in args:
        if name not in names:
            raise ValueError(f"set_sat_args: {name!r} is no satellite; {nearest(str(name), names)}")
    each = {names.index(who): expand(values, f"sat_args of {who}") for who, values in args.items()}
    return [Change(k, name, value, envs) for k, arguments in each.items() for name, value in arguments.items()]


def of_world(args: Any, envs: tuple[int, ...] | None) -> list[Change]:
    """Return the changes of ``world_args`` specified by ``args``."""
    return [Change(WORLD, name, value, envs) for name, value in expand(args, "world_args").items()]


def episodes(envs: object, num_envs: int, env_ids: Tensor) -> tuple[Tensor | None, tuple[int, ...] | None]:
    """Return the rows of ``envs``, indices or a mask [N], and their indices in the draws; twice None for all.

    Raises:
        IndexError: For indices out of range.
        ValueError: For rows with the same ``env_ids`` as rows not in ``envs``.
    """
    if envs is None:
        return None, None
    rows = torch.as_tensor(envs).cpu()
    if rows.dtype == torch.bool:
        if rows.shape != (num_envs,):
            raise IndexError(f"envs is a mask of shape {list(rows.shape)}; it must be [{num_envs}]")
        rows = torch.nonzero(rows).squeeze(-1)
    rows = torch.atleast_1d(rows).long()
    if rows.ndim != 1 or (len(rows) and not 0 <= int(rows.min()) <= int(rows.max()) < num_envs):
        raise IndexError(f"envs={rows.tolist()} must be indices from 0 to {num_envs - 1}, or a mask [{num_envs}]")
    ids = env_ids.cpu()
    shared = torch.isin(ids, ids[rows])
    if int(shared.sum()) > len(rows.unique()):
        raise ValueError("envs names episodes whose env_ids others have too; these would change with them: name all of them")
    return rows, tuple(ids[rows].tolist())


def remembered(old: Sequence[Change], new: Sequence[Change]) -> list[Change]:
    """Return the earlier changes that remain in effect after the ``new`` ones."""
    kept = list(old)
    for change in new:
        remaining, repeated = [], False
        for earlier in kept:
            if (earlier.satellite, earlier.name) == (change.satellite, change.name):
                if change.envs is None:
                    continue
                repeated = repeated or (earlier.envs is None and earlier.value is change.value)
                if earlier.envs is not None:
                    envs = tuple(env for env in earlier.envs if env not in change.envs)
                    if not envs:
                        continue
                    earlier = earlier._replace(envs=envs)
            remaining.append(earlier)
        kept = remaining if repeated else [*remaining, change]
    return kept


def changed(types: Sequence[SatelliteType], changes: Sequence[Change], env_ids: Tensor) -> list[SatelliteType]:
    """Return the types of satellites with changed arguments, checked by trial draws of environments with ``env_ids`` [N]."""
    new = []
    for satellite_type in types:
        columns, around = satellite_type.usage.columns, satellite_type.arguments.world_args.table
        settings = [(columns.index(c.satellite), *c[1:]) for c in changes if c.satellite in columns]
        world = [(0, *c[1:]) for c in changes if c.satellite is WORLD and c.name in around]
        new.append(satellite_type.changed(settings, world, len(env_ids)) if settings or world else satellite_type)
        if settings or world:
            new[-1].arguments.check_per_env(env_ids)
    return new


class LiveArguments(MutableMapping[str, Any]):
    """Given and default values by name; a change takes effect at the next reset."""

    def __init__(
        self, arguments: Callable[[], Sequence[Arguments]], write: Callable[[dict[str, object]], None], title: str
    ) -> None:
        """Look up names in ``arguments``, in order of precedence; ``write`` sets values."""
        self._arguments, self._write, self._title = arguments, write, title

    def _table(self) -> dict[str, object]:
        return {name: value for arguments in reversed(self._arguments()) for name, value in arguments.given.items()}

    def __getitem__(self, name: str) -> Any:
        table = self._table()
        if name not in table:
            raise KeyError(f"{self._title}[{name!r}] is unknown; {nearest(str(name), table)}")
        value = table[name]
        return value if not isinstance(value, Member) else value.function

    def __setitem__(self, name: str, value: object) -> None:
        self._write({name: as_value(value)})

    def __delitem__(self, name: str) -> None:
        raise TypeError(f"{self._title}[{name!r}] cannot be deleted; set it to another value instead")

    def __iter__(self) -> Iterator[str]:
        return iter(self._table())

    def __len__(self) -> int:
        return len(self._table())

    def __repr__(self) -> str:
        return repr(dict(self))
