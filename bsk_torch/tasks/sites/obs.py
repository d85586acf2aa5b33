"""Properties of the next images that their sites give them."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.sats.bound_access import BoundAccessSatellite
from bsk_torch.sats.opportunities import Opportunities
from bsk_torch.tasks.sites.scene import BEGUN, NOT_BEGUN, Sites
from bsk_torch.tasks.sites.worth import Commitment, worth

BITS = 8
"""Numbers of the code of a site."""

NEXT = 64
"""Images among which the others of a site are looked for: the 32 observed ones, and those that close within a minute or more."""


SLEW, EACH = 60.0, 21.4
"""Time for a turn of one radian, which grows with the square root of the angle, and for each further image of a site, s."""


class Prospects(NamedTuple):
    """What is known of the sites of n images, [N, n] each.

    Attributes:
        size: Number of images of the site.
        done: Clear images taken.
        left: Images that can still be taken in this pass, including this one.
        ago: Time since the first image, s; 0 before.
        risk: Probability that the image is not clear.
        chance: Probability that all images that are left are clear.
        step: What the image pays if it is clear and the next one of its site.
        finish: What the images that are left pay if all are clear.
        margin: Time by which the others that are left are in time if this image is next, at least, s.
        others: Mean place of the images that are left relative to this one, in the Hill frame, m, [N, n, 3].
    """

    size: Tensor
    done: Tensor
    left: Tensor
    ago: Tensor
    risk: Tensor
    chance: Tensor
    step: Tensor
    finish: Tensor
    margin: Tensor
    others: Tensor


def prospects(satellite: BoundAccessSatellite, images: Opportunities) -> Prospects:
    """Return what is known of the sites of the observed images, computed once for a state.

    Images of a site are left if they can be chosen and are among the next :data:`NEXT` images of this satellite.
    """
    scenario: Sites = satellite.scenario
    key: Hashable = ("prospects", satellite.type_index)
    draws = satellite.fleet.scenario_state.version
    return scenario.memo.once(key, satellite.fleet, lambda: _prospects(satellite, scenario, images), (draws,))


def _prospects(satellite: BoundAccessSatellite, scenario: Sites, images: Opportunities) -> Prospects:
    look_up, image = satellite.simulator.look_up, images.place
    site = image // scenario.most
    following = satellite.find_next_opportunities(NEXT, "target")
    same = (site.unsqueeze(2) == (following.place // scenario.most).unsqueeze(1)) & following.mask.unsqueeze(1)
    clear = 1.0 - look_up(scenario.drawn("image_risk"), following.place)
    size, done = look_up(scenario.drawn("site_size"), site), look_up(scenario.done, site)
    left = same.double().sum(2)
    paid = scenario.gain(done / size)
    whole = look_up(scenario.priority, image) * size
    begun = look_up(scenario.memory[BEGUN], site)
    now = satellite.simulator.of_env(satellite.fleet.sim_time).unsqueeze(1)
    taken = torch.maximum(images.open, now + SLEW * satellite.aims(images, None)[..., 3].sqrt())
    further = same & (image.unsqueeze(2) != following.place.unsqueeze(1))
    latest = torch.where(further, following.close.unsqueeze(1) - EACH * further.cumsum(2), torch.inf).amin(2)
    r_LB_H, r_FB_H = satellite.aims(images, None)[..., :3], satellite.aims(following, None)[..., :3]
    return Prospects(
        size=size,
        done=done,
        left=left,
        ago=torch.where(begun == NOT_BEGUN, 0.0, now - begun),
        risk=look_up(scenario.drawn("image_risk"), image),
        chance=torch.where(same, clear.unsqueeze(1), 1.0).prod(2),
        step=whole * (scenario.gain((done + 1.0) / size) - paid),
        finish=whole * (scenario.gain((done + left) / size) - paid),
        margin=torch.minimum(latest, images.close) - taken,
        others=same.double() @ r_FB_H / left.clamp(min=1.0).unsqueeze(2) - r_LB_H,
    )


def _prospect(name: str) -> Callable[[BoundAccessSatellite, Opportunities], Tensor]:
    def read(satellite: BoundAccessSatellite, images: Opportunities) -> Tensor:
        return getattr(prospects(satellite, images), name)

    return read


def commit_worth(satellite: BoundAccessSatellite, images: Opportunities) -> Tensor:
    """Return what each image is worth to the rule *commit*, divided by that of the best, [N, n]; -1 for those out of reach."""
    now, outlook = satellite.simulator.state.sim_time.unsqueeze(1), prospects(satellite, images)
    values = {f"site_{name}": value for name, value in outlook._asdict().items() if value.ndim == 2} | {
        "risk": outlook.risk,
        "target_angle": satellite.aims(images, None)[..., 3],
        "opportunity_open": images.open - now,
        "opportunity_close": images.close - now,
    }
    worths = worth(values.__getitem__, Commitment())
    return (worths / worths.amax(1, keepdim=True).clamp(min=1e-9)).clamp(min=-1.0)


def site_code(satellite: BoundAccessSatellite, images: Opportunities) -> Tensor:
    """Return the number of each image's site as a code, [N, n, 8] of -1 and 1, so that networks can compare sites.

    The bits are those of the number multiplied by an odd constant (D. Knuth, The art of computer programming 3, section 6.4):
    codes of different sites differ in half of the bits on average.
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
    dict(fn=_prospect("margin"), prop="site_margin", norm=300.0),
    dict(fn=_prospect("others"), prop="site_others", norm=100e3),
    dict(fn=commit_worth, prop="commit_worth"),
    dict(fn=site_code, prop="site_code"),
)
"""Observed properties of each image, in addition to its place, turn and window."""
