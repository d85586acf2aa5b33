"""Actions that put the flight software into a mode for a while. Names and defaults are bsk_rl's."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch.act.base import Action, Decision, Table

if TYPE_CHECKING:
    from bsk_torch.sats.satellite import Satellite

FOREVER = 1e9
"""Duration, s, of an action that nothing but another event ends."""


class DiscreteFSWAction(Action):
    """Enter a flight mode for ``duration`` seconds.

    The same action twice in a row lets the mode run on, unless ``reset_task`` is set.
    """

    def __init__(self, fsw_action: str, name: str | None = None, duration: float | None = None, reset_task: bool = False) -> None:
        """Command ``fsw_action`` of the flight-software model; ValueError for a duration that is not positive."""
        super().__init__(name or fsw_action)
        self.fsw_action, self.reset_task = fsw_action, reset_task
        self.duration = FOREVER if duration is None else float(duration)
        if not self.duration > 0.0:
            raise ValueError(f"duration={duration!r} s of action {self.name!r} must be positive")

    def link_satellite(self, satellite: Satellite) -> None:
        """See :meth:`Action.link_satellite`; ValueError if the flight software has no such command."""
        super().link_satellite(satellite)
        satellite.simulator.check_command(self.fsw_action)

    def table(self) -> Table | None:
        """See :meth:`Action.table`; None for a subclass that decides otherwise."""
        if type(self).decide is not DiscreteFSWAction.decide:
            return None
        mode = self.satellite.simulator.mode_index(self.fsw_action).unsqueeze(1)
        reset = torch.tensor([self.reset_task], device=mode.device)
        return Table(mode, reset, torch.full((1,), self.duration, dtype=torch.float64, device=mode.device))

    def decide(self, index: Tensor, mine: Tensor, action: Tensor, previous: Tensor) -> Decision:
        """See :meth:`Action.decide`."""
        mode = self.satellite.simulator.mode_index(self.fsw_action)
        retask = torch.ones_like(mine) if self.reset_task else action != previous
        duration = torch.full_like(mode, self.duration, dtype=torch.float64)
        return Decision(mode, retask, duration, action, duration)


class Charge(DiscreteFSWAction):
    """Point the solar panel at the Sun."""

    def __init__(self, name: str = "action_charge", duration: float | None = None) -> None:
        """See :class:`DiscreteFSWAction`."""
        super().__init__("charge", name, duration)


class Drift(DiscreteFSWAction):
    """Switch control off; the wheels keep their last torque."""

    def __init__(self, name: str = "action_drift", duration: float | None = None) -> None:
        """See :class:`DiscreteFSWAction`."""
        super().__init__("drift", name, duration)


class NadirPoint(DiscreteFSWAction):
    """Align the body with the Hill frame."""

    def __init__(self, name: str = "action_nadir_point", duration: float | None = None) -> None:
        """See :class:`DiscreteFSWAction`."""
        super().__init__("nadir_point", name, duration)


class Desat(DiscreteFSWAction):
    """Fire thrusters to slow the wheels down; a repeated action measures their momentum anew."""

    def __init__(self, name: str = "action_desat", duration: float | None = None) -> None:
        """See :class:`DiscreteFSWAction`."""
        super().__init__("desat", name, duration, reset_task=True)


class Downlink(DiscreteFSWAction):
    """Align with the Hill frame and transmit while a station sees the satellite."""

    def __init__(self, name: str = "action_downlink", duration: float | None = None) -> None:
        """See :class:`DiscreteFSWAction`."""
        super().__init__("downlink", name, duration)


class Scan(DiscreteFSWAction):
    """Point the instrument down and record."""

    def __init__(self, name: str = "action_nadir_scan", duration: float | None = None) -> None:
        """See :class:`DiscreteFSWAction`."""
        super().__init__("nadir_scan", name, duration)
