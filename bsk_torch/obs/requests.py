"""Properties of the next requests, for :class:`bsk_torch.obs.OpportunityProperties`."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from bsk_torch.sats.opportunities import Opportunities
from bsk_torch.sats.requests import BoundRequestSatellite
from bsk_torch.sim.places.requested import DUE, DURATION, RELEASE


def time_to_release(satellite: BoundRequestSatellite, requests: Opportunities) -> Tensor:
    """Return the time until the release of each request, [N, n] s; negative after it."""
    return satellite.request_values(RELEASE, requests.place) - satellite.simulator.sim_time.unsqueeze(-1)


def time_to_due(satellite: BoundRequestSatellite, requests: Opportunities) -> Tensor:
    """Return the time until each request is due, or the episode ends if that is sooner, [N, n] s."""
    due = torch.minimum(satellite.request_values(DUE, requests.place), satellite.time_limit.unsqueeze(-1))
    return due - satellite.simulator.sim_time.unsqueeze(-1)


def look_duration(satellite: BoundRequestSatellite, requests: Opportunities) -> Tensor:
    """Return the time for which a look at each request lasts, [N, n] s."""
    return satellite.request_values(DURATION, requests.place)


def look_slack(satellite: BoundRequestSatellite, requests: Opportunities) -> Tensor:
    """Return the time that the window leaves before a look must begin, from now or from its opening, [N, n] s."""
    begin = torch.maximum(requests.open, satellite.simulator.sim_time.unsqueeze(-1))
    return requests.close - begin - look_duration(satellite, requests)


def sensors(satellite: BoundRequestSatellite, requests: Opportunities) -> Tensor:
    """Return which of ``scenario.sensor_types`` may serve each request, [N, n, types], 1 or 0."""
    place = requests.place
    allowed = satellite.scenario.allows(place.reshape(satellite.fleet.num_envs, -1))
    return allowed.view(*place.shape, -1).to(requests.open.dtype)


REQUEST_PRESETS: dict[str, Callable[[BoundRequestSatellite, Opportunities], Tensor]] = {
    "time_to_release": time_to_release,
    "time_to_due": time_to_due,
    "look_duration": look_duration,
    "look_slack": look_slack,
    "sensors": sensors,
}
"""Properties of requests."""
