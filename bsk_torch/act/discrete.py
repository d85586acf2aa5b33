"""Actions that put the flight software into a mode for some time."""

from __future__ import annotations

import logging
import math

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import switch, text
from bsk_torch.act.base import LONGEST, Action, ActionTable, Decision, positive_duration
from bsk_torch.astro.frames import angle_between
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sim.dyn.events import DISARMED, DOWNLINK_TICK, EMPTY_DOWNLINKS, LEFT_OVER
from bsk_torch.sim.fsw.models import EndedDownlinkFSWModel, ImagingFSWModel
from bsk_torch.sim.instruments import INDEX, each_value, number_of

logger = logging.getLogger(__name__)

MISALIGNED = math.radians(1.0)
"""Angle, rad, by which an instrument may miss nadir without a warning."""

LEAST_DOWNLINK = 10.0
"""Shortest downlink, s."""


def choose_instrument(satellite: BoundSatellite, number: int, mask: Tensor) -> None:
    """Choose one of several instruments where ``mask`` [N] holds; what was commanded to another one is withdrawn."""
    index = satellite.simulator.read(INDEX)
    changed = mask & (index != number)
    satellite.simulator.write("instrument_command", changed, torch.zeros_like(index))
    satellite.simulator.write(INDEX, changed, torch.full_like(index, number))


def _warn_of_axis(satellite: BoundSatellite, title: str) -> None:
    kind = satellite.simulator.type
    if not isinstance(satellite.fsw, ImagingFSWModel) or kind.compat:
        return
    down = torch.tensor([-1.0, 0.0, 0.0], dtype=torch.float64)
    off = min(float(angle_between(axis, down).max()) for axis in each_value(kind.trial, "inst_pHat_B"))
    if off > MISALIGNED and kind.arguments.is_new("nadir_point"):
        logger.warning(
            "%r of %s aligns B with the Hill frame, which leaves the instrument %.0f degrees off nadir; with "
            "inst_pHat_B=[-1, 0, 0] in sat_args it looks at nadir",
            title,
            satellite.name,
            math.degrees(off),
        )


class DiscreteFSWAction(Action):
    """Enter a flight mode for ``duration`` seconds.

    Repeating the action continues the mode, unless ``reset_task`` is set.
    """

    variant: int | None = None
    """Number that tells apart entries with the same command which do not continue one another."""

    def __init__(self, fsw_action: str, name: str | None = None, duration: float | None = None, reset_task: bool = False) -> None:
        """Command a mode of the flight software.

        Args:
            fsw_action: Command of the flight-software model, such as ``"charge"``, or ``"action_charge"``.
            name: Name in ``action_description`` (default: the name of the command).
            duration: Time until the action ends, s; None for 1e9 s.
            reset_task: Whether a repeated action enters the mode again.
        """
        super().__init__(text("fsw_action", fsw_action) if name is None else name)
        self.fsw_action, self.reset_task = text("fsw_action", fsw_action), switch("reset_task", reset_task)
        self.duration = positive_duration("duration", duration, self.name, LONGEST)

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Action.link_satellite`; ValueError if the flight software has no such command."""
        super().link_satellite(satellite)
        if self.fsw_action not in satellite.simulator.type.commands:
            self.fsw_action = self.fsw_action.removeprefix("action_")
        satellite.simulator.check_command(self.fsw_action)
        if self.fsw_action == "nadir_point":
            _warn_of_axis(satellite, self.name)

    @override
    def table(self) -> ActionTable:
        mode = self.satellite.simulator.mode_index(self.fsw_action).unsqueeze(1)
        reset = torch.tensor([self.reset_task], device=mode.device)
        return ActionTable(mode, reset, torch.full((1,), self.duration, dtype=torch.float64, device=mode.device))


class Charge(DiscreteFSWAction):
    """Point the solar panel at the Sun."""

    @override
    def __init__(self, name: str = "action_charge", duration: float | None = None) -> None:
        super().__init__("charge", name, duration)


class Drift(DiscreteFSWAction):
    """Switch attitude control off; the wheels keep their last torque."""

    @override
    def __init__(self, name: str = "action_drift", duration: float | None = None) -> None:
        super().__init__("drift", name, duration)


class NadirPoint(DiscreteFSWAction):
    """Align the body frame B with the Hill frame H: x of B points away from the Earth, z along the orbit normal.

    The instrument looks at nadir if its axis is ``inst_pHat_B=[-1, 0, 0]``, which the spacecraft of :mod:`bsk_torch.craft` have.
    With the default, ``[0, 0, 1]``, it looks along the orbit normal, 90 degrees off, and a warning is logged. The property
    ``nadir_pointing_error`` of the flight software is the angle.
    """

    @override
    def __init__(self, name: str = "action_nadir_point", duration: float | None = None) -> None:
        super().__init__("nadir_point", name, duration)


class Desat(DiscreteFSWAction):
    """Desaturate the reaction wheels with thrusters; a repeated action replans the impulses from the current momentum."""

    @override
    def __init__(self, name: str = "action_desat", duration: float | None = None) -> None:
        super().__init__("desat", name, duration, reset_task=True)


class Downlink(DiscreteFSWAction):
    """Align the body frame with the Hill frame, and transmit while a ground station has access.

    With ``until_empty``, the action ends with the first tick at whose end no more than a bit is stored, but lasts 10 s at least;
    an empty store therefore costs 10 s. The satellite counts these downlinks from an empty store in its memory, see
    :class:`bsk_torch.data.OperationsPenalty`.
    """

    def __init__(self, name: str = "action_downlink", duration: float | None = None, until_empty: bool = False) -> None:
        """See :class:`DiscreteFSWAction`; ``until_empty`` tells whether an empty store ends the action."""
        super().__init__("downlink", name, duration)
        self.until_empty = switch("until_empty", until_empty)
        self.fsw_type = EndedDownlinkFSWModel if self.until_empty else None

    @override
    def link_satellite(self, satellite: BoundSatellite) -> None:
        super().link_satellite(satellite)
        if self.until_empty and EMPTY_DOWNLINKS not in satellite.memory:
            satellite.memory.declare(EMPTY_DOWNLINKS, 0, low=0)
        self.begins = DOWNLINK_TICK in satellite.simulator.state.layout.fields

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """See :meth:`Action.begin`: count a downlink from an empty store, and arm the event of an empty store or disarm it."""
        simulator, memory = self.satellite.simulator, self.satellite.memory
        tick = simulator.ticks.double() + math.ceil(LEAST_DOWNLINK / simulator.h)
        if not self.until_empty:
            simulator.write(DOWNLINK_TICK, mask, torch.full_like(tick, DISARMED))
            return
        empty = simulator.read("storage") <= LEFT_OVER
        memory[EMPTY_DOWNLINKS] = memory[EMPTY_DOWNLINKS] + (mask & empty)
        simulator.write(DOWNLINK_TICK, mask, tick)


class Scan(DiscreteFSWAction):
    """Point the instrument at nadir and record.

    A satellite with several ``instruments`` has an entry for each that it may choose. The choice holds from the next tick on, in
    which the instrument chosen before no longer records.
    """

    def __init__(
        self, name: str = "action_nadir_scan", duration: float | None = None, instrument: str | int | None = None
    ) -> None:
        """See :class:`DiscreteFSWAction`; ``instrument`` is the name or number of one of several, added to the name."""
        super().__init__("nadir_scan", name if instrument is None else f"{name}_{instrument}", duration)
        self.instrument = instrument

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Action.link_satellite`; ValueError for one that cannot scan, or lacks the instrument."""
        super().link_satellite(satellite)
        listed = satellite.simulator.type.instruments
        if listed or self.instrument is not None:
            self.variant = number_of(listed, self.instrument, f"act.Scan {self.name!r}")
        self.begins = self.variant is not None

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """See :meth:`Action.begin`: choose the instrument."""
        assert self.variant is not None
        choose_instrument(self.satellite, self.variant, mask)


PENDING = "broadcast_pending"
"""Name of the value in ``simulator.memory`` that marks satellites with an unsent message, [N] bool."""


class Broadcast(Action):
    """Send a satellite's knowledge to the satellites that can receive it; its flight mode continues.

    Use it with :class:`~bsk_torch.comm.BroadcastCommunication`. The message is sent at the end of the step, which another
    satellite may end before ``duration`` has passed. The next action counts as new, even if it equals the action before the
    broadcast.
    """

    def __init__(self, name: str = "action_broadcast", duration: float | None = None) -> None:
        """Last ``duration`` seconds, None for 1e9 s; ValueError unless it is positive."""
        super().__init__(name)
        self.duration = positive_duration("duration", duration, name, LONGEST)

    @override
    def link_satellite(self, satellite: BoundSatellite) -> None:
        super().link_satellite(satellite)
        if PENDING not in satellite.simulator.memory:
            satellite.simulator.memory.declare(PENDING, False, dtype=torch.bool)

    @override
    def decide(self, index: Tensor, mask: Tensor, action: Tensor, previous: Tensor) -> Decision:
        seconds = torch.full_like(action, self.duration, dtype=torch.float64)
        return Decision(self.satellite.simulator.mode, torch.zeros_like(mask), seconds, action, seconds)

    @override
    def begin(self, mask: Tensor, decision: Decision) -> None:
        memory = self.satellite.simulator.memory
        memory[PENDING] = memory[PENDING] | mask
