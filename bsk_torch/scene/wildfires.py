"""Wildfires: targets that appear, grow and disappear."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.constants import R_EARTH
from bsk_torch.rand import Key, Uniform
from bsk_torch.scene.draws import Count, Numbers, calls_user, check_numbers, count_range, draw_numbers, on_sphere
from bsk_torch.scene.targets import ChangingTargets
from bsk_torch.scene.uniform import UniformTargets
from bsk_torch.sim.state import FINITE

Region = tuple[float, float, float, float]
"""Southern, northern, western and eastern edges, degrees; west is larger than east if the region crosses 180 degrees."""

WORLD: Region = (-90.0, 90.0, -180.0, 180.0)

FIRE_BOUNDS: dict[str, dict[str, Any]] = {
    "ignition": {"unit": "s"},
    "rate_of_spread": {"low": 0.0, "unit": "m/s"},
    "burning_time": {"low": 0.0, "unit": "s"},
}


ATTEMPTS = 64
"""Draws of a fire to come, of which the first that comes after the current time is taken."""


class Wildfires(ChangingTargets, UniformTargets):
    """Fires that break out at random places and times, gain priority as they grow, and disappear when they have burnt out.

    A fire spreads as an ellipse whose axes grow linearly (Van Wagner, "A simple fire-growth model", Forestry Chronicle 45, 1969),
    from one of its foci (Alexander, "Estimating the length-to-breadth ratio of elliptical forest fire patterns", 1985): with the
    rate of spread v at its head, the length-to-breadth ratio L and the eccentricity e = sqrt(1 - 1 / L^2), after t seconds

        a = v t / (1 + e)        area = pi a^2 / L        priority = weight * min(area / full_area, 1)
    """

    def __init__(
        self,
        n_fires: Count,
        priority_distribution: Numbers = 1.0,
        *,
        ignition: Numbers = Uniform(0.0, 17100.0),  # noqa: B008  frozen
        rate_of_spread: Numbers = Uniform(0.2, 1.0),  # noqa: B008
        burning_time: Numbers = Uniform(5400.0, 21600.0),  # noqa: B008
        length_to_breadth: float = 2.0,
        full_area: float = 1e7,
        regions: Sequence[Region] | None = None,
        radius: float = R_EARTH,
    ) -> None:
        """ValueError for a wrong argument. Numbers are drawn for each fire in each episode; see :class:`UniformTargets`.

        Args:
            n_fires: Number of fires in an episode, or a range with an exclusive end.
            priority_distribution: Weight: priority of a fire of ``full_area``.
            ignition: Time at which a fire breaks out, s since reset; negative for fires already burning at the reset.
            rate_of_spread: Speed of the head of a fire, m/s.
            burning_time: Time from the outbreak of a fire to its end, s.
            length_to_breadth: Ratio of the axes of the burnt area, at least 1.
            full_area: Burnt area above which the priority is constant, m^2.
            regions: Regions in which fires break out, uniformly by area: (south, north, west, east) in degrees each; None for
                the whole Earth.
            radius: Distance of the fires from the Earth's center, m.
        """
        count_range("n_fires", n_fires)
        super().__init__(n_fires, priority_distribution, radius)
        self.fire_args = {"ignition": ignition, "rate_of_spread": rate_of_spread, "burning_time": burning_time}
        for name, value in self.fire_args.items():
            check_numbers(name, value, self.most_targets, **FIRE_BOUNDS[name])
        self.length_to_breadth = number("length_to_breadth", length_to_breadth, 1.0, 1e6)
        self.full_area = number("full_area", full_area, 1e-6, 1e18, unit="m^2")
        self.regions = _region_table([WORLD] if regions is None else regions)

    @property
    @override
    def calls_user(self) -> bool:
        return super().calls_user or calls_user(*self.fire_args.values())

    def draw(self, key: Key) -> dict[str, Tensor]:
        """See :class:`TargetScenario`; adds ``fire_ignition``, ``fire_rate_of_spread`` and ``fire_burning_time``, [n or 1, T]."""
        values = super().draw(key)
        for name, value in self.fire_args.items():
            values[f"fire_{name}"] = draw_numbers(name, value, key.named(f"fire_{name}"), self.most_targets, **FIRE_BOUNDS[name])
        return values

    def redraw(self, rows: Tensor, key: Key, time: Tensor) -> dict[str, Tensor]:
        """See :meth:`Scenario.redraw`; fires to come break out at other times after ``time``, spread and burn otherwise.

        Of :data:`ATTEMPTS` times of ignition, the first one to come is taken; fires for which there is none keep theirs.
        """
        ignition = self.drawn("fire_ignition")[rows]
        now = time.unsqueeze(-1)
        waits = ignition > now
        values = {f"fire_{name}": self.drawn(f"fire_{name}")[rows].clone() for name in self.fire_args}
        for k in range(ATTEMPTS):
            if not bool(waits.any()):
                break
            new = {
                f"fire_{name}": draw_numbers(
                    name, value, key.named(f"fire_{name} again {k}"), self.most_targets, **FIRE_BOUNDS[name]
                ).to(ignition.device)
                for name, value in self.fire_args.items()
            }
            taken = waits & (new["fire_ignition"] > now)
            values = {name: torch.where(taken, new[name], old) for name, old in values.items()}
            waits = waits & ~taken
        return super().redraw(rows, key, time) | values

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        fires = {f"fire_{name}": (given.get("low", -FINITE), FINITE) for name, given in FIRE_BOUNDS.items()}
        return super()._bounds() | fires

    @override
    def places(self, key: Key) -> dict[str, Tensor]:
        u = key.named("target_r_LP_P").uniform(3 * self.most_targets).view(len(key), -1, 3)
        share, low, high, west, width = self.regions
        region = torch.searchsorted(share.cumsum(0)[:-1] / share.sum(), u[..., 2].contiguous(), right=True)
        place = on_sphere(u[..., :2], west[region], width[region], (low[region], high[region]))
        return {"target_r_LP_P": self.radius * place}

    def burnt_area(self, time: Tensor) -> Tensor:
        """Return the burnt area of each fire at ``time`` [N] s since reset, [N, T] m^2, by the formula of the class."""
        age = time.unsqueeze(-1) - self.drawn("fire_ignition")
        age = torch.minimum(age.clamp(min=0.0), self.drawn("fire_burning_time"))
        eccentricity = math.sqrt(1.0 - self.length_to_breadth**-2)
        a = self.drawn("fire_rate_of_spread") * age / (1.0 + eccentricity)
        return math.pi * a**2 / self.length_to_breadth

    @override
    def at(self, time: Tensor) -> tuple[Tensor, Tensor]:
        age = time.unsqueeze(-1) - self.drawn("fire_ignition")
        burning = (age >= 0.0) & (age < self.drawn("fire_burning_time"))
        grown = torch.clamp(self.burnt_area(time) / self.full_area, max=1.0)
        return self.drawn("target_priority") * grown * burning, burning


def _region_table(regions: Sequence[Region]) -> Tensor:
    """Return the relative area, sines of southern and northern latitude, western edge and width (rad) of each region, [5, R]."""
    rows = []
    if isinstance(regions, str) or not isinstance(regions, Sequence):
        raise ValueError(f"regions={regions!r} must be a list of (south, north, west, east), or None for everywhere")
    for k, region in enumerate(regions):
        numbers = isinstance(region, Sequence) and len(region) == 4 and all(isinstance(edge, int | float) for edge in region)
        south, north, west, east = region if numbers else (math.nan,) * 4
        width = east - west if east > west else east - west + 360.0
        if not (-90.0 <= south < north <= 90.0 and -180.0 <= west <= 180.0 and -180.0 <= east <= 180.0 and west != east):
            raise ValueError(
                f"regions[{k}]={region!r} must be (south, north, west, east) in degrees, with latitudes in [-90, 90], south "
                "below north, and different longitudes in [-180, 180]"
            )
        low, high = (math.sin(math.radians(x)) for x in (south, north))
        rows.append(((high - low) * width, low, high, math.radians(west), math.radians(width)))
    if not rows:
        raise ValueError("regions is empty; give at least one (south, north, west, east), or None for everywhere")
    return torch.tensor(rows, dtype=torch.float64).mT
