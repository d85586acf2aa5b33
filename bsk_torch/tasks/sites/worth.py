"""What images of sites are worth to one who commits to sites that can be finished."""

from __future__ import annotations

from collections.abc import Callable, Container
from typing import NamedTuple

import torch
from torch import Tensor

Number = Tensor | float
"""A number, or one for each row, [N, 1]."""


class Commitment(NamedTuple):
    """Numbers of :func:`worth`. The defaults are the best of 96 settings in 4,864 episodes of Sites-v1, rounded.

    Attributes:
        patience: Time that divides the value of what is finished later by e, s.
        loyalty: Additional value of a site as it approaches completion.
        each: Time for each further image of a site, s.
        reserve: Margin with which a site is completed in every other case, s.
        doubt: How slowly confidence in completing a site grows with the margin, s.
        slew: Time for a turn of one radian, s; it grows with the square root of the angle.
        alone: Weight of what an image pays without the others.
        nerve: Exponent of the probability that all images are clear: 0 for one who does not look at the forecast.
        yielding: Part of its worth that a site loses while another satellite is about to take an image of it.
        hope: Weight of a wide look.
        rush: Time that divides the value of a later wide look by e, s.
        busy: Exponent by which a wide look is worth less for each spot that waits.
    """

    patience: Number = 125.5
    loyalty: Number = 4.05
    each: Number = 23.4
    reserve: Number = 0.3
    doubt: Number = 30.2
    slew: Number = 45.9
    alone: Number = 0.42
    nerve: Number = 0.46
    yielding: Number = 0.0
    hope: Number = 0.45
    rush: Number = 45.4
    busy: Number = 0.25


COORDINATED = Commitment(40.0, 2.4, 6.8, -6.3, 13.4, 56.9, 0.15, 0.6, yielding=0.8)
"""Numbers for SitesTeam-v1."""

CONFIRMING = Commitment(33.4, 5.03, 22.8, -10.5, 21.5, 49.2, 0.55)
"""Numbers for TipAndCue-v1: with those of wide looks, the best of 96 settings in 4,864 of its episodes, rounded."""


def worth(read: Callable[[str], Tensor], numbers: Commitment, more: Container[str] = ()) -> Tensor:
    """Return what images are worth, [N, n]; those that are out of reach have less than -1.

    With the time t until an image of a site is taken and n images that are left, it is::

        finish * chance^nerve * (1 + loyalty * done / size) * exp(-(t + (n - 1) * each) / patience)
            * sigmoid((margin - reserve) / doubt)

    and further ``alone * step * (1 - risk) * exp(-t / patience)``. In a team, images that another satellite is about to take are
    worth nothing, and the first term is multiplied by ``1 - yielding`` for the others of their site. A wide look at n spots on
    average is worth ``hope * finish * exp(-t / rush - busy * waiting) * sigmoid((margin - n * each) / doubt)``.

    Args:
        read: Function from the name of an observed property to its values, [N, n].
        numbers: The numbers.
        more: Further properties that are observed: ``"site_claims"`` in teams, ``"wide"`` where wide looks show what is left.
    """
    taken = torch.maximum(read("opportunity_open"), numbers.slew * read("target_angle").clamp(min=0.0).sqrt())
    closes = read("opportunity_close")
    last = taken + (read("site_left") - 1.0).clamp(min=0.0) * numbers.each
    nearly = 1.0 + numbers.loyalty * read("site_done") / read("site_size").clamp(min=1.0)
    in_time = torch.sigmoid((read("site_margin") - numbers.reserve) / numbers.doubt)
    whole = read("site_finish") * read("site_chance") ** numbers.nerve * nearly * in_time * torch.exp(-last / numbers.patience)
    step = numbers.alone * read("site_step") * (1.0 - read("risk")) * torch.exp(-taken / numbers.patience)
    if "site_claims" in more:
        whole = whole * (1.0 - numbers.yielding * read("site_claims").clamp(max=1.0))
    worths = whole + step if "site_claims" not in more else (whole + step) * (read("claimed") <= 0.0)
    if "wide" in more:
        in_time = torch.sigmoid((read("site_margin") - numbers.each * read("site_size")) / numbers.doubt)
        look = numbers.hope * read("site_finish") * in_time * torch.exp(-taken / numbers.rush - numbers.busy * read("waiting"))
        worths = torch.where(read("wide") > 0.5, look, worths)
    return torch.where(taken < closes, worths, -1.0 - 1e-6 * taken)
