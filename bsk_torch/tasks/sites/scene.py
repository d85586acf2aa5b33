"""Sites: mosaics of a few images each, under weather that a forecast tells in part."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number, whole
from bsk_torch.constants import R_EARTH
from bsk_torch.rand import Key
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.scene.base import Memo
from bsk_torch.scene.draws import on_sphere
from bsk_torch.scene.overlaid import displaced
from bsk_torch.scene.targets import TargetScenario
from bsk_torch.sim.names import one_of
from bsk_torch.sim.state import FINITE

COLUMNS = 3
"""Images in a row of a site."""

SHOT, BEGUN = "site_shot", "site_begun"
"""Fields of the state: images that have been taken, clear or not, [N, T] bool; time of the first of each site, s, [N, J]."""

NOT_BEGUN = -1.0
"""Value of :data:`BEGUN` of sites of which no image has been taken."""

GAINS: dict[str, tuple[tuple[float, float], ...]] = {
    "convex": ((0.0, 0.0), (0.4, 0.1), (0.7, 0.4), (1.0, 1.0)),
    "complete": ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)),
}
"""Corners of the paid part of a site by the part of its images that is clear."""


class Sites(TargetScenario):
    """Sites of 3 to 6 images, of which parts pay little or nothing, drawn in every episode; an image is a target.

    The images of a site lie on a grid with three columns, turned at random about its middle. A site of value v with n images,
    m of which are clear, has paid ``v n gain(m / n)``: with the ``"complete"`` gain, nothing before all are clear. The
    ``"convex"`` gain is the piecewise linear one of the ROADEF challenge 2003 (M. Lemaître et al., "Selecting and scheduling
    observations of agile satellites", Aerospace Science and Technology 6, 2002; roadef.org/challenge/2003)::

        gain(0) = 0    gain(0.4) = 0.1    gain(0.7) = 0.4    gain(1) = 1

    Weather: an image is not clear with the probability ``risk`` that its forecast shows. Whether it is shows itself when it has
    been taken; the clouds stay, so that there is no second attempt. With the largest risk r, the risks of a site's images are
    ``r q (1 + u) / 2``, with q the square of a uniform number, one for the site, and u uniform, one for each image.

    Values are skewed: ``0.2 + 0.8 u^2`` with uniform u.
    """

    def __init__(
        self,
        n_sites: int,
        *,
        spacing: float = 100e3,
        latitude: float = 9.0,
        risk: float = 0.4,
        gain: str = "complete",
        within: float = 300.0,
    ) -> None:
        """ValueError for a wrong argument.

        Args:
            n_sites: Number of sites J. There are T = 6 J targets, some of them padding.
            spacing: Distance between neighboring images of a site, m.
            latitude: Largest latitude of sites, north and south, degrees; they are uniform by area between.
            risk: Largest probability that an image is not clear; 0 for no weather.
            gain: One of :data:`GAINS`: ``"complete"`` to pay for complete sites only, or ``"convex"``.
            within: Time after its first image in which a site's further images can be chosen, s.
        """
        self.n_sites = whole("n_sites", n_sites, 1, 100_000)
        self.spacing = number("spacing", spacing, 0.0, 1e6, unit="m", above=True)
        self.latitude = number("latitude", latitude, 0.0, 90.0, unit="degrees", above=True)
        self.risk = number("risk", risk, 0.0, 1.0)
        self.corners = GAINS[one_of("gain", gain, GAINS)]
        self.within = number("within", within, 0.0, unit="s")
        self.least, self.most = 3, 6
        self.most_targets = self.most * self.n_sites

    # -- episodes -----------------------------------------------------------------------------------------------------

    @override
    def draw(self, key: Key) -> dict[str, Tensor]:
        n, each = self.n_sites, self.most
        u = key.named("site").uniform(5 * n).view(len(key), n, 5)
        size = self.least + (u[..., 2] * (each - self.least + 1)).floor()
        exists = (torch.arange(each) < size.unsqueeze(-1)).double().flatten(1)
        sine = math.sin(math.radians(self.latitude))
        middle = R_EARTH * on_sphere(u[..., :2], span=(-sine, sine))
        value = 0.2 + 0.8 * u[..., 3] ** 2
        turn = key.named("site_turn").uniform(n) * 2.0 * math.pi
        weather = key.named("image").uniform(2 * each * n).view(len(key), n, each, 2)
        risk = self.risk * (u[..., 4:] ** 2 * 0.5 * (1.0 + weather[..., 0])).flatten(1)
        return {
            "target_r_LP_P": self._grid(middle, turn).flatten(1, 2),
            "target_priority": value.repeat_interleave(each, 1) * exists,
            "target_exists": exists,
            "site_size": size,
            "image_risk": risk,
            "image_clear": (weather[..., 1].flatten(1) >= risk).double(),
        }

    def _grid(self, middle: Tensor, turn: Tensor) -> Tensor:
        """Return the places of images, [n, J, 6, 3] m, of sites with ``middle`` [n, J, 3] m, by the ``turn`` of grids, [n, J]."""
        k = torch.arange(self.most, dtype=torch.float64)
        x, y = self.spacing * (k % COLUMNS - 1.0), self.spacing * ((k / COLUMNS).floor() - 0.5)
        cos, sin = turn.cos().unsqueeze(-1), turn.sin().unsqueeze(-1)
        return displaced(middle.unsqueeze(2), torch.stack([cos * x - sin * y, sin * x + cos * y], -1))

    @override
    def redraw(self, rows: Tensor, key: Key, time: Tensor) -> dict[str, Tensor]:
        """See :meth:`Scenario.redraw`; the weather over images that have not been taken, given its forecast."""
        risk = self.drawn("image_risk")[rows]
        new = (key.named("image_clear again").uniform(self.most_targets).to(risk.device) >= risk).double()
        return {"image_clear": torch.where(self.shot[rows], self.drawn("image_clear")[rows], new)}

    @override
    def _bounds(self) -> dict[str, tuple[float, float]]:
        own = {"site_size": (self.least, self.most), "image_risk": (0.0, 1.0), "image_clear": (0.0, 1.0)}
        return super()._bounds() | own

    @override
    def link(self, fleet: SatelliteFleet) -> None:
        super().link(fleet)
        self.memory.declare(SHOT, 0, self.most_targets, dtype=torch.bool)
        self.memory.declare(BEGUN, NOT_BEGUN, self.n_sites, low=NOT_BEGUN, high=FINITE)
        self.memo = Memo()

    # -- state --------------------------------------------------------------------------------------------------------

    def gain(self, part: Tensor) -> Tensor:
        """Return what sites have paid, as a part of their value, of which a ``part`` from 0 to 1 of the images is clear."""
        paid = torch.zeros_like(part)
        for (x, low), (end, high) in zip(self.corners[:-1], self.corners[1:], strict=True):
            rise = (part - x) / (end - x) if end > x else (part >= end - 1e-9).to(part.dtype)
            paid = paid + (high - low) * rise.clamp(0.0, 1.0)
        return paid

    @property
    def size(self) -> Tensor:
        """Number of images of each site, as far as it is known, [N, J] float64."""
        return self.drawn("site_size")

    @property
    def risks(self) -> Tensor:
        """Probability that each image is not clear, as far as it is known, [N, T] float64."""
        return self.drawn("image_risk")

    @property
    def ends(self) -> Tensor:
        """Time after which images of each site cannot be chosen, s, [N, J] float64; infinity before the first one."""
        begun = self.memory[BEGUN]
        return torch.where(begun == NOT_BEGUN, torch.inf, begun + self.within)

    @property
    def shot(self) -> Tensor:
        """Images that have been taken, clear or not, [N, T] bool."""
        return self.memory[SHOT]

    @property
    def done(self) -> Tensor:
        """Number of clear images taken of each site, [N, J] float64."""
        return (self.shot * self.drawn("image_clear")).unflatten(1, (-1, self.most)).sum(2)

    @property
    def free(self) -> Tensor:
        """Images not taken, [N, T] bool."""
        return self.available & ~self.shot

    @property
    def open(self) -> Tensor:
        """Images that can be chosen: those not taken, of sites that are not over and can still pay, [N, T] bool."""
        free, size, done = self.free, self.size, self.done
        left = free.unflatten(1, (-1, self.most)).sum(2)
        pays = self.gain((done + left) / size) > self.gain(done / size)
        late = self.fleet.sim_time.unsqueeze(1) > self.ends
        return free & (pays & ~late).repeat_interleave(self.most, 1)
