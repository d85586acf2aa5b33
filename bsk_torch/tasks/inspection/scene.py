"""Points on the surface of a resident space object (RSO), to be inspected by other satellites."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import no_gradient, number, whole
from bsk_torch.astro.relative import fibonacci_sphere
from bsk_torch.rand import Key, seeded
from bsk_torch.sats.bound import BoundSatellite, SatelliteFleet
from bsk_torch.sats.satellite import Satellite
from bsk_torch.scene.base import Scenario
from bsk_torch.scene.recorded import RecordedTargets
from bsk_torch.sim.hooks import check_class, note_slow
from bsk_torch.tasks.inspection.models import RSODynModel, RSOInspectorDynModel, RSOInspectorFSWModel
from bsk_torch.tasks.inspection.points import point_columns

DRAWN = "rso_points"
"""Drawn value with the numbers of the points, [N, P, 10], if they differ between episodes."""

ADVICE = "write points_are_fixed = True into the class if the points are the same in all episodes, and it is called once"

FARTHEST = 1e6
"""Largest coordinate of a point, m."""


@dataclass(eq=False)
class RSOPoint:
    """A point on the surface of an RSO.

    Attributes:
        r_PB_B: Position in body axes, m.
        n_B: Normal of the surface in body axes, of any length.
        theta_max: Maximum angle between the normal and the direction to the inspector, rad; no limit unless positive.
        range_max: Maximum distance of the inspector, m; no limit unless positive.
        theta_solar_max: Maximum angle between the normal and the direction to the Sun, rad; no limit if negative.
        min_illumination_factor: Minimum visible fraction of the Sun; no limit unless positive.
    """

    r_PB_B: Any
    n_B: object
    theta_max: float
    range_max: float
    theta_solar_max: float
    min_illumination_factor: float

    def numbers(self, title: str) -> list[float]:
        """Return the ten numbers of the point; ValueError, with a message starting with ``title``, for invalid ones."""
        r_PB_B, n_B = (_vector(f"{title}.{name}", getattr(self, name)) for name in ("r_PB_B", "n_B"))
        if max(map(abs, n_B)) == 0.0:
            raise ValueError(f"{title}.n_B is zero; it must be a direction")
        limits = ("theta_max", "range_max", "theta_solar_max", "min_illumination_factor")
        return [*r_PB_B, *n_B, *(number(f"{title}.{name}", getattr(self, name)) for name in limits)]


def _vector(title: str, value: object) -> list[float]:
    no_gradient(title, value)
    try:
        array = np.asarray(value.cpu() if isinstance(value, Tensor) else value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{title}={value!r} must be three numbers") from error
    if array.shape != (3,) or not np.isfinite(array).all() or np.abs(array).max() > FARTHEST:
        raise ValueError(f"{title}={value!r} must be three numbers of at most {FARTHEST:g}")
    return array.tolist()


class RSOPoints(Scenario):
    """Points on the surface of the only satellite with a :class:`~bsk_torch.tasks.inspection.RSODynModel`.

    Satellites with a :class:`~bsk_torch.tasks.inspection.RSOInspectorDynModel` inspect them; see
    :class:`bsk_torch.tasks.inspection.RSOInspectionReward`. Subclasses define :meth:`generate_points`.

    A point is *seen* by an inspector within its range and within the cone ``theta_max`` about its normal, if the Earth does not
    block the line of sight. It is *lit* if the direction from the Earth's center to the Sun is within ``theta_solar_max`` of its
    normal, and the visible fraction of the Sun at the RSO is at least ``min_illumination_factor``. Apart from these cones, the
    RSO does not hide its points.

    Attributes:
        points_are_fixed: Whether :meth:`generate_points` returns the same points in all episodes. If so, it is called once, when
            an environment is built; otherwise for each episode, which is slow.
        rso_column: Index of the RSO among the satellites of an episode.
        inspector_columns: Indices of the inspectors, [I].
    """

    points_are_fixed: ClassVar[bool] = False
    rso_column: int
    inspector_columns: list[int]
    _link_needs_super = True
    _fixed: Tensor | None = None
    _count: int | None = None

    def __init_subclass__(cls, **options: object) -> None:
        """See :meth:`Scenario.__init_subclass__`; by default, custom points differ between episodes."""
        super().__init_subclass__(**options)
        check_class(cls, RSOPoints, ("generate_points",), {})
        if "generate_points" in vars(cls) and "points_are_fixed" not in vars(cls):
            cls.points_are_fixed = False

    # -- points -------------------------------------------------------------------------------------------------------

    def generate_points(self) -> list[RSOPoint]:
        """Return the points of an episode, with the same number in all episodes.

        NumPy's global generator has a separate stream for each environment and episode.
        """
        raise NotImplementedError(f"{type(self).__name__} must implement generate_points()")

    def _numbers(self) -> list[list[float]]:
        """Return the numbers of the points generated by :meth:`generate_points`, [P, 10]."""
        title, result = f"{type(self).__name__}.generate_points()", self.generate_points()
        if not isinstance(result, Iterable) or isinstance(result, str):
            raise TypeError(f"{title} returns {result!r}; it must return a list of RSOPoint")
        points = list(result)
        if not points:
            raise ValueError(f"{title} returns no points; there must be at least one")
        for point in points:
            if not isinstance(point, RSOPoint):
                raise TypeError(f"{title} returns {point!r}; it must return RSOPoint objects")
        return [point.numbers(f"{title}[{k}]") for k, point in enumerate(points)]

    @property
    @override
    def calls_user(self) -> bool:
        return not self.points_are_fixed

    def draw(self, key: Key) -> dict[str, Tensor]:
        """See :meth:`Scenario.draw`; the numbers of the points, if they differ between episodes."""
        if self.points_are_fixed:
            return {}
        note_slow(f"{type(self).__name__}.generate_points()", ADVICE)
        with seeded(key.named("generate_points")) as rows:
            tables = [self._numbers() for _ in rows]
        counts = sorted({len(points) for points in tables} | ({self._count} if self._count else set()))
        if len(counts) > 1:
            raise ValueError(
                f"{type(self).__name__}.generate_points() returns {counts} points in different episodes; there must be equally "
                "many in all"
            )
        self._count = counts[0]
        return {DRAWN: torch.tensor(tables, dtype=torch.float64)}

    @property
    def _table(self) -> Tensor:
        """Numbers of the points, [P, 10], or [N, P, 10] if they differ between episodes."""
        if not self.points_are_fixed:
            return self.drawn(DRAWN)
        if self._fixed is None:
            self._fixed = torch.tensor(self._numbers(), dtype=torch.float64)
        return self._fixed if self.__dict__.get("fleet") is None else self._fixed.to(self.fleet.device)

    @property
    def n_points(self) -> int:
        """Number of points."""
        return self._table.shape[-2]

    @property
    def r_PB_B(self) -> Tensor:
        """Positions of the points in body axes, [P, 3] m, or [N, P, 3] if they differ between episodes."""
        return self._table[..., :3]

    @property
    def columns(self) -> Tensor:
        """Points in the form expected by :func:`bsk_torch.tasks.inspection.flags.find_flags`, [10, P] or [10, N, P]."""
        table = self._table
        return point_columns(table[..., :3], table[..., 3:6], *table[..., 6:].unbind(-1))

    @property
    def rso_points(self) -> list[RSOPoint]:
        """The points; AttributeError if they differ between episodes (use :meth:`points_of`)."""
        if not self.points_are_fixed:
            raise AttributeError("the points differ between episodes; scenario.points_of(env) returns those of an environment")
        return self.points_of(0)

    def points_of(self, env: int) -> list[RSOPoint]:
        """Return the points of the current episode of environment ``env``."""
        table = self._table if self.points_are_fixed else self._table[env]
        return [RSOPoint(np.array(row[:3]), np.array(row[3:6]), *row[6:]) for row in table.tolist()]

    @override
    def recorded_targets(self, env: int) -> RecordedTargets:
        points = self.points_of(env)
        reach = max(point.range_max if point.range_max > 0.0 else math.inf for point in points)
        return RecordedTargets(
            places="points",
            r=torch.tensor([point.r_PB_B.tolist() for point in points], dtype=torch.float64),
            priority=torch.ones(len(points), dtype=torch.float64),
            owner=self.rso_column,
            viewers=self.inspector_columns,
            reach=reach if math.isfinite(reach) else None,
        )

    # -- satellites ---------------------------------------------------------------------------------------------------

    @override
    def validate_satellite_names(self, satellites: Sequence[Satellite]) -> None:
        rsos, inspectors = (
            [s.name for s in satellites if issubclass(s.dyn_type, model)] for model in (RSODynModel, RSOInspectorDynModel)
        )
        title = f"scene.{type(self).__name__}"
        if len(rsos) != 1:
            raise ValueError(
                f"{title} needs exactly one satellite with RSODynModel; {rsos or 'none'} of {_names(satellites)} have it"
            )
        if not inspectors:
            raise ValueError(
                f"{title} needs at least one satellite with RSOInspectorDynModel and RSOInspectorFSWModel; none of "
                f"{_names(satellites)} has that dynamics model"
            )
        unfit = [s.name for s in satellites if s.name in inspectors and not issubclass(s.fsw_type, RSOInspectorFSWModel)]
        if unfit:
            raise ValueError(f"{title}: {unfit} have RSOInspectorDynModel, but not RSOInspectorFSWModel, which points at the RSO")
        if both := sorted(set(rsos) & set(inspectors)):
            raise ValueError(f"{title}: {both} would inspect itself; give the RSO and its inspectors separate models")

    @override
    def link(self, fleet: SatelliteFleet) -> None:
        super().link(fleet)
        kinds = [part.dyn_type for part in fleet.satellites]
        self.rso_type = next(k for k, kind in enumerate(kinds) if issubclass(kind, RSODynModel))
        self.inspector_types = tuple(k for k, kind in enumerate(kinds) if issubclass(kind, RSOInspectorDynModel))
        self.rso_column = int(fleet.columns[self.rso_type][0])
        self.inspector_columns = [column for k in self.inspector_types for column in fleet.columns[k].tolist()]

    @property
    def rso(self) -> BoundSatellite:
        """The RSO."""
        return self.fleet.satellites[self.rso_type]

    @property
    def inspectors(self) -> list[BoundSatellite]:
        """The inspectors of each type."""
        return [self.fleet.satellites[k] for k in self.inspector_types]

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        return {} if self.points_are_fixed else {DRAWN: (-1e200, 1e200)}


def _names(satellites: Sequence[Satellite]) -> list[str]:
    return [satellite.name for satellite in satellites]


class SphericalRSO(RSOPoints):
    """Points spread evenly over a sphere along a Fibonacci spiral, with normals pointing outward."""

    points_are_fixed = True

    def __init__(
        self,
        n_points: int = 100,
        radius: float = 1.0,
        theta_max: float = math.radians(45.0),
        range_max: float = -1.0,
        theta_solar_max: float = math.radians(60.0),
        min_illumination_factor: float = 0.1,
    ) -> None:
        """Choose points and limits; ValueError for a wrong argument.

        Args:
            n_points: Number of points.
            radius: Radius of the sphere, m.
            theta_max: Maximum angle between a point's normal and the direction to the inspector, rad; no limit unless positive.
            range_max: Maximum distance between a point and the inspector, m; no limit unless positive.
            theta_solar_max: Maximum angle between a point's normal and the direction to the Sun, rad; no limit if negative.
            min_illumination_factor: Minimum visible fraction of the Sun; no limit unless positive.
        """
        self.number_of_points = whole("n_points", n_points, 1, 100_000)
        self.radius = number("radius", radius, 0.0, FARTHEST, unit="m", above=True)
        self.theta_max = number("theta_max", theta_max, -math.pi, math.pi, unit="rad")
        self.range_max = number("range_max", range_max, unit="m")
        self.theta_solar_max = number("theta_solar_max", theta_solar_max, -math.pi, math.pi, unit="rad")
        self.min_illumination_factor = number("min_illumination_factor", min_illumination_factor, -math.inf, 1.0)

    @override
    def generate_points(self) -> list[RSOPoint]:
        limits = self.theta_max, self.range_max, self.theta_solar_max, self.min_illumination_factor
        return [RSOPoint(self.radius * n_B, n_B, *limits) for n_B in fibonacci_sphere(self.number_of_points)]
