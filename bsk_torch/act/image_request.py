"""Action that looks at one of the next requests."""

from __future__ import annotations

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.act.base import Decision
from bsk_torch.act.candidates import NO_TARGET
from bsk_torch.act.image import Image
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sats.requests import BoundRequestSatellite
from bsk_torch.sim.fsw.look import LOOK_MODE
from bsk_torch.sim.places.requested import DUE, DURATION, MAX_OFF_NADIR, MIN_ELEVATION, RELEASE

ROUNDING = 1e-9  # part of a tick by which times may miss it


class ImageRequest(Image):
    """Look at the request of the k-th next access window, for k from 0 to ``n_ahead_image`` - 1.

    The image is taken when the look has lasted as long as the request wants, and recorded one tick later, which ends the action,
    as the end of the window and ``max_duration`` do. Choosing the same request again continues the look, another one drops it.
    ``action_mask`` excludes windows too short for the rest of a look that begins now, or when the window opens, without the turn
    to the target.

    For :class:`bsk_torch.scene.Requests` and :class:`bsk_torch.sats.RequestSatellite`.
    """

    satellite: BoundRequestSatellite
    flight_mode = LOOK_MODE

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Image.link_satellite`; ValueError for another satellite."""
        if not isinstance(satellite, BoundRequestSatellite):
            raise ValueError(f"{self.name!r} needs a sats.RequestSatellite; {satellite.name} is a {type(satellite).__name__}")
        super().link_satellite(satellite)

    @override
    def mask(self) -> Tensor:
        offered = self.satellite.find_next_opportunities(self.n_actions, self.kind)
        simulator = self.satellite.simulator
        seconds = self.satellite.request_values(DURATION, offered.place)
        # the part of a look that is over already
        current = self.satellite.task.previous_action.unsqueeze(1) == self.keys(offered.place, self._first)
        done = (simulator.state.read("look_ticks").unsqueeze(1) - 1.0).clamp(min=0.0) * simulator.h
        remaining = torch.where(current, seconds - done, seconds)
        time = torch.maximum(offered.open, simulator.sim_time.unsqueeze(1))
        # how long those last that are in progress at the end of look-ahead is not known
        uncertain = offered.close >= self.satellite.access_windows.until.unsqueeze(1)
        return super().mask() & (uncertain | (offered.close - time >= remaining - ROUNDING))

    @override
    def decide(self, index: Tensor, mask: Tensor, action: Tensor, previous: Tensor) -> Decision:
        chosen = super().decide(index, mask, action, previous)
        place = torch.where(chosen.key == NO_TARGET, 0, self.keys(chosen.key, self._first))  # keys() is its own inverse
        seconds = self.satellite.request_values(DURATION, place.unsqueeze(1)).squeeze(1)
        # the image of a look that is complete as the window closes is recorded in the next tick
        duration = (chosen.duration + self.satellite.simulator.h).clamp(max=self.max_duration)
        return chosen._replace(duration=duration, expected=torch.minimum(chosen.expected + seconds, duration))

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """See :meth:`Image.begin`; set the limits of the request, too."""
        super().begin(mask, decision)
        simulator, mask = self.satellite.simulator, mask & (decision.key != NO_TARGET)
        place = torch.where(mask, self.keys(decision.key, self._first), 0).unsqueeze(1)
        release, due, seconds, elevation, off_nadir = (
            self.satellite.request_values(name, place).squeeze(1)
            for name in (RELEASE, DUE, DURATION, MIN_ELEVATION, MAX_OFF_NADIR)
        )
        values = {
            "request_first_tick": torch.ceil(release / simulator.h - ROUNDING),
            "request_last_tick": torch.floor(due / simulator.h + ROUNDING),
            "request_sin2_elevation": elevation.sin() ** 2,
            "request_cos2_off_nadir": off_nadir.cos() ** 2,
            "look_needed": torch.ceil(seconds / simulator.h - ROUNDING),
        }
        for name, value in values.items():
            simulator.write(name, mask, value)
