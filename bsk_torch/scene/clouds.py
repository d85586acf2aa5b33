"""Targets under clouds, with an observable forecast of the cloud cover."""

from __future__ import annotations

from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.rand import Key, Uniform
from bsk_torch.scene.draws import Numbers, calls_user, check_numbers, draw_numbers
from bsk_torch.scene.overlaid import OverlaidTargets
from bsk_torch.scene.targets import TargetScenario
from bsk_torch.sim.state import FINITE


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
