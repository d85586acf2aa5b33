"""Targets on the ground; counterpart of ``bsk_rl.scene.targets``."""

from __future__ import annotations

import csv
import functools
import logging
import sys
from collections.abc import Callable, Iterable
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from bsk_torch.bsk_rl.scene.scenario import Scenario
from bsk_torch.bsk_rl.utils.orbital import lla2ecef
from bsk_torch.constants import R_EARTH
from bsk_torch.scene.cities import city_table

logger = logging.getLogger(__name__)


class Target:
    """A place on the ground that is worth imaging; two targets are never equal.

    Attributes:
        name: Name; need not be unique.
        r_LP_P: Earth-fixed position, m [3].
        priority: Value of an image of it.
    """

    def __init__(self, name: str, r_LP_P: Iterable[float], priority: float) -> None:
        self.name, self.r_LP_P, self.priority = name, np.array(r_LP_P), priority

    @property
    def id(self) -> str:
        """Unique name, which copies keep."""
        if not hasattr(self, "_id"):
            self._id = f"{self.name}_{id(self)}"
        return self._id

    def __repr__(self) -> str:
        return f"Target({self.name})"


def uniform_priority() -> float:
    """Draw a priority from [0, 1); a function, since copies of NumPy's methods have copies of the generator."""
    return np.random.rand()


class UniformTargets(Scenario):
    """Targets distributed uniformly over a sphere, drawn in every episode."""

    def __init__(
        self,
        n_targets: int | tuple[int, int],
        priority_distribution: Callable[[], float] | None = None,
        radius: float = R_EARTH,
    ) -> None:
        """Initialize the scenario.

        Args:
            n_targets: Number of targets, or ``(low, high)`` to draw it from [low, high).
            priority_distribution: Function that draws the priority of a target (default: uniform in [0, 1)).
            radius: Distance of targets from the Earth's center, m.
        """
        self._n_targets = n_targets
        self.priority_distribution = priority_distribution or uniform_priority
        self.radius = radius

    def reset_overwrite_previous(self) -> None:
        """Forget the targets of the last episode."""
        self.targets: list[Target] = []

    def reset_pre_sim_init(self) -> None:
        """Draw targets and add them to the locations of satellites."""
        n = self._n_targets
        self.n_targets = int(n) if isinstance(n, int | np.integer) else int(np.random.randint(n[0], n[1]))
        logger.info("Generating %d targets", self.n_targets)
        self.regenerate_targets()
        for satellite in self.satellites:
            if hasattr(satellite, "add_location_for_access_checking"):
                for target in self.targets:
                    satellite.add_location_for_access_checking(
                        object=target,
                        r_LP_P=target.r_LP_P,
                        min_elev=satellite.sat_args_generator["imageTargetMinimumElevation"],
                        type="target",
                    )

    def reset_during_sim_init(self) -> None:
        """Draw the targets in Vizard."""
        for target in self.targets:
            self.visualize_target(target)

    def visualize_target(self, target: Target, vizSupport: object = None, vizInstance: object = None) -> None:
        """Draw a target in Vizard."""

    def regenerate_targets(self) -> None:
        """Set ``self.targets`` for an episode; subclasses override this method to create other targets."""
        self.targets = []
        for k in range(self.n_targets):
            r_LP_P = np.random.normal(size=3)
            r_LP_P *= self.radius / np.linalg.norm(r_LP_P)
            self.targets.append(Target(name=f"tgt-{k}", r_LP_P=r_LP_P, priority=self.priority_distribution()))


@functools.cache
def city_places() -> list[tuple[str, float, float]]:
    """Return names such as ``"Denver, US"``, latitudes and longitudes, deg, of all cities, the most populous first.

    Cities are those of bsk_rl's table where bsk_rl is installed; it is not imported. Elsewhere they are those of
    :func:`bsk_torch.scene.cities.city_table`, at other places.

    Raises:
        ImportError: Without bsk_rl and the extra ``cities``.
    """
    spec = find_spec("bsk_rl")
    for folder in spec.submodule_search_locations or () if spec else ():
        file = Path(folder) / "_dat" / "simplemaps_worldcities" / "worldcities.csv"
        if file.exists():
            with file.open(encoding="utf-8", newline="") as table:  # as pandas reads it there, where Namibia's "NA" is no text
                rows = [(row["city"], row["iso2"].replace("NA", "nan"), row) for row in csv.DictReader(table)]
            return [(f"{city}, {country}", float(row["lat"]), float(row["lng"])) for city, country, row in rows]
    logger.info("cities are those of GeoNames; where bsk_rl is installed, they are those of its table")
    names, angles = city_table()
    return [(name, *place) for name, place in zip(names, np.degrees(angles.numpy()).tolist(), strict=True)]


class CityTargets(UniformTargets):
    """Targets at different cities, drawn in every episode; the table is :func:`city_places`."""

    def __init__(
        self,
        n_targets: int | tuple[int, int],
        n_select_from: int | str | None = None,
        location_offset: float = 0,
        priority_distribution: Callable[[], float] | None = None,
        radius: float = R_EARTH,
    ) -> None:
        """Initialize the scenario; see :class:`UniformTargets`.

        ``n_select_from`` is the number of the most populous cities to draw from, None or ``"all"`` for all; ``location_offset``
        the length of a random shift away from the city, m.
        """
        super().__init__(n_targets, priority_distribution, radius)
        self.n_select_from = sys.maxsize if n_select_from in ("all", None) else int(n_select_from)
        self.location_offset = location_offset

    def regenerate_targets(self) -> None:
        """See :meth:`UniformTargets.regenerate_targets`; ImportError without a table; see :func:`city_places`."""
        places = city_places()
        self.targets = []
        self.n_select_from = min(self.n_select_from, len(places))
        for k in np.random.choice(self.n_select_from, self.n_targets, replace=False):
            name, latitude, longitude = places[k]
            shift = np.random.normal(size=3)
            shift *= self.location_offset / np.linalg.norm(shift)
            r_LP_P = lla2ecef(latitude, longitude, self.radius) + shift
            r_LP_P *= self.radius / np.linalg.norm(r_LP_P)
            self.targets.append(Target(name=name.replace("'", ""), r_LP_P=r_LP_P, priority=self.priority_distribution()))
