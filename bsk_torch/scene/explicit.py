"""Targets at given positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import get_args

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import text
from bsk_torch.astro.geodetic import Vertical, geodetic_to_fixed
from bsk_torch.constants import R_EARTH
from bsk_torch.formats.places import HIGHEST, LOWEST, PlaceList, angle_hint, read_csv, read_geojson
from bsk_torch.rand import Distribution, Key, PerEnv, first_key
from bsk_torch.scene.draws import as_numbers, calls_user, check_numbers, check_positions, draw_numbers
from bsk_torch.scene.targets import TargetScenario

ON_SPHERE = 1.0  # distance from bsk_rl's sphere, m, within which a place lies on it


class Targets(TargetScenario):
    """Targets at given positions, the same in all episodes, for all environments or for each environment separately."""

    def __init__(
        self,
        r_LP_P: object,
        priority: object = 1.0,
        names: Sequence[str] | None = None,
        vertical: Vertical | None = None,
    ) -> None:
        """ValueError for a wrong argument.

        Args:
            r_LP_P: Earth-fixed positions in m, [T, 3] for all environments; or ``rand.per_env`` with [T, 3] for each environment,
                as a tensor [N, T, 3] or as a list of N lists that may differ in length.
            priority: Priority of each target: a number, T numbers, a distribution, a callable without arguments called for each
                target, or ``rand.per_env`` with a number for each environment or for each of its targets.
            names: Names of the T columns (default: ``"tgt-0"`` and so on).
            vertical: Direction from which elevations are counted: the normal of the ellipsoid of ``"wgs84"``, or the place's
                ``"radius"``, as bsk_rl does. By default the former, unless all places lie on the sphere on which bsk_rl puts
                them, 6,378,136.6 m from the Earth's center. ``compat="bsk_rl"`` counts from the radius in any case.
        """
        self.per_env = isinstance(r_LP_P, PerEnv)
        tables = _tables(r_LP_P)
        counts = [len(table) for table in tables]
        self.most_targets = max(counts)
        self.exists = (torch.arange(self.most_targets) < torch.tensor(counts).unsqueeze(-1)).double()
        missing = (self.most_targets - len(table) for table in tables)
        self.positions = torch.stack([torch.cat([t, t[:1].expand(n, -1)]) for t, n in zip(tables, missing, strict=True)])
        self.priorities = _priorities(priority, counts) if isinstance(priority, PerEnv) else priority
        check_numbers("priority", self.priorities, self.most_targets)
        if names is not None and (isinstance(names, str) or not isinstance(names, Sequence)):
            raise ValueError(f"names={names!r} must be a list of names, one for each target, or None")
        self.vertical = _vertical(vertical, tables)
        self.given_names = None if names is None else [text("names", name) for name in names]
        if self.given_names is not None and len(self.given_names) != self.most_targets:
            raise ValueError(f"names has {len(self.given_names)} entries; r_LP_P has {self.most_targets} targets")

    @classmethod
    def from_geodetic(
        cls,
        latitude: object,
        longitude: object,
        height: object = 0.0,
        priority: object = 1.0,
        names: Sequence[str] | None = None,
    ) -> Targets:
        """Return targets at places on the real Earth; see :func:`bsk_torch.astro.geodetic.geodetic_to_fixed`.

        Polar motion, up to 10 m on the ground, and the difference of UT1 and UTC, up to 420 m at the equator, are neglected.

        Args:
            latitude: Geodetic latitude of each target on WGS84, [T] degrees.
            longitude: Longitude of each target, [T] degrees from -180 to 180.
            height: Height above the ellipsoid, [T] or one for all, m.
            priority: See :class:`Targets`.
            names: See :class:`Targets`.

        Raises:
            ValueError: For wrong numbers.
        """
        degrees = [_angles(name, x, bound) for name, x, bound in (("latitude", latitude, 90.0), ("longitude", longitude, 180.0))]
        if len(degrees[0]) != len(degrees[1]):
            raise ValueError(f"latitude has {len(degrees[0])} numbers, longitude {len(degrees[1])}; there is one for each target")
        heights = draw_numbers("height", height, first_key(1), len(degrees[0]), LOWEST, HIGHEST, "m")[0]
        return cls(geodetic_to_fixed(degrees[0].deg2rad(), degrees[1].deg2rad(), heights), priority, names, "wgs84")

    @classmethod
    def from_csv(cls, source: str | Path, columns: Mapping[str, str] | None = None, priority: object | None = None) -> Targets:
        """Return the targets of a CSV file, or its text; see :func:`bsk_torch.formats.places.read_csv`.

        ``priority`` replaces that of the file, which is 1 without a column for it.
        """
        return cls._from_places(read_csv(source, columns), priority)

    @classmethod
    def from_geojson(cls, source: str | Path, priority: object | None = None) -> Targets:
        """Return the points of a GeoJSON file, or its text; see :func:`bsk_torch.formats.places.read_geojson`.

        ``priority`` replaces that of the file, which is 1 without a property for it.
        """
        return cls._from_places(read_geojson(source), priority)

    @classmethod
    def _from_places(cls, places: PlaceList, priority: object | None) -> Targets:
        names = [name or f"tgt-{k}" for k, name in enumerate(places.names)]
        drawn = priority if priority is not None else 1.0 if places.priority is None else places.priority
        return cls.from_geodetic(places.latitude, places.longitude, places.height, drawn, names)

    @property
    @override
    def calls_user(self) -> bool:
        return calls_user(self.priorities)

    @property
    def target_names(self) -> list[str]:
        """Name of every column."""
        return super().target_names if self.given_names is None else self.given_names

    @override
    def draw(self, key: Key) -> dict[str, Tensor]:
        tables = self.positions, self.exists
        r_LP_P, exists = (as_numbers(PerEnv(x).draw(key)) if self.per_env else x for x in tables)
        priority = draw_numbers("priority", self.priorities, key.named("target_priority"), self.most_targets)
        return {"target_r_LP_P": r_LP_P, "target_priority": priority * exists, "target_exists": exists}


def _vertical(vertical: Vertical | None, tables: Sequence[Tensor]) -> Vertical:
    if vertical is None:
        on_sphere = all(bool(((table.norm(dim=-1) - R_EARTH).abs() < ON_SPHERE).all()) for table in tables)
        return "radius" if on_sphere else "wgs84"
    if vertical not in get_args(Vertical):
        raise ValueError(f"vertical={vertical!r} must be one of {list(get_args(Vertical))}, or None")
    return vertical


def _angles(name: str, value: object, bound: float) -> Tensor:
    angles = _numbers(name, value)
    if angles.ndim != 1 or not len(angles):
        raise ValueError(f"{name} has shape {list(angles.shape)}; it must be [T], degrees")
    bad = torch.nonzero(~(angles.abs() <= bound))
    if len(bad):
        k = int(bad[0])
        hint = angle_hint(name, angles[k].item())
        raise ValueError(f"{name} of target {k} is {angles[k].item():g}; it must be from {-bound:g} to {bound:g} degrees{hint}")
    return angles


def _tables(r_LP_P: object) -> list[Tensor]:
    """Return the lists of positions, [T, 3] each: a single list for all environments, or one per environment."""
    if isinstance(r_LP_P, PerEnv):
        if not len(r_LP_P.values):
            raise ValueError("r_LP_P=rand.per_env([]) is empty; it needs a list of targets for each environment")
        return [_table(rows, f" of environment {i}") for i, rows in enumerate(r_LP_P.values)]
    if isinstance(r_LP_P, Distribution):
        raise ValueError(f"r_LP_P={r_LP_P!r} must be positions [T, 3] or rand.per_env; scene.UniformTargets draws positions")
    return [_table(r_LP_P, "")]


def _table(rows: object, of: str) -> Tensor:
    table = _numbers(f"r_LP_P{of}", rows)
    if table.ndim == 3 and not of:
        raise ValueError(f"r_LP_P has shape {list(table.shape)}; use rand.per_env to give each environment its own targets")
    if not table.numel():
        raise ValueError(f"r_LP_P{of} is empty; there must be at least one target")
    if table.ndim != 2 or table.shape[1] != 3:
        raise ValueError(f"r_LP_P{of} has shape {list(table.shape)}; it must be [T, 3], Earth-fixed positions in m")
    check_positions(table, of)
    return table


def _priorities(priority: PerEnv, counts: list[int]) -> PerEnv:
    rows = [_numbers(f"priority of environment {i}", row) for i, row in enumerate(priority.values)]
    if all(row.ndim == 0 for row in rows):
        return PerEnv(torch.stack(rows)) if rows else priority
    counts = counts * len(rows) if len(counts) == 1 else counts
    if len(rows) != len(counts):
        raise ValueError(f"priority has rows for {len(rows)} environments, but r_LP_P for {len(counts)}")
    for i, (row, count) in enumerate(zip(rows, counts, strict=True)):
        if row.shape != (count,):
            raise ValueError(f"priority of environment {i} has shape {list(row.shape)}; its r_LP_P has {count} targets")
    return PerEnv(torch.stack([torch.nn.functional.pad(row, (0, max(counts) - len(row))) for row in rows]))


def _numbers(what: str, value: object) -> Tensor:
    try:
        return as_numbers(value)
    except (TypeError, ValueError, RuntimeError, OverflowError) as error:
        raise ValueError(f"{what} must be numeric, in rows of equal length: {error}") from error
