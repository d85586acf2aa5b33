"""TipAndCue-v1: a wide look finds what is active, and narrow looks must confirm all of it in time.

The satellite of Sites-v1, see :mod:`bsk_torch.tasks.sites.preset`, flies half an orbit at 5 degrees inclination over 300 sites
within 9 degrees of the equator. Each has five spots within 150 km east, west, north and south of its middle. Which of them are
active is hidden; the probability is that of the site, from 0.1 to 0.9. A wide look at the middle shows the active spots, and
each takes a separate narrow look. So it matters which sites to look at, when there is time to confirm what shows itself, and
which spots to leave.

Observation, 12 + 32 * 31 + 1 = 1,005 numbers: those of Sites-v1, where an image is a wide look or a narrow look at a spot. Before
the wide look, the size of a site, and its images left, are the expected number of active spots, and ``site_finish`` is what these
pay; ``risk`` is the probability that a spot is not active, 0 afterwards. The first image is the wide look. Further, of each of
the next 32 images:

============================  ==================================================================================
``wide``                      whether it is a wide look, 0 or 1
``waiting_normd``             number of spots that wait among the next 64 images, divided by 10
============================  ==================================================================================

With ``as_set=True``, they are ``rows`` [N, 32, 31] with a ``mask`` [N, 32]. Nothing is hidden but which spots are active.

Actions: 0 to 31 image the corresponding target. The step ends with the image, with the end of the window, or after 300 s.

Reward: value times number of active spots for the narrow look that confirms the last one of a site; with ``gain="convex"``, what
each adds to the gain of :class:`~bsk_torch.tasks.sites.Sites`. A narrow look confirms within 240 s of the wide one.

Termination: at the time limit of 2,850 s.

Random at reset: orbit; places and values of sites; places, probabilities and activity of spots.
"""

from __future__ import annotations

from bsk_torch.env import SatelliteTasking
from bsk_torch.tasks.sites.obs import TIPS
from bsk_torch.tasks.sites.preset import SITES, parts_of, slow_imager
from bsk_torch.tasks.sites.tips import ConfirmationReward, Tips


def tip_and_cue(
    *, as_set: bool = False, n_sites: int = SITES, gain: str = "complete", within: float = 240.0, **options: object
) -> SatelliteTasking:
    """Return TipAndCue-v1; see the module.

    Args:
        as_set: Whether images are observed as ``rows`` [N, 32, features] with a ``mask`` instead of in one vector.
        n_sites: Number of sites.
        gain: What parts of a site pay, ``"complete"`` or ``"convex"``; see :class:`~bsk_torch.tasks.sites.Sites`.
        within: Time after the wide look in which spots can be confirmed, s.
        **options: Arguments of :class:`~bsk_torch.SatelliteTasking` that replace those of the preset, and ``obs_type`` and
            ``sat_args`` of the satellite.
    """
    scenario = Tips(n_sites, gain=gain, within=within)
    return slow_imager(parts_of(scenario, ConfirmationReward()) | options, TIPS, as_set)
