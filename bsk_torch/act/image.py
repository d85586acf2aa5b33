"""Action that images one of the next targets."""

from __future__ import annotations

import logging

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import switch, whole
from bsk_torch.act.base import Action, Decision, positive_duration
from bsk_torch.act.candidates import NO_TARGET, SLEW, CandidateAction
from bsk_torch.act.discrete import choose_instrument
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sats.imaging import BoundImagingSatellite
from bsk_torch.sim.instruments import number_of
from bsk_torch.sim.places import instrument_kind

logger = logging.getLogger(__name__)


def image_target(target: Tensor | int) -> Tensor | int:
    """Return the action -1 - ``target``, which images the target with that index in the scenario."""
    return -1 - target


class Image(CandidateAction):
    """Image the target of the k-th next access window, for k from 0 to ``n_ahead_image`` - 1.

    The action ends when the image is taken, when the target's window closes, or after ``max_duration``. Choosing the same target
    again continues the action: a target is not imaged twice in a row. Actions -1, -2, ... select targets 0, 1, ... by their index
    in the scenario; see :func:`image_target`.

    A satellite with several ``instruments`` has an entry for each that it may choose. Windows are those of the instrument, the
    choice holds from the next tick on, and an image that the last instrument has not taken yet is dropped. Negative actions
    belong to the first of these entries.
    """

    satellite: BoundImagingSatellite
    flight_mode = "image"
    aim = "latest_target"
    drawn = "target_exists"

    def __init__(
        self,
        n_ahead_image: int,
        max_duration: float | None = None,
        name: str = "action_image",
        mask_repeated: bool = False,
        mask_late: bool = True,
        instrument: str | int | None = None,
    ) -> None:
        """Provide ``n_ahead_image`` actions.

        Args:
            n_ahead_image: Number of windows to choose from.
            max_duration: Maximum duration, s; None for no limit other than the window.
            name: Name in ``action_description``, followed by the instrument where one is given.
            mask_repeated: Whether ``action_mask`` excludes actions that repeat the last target because fewer than
                ``n_ahead_image`` windows are known.
            mask_late: Whether ``action_mask`` excludes windows that open at the time limit of the episode or later. A satellite
                that chooses one is busy until the end, and images nothing. Without effect under ``compat="bsk_rl"``.
            instrument: Name or number of the instrument, of a satellite with several.
        """
        super().__init__(name if instrument is None else f"{name}_{instrument}")
        self.instrument = instrument
        self._number: int | None = None
        self.n_actions, self.mask_repeated = whole("n_ahead_image", n_ahead_image, 1), switch("mask_repeated", mask_repeated)
        self.mask_late = switch("mask_late", mask_late)
        self.max_duration = positive_duration("max_duration", max_duration, name, float("inf"))

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Action.link_satellite`; ValueError for one that cannot image, has no targets, or lacks the instrument."""
        super().link_satellite(satellite)
        satellite.simulator.check_command(self.flight_mode)
        self.mask_late = self.mask_late and not satellite.simulator.type.compat
        kinds, listed = getattr(satellite, "opportunity_types", ()), satellite.simulator.type.instruments
        wanted: str | None = getattr(satellite, "target_types", None)
        if listed or self.instrument is not None:
            self._number = number_of(listed, self.instrument, f"act.Image {self.name!r}")
            wanted = instrument_kind(listed[self._number])
        if not hasattr(satellite, "target_types") or wanted is None or wanted not in kinds:
            raise ValueError(
                f"{self.name!r} needs a sats.ImagingSatellite and a scenario with targets, such as scene.UniformTargets; "
                f"{satellite.name} is a {type(satellite).__name__} with opportunities of type {list(kinds) or 'none'}"
            )
        self.kind = wanted
        self.satellite.access_windows.expect(self.n_actions, self.n_negative_actions)

    @override
    def offers(self) -> tuple[Tensor, Tensor]:
        number = torch.zeros_like(self.satellite.simulator.ticks)  # no look-ahead for the sake of a picture
        windows = self.satellite.find_next_opportunities(self.n_actions, self.kind, number, may_see_nothing=True)
        same = windows.place.unsqueeze(-1) == windows.place.unsqueeze(-2)  # as in decide, a target's first window counts
        opens = torch.where(same, windows.open.unsqueeze(-2), torch.inf).amin(-1)
        return torch.where(windows.found.unsqueeze(-1) > 0, windows.place, -1), opens

    @override
    def mask(self) -> Tensor:
        simulator = self.satellite.simulator
        first = not simulator.type.compat and simulator.type.arguments.is_new(f"late windows of {self.name}")
        if not (self.mask_repeated or self.mask_late or first):
            return Action.mask(self)
        # whether there must be any is for observations and decisions to say
        may_see_nothing = None if self.mask_repeated else True
        offered = self.satellite.find_next_opportunities(self.n_actions, self.kind, may_see_nothing=may_see_nothing)
        early = offered.open < self.satellite.time_limit.unsqueeze(-1)
        if first:
            self._warn_of_late(offered.mask & ~early, offered.mask)
        mask = offered.mask if self.mask_repeated else Action.mask(self)
        return mask & early if self.mask_late else mask

    def _warn_of_late(self, late: Tensor, offered: Tensor) -> None:
        """Log that most of the ``offered`` windows [N, n_actions] open too ``late``."""
        share = float(late.sum()) / max(1, int(offered.sum()))
        if share > 0.5:
            logger.warning(
                "%.0f %% of the windows that %r of %s offers at the first reset open after the time limit, so their images are "
                "never taken; add targets, extend time_limit or reduce n_ahead_image: %s",
                100.0 * share,
                self.name,
                self.satellite.name,
                "action_mask excludes these windows" if self.mask_late else "action_mask allows these windows (mask_late=False)",
            )

    @override
    def decide(self, index: Tensor, mask: Tensor, action: Tensor, previous: Tensor) -> Decision:
        simulator = self.satellite.simulator
        by_index = mask & (action < 0) if self.by_index else None
        count = (index + 1) * (mask if by_index is None else mask & ~by_index)
        windows = self.satellite.find_next_opportunities(self.n_actions, self.kind, count)
        chosen = windows.place.gather(1, index.unsqueeze(-1))
        target, others = chosen.squeeze(-1), windows.place != chosen
        # the target's first window may come before the chosen one
        opens, close = (time.masked_fill(others, torch.inf).amin(1) for time in (windows.open, windows.close))
        waits = windows.found == 0
        if by_index is not None and bool(by_index.any()):
            target = torch.where(by_index, -1 - action, target)
            window = self.satellite.window_of(torch.where(by_index, target, 0), self.kind)
            why = "which has already been imaged, does not exist, or has no known window"
            self.refuse(by_index & torch.isinf(window[1]), target, lambda number: why)
            opens, close = (torch.where(by_index, *pair) for pair in zip(window, (opens, close), strict=True))
            waits = waits & ~by_index
        key, time = torch.where(waits, NO_TARGET, self.keys(target, self._first)), simulator.sim_time
        seconds = torch.where(waits, self.satellite.segment, close - time)
        duration = torch.clamp(seconds, max=self.max_duration)
        expected = torch.minimum(torch.clamp(opens - time, min=SLEW), duration)
        mode = torch.full_like(target, simulator.mode_names.index(self.flight_mode))
        return Decision(mode, (key != previous) & ~waits, duration, key, expected)

    @property
    def _first(self) -> int:
        """Number by which keys count the first target: with the second instrument, on from the last one with the first."""
        return (self._number or 0) * self.n_negative_actions

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """See :meth:`Action.begin`: set instrument and target of the pointing guidance, and arm the event of a growing store."""
        simulator, target = self.satellite.simulator, self.keys(decision.key, self._first)  # keys() is its own inverse
        mask = mask & (decision.key != NO_TARGET)
        if self._number is not None:
            choose_instrument(self.satellite, self._number, mask)
        place = torch.where(mask, target, 0).unsqueeze(-1)
        r_LP_P = self.satellite.positions(self.kind, place).squeeze(1)
        simulator.write("r_LP_P", mask & decision.retask, r_LP_P)
        simulator.write("image_level", mask, self.satellite.dynamics.partition_levels[:, 0])
        self.remember(mask, target)

    def end(self, mask: Tensor, decision: Decision, event: Tensor) -> None:
        """See :meth:`Action.end`: count windows that have closed without an image."""
        memory = self.satellite.simulator.memory
        closed = mask & ~event & (decision.duration < self.max_duration) & (decision.key != NO_TARGET)
        memory["missed"] = memory["missed"] + closed
