"""The rule for clusters of satellites with different instruments, which share out targets by clouds and claims."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.rules.imaging import LEVEL, OPENS, URGENCY, ImagingRule, by_tour, tours
from bsk_torch.rl.rules.observation_columns import Columns
from bsk_torch.rl.rules.targets import Observation, read


@dataclass(frozen=True)
class Sharing:
    """Numbers of the rule.

    Args:
        cloudy: Forecast of the cloud cover at which half of the optical images are useful.
        spread: Standard deviation of the forecast.
        discount: Part of the value of a clear target that satellites which see through clouds leave to the others.
        charge: Value of charging with an empty battery in sunlight, in priorities; it falls to zero with a full battery.
        slew: Time for a turn of one radian, s; it grows with the square root of the angle.
        full: Store above which a pass is used for downlink, as a fraction of the capacity.
    """

    cloudy: float = 0.7
    spread: float = 0.03
    discount: float = 0.5
    charge: float = 0.3
    slew: float = 46.0
    full: float = 0.5


RADAR = Sharing(slew=95.0)
"""The same for a radar, which is on a larger spacecraft. Both times are those of nearly all turns to targets in view."""


@dataclass(frozen=True)
class CooperativeRule(ImagingRule):
    """Tours of *farsighted* over targets that other satellites have not claimed, valued by what their images are worth here.

    Optical satellites multiply priorities by the probability of a clear image. Satellites that see through clouds reduce those
    of clear targets, which the optical ones can take. Charging competes with images; where nothing can be imaged, satellites
    charge.
    """

    sees_through: bool = False
    numbers: Sharing = Sharing()

    @classmethod
    def in_cluster(cls, env: SatelliteTasking) -> CooperativeRule:
        """Return the rule for an environment, with numbers that suit the instrument.

        ValueError or KeyError without targets or the required observations.
        """
        plain, sees_through = ImagingRule.of(env, by_tour), getattr(env.satellite, "sees_through_clouds", False)
        numbers = RADAR if sees_through else Sharing()
        return cls(plain.see, plain.images, by_tour, plain.description, plain.actions, sees_through, numbers)

    def worths(self, observation: Observation, action_mask: Tensor) -> Tensor:
        """Return what each action is worth, [N, A]; charging has a value between zero and that of an image."""
        columns, numbers = Columns(observation, self.description), self.numbers
        start, end = columns.all("eclipse").unbind(-1)
        charge = numbers.charge * (1.0 - columns["battery_charge_fraction"]) * (start <= end)
        level, opens = (read(observation, self.description, path) for path in (LEVEL, OPENS))
        worths = torch.full(action_mask.shape, -URGENCY, dtype=charge.dtype, device=charge.device)
        worths[:, self.actions.index("action_charge")] = charge
        worths[:, self.actions.index("action_downlink")] = torch.where((level > numbers.full) & (opens <= 0.0), URGENCY, -URGENCY)
        images = torch.where(self.see.exist(observation), self._tours(observation), -URGENCY)
        worths[:, self.images.start : self.images.stop] = images
        return worths.masked_fill(~action_mask, -torch.inf)

    def _tours(self, observation: Observation) -> Tensor:
        """Return the values of tours that start with each target, [N, n]."""
        priority, forecast, claims = (self.see.read(observation, name) for name in ("priority", "cloud_forecast", "claimed"))
        clear = torch.special.ndtr((self.numbers.cloudy - forecast) / self.numbers.spread)
        useful = 1.0 - self.numbers.discount * clear if self.sees_through else clear
        return tours(self.see, observation, priority * useful * (claims <= 0.0), self.numbers.slew)
