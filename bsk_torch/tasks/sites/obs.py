"""Properties of the next images that their sites give them."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.frames import sin_elevation
from bsk_torch.sats.bound_access import BoundAccessSatellite
from bsk_torch.sats.opportunities import Opportunities
from bsk_torch.tasks.sites.scene import BEGUN, NOT_BEGUN, Sites
from bsk_torch.vec3 import Vec3

BITS = 8
"""Numbers of the code of a site."""


class Prospects(NamedTuple):
    """What is known of the sites of n images, [N, n] each.

    Attributes:
        size: Number of images of the site.
        done: Clear images taken.
        left: Images that can still be taken, including this one.
        ago: Time since the first image, s; 0 before.
        risk: Probability that the image is not clear.
        chance: Probability that all images that are left are clear.
        step: What the image pays if it is clear and the next one of its site.
        finish: What the images that are left pay if all are clear.
    """

    size: Tensor
    done: Tensor
    left: Tensor
    ago: Tensor
    risk: Tensor
    chance: Tensor
    step: Tensor
    finish: Tensor


def prospects(satellite: BoundAccessSatellite, images: Opportunities) -> Prospects:
    """Return what is known of the sites of the observed images, computed once for a state.

    Images of a site are left if they have not been taken and the satellite has not left them behind. In a constellation, those
    behind this satellite may still come into view of another one.
    """
    scenario: Sites = satellite.scenario
    key: Hashable = ("prospects", satellite.type_index)
    draws = satellite.fleet.scenario_state.version
    return scenario._memo.once(key, satellite.fleet, lambda: _prospects(satellite, scenario, images.place), (draws,))


def _prospects(satellite: BoundAccessSatellite, scenario: Sites, image: Tensor) -> Prospects:
    look_up, of_env = satellite.simulator.look_up, satellite.simulator.of_env
    site = image // scenario.most
    others = site.unsqueeze(-1) * scenario.most + torch.arange(scenario.most, device=image.device)

    def of_others(table: Tensor) -> Tensor:
        return look_up(table, others.flatten(1)).view_as(others)

    place = look_up(scenario.r_LP_P, others.flatten(1)).view(*others.shape, 3)
    r, v = (Vec3.of(value[:, None, None]) for value in (satellite.dynamics.r_BN_P, satellite.dynamics.v_BN_P))
    line = Vec3.of(place) - r
    least = torch.sin(satellite.simulator.state.argument("imageTargetMinimumElevation"))
    behind = (line.dot(v) < 0.0) & (sin_elevation(r, Vec3.of(place)) < least.reshape(-1, 1, 1))
    free = of_others(scenario.available & ~scenario.shot) & ~behind
    risk = of_others(scenario.drawn("image_risk"))
    size, done = look_up(scenario.drawn("site_size"), site), look_up(scenario.done, site)
    begun = look_up(scenario.memory[BEGUN], site)
    left = free.sum(-1)
    paid = scenario.gain(done / size)
    whole = look_up(scenario.priority, image) * size
    now = of_env(satellite.fleet.sim_time).unsqueeze(-1)
    return Prospects(
        size=size,
        done=done,
        left=left.double(),
        ago=torch.where(begun == NOT_BEGUN, 0.0, now - begun),
        risk=look_up(scenario.drawn("image_risk"), image),
        chance=torch.where(free, 1.0 - risk, 1.0).prod(-1),
        step=whole * (scenario.gain((done + 1.0) / size) - paid),
        finish=whole * (scenario.gain((done + left) / size) - paid),
    )


def _prospect(name: str) -> Callable[[BoundAccessSatellite, Opportunities], Tensor]:
    def read(satellite: BoundAccessSatellite, images: Opportunities) -> Tensor:
        return getattr(prospects(satellite, images), name)

    return read


def site_code(satellite: BoundAccessSatellite, images: Opportunities) -> Tensor:
    """Return the number of each image's site as a code, [N, n, 8] of -1 and 1, so that networks can compare sites.

    The bits are those of the number multiplied by an odd constant (Knuth, The art of computer programming 3, section 6.4): codes of
    different sites differ in half of the bits on average.
    """
    scenario: Sites = satellite.scenario
    hashed = (images.place // scenario.most + 1) * 2654435761
    bits = torch.arange(32 - BITS, 32, device=hashed.device)
    return ((hashed.unsqueeze(-1) >> bits) & 1).double() * 2.0 - 1.0


SITE = (
    dict(fn=_prospect("size"), prop="site_size", norm=6.0),
    dict(fn=_prospect("done"), prop="site_done", norm=6.0),
    dict(fn=_prospect("left"), prop="site_left", norm=6.0),
    dict(fn=_prospect("ago"), prop="site_ago", norm=300.0),
    dict(fn=_prospect("risk"), prop="risk"),
    dict(fn=_prospect("chance"), prop="site_chance"),
    dict(fn=_prospect("step"), prop="site_step", norm=6.0),
    dict(fn=_prospect("finish"), prop="site_finish", norm=6.0),
    dict(fn=site_code, prop="site_code"),
)
"""Observed properties of each image, in addition to its place, turn and window."""
