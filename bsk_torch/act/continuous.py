"""Base classes of continuous actions, alone or combined with a discrete choice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch._checks import text
from bsk_torch.act.base import Action, Decision
from bsk_torch.sim.hooks import check_class

if TYPE_CHECKING:
    from bsk_torch.sats.bound import BoundSatellite
    from bsk_torch.sim.fsw.models import FSWModel

HOOKS = ("link_satellite", "bounds", "names", "decide", "begin", "end", "choices", "mask")
"""Members of :class:`ContinuousAction` and :class:`HybridAction` that subclasses may define."""


class ContinuousAction:
    """The only entry of an ``action_spec``: actions of A real numbers.

    N is the number of satellites of the type. Every action is executed, even if it equals the previous one: the flight software
    enters its mode, and resets the fields that the mode resets. Numbers are converted to float64. Values outside :meth:`bounds`
    are passed to :meth:`decide` unchanged; the action defines their meaning.

    Subclasses define :meth:`bounds`, :meth:`names` and :meth:`decide`; the other hooks are optional.

    Attributes:
        name: Name of the entry.
        satellite: The satellites, once an environment has been built.
        given_dtype: Input dtype of the actions of the current step.
        fsw_type: Flight software added to the satellite's by the action; None for none.
    """

    satellite: BoundSatellite
    given_dtype: torch.dtype = torch.float64
    fsw_type: type[FSWModel] | None = None

    def __init__(self, name: str) -> None:
        """Name the entry; ValueError unless the name is a string."""
        self.name = text("name", name)

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_class(cls, ContinuousAction, [hook for hook in HOOKS if hook in vars(ContinuousAction)])

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """Prepare for a satellite; called once when an environment is built.

        Overriding methods call ``super().link_satellite(satellite)`` first, and raise ValueError for a satellite that lacks
        something needed by the action.
        """
        self.satellite = satellite

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

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """Called after actions have been commanded, in the rows ``mask`` [N] bool; ``decision.command`` is decide()'s."""

    def end(self, mask: Tensor, decision: Decision, event: Tensor) -> None:
        """Called after actions have ended within an episode; ``decision.command`` is the action, [N, A].

        See :meth:`bsk_torch.act.Action.end`.
        """

    def enter(self, fsw_action: str, duration: Tensor, command: Tensor | None = None) -> Decision:
        """Return the decision to enter a mode of the flight software, even if it is already active.

        Args:
            fsw_action: Command of the flight software, such as ``"charge"``.
            duration: Time after which the actions end, [N] s.
            command: Value passed to :meth:`begin`, [N, ...].
        """
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
