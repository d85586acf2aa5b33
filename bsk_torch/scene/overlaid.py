"""Targets of another scenario with more drawn values: clouds, errors of their places, or strips around them."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.rand import Key, Uniform
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.scene.draws import Numbers, calls_user, check_numbers, draw_numbers, horizontal
from bsk_torch.scene.targets import TargetScenario
from bsk_torch.sim.orbit.arcs import FARTHEST
from bsk_torch.sim.places import Places, PlaceTables
from bsk_torch.sim.state import FINITE


class OverlaidTargets(TargetScenario):
    """Base class of scenarios that add values to the targets of another one; subclasses extend ``draw`` and ``_bounds``."""

    targets: TargetScenario

    def __init__(self, targets: TargetScenario) -> None:
        """Take positions and priorities from ``targets``; ValueError for another scenario, or one that adds the same values."""
        if not isinstance(targets, TargetScenario):
            raise ValueError(f"targets={targets!r} must be a scenario of point targets, such as scene.UniformTargets(300)")
        within: TargetScenario | None = targets
        while isinstance(within, OverlaidTargets):
            if isinstance(within, type(self)) or isinstance(self, type(within)):
                raise ValueError(
                    f"targets={targets!r} has a {type(within).__name__} already, whose values {type(self).__name__} would replace"
                )
            within = within.targets
        self.targets, self.most_targets, self.vertical = targets, targets.most_targets, targets.vertical

    @property
    @override
    def calls_user(self) -> bool:
        return self.targets.calls_user

    @property
    @override
    def varies_population(self) -> bool:
        return self.targets.varies_population

    @override
    def present(self, key: Key, names: Sequence[str]) -> Tensor:
        return self.targets.present(key, names)

    @property
    @override
    def target_names(self) -> list[str]:
        return self.targets.target_names

    @override
    def names(self, row: int) -> list[str]:
        return self.targets.names(row)

    def place_kinds(self, tables: PlaceTables) -> Mapping[str, Places]:
        """See :meth:`Scenario.place_kinds`; the places of the other scenario."""
        return self.targets.place_kinds(tables)

    def draw(self, key: Key) -> dict[str, Tensor]:
        """See :class:`TargetScenario`; the values of the other scenario."""
        return self.targets.draw(key)

    @override
    def redraw(self, rows: Tensor, key: Key, time: Tensor) -> dict[str, Tensor]:
        return self.targets.redraw(rows, key, time)

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        return self.targets._bounds()

    @override
    def link(self, fleet: SatelliteFleet) -> None:
        self.targets = copy.copy(self.targets)  # environments that share this scenario each link their own
        self.targets.link(fleet)
        super().link(fleet)

    @property
    @override
    def priority(self) -> Tensor:
        return self.targets.priority

    @property
    @override
    def available(self) -> Tensor:
        return self.targets.available

    @override
    def reset(self, rows: Tensor) -> None:
        super().reset(rows)
        self.targets.reset(rows)

    @override
    def after_step(self, sim_time: Tensor) -> None:
        super().after_step(sim_time)
        self.targets.after_step(sim_time)

    @override
    def _forget_draws(self, rows: Tensor) -> None:
        super()._forget_draws(rows)
        self.targets._forget_draws(rows)

    @override
    def _forget_time(self) -> None:
        super()._forget_time()
        self.targets._forget_time()

    @override
    def _keep_time(self) -> None:
        super()._keep_time()
        self.targets._keep_time()


LARGEST_ERROR = 1e5
"""Largest standard deviation of an error, m."""


class UncertainTargets(OverlaidTargets):
    """Targets of another scenario that lie near the places where they are believed to be.

    Satellites point at the believed places, of which they compute windows. The true place lies at the same distance from the
    Earth's center, farther along the surface by two independent normal errors in perpendicular directions, each with the standard
    deviation ``sigma``. It is drawn once for an episode. :class:`bsk_torch.data.FootprintImageReward` pays for images that show
    it.
    """

    def __init__(self, targets: TargetScenario, sigma: Numbers = 3000.0) -> None:
        """Displace ``targets`` by ``sigma``, m, up to 100,000, in each of two directions, drawn as in :class:`UniformTargets`."""
        super().__init__(targets)
        check_numbers("sigma", sigma, self.most_targets, low=0.0, high=LARGEST_ERROR, unit="m")
        self.sigma = sigma

    @property
    @override
    def calls_user(self) -> bool:
        return super().calls_user or calls_user(self.sigma)

    def draw(self, key: Key) -> dict[str, Tensor]:
        """See :class:`TargetScenario`; adds ``location_sigma`` [n or 1, T] m and ``true_r_LP_P`` [n, T, 3] m."""
        drawn, t = super().draw(key), self.most_targets
        sigma = draw_numbers("sigma", self.sigma, key.named("location_sigma"), t, low=0.0, high=LARGEST_ERROR, unit="m")
        error = sigma.unsqueeze(-1) * key.named("location_error").normal(2 * t).view(-1, t, 2)
        return drawn | {"location_sigma": sigma, "true_r_LP_P": displaced(drawn["target_r_LP_P"], error)}

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        return super()._bounds() | {"location_sigma": (0.0, LARGEST_ERROR), "true_r_LP_P": (-FARTHEST, FARTHEST)}

    @property
    def location_sigma(self) -> Tensor:
        """Standard deviation of the error of each place in each of two directions, [N, T] m."""
        return self.drawn("location_sigma")

    @property
    def true_r_LP_P(self) -> Tensor:
        """True Earth-fixed positions, [N, T, 3] m; for rewards, not for observations."""
        return self.drawn("true_r_LP_P")


def displaced(r: Tensor, error: Tensor) -> Tensor:
    """Return places ``r`` [..., 3] m, moved by ``error`` [..., 2] m along great circles in two perpendicular directions."""
    one, other = horizontal(r)
    along = error[..., :1] * one + error[..., 1:] * other
    angle = error.norm(dim=-1, keepdim=True) / r.norm(dim=-1, keepdim=True)
    return r * angle.cos() + along * torch.sinc(angle / torch.pi)


CANDIDATES = 64
"""Covers from which one is chosen when clouds are drawn again."""


class CloudyTargets(OverlaidTargets):
    """Targets of another scenario, each with a hidden true cloud cover and a forecast of it.

    The outcome of an image is not random: the rewarder compares the true cover with a threshold. The defaults are those of
    BSK-RL's cloud examples::

        cover    = min(x, 1),  x uniform in [0, 1.348)          (mean of x: 0.674, the Earth's average; 26 % of covers are 1)
        forecast = clamp(cover + sigma n, 0, 1),  n standard normal,  sigma uniform in [0.01, 0.05)
    """

    def __init__(
        self,
        targets: TargetScenario,
        cover: Numbers = Uniform(0.0, 1.348),  # noqa: B008  frozen
        forecast_sigma: Numbers = Uniform(0.01, 0.05),  # noqa: B008
        largest_forecast: float | None = None,
    ) -> None:
        """ValueError for a wrong argument. Numbers are drawn for each target in each episode; see :class:`UniformTargets`.

        Args:
            targets: Scenario that draws positions and priorities of the targets.
            cover: True fraction of the sky covered by clouds over a target, clamped to [0, 1].
            forecast_sigma: Standard deviation of the forecast.
            largest_forecast: Targets with a higher forecast cannot be selected; None for no limit.
        """
        super().__init__(targets)
        check_numbers("cover", cover, self.most_targets)
        check_numbers("forecast_sigma", forecast_sigma, self.most_targets, low=0.0)
        if largest_forecast is not None and not 0.0 <= number("largest_forecast", largest_forecast) <= 1.0:
            raise ValueError(f"largest_forecast={largest_forecast!r} must lie in [0, 1], or be None for no limit")
        self.cover, self.forecast_sigma, self.largest_forecast = cover, forecast_sigma, largest_forecast

    @property
    @override
    def calls_user(self) -> bool:
        return super().calls_user or calls_user(self.cover, self.forecast_sigma)

    def draw(self, key: Key) -> dict[str, Tensor]:
        """See :class:`TargetScenario`; adds ``cloud_cover``, ``cloud_forecast`` and ``cloud_forecast_sigma``, [n, T]."""
        t = self.most_targets
        cover = draw_numbers("cover", self.cover, key.named("cloud_cover"), t).clamp(0.0, 1.0)
        sigma = draw_numbers("forecast_sigma", self.forecast_sigma, key.named("cloud_forecast_sigma"), t, low=0.0)
        forecast = (cover + sigma * key.named("cloud_forecast").normal(t)).clamp(0.0, 1.0)
        clouds = {"cloud_cover": cover, "cloud_forecast": forecast, "cloud_forecast_sigma": sigma}
        return super().draw(key) | clouds

    def redraw(self, rows: Tensor, key: Key, time: Tensor) -> dict[str, Tensor]:
        """See :meth:`Scenario.redraw`; draws the true cover over all targets again, given its forecast.

        One of :data:`CANDIDATES` covers is chosen with a probability proportional to the likelihood of the forecast
        (sampling-importance resampling, Rubin 1987). Forecasts of 0 and 1 are clamped, so their likelihood is that of all values
        beyond.
        """
        forecast, sigma = self.cloud_forecast[rows], self.cloud_forecast_sigma[rows].clamp(min=1e-6)
        best = torch.full_like(forecast, -torch.inf)
        clouds = forecast
        for k in range(CANDIDATES):  # in a loop, because all at once would need so many times the memory
            cover = draw_numbers("cover", self.cover, key.named(f"redrawn cover {k}"), self.most_targets)
            cover = cover.clamp(0.0, 1.0).to(forecast.device)
            z = (forecast - cover) / sigma
            below, above = torch.special.log_ndtr(z), torch.special.log_ndtr(-z)
            weight = torch.where(forecast <= 0.0, below, torch.where(forecast >= 1.0, above, -0.5 * z.square() - sigma.log()))
            lot = key.named(f"redrawn lot {k}").uniform(forecast.shape[1]).to(forecast.device)
            weight = weight - torch.log(-torch.log(lot.clamp(1e-300, 1.0 - 1e-16)))  # Gumbel: the largest is a draw by weights
            clouds, best = torch.where(weight > best, cover, clouds), torch.maximum(weight, best)
        return super().redraw(rows, key, time) | {"cloud_cover": clouds}

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        share = (0.0, 1.0)
        clouds = {"cloud_cover": share, "cloud_forecast": share, "cloud_forecast_sigma": (0.0, FINITE)}
        return super()._bounds() | clouds

    @property
    def cloud_cover(self) -> Tensor:
        """True cover, [N, T] in [0, 1]; for rewards, not for observations."""
        return self.drawn("cloud_cover")

    @property
    def cloud_forecast(self) -> Tensor:
        """Forecast cover, [N, T] in [0, 1]."""
        return self.drawn("cloud_forecast")

    @property
    def cloud_forecast_sigma(self) -> Tensor:
        """Standard deviation of the forecast, [N, T]."""
        return self.drawn("cloud_forecast_sigma")

    @property
    @override
    def available(self) -> Tensor:
        targets = super().available
        if self.largest_forecast is None:
            return targets
        if self._available is None or self._under is not targets:
            self._under, self._available = targets, targets & (self.cloud_forecast <= self.largest_forecast)
        return self._available

    _under: Tensor | None = None


SHORTEST, LONGEST = 1.0, 1e7
"""Bounds of the length of a strip, m; the longest one is a quarter of the Earth's circumference."""


class StripTargets(OverlaidTargets):
    """Strips along great circles, whose middles are the targets of another scenario and whose directions are uniform.

    An instrument records a strip at a constant speed, from its start to its end; see :class:`bsk_torch.act.ImageStrip` and
    :class:`bsk_torch.data.StripImageReward`. Windows are those of the middle.
    """

    def __init__(
        self,
        targets: TargetScenario,
        length: Numbers = Uniform(50e3, 300e3),  # noqa: B008  frozen
        acquisition_speed: float = 3000.0,
    ) -> None:
        """ValueError for a wrong argument. Numbers are drawn for each target in each episode; see :class:`UniformTargets`.

        Args:
            targets: Scenario that draws middles and priorities of the strips.
            length: Length of each strip, m, from 1 to 10,000,000.
            acquisition_speed: Speed at which strips are recorded, m/s.
        """
        super().__init__(targets)
        check_numbers("length", length, self.most_targets, low=SHORTEST, high=LONGEST, unit="m")
        self.length, self.acquisition_speed = length, number("acquisition_speed", acquisition_speed, 0.0, unit="m/s", above=True)

    @property
    @override
    def calls_user(self) -> bool:
        return super().calls_user or calls_user(self.length)

    def draw(self, key: Key) -> dict[str, Tensor]:
        """See :class:`TargetScenario`; adds ``strip_length`` [n or 1, T] m and ``strip_along`` [n, T, 3] m."""
        drawn, t = super().draw(key), self.most_targets
        middle = drawn["target_r_LP_P"]
        length = draw_numbers("length", self.length, key.named("strip_length"), t, low=SHORTEST, high=LONGEST, unit="m")
        azimuth = 2.0 * math.pi * key.named("strip_azimuth").uniform(t).unsqueeze(-1)
        one, other = horizontal(middle)
        along = (azimuth.cos() * one + azimuth.sin() * other) * middle.norm(dim=-1, keepdim=True)
        return drawn | {"strip_length": length, "strip_along": along}

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        return super()._bounds() | {"strip_length": (SHORTEST, LONGEST), "strip_along": (-FARTHEST, FARTHEST)}

    @property
    def strip_length(self) -> Tensor:
        """Length of each strip, [N, T] m."""
        return self.drawn("strip_length")

    @property
    def strip_along(self) -> Tensor:
        """Direction of each strip in its middle, as long as the position of the middle, [N, T, 3] m, Earth-fixed."""
        return self.drawn("strip_along")

    @property
    def strip_seconds(self) -> Tensor:
        """Time in which each strip is recorded, [N, T] s."""
        return self.strip_length / self.acquisition_speed

    def ends(self) -> tuple[Tensor, Tensor]:
        """Return starts and ends of all strips, [N, T, 3] m each, Earth-fixed."""
        half = (0.5 * self.strip_length / self.r_LP_P.norm(dim=-1)).unsqueeze(-1)
        across, along = self.r_LP_P * torch.cos(half), self.strip_along * torch.sin(half)
        return across - along, across + along
