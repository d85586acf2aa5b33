"""Properties of the next images that their sites give them."""

from __future__ import annotations

from collections.abc import Hashable
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.sats.bound_access import BoundAccessSatellite
from bsk_torch.sats.imaging import BoundImagingSatellite
from bsk_torch.sats.opportunities import Opportunities
from bsk_torch.tasks.sites.scene import BEGUN, NOT_BEGUN, Sites
from bsk_torch.tasks.sites.tips import WIDE, Tips
from bsk_torch.tasks.sites.worth import CONFIRMING, COORDINATED, Commitment, worth

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
    clear = 1.0 - look_up(scenario.risks, following.place)
    size, done = look_up(scenario.size, site), look_up(scenario.done, site)
    left = same.double().sum(2)
    paid = scenario.gain(done / size)
    whole = look_up(scenario.priority, image) * size
    begun = look_up(scenario.memory[BEGUN], site)
    now = satellite.simulator.of_env(satellite.fleet.sim_time).unsqueeze(1)
    taken = torch.maximum(images.open, now + getattr(satellite, "slew", SLEW) * satellite.aims(images, None)[..., 3].sqrt())
    further = same & (image.unsqueeze(2) != following.place.unsqueeze(1))
    ends = torch.minimum(following.close, look_up(scenario.ends, following.place // scenario.most))
    latest = torch.where(further, ends.unsqueeze(1) - EACH * further.cumsum(2), torch.inf).amin(2)
    r_LB_H, r_FB_H = satellite.aims(images, None)[..., :3], satellite.aims(following, None)[..., :3]
    outlook = Prospects(
        size=size,
        done=done,
        left=left,
        ago=torch.where(begun == NOT_BEGUN, 0.0, now - begun),
        risk=look_up(scenario.risks, image),
        chance=torch.where(same, clear.unsqueeze(1), 1.0).prod(2),
        step=whole * (scenario.gain((done + 1.0) / size) - paid),
        finish=whole * (scenario.gain((done + left) / size) - paid),
        margin=torch.minimum(latest, torch.minimum(images.close, look_up(scenario.ends, site))) - taken,
        others=same.double() @ r_FB_H / left.clamp(min=1.0).unsqueeze(2) - r_LB_H,
    )
    if not isinstance(scenario, Tips):
        return outlook
    wide = image % scenario.most == WIDE  # it pays nothing, and shows the spots that pay
    step, finish = torch.where(wide, 0.0, outlook.step), torch.where(wide, whole, outlook.finish)
    return outlook._replace(left=torch.where(wide, size, left), step=step, finish=finish)


def _prospect(name: str, satellite: BoundAccessSatellite, images: Opportunities) -> Tensor:
    return getattr(prospects(satellite, images), name)


def commit_worth(satellite: BoundAccessSatellite, images: Opportunities) -> Tensor:
    """Return what each image is worth to the rule *commit*, divided by that of the best, [N, n]; -1 for those out of reach."""
    return _part_of_best(satellite, images, {}, Commitment())


def team_worth(satellite: BoundAccessSatellite, images: Opportunities) -> Tensor:
    """Return the same in a team, where the rule leaves images to others."""
    return _part_of_best(satellite, images, shares(satellite, images)._asdict(), COORDINATED)


def tip_worth(satellite: BoundAccessSatellite, images: Opportunities) -> Tensor:
    """Return the same where a wide look shows what is left of a site."""
    looks = {"wide": wide(satellite, images), "waiting": waiting(satellite, images)}
    return _part_of_best(satellite, images, looks, CONFIRMING)


def wide(satellite: BoundAccessSatellite, images: Opportunities) -> Tensor:
    """Return whether each image is a wide look, as 0 or 1, [N, n]."""
    return (images.place % satellite.scenario.most == WIDE).double()


def waiting(satellite: BoundAccessSatellite, images: Opportunities) -> Tensor:
    """Return the number of spots that wait among the next :data:`NEXT` images, the same for all, [N, n]."""
    following = satellite.find_next_opportunities(NEXT, "target")
    spots = following.mask & (following.place % satellite.scenario.most != WIDE)
    return spots.double().sum(1, keepdim=True).expand(images.place.shape)


def _part_of_best(satellite: BoundAccessSatellite, images: Opportunities, more: dict[str, Tensor], numbers: Commitment) -> Tensor:
    now, outlook = satellite.simulator.state.sim_time.unsqueeze(1), prospects(satellite, images)
    values = {f"site_{name}": value for name, value in outlook._asdict().items() if value.ndim == 2} | more
    values |= {
        "risk": outlook.risk,
        "target_angle": satellite.aims(images, None)[..., 3],
        "opportunity_open": images.open - now,
        "opportunity_close": images.close - now,
    }
    worths = worth(values.__getitem__, numbers, more)
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


class Shares(NamedTuple):
    """What is known of n images where several satellites take images of the same sites, [N, n] each.

    Attributes:
        claimed: Number of other satellites that are about to take the image.
        site_claims: Number of other satellites that are about to take an image of its site.
        later: Time until the last window of the image over another satellite closes, s; 0 without one.
        team_left: Images of the site that some satellite can still take.
        team_chance: Probability that all of them are clear.
        team_finish: What they pay if all are clear.
        team_close: Time until the last window of these images closes, s.
    """

    claimed: Tensor
    site_claims: Tensor
    later: Tensor
    team_left: Tensor
    team_chance: Tensor
    team_finish: Tensor
    team_close: Tensor


def shares(satellite: BoundAccessSatellite, images: Opportunities) -> Shares:
    """Return what is known of the observed images in a team, computed once for a state."""
    scenario: Sites = satellite.scenario
    key: Hashable = ("shares", satellite.type_index)
    draws = satellite.fleet.scenario_state.version
    return scenario.memo.once(key, satellite.fleet, lambda: _shares(satellite, scenario, images.place), (draws,))


def _last_closing(satellite: BoundAccessSatellite) -> Tensor:
    """Return when the last window over each image among the next :data:`NEXT` closes, [N, T] s; minus infinity without one."""
    most, following = satellite.scenario.most_targets, satellite.find_next_opportunities(NEXT, "target")
    place = torch.where(following.mask, following.place, most)
    never = torch.full((len(place), most + 1), -torch.inf, dtype=torch.float64, device=place.device)
    return never.scatter_reduce(1, place, following.close, "amax")[:, :-1]


def _aim(satellite: BoundImagingSatellite) -> Tensor:
    """Return the image that each satellite is about to take, [N]; negative without one."""
    free = satellite.task.requires_retasking | satellite.task.dead
    return torch.where(free, -1, satellite.latest_target)


def _shares(satellite: BoundAccessSatellite, scenario: Sites, image: Tensor) -> Shares:
    fleet, of_env, look_up = satellite.fleet, satellite.of_env, satellite.simulator.look_up
    closes = fleet.each(_last_closing)
    last = closes.amax(1)
    number = torch.arange(fleet.size, device=image.device)
    by_each = of_env(closes).gather(2, image.unsqueeze(1).expand(-1, fleet.size, -1))
    itself = satellite.rows_of(number.expand(fleet.num_envs, -1)).unsqueeze(1) == number
    later = torch.where(itself.unsqueeze(2), -torch.inf, by_each).amax(1)
    aims = torch.where(itself, -1, of_env(fleet.each(_aim))).unsqueeze(1)
    site = image // scenario.most
    now = of_env(fleet.sim_time).unsqueeze(1)
    within_reach = (last > -torch.inf).unflatten(1, (-1, scenario.most))
    clear = (1.0 - scenario.drawn("image_risk")).unflatten(1, (-1, scenario.most))
    count = within_reach.double().sum(2)
    size, done = scenario.drawn("site_size"), scenario.done
    pays = scenario.gain((done + count) / size) - scenario.gain(done / size)
    return Shares(
        claimed=(aims == image.unsqueeze(2)).double().sum(2),
        site_claims=(aims // scenario.most == site.unsqueeze(2)).double().sum(2),
        later=(later - now).clamp(min=0.0),
        team_left=look_up(count, site),
        team_chance=look_up(torch.where(within_reach, clear, 1.0).prod(2), site),
        team_finish=look_up(scenario.priority, image) * look_up(size * pays, site),
        team_close=(look_up(last.unflatten(1, (-1, scenario.most)).amax(2), site) - now).clamp(min=0.0),
    )


def _share(name: str, satellite: BoundAccessSatellite, images: Opportunities) -> Tensor:
    return getattr(shares(satellite, images), name)


SITE = (
    dict(fn=partial(_prospect, "size"), prop="site_size", norm=6.0),
    dict(fn=partial(_prospect, "done"), prop="site_done", norm=6.0),
    dict(fn=partial(_prospect, "left"), prop="site_left", norm=6.0),
    dict(fn=partial(_prospect, "ago"), prop="site_ago", norm=300.0),
    dict(fn=partial(_prospect, "risk"), prop="risk"),
    dict(fn=partial(_prospect, "chance"), prop="site_chance"),
    dict(fn=partial(_prospect, "step"), prop="site_step", norm=6.0),
    dict(fn=partial(_prospect, "finish"), prop="site_finish", norm=6.0),
    dict(fn=partial(_prospect, "margin"), prop="site_margin", norm=300.0),
    dict(fn=partial(_prospect, "others"), prop="site_others", norm=100e3),
    dict(fn=commit_worth, prop="commit_worth"),
    dict(fn=site_code, prop="site_code"),
)
"""Observed properties of each image, in addition to its place, turn and window."""

TEAM = (
    *(entry | dict(fn=team_worth) if entry["prop"] == "commit_worth" else entry for entry in SITE),
    dict(fn=partial(_share, "claimed"), prop="claimed"),
    dict(fn=partial(_share, "site_claims"), prop="site_claims"),
    dict(fn=partial(_share, "later"), prop="later", norm=300.0),
    dict(fn=partial(_share, "team_left"), prop="team_left", norm=6.0),
    dict(fn=partial(_share, "team_chance"), prop="team_chance"),
    dict(fn=partial(_share, "team_finish"), prop="team_finish", norm=6.0),
    dict(fn=partial(_share, "team_close"), prop="team_close", norm=300.0),
)
"""The same in a team."""

TIPS = (
    *(entry | dict(fn=tip_worth) if entry["prop"] == "commit_worth" else entry for entry in SITE),
    dict(fn=wide, prop="wide"),
    dict(fn=waiting, prop="waiting", norm=10.0),
)
"""The same where a wide look shows what is left of a site."""
