"""Continuous actions, alone or combined with a discrete choice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.act.base import Action, Decision, Entry
from bsk_torch.sim.fsw.setpoint import ATTITUDE_MRP, AttitudeSetpointFSWModel
from bsk_torch.sim.hooks import check_class

HOOKS = ("link_satellite", "bounds", "names", "decide", "begin", "end", "choices", "mask")
"""Members of :class:`ContinuousAction` and :class:`HybridAction` that subclasses may define."""


class ContinuousAction(Entry):
    """The only entry of an ``action_spec``: actions of A real numbers.

    Every action is executed, even if it equals the previous one: the flight software enters its mode, and resets the fields that
    the mode resets. Numbers are converted to float64. Values outside :meth:`bounds` are passed to :meth:`decide` unchanged; the
    action defines their meaning.

    Subclasses define :meth:`bounds`, :meth:`names` and :meth:`decide`; the other hooks are optional.

    ``decision.command`` in :meth:`begin` is that of :meth:`decide`, in :meth:`end` the ended action, [N, A].

    Attributes:
        given_dtype: Input dtype of the actions of the current step.
    """

    given_dtype: torch.dtype = torch.float64

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_class(cls, ContinuousAction, [hook for hook in HOOKS if hasattr(ContinuousAction, hook)])

    def bounds(self) -> tuple[Tensor | Sequence[float], Tensor | Sequence[float]]:
        """Return the lower and upper bounds of actions, [A] each; they may be infinite.

        Called once, after :meth:`link_satellite`; defines the action space of all agents of the type.
        """
        raise NotImplementedError(f"{type(self).__name__} must implement bounds()")

    def names(self) -> list[str]:
        """Return the names of the A numbers."""
        raise NotImplementedError(f"{type(self).__name__} must implement names()")

    def decide(self, action: Tensor, mask: Tensor) -> Decision:
        """Return the commands of actions; must not change anything, since all satellites decide first.

        Args:
            action: Actions, [N, A] float64: finite, but not always within the bounds.
            mask: Whether an action is executed now, [N] bool; the commands of other rows are ignored.
        """
        raise NotImplementedError(f"{type(self).__name__} must implement decide(action, mask)")

    def enter(self, fsw_action: str, duration: Tensor, command: Tensor | None = None) -> Decision:
        """Return the decision to enter the mode of a command for ``duration`` [N] s, even if it is already active."""
        mode = self.satellite.simulator.mode_index(fsw_action)
        reenter = torch.ones_like(mode, dtype=torch.bool)
        return Decision(mode, reenter, duration, torch.zeros_like(mode), duration, command)


class HybridAction(ContinuousAction):
    """Actions of A real numbers and one of K choices, such as a maneuver and a flight mode.

    The action of an environment has two parts, ``"values"`` [..., A] and ``"choice"`` [...]; ``action_mask`` [..., K] marks legal
    choices. Subclasses define :meth:`choices` and the hooks of :class:`ContinuousAction`; :meth:`bounds` and :meth:`names` refer
    to the real numbers.

    In :meth:`decide`, the last of the A + 1 columns of ``action`` is the number of the choice.
    """

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_class(cls, HybridAction, HOOKS)

    def choices(self) -> list[str]:
        """Return the names of the K choices."""
        raise NotImplementedError(f"{type(self).__name__} must implement choices()")

    def mask(self) -> Tensor:
        """Return which choices are legal now, [N, K] bool (default: all)."""
        ticks = self.satellite.simulator.ticks
        return torch.ones(len(ticks), len(self.choices()), dtype=torch.bool, device=ticks.device)


def is_continuous(entry: object) -> bool:
    """Return whether an entry of an ``action_spec`` is continuous; ValueError unless it is an action."""
    if not isinstance(entry, Action | ContinuousAction):
        raise ValueError(f"action_spec holds {entry!r}, which is not an action; write act.Charge(), with parentheses")
    return isinstance(entry, ContinuousAction)


class AttitudeSetpoint(ContinuousAction):
    """Turn to an attitude, and hold it: the action is sigma_RN, the MRP of the reference R relative to N.

    The reference is inertially fixed and stays until the next action. With reaction wheels, the control law turns the satellite
    the short way around. Components up to one allow MRPs longer than one, which represent the same attitudes. A satellite without
    actuators has the attitude of the reference after one tick, and reports the MRP as given, even if longer than one.
    """

    fsw_type = AttitudeSetpointFSWModel

    def __init__(self, name: str = "attitude_act", control_period: float = 60.0) -> None:
        """Last ``control_period`` seconds; ValueError unless it is positive and finite."""
        super().__init__(name)
        self.control_period = number(f"action {name!r}: control_period", control_period, 0.0, unit="s", above=True)

    def bounds(self) -> tuple[Tensor, Tensor]:
        """See :meth:`ContinuousAction.bounds`: -1 and 1."""
        one = torch.ones(3, dtype=torch.float64)
        return -one, one

    @override
    def names(self) -> list[str]:
        return ["mrp_1", "mrp_2", "mrp_3"]

    @override
    def decide(self, action: Tensor, mask: Tensor) -> Decision:
        return self.enter(ATTITUDE_MRP, torch.full_like(action[:, 0], self.control_period), action)

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """See :meth:`ContinuousAction.begin`: set the reference."""
        self.satellite.simulator.write("sigma_RN", mask, cast(Tensor, decision.command))
