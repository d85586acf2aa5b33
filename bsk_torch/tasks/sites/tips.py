"""Tip and cue: a wide look at a site shows its active spots, and narrow looks confirm them."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.constants import R_EARTH
from bsk_torch.rand import Key
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.scene.base import Scenario
from bsk_torch.scene.draws import on_sphere
from bsk_torch.scene.overlaid import displaced
from bsk_torch.tasks.sites.reward import CompletionReward
from bsk_torch.tasks.sites.scene import BEGUN, NOT_BEGUN, Sites

WIDE = 0
"""Number of the wide look among the images of a site; the others are its spots."""


class Tips(Sites):
    """Sites of five spots, of which a wide look at the middle shows the active ones; narrow looks confirm these in time.

    The images of a site are the wide look, and narrow looks at the spots, which are uniform within ``spread`` east, west, north
    and south of the middle. Each spot is active with a probability of its site, ``0.1 + 0.8 u^2`` with uniform u, which is
    known. Which spots are active shows itself in the wide look; only then, they can be looked at. A site of value v with n active
    spots, m of which are confirmed, has paid ``v n gain(m / n)``; wide looks pay nothing. Values are ``0.2 + 0.8 u^2``.

    In the terms of :class:`Sites`: an image is clear if it is a narrow look at an active spot, and its risk is the probability
    that the spot is not active.
    """

    def __init__(
        self, n_sites: int, *, spread: float = 150e3, latitude: float = 9.0, gain: str = "complete", within: float = 240.0
    ) -> None:
        """ValueError for a wrong argument.

        Args:
            n_sites: Number of sites J. There are T = 6 J targets.
            spread: Largest distance of spots from the middle, in each of two directions, m.
            latitude: Largest latitude of sites, north and south, degrees; they are uniform by area between.
            gain: See :class:`Sites`.
            within: Time after the wide look in which spots can be confirmed, s.
        """
        super().__init__(n_sites, latitude=latitude, gain=gain, within=within)
        self.spread = number("spread", spread, 0.0, 1e6, unit="m", above=True)
        self.least = 1

    @override
    def draw(self, key: Key) -> dict[str, Tensor]:
        n, each = self.n_sites, self.most
        u = key.named("site").uniform(4 * n).view(len(key), n, 4)
        sine = math.sin(math.radians(self.latitude))
        middle = R_EARTH * on_sphere(u[..., :2], span=(-sine, sine))
        offset = self.spread * (2.0 * key.named("spot").uniform(2 * each * n).view(len(key), n, each, 2) - 1.0)
        offset[:, :, WIDE] = 0.0
        risk = (0.9 - 0.8 * u[..., 3] ** 2).repeat_interleave(each, 1)
        return {
            "target_r_LP_P": displaced(middle.unsqueeze(2), offset).flatten(1, 2),
            "target_priority": (0.2 + 0.8 * u[..., 2] ** 2).repeat_interleave(each, 1),
            "target_exists": torch.ones_like(risk),
            "image_risk": risk,
            **self._hidden(key.named("active").uniform(each * n) >= risk),
        }

    def _hidden(self, active: Tensor) -> dict[str, Tensor]:
        """Return the hidden values, of active spots [n, T] bool; sites without any have the size 1, and are never complete."""
        spots = active.double().unflatten(1, (-1, self.most))
        spots[..., WIDE] = 0.0
        return {"image_clear": spots.flatten(1), "site_size": spots.sum(2).clamp(min=1.0)}

    @override
    def redraw(self, rows: Tensor, key: Key, time: Tensor) -> dict[str, Tensor]:
        """See :meth:`Scenario.redraw`; the active spots of sites without a wide look, given their probabilities."""
        risk, shown = self.drawn("image_risk")[rows], self.shown_sites[rows].repeat_interleave(self.most, 1)
        new = key.named("active again").uniform(self.most_targets).to(risk.device) >= risk
        return self._hidden(torch.where(shown, self.drawn("image_clear")[rows] > 0.5, new))

    # -- state --------------------------------------------------------------------------------------------------------

    @property
    def shown_sites(self) -> Tensor:
        """Sites of which a wide look has shown the active spots, [N, J] bool."""
        return self.memory[BEGUN] != NOT_BEGUN

    @property
    @override
    def size(self) -> Tensor:
        """Number of active spots of each site, expected before the wide look, [N, J] float64."""
        expected = (self.most - 1) * (1.0 - self.drawn("image_risk")[:, :: self.most])
        return torch.where(self.shown_sites, self.drawn("site_size"), expected)

    @property
    @override
    def risks(self) -> Tensor:
        """Probability that each spot is not active, 0 or 1 after the wide look, [N, T] float64."""
        shown = self.shown_sites.repeat_interleave(self.most, 1)
        return torch.where(shown, 1.0 - self.drawn("image_clear"), self.drawn("image_risk"))

    @property
    @override
    def free(self) -> Tensor:
        """Wide looks not taken, and active spots that they have shown and that are not confirmed, [N, T] bool."""
        free = (super().free & (self.drawn("image_clear") > 0.5)).unflatten(1, (-1, self.most)) & self.shown_sites.unsqueeze(2)
        free[..., WIDE] = ~self.shown_sites
        return free.flatten(1)

    @property
    @override
    def open(self) -> Tensor:
        """Free images of sites that can still pay: all wide looks, and spots in time, [N, T] bool."""
        return torch.where(self.shown_sites.repeat_interleave(self.most, 1), super().open, self.free)


class ConfirmationReward(CompletionReward):
    """Reward for confirmed spots of :class:`Tips`, by what they add to the completion of their site.

    As :class:`CompletionReward`, and a look at a spot counts only within the scenario's time after the wide look.
    """

    scenario: Tips

    @override
    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        if not isinstance(scenario, Tips):
            raise ValueError(f"ConfirmationReward needs a scenario of spots, Tips; the scenario is {type(scenario).__name__}")
        super().link(scenario, fleet)

    @override
    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        ends = self.scenario.ends.gather(1, target // self.scenario.most)
        return super().value(target, taken & (self.fleet.sim_time.unsqueeze(1) <= ends))

    @override
    def counts(self) -> dict[str, Tensor]:
        return {}  # images that are not clear are the wide looks, which measures count
