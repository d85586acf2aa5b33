"""Points on the surface of a resident space object (RSO); counterpart of ``bsk_rl.scene.rso_points``."""

from __future__ import annotations

import logging
from abc import abstractmethod
from dataclasses import astuple, dataclass
from typing import TYPE_CHECKING

import numpy as np
from typing_extensions import override

from bsk_torch.bsk_rl.scene.scenario import Scenario
from bsk_torch.bsk_rl.sim.inspection import Inspection
from bsk_torch.bsk_rl.utils.orbital import fibonacci_sphere
from bsk_torch.tasks.inspection import RSODynModel, RSOInspectorDynModel, RSOInspectorFSWModel

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite


logger = logging.getLogger(__name__)


@dataclass(eq=False)
class RSOPoint:
    """A point on the surface of an RSO; points with the same attributes are equal.

    Attributes:
        r_PB_B: Position in body axes, m [3].
        n_B: Normal of the surface in body axes, of any length [3].
        theta_max: Largest angle between the normal and the direction of the inspector, rad.
        range_max: Maximum distance of the inspector, m; no limit unless positive.
        theta_solar_max: Largest angle between the normal and the direction of the Sun, rad.
        min_illumination_factor: Minimum visible fraction of the Sun.
    """

    r_PB_B: np.ndarray
    n_B: np.ndarray
    theta_max: float
    range_max: float
    theta_solar_max: float
    min_illumination_factor: float

    @property
    def _key(self) -> tuple[float, ...]:
        position, normal, *limits = astuple(self)
        return (*map(float, position), *map(float, normal), *map(float, limits))

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RSOPoint) and self._key == other._key

    def __str__(self) -> str:
        return f"RSOPoint_{self.r_PB_B}"


class RSOPoints(Scenario):
    """Points on the one satellite with a ``dyn.RSODynModel``, which those with a ``dyn.RSOInspectorDynModel`` inspect.

    A subclass defines :meth:`generate_points`. See :class:`bsk_torch.bsk_rl.data.RSOInspectionReward`.

    Attributes:
        rso_points: Points of the episode.
        rso: The satellite that is inspected.
        inspectors: Those that inspect it.
        inspection: What has been inspected, and lit, in the runs of the episode.
    """

    rso: Satellite
    inspectors: list[Satellite]
    inspection: Inspection | None = None

    def reset_overwrite_previous(self) -> None:
        """Forget the points of the last episode."""
        self.rso_points: list[RSOPoint] = []
        if self.inspection is not None:
            self.inspection.stop()
        self.inspection = None

    def reset_pre_sim_init(self) -> None:
        """Make the points, and find the RSO and its inspectors."""
        self.rso_points = self.generate_points()
        rsos = [satellite for satellite in self.satellites if issubclass(satellite.dyn_type, RSODynModel)]
        if not rsos:
            logger.warning("No satellite has dyn.RSODynModel; there is nothing to inspect.")
            return
        if len(rsos) > 1:
            raise AssertionError(f"{[rso.name for rso in rsos]} all have dyn.RSODynModel; one satellite can be inspected")
        self.rso = rsos[0]
        self.inspectors = [satellite for satellite in self.satellites if issubclass(satellite.dyn_type, RSOInspectorDynModel)]
        if not self.inspectors:
            logger.warning("No satellite has dyn.RSOInspectorDynModel; none can inspect.")
            return
        super().reset_pre_sim_init()

    def reset_during_sim_init(self) -> None:
        """Check the RSO and its inspectors, and draw the points in Vizard."""
        if not isinstance(self.rso.dynamics, RSODynModel):
            raise AssertionError(f"{self.rso.name} needs dyn.RSODynModel")
        for inspector in self.inspectors:
            if not isinstance(inspector.fsw, RSOInspectorFSWModel):
                raise AssertionError(f"{inspector.name} needs fsw.RSOInspectorFSWModel, which points at the RSO")
            self.setup_inspector_camera(inspector)
        for point in self.rso_points:
            self.visualize_rso_point(point)

    def reset_post_sim_init(self) -> None:
        """Start to record which points are inspected."""
        simulator = self.rso.simulator
        places = self.rso.core_row, [inspector.core_row for inspector in self.inspectors]
        self.inspection = Inspection(simulator.fleet, *places, self.rso_points)

    def visualize_rso_point(self, rso_point: RSOPoint, vizSupport: object = None, vizInstance: object = None) -> None:
        """Draw a point in Vizard."""

    def setup_inspector_camera(self, inspector: object, vizSupport: object = None, vizInstance: object = None) -> None:
        """Show what an inspector sees in Vizard."""

    @abstractmethod
    def generate_points(self) -> list[RSOPoint]:
        """Return the points of an episode."""


class SphericalRSO(RSOPoints):
    """Points spread evenly over a sphere along Fibonacci's spiral; their normals point outwards."""

    def __init__(
        self,
        n_points: int = 100,
        radius: float = 1.0,
        theta_max: float = np.radians(45),
        range_max: float = -1,
        theta_solar_max: float = np.radians(60),
        min_illumination_factor: float = 0.1,
    ) -> None:
        """Spread ``n_points`` over a sphere of ``radius`` m; see :class:`RSOPoint` for their limits."""
        self.n_points, self.radius, self.theta_max, self.range_max = n_points, radius, theta_max, range_max
        self.theta_solar_max, self.min_illumination_factor = theta_solar_max, min_illumination_factor

    @override
    def generate_points(self) -> list[RSOPoint]:
        limits = self.theta_max, self.range_max, self.theta_solar_max, self.min_illumination_factor
        return [RSOPoint(self.radius * n_B, n_B, *limits) for n_B in fibonacci_sphere(self.n_points)]
