"""Sites-v1 and SitesTeam-v1: mosaics of 3 to 6 images that pay when they are complete, under weather with a forecast.

A satellite like that of :mod:`bsk_torch.presets.aeos`, which turns more slowly, and which time limits, not power or storage,
flies half an orbit at 5 degrees inclination over 300 sites within 9 degrees of the equator. Several sites are in view at once,
with more images than can be taken, so that it matters which sites to begin, which to leave, and in which order to take the images
of neighboring ones.

In SitesTeam-v1, two satellites, as agile as in AEOS-v1, fly one behind the other, 4 degrees apart, over the same sites. Images of
both count together, and each knows at once what the other has taken.

Observation, 12 + 32 * 29 + 1 = 941 numbers: satellite and time as in AEOS-v1, and of each of the next 32 images, in order of
closing time:

============================  ==================================================================================
``priority``                  value of its site
``r_LB_H_normd`` (3)          as in AEOS-v1, as are ``target_angle_normd``, ``target_angle_rate_normd``,
                              ``opportunity_open_normd`` and ``opportunity_close_normd``
``site_size_normd``           number of images of its site, divided by 6, as are the next two
``site_done_normd``           clear images taken
``site_left_normd``           images that can still be taken in this pass, including this one
``site_ago_normd``            time since the first image of the site, divided by 300 s; 0 before
``risk``                      forecast: the probability that the image is not clear
``site_chance``               probability that all images that are left are clear
``site_step_normd``           what the image pays if it is clear and the next one of its site, divided by 6
``site_finish_normd``         what all images that are left pay if they are clear, divided by 6
``site_margin_normd``         least time by which it and the others that are left are in time, if it is next and each
                              further one takes 21.4 s, divided by 300 s
``site_others_normd`` (3)     mean place of the images that are left, relative to it, in the Hill frame, divided by 100 km
``commit_worth``              what it is worth to the rule *commit*, divided by that of the best; -1 out of reach
``site_code`` (8)             a code of the number of the site, of -1 and 1
============================  ==================================================================================

With ``as_set=True``, they are ``rows`` [N, 32, 29] with a ``mask`` [N, 32]. Nothing is hidden but whether images that have not
been taken are clear.

Satellites of a team observe 12 + 32 * 36 + 1 = 1,165 numbers, and in ``rows`` 36, with what the others do and can do:

============================  ==================================================================================
``claimed``                   number of other satellites that are about to take the image
``site_claims``               number of other satellites that are about to take an image of its site
``later_normd``               time until the last window of the image over another satellite closes, divided by
                              300 s; 0 without one
``team_left_normd``           images of its site that some satellite can still take, divided by 6
``team_chance``               probability that all of them are clear
``team_finish_normd``         what they pay if they are clear, divided by 6
``team_close_normd``          time until the last of their windows closes, divided by 300 s
============================  ==================================================================================

Actions: 0 to 31 image the corresponding target. The step ends with the image, with the end of the window, or after 300 s.

Reward: value times size of the site for the image that completes it; with ``gain="convex"``, what each clear image adds to the
gain of :class:`~bsk_torch.tasks.sites.Sites`. The satellites of a team get equal parts, whoever took the image.
Images of a site can be chosen for 300 s after its first one.

Termination: at the time limit of 2,850 s.

Random at reset: orbit; places, sizes, values and directions of sites; risks and weather.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

from bsk_torch import formations, rand
from bsk_torch.env import ConstellationTasking, SatelliteTasking
from bsk_torch.presets.aeos import ALTITUDE, ORBIT, SOON, AgileSatellite, agile_args, agile_environment, imagers, looking_ahead
from bsk_torch.tasks.sites.obs import SITE, TEAM
from bsk_torch.tasks.sites.reward import CompletionReward
from bsk_torch.tasks.sites.scene import Sites

INCLINATION = 5.0
"""Inclination of the orbits, degrees."""

APART = 4.0
"""Angle at the Earth's center between two satellites of a team, degrees."""

SITES = 300
"""Number of sites."""

SLOW: dict[str, object] = dict(u_max=0.1, omega_max=math.radians(2.0))
"""Largest torque of a wheel, N m, and largest rate, rad/s: a turn to a neighboring image takes 20 s, one of 30 degrees 60 s."""


class TeamSatellite(AgileSatellite):
    """Observes also what other satellites do, and can do.

    Attributes:
        slew: Time for a turn of one radian, by which margins are counted, s; less than that of the satellite of Sites-v1.
    """

    slew: ClassVar[float] = 45.0


def sites(
    *, as_set: bool = False, n_sites: int = SITES, gain: str = "complete", risk: float = 0.4, **options: object
) -> SatelliteTasking:
    """Return Sites-v1; see the module.

    Args:
        as_set: Whether images are observed as ``rows`` [N, 32, features] with a ``mask`` instead of in one vector.
        n_sites: Number of sites.
        gain: What parts of a site pay, ``"complete"`` or ``"convex"``; see :class:`~bsk_torch.tasks.sites.Sites`.
        risk: Largest probability that an image is not clear; 0 for no weather.
        **options: Arguments of :class:`~bsk_torch.SatelliteTasking` that replace those of the preset, and ``obs_type`` and
            ``sat_args`` of the satellite.
    """
    return slow_imager(parts_of(Sites(n_sites, gain=gain, risk=risk), CompletionReward()) | options, SITE, as_set)


def sites_team(*, n_satellites: int = 2, as_set: bool = False, n_sites: int = SITES, **options: Any) -> ConstellationTasking:
    """Return SitesTeam-v1; see the module, and :func:`sites`.

    Args:
        n_satellites: Number of satellites, one behind the other.
        as_set: See :func:`sites`.
        n_sites: See :func:`sites`.
        **options: Arguments of :class:`~bsk_torch.ConstellationTasking` that replace those of the preset, and ``obs_type`` and
            ``sat_args`` of the satellites.
    """
    arguments = {name: value for name, value in agile_args().items() if name != "oe"}
    names = [f"EO{k + 1}" for k in range(n_satellites)]
    satellites = imagers(TeamSatellite, names, arguments, options, **looking_ahead(*TEAM, as_set=as_set))
    train = formations.train_args(APART, altitude=ALTITUDE / 1e3, inc=INCLINATION)
    parts = dict(
        sat_arg_randomizer=train, sim_rate=0.5, max_step_duration=SOON, failure_penalty=0.0, terminate_on_time_limit=True
    )
    return ConstellationTasking(satellites, **(parts_of(Sites(n_sites), CompletionReward()) | parts | options))


def parts_of(scenario: Sites, rewarder: CompletionReward) -> dict[str, Any]:
    """Return the arguments that tasks of sites share."""
    return dict(scenario=scenario, rewarder=rewarder, time_limit=ORBIT / 2)


def slow_imager(options: dict[str, Any], properties: Sequence[dict[str, Any]], as_set: bool) -> SatelliteTasking:
    """Return the task of one satellite that turns slowly and observes ``properties`` of images; see :func:`sites`."""
    arguments = agile_args() | SLOW | dict(oe=rand.random_orbit(a=(6371e3 + ALTITUDE) / 1e3, i=INCLINATION))
    (satellite,) = imagers(AgileSatellite, ["EO1"], arguments, options, **looking_ahead(*properties, as_set=as_set))
    return agile_environment(satellite, options)
