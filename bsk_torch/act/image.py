"""Imaging one of the next targets."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch.act.base import Action, Decision
from bsk_torch.sim.queries import positions

if TYPE_CHECKING:
    from bsk_torch.sats.satellite import Satellite

SLEW = 40.0
"""About the time, s, in which a satellite turns to a target: what runs are sorted by."""


NOTHING = -1
"""Key of an action without a target, and of none at all."""


def of_target(target: Tensor | int) -> Tensor | int:
    """The action that images a target of a given index, wherever it stands among the next ones."""
    return -1 - target


class Image(Action):
    """Images the target of the k-th next window, for k up to ``n_ahead_image``.

    The action ends when the image has been taken, when the target's window closes, or after ``max_duration``. Choosing the same
    target again goes on waiting for it: a target is not imaged twice in a row. Actions -1, -2 and so on mean the target 0, 1 and
    so on by its index in the scenario; see :func:`of_target`.
    """

    def __init__(
        self, n_ahead_image: int, max_duration: float | None = None, name: str = "action_image", mask_repeated: bool = False
    ) -> None:
        """Stand for ``n_ahead_image`` actions.

        Args:
            n_ahead_image: Number of targets to choose from.
            max_duration: Longest duration, s; None for as long as the window lasts.
            name: Name in ``action_description``.
            mask_repeated: Whether ``action_mask`` excludes actions that repeat the last target because there are no more.

        Raises:
            ValueError: For fewer than one target or a duration that is not positive.
        """
        super().__init__(name)
        if n_ahead_image < 1:
            raise ValueError(f"n_ahead_image={n_ahead_image} must be at least 1")
        if max_duration is not None and not max_duration > 0.0:
            raise ValueError(f"max_duration={max_duration!r} s of action {name!r} must be positive, or None")
        self.n_actions, self.mask_repeated = n_ahead_image, mask_repeated
        self.max_duration = float("inf") if max_duration is None else float(max_duration)

    def link_satellite(self, satellite: Satellite) -> None:
        """See :meth:`Action.link_satellite`; ValueError for a satellite that cannot image or has no targets."""
        super().link_satellite(satellite)
        satellite.simulator.check_command("image")
        kinds = getattr(satellite, "opportunity_types", ())
        if not hasattr(satellite, "target_types") or satellite.target_types not in kinds:
            raise ValueError(
                f"{self.name!r} needs a sats.ImagingSatellite and a scenario with targets, such as scene.UniformTargets; "
                f"{satellite.name} is a {type(satellite).__name__} with opportunities of type {list(kinds) or 'none'}"
            )
        self.kind = satellite.target_types
        targets = satellite.simulator.tables["target_exists"].shape[1]
        satellite.simulator.access.expect(self.n_actions, targets)  # type: ignore[union-attr]

    @property
    def explicit(self) -> int:
        """See :attr:`Action.explicit`."""
        return self.satellite.simulator.tables["target_exists"].shape[1]

    def mask(self) -> Tensor:
        """See :meth:`Action.mask`."""
        if not self.mask_repeated:
            return super().mask()
        return self.satellite.find_next_opportunities(self.n_actions, self.kind).mask

    def decide(self, index: Tensor, mine: Tensor, action: Tensor, previous: Tensor) -> Decision:
        """See :meth:`Action.decide`."""
        simulator = self.satellite.simulator
        known = self.satellite.find_next_opportunities(self.n_actions, self.kind, torch.where(mine & (action >= 0), index + 1, 0))
        slot = index.unsqueeze(-1)
        target = known.place.gather(1, slot).squeeze(-1)
        same = known.place == target.unsqueeze(-1)  # its first window, which may come before the one that was chosen
        opens, close = (torch.where(same, time, torch.inf).amin(1) for time in (known.open, known.close))
        by_index = mine & (action < 0)
        if bool(by_index.any()):
            target, opens, close = self._explicit(by_index, action, target, opens, close)
        waits = (known.found == 0) & ~by_index
        key, time = torch.where(waits, NOTHING, self.keys(target)), simulator.sim_time
        seconds = torch.where(waits, self.satellite.segment, close - time)
        duration = torch.clamp(seconds, max=self.max_duration)
        expected = torch.minimum(torch.clamp(opens - time, min=SLEW), duration)
        mode = torch.full_like(target, simulator.mode_names.index("image"))
        return Decision(mode, (key != previous) & ~waits, duration, key, expected)

    @staticmethod
    def keys(target: Tensor) -> Tensor:
        """What the action is remembered by: other actions have keys from 0 on, and -1 is :data:`NOTHING`."""
        return -2 - target

    def _explicit(self, rows: Tensor, action: Tensor, *found: Tensor) -> tuple[Tensor, ...]:
        """Target and window of the rows that name a target by its index; ValueError where it has no window."""
        target = torch.where(rows, -1 - action, 0)
        window = self.satellite.window_of(target)
        lost = rows & torch.isinf(window[1])
        if bool(lost.any()):
            row = int(torch.nonzero(lost)[0])
            raise ValueError(
                f"action {int(action[row])} of {self.satellite.title(row)} asks for target {int(target[row])}, which has "
                "been imaged, does not exist, or has no window that is known now"
            )
        return tuple(torch.where(rows, a, b) for a, b in zip((target, *window), found, strict=True))

    def begin(self, rows: Tensor, decision: Decision) -> None:
        """See :meth:`Action.begin`: aim, and wait for the store to grow."""
        simulator, target = self.satellite.simulator, -2 - decision.key
        rows = rows & (decision.key != NOTHING)
        place = positions(simulator, self.kind, torch.where(rows, target, 0).unsqueeze(-1)).squeeze(1)
        simulator.write("target_r_P", rows & decision.retask, place)
        simulator.write("image_level", rows, self.satellite.dynamics.partition_levels[:, 0])
        memory = simulator.memory
        memory["latest_target"] = torch.where(rows, target, memory["latest_target"])

    def end(self, rows: Tensor, decision: Decision, event: Tensor) -> None:
        """See :meth:`Action.end`: a window that has closed without an image was missed."""
        memory = self.satellite.simulator.memory
        closed = rows & ~event & (decision.duration < self.max_duration) & (decision.key != NOTHING)
        memory["missed"] = memory["missed"] + closed
