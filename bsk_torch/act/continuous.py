"""Base classes of actions that are real numbers, alone or alongside a choice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch._checks import text
from bsk_torch.act.base import BSK_RL, Action, Decision
from bsk_torch.sim.hooks import check_class

if TYPE_CHECKING:
    from bsk_torch.sats.bound import BoundSatellite
    from bsk_torch.sim.fsw.models import FSWModel

HOOKS = ("link_satellite", "bounds", "names", "decide", "begin", "end", "choices", "mask")
"""Members of :class:`ContinuousAction` and :class:`HybridAction` that subclasses may define."""

DECIDE = (
    "define decide(action, mask), which returns the modes and durations of all satellites, and begin(mask, decision) for what "
    "follows the commands; self.enter(command, duration) makes such a decision"
)

UNUSED = {
    "set_action": DECIDE,
    "set_action_override": DECIDE,
    "space": "define bounds(), which returns the lowest and the highest values",
    "action_space": "define bounds(), which returns the lowest and the highest values",
    "builder_type": "an act.ContinuousAction is the only entry of its action_spec",
    "n_actions": "an act.ContinuousAction has as many numbers as names() returns; act.HybridAction has choices()",
    "n_negative_actions": "an act.ContinuousAction has no numbers of actions",
    "table": DECIDE,
    **BSK_RL,
}
"""Names that are no hooks of continuous actions, those of bsk_rl among them, and what to write instead."""


class ContinuousAction:
    """The only entry of an ``action_spec``: actions of A real numbers.

    N is the number of satellites of the type. Every action is carried out, also one that equals the one before: the flight
    software enters its mode, and resets what the mode resets. All numbers are float64 inside, whatever type they were given in.
    Values outside :meth:`bounds` reach :meth:`decide` as they are; what they mean is the action's.

    Subclasses define :meth:`bounds`, :meth:`names` and :meth:`decide`; the other hooks are optional.

    Attributes:
        name: Name of the entry.
        satellite: The satellites, once an environment has been built.
        given_dtype: Type in which the actions of the present step were given.
        fsw_type: Flight software that the action adds to that of the satellite; None for nothing.
    """

    satellite: BoundSatellite
    given_dtype: torch.dtype = torch.float64
    fsw_type: type[FSWModel] | None = None

    def __init__(self, name: str) -> None:
        """Name the entry; ValueError for a name that is no string."""
        self.name = text("name", name)

    def __init_subclass__(cls, **options: object) -> None:
        """Refuse definitions that no environment would use; TypeError says what to write instead."""
        super().__init_subclass__(**options)
        check_class(cls, ContinuousAction, [hook for hook in HOOKS if hook in vars(ContinuousAction)], UNUSED)

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """Prepare for a satellite; called once when an environment is built.

        Overriding methods call ``super().link_satellite(satellite)`` first, and raise ValueError for a satellite that lacks
        something that the action needs.
        """
        self.satellite = satellite

    def bounds(self) -> tuple[Tensor | Sequence[float], Tensor | Sequence[float]]:
        """Return the lowest and the highest values of actions, [A] each; they may be infinite.

        They are asked for once, after :meth:`link_satellite`, and become the action space of all agents of the type.
        """
        raise NotImplementedError(f"{type(self).__name__} must implement bounds()")

    def names(self) -> list[str]:
        """Return the names of the A numbers."""
        raise NotImplementedError(f"{type(self).__name__} must implement names()")

    def decide(self, action: Tensor, mask: Tensor) -> Decision:
        """Return the commands of actions; nothing may change yet, since the decisions of all satellites are made first.

        Args:
            action: Actions, [N, A] float64: finite, but not always within the bounds.
            mask: Whether an action is carried out now, [N] bool; the commands of other rows are ignored.
        """
        raise NotImplementedError(f"{type(self).__name__} must implement decide(action, mask)")

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """Called after actions have been commanded, in the rows ``mask`` [N] bool; ``decision.command`` is decide()'s."""

    def end(self, mask: Tensor, decision: Decision, event: Tensor) -> None:
        """Called after actions have ended within an episode; ``decision.command`` is the action, [N, A].

        See :meth:`bsk_torch.act.Action.end`.
        """

    def enter(self, fsw_action: str, duration: Tensor, command: Tensor | None = None) -> Decision:
        """Return the decision to enter a mode of the flight software, also the present one.

        Args:
            fsw_action: Command of the flight software, such as ``"charge"``.
            duration: Time after which the actions end, [N] s.
            command: What :meth:`begin` needs, [N, ...].
        """
        mode = self.satellite.simulator.mode_index(fsw_action)
        reenter = torch.ones_like(mode, dtype=torch.bool)
        return Decision(mode, reenter, duration, torch.zeros_like(mode), duration, command)


class HybridAction(ContinuousAction):
    """Actions of A real numbers and one of K choices, such as a manoeuvre and a flight mode.

    The action of an environment has two parts, ``"values"`` [..., A] and ``"choice"`` [...]; ``action_mask`` [..., K] says which
    choices are legal. Subclasses define :meth:`choices` and the hooks of :class:`ContinuousAction`, whose :meth:`bounds` and
    :meth:`names` are those of the real numbers.

    In :meth:`decide`, the last of the A + 1 columns of ``action`` is the number of the choice.
    """

    def __init_subclass__(cls, **options: object) -> None:
        """Refuse definitions that no environment would use; TypeError says what to write instead."""
        super().__init_subclass__(**options)
        check_class(cls, HybridAction, HOOKS, UNUSED)

    def choices(self) -> list[str]:
        """Return the names of the K choices."""
        raise NotImplementedError(f"{type(self).__name__} must implement choices()")

    def mask(self) -> Tensor:
        """Return which choices are legal now, [N, K] bool; all of them unless overridden."""
        ticks = self.satellite.simulator.ticks
        return torch.ones(len(ticks), len(self.choices()), dtype=torch.bool, device=ticks.device)


def is_continuous(entry: object) -> bool:
    """Return whether an entry of an ``action_spec`` has real numbers; ValueError for what is no entry."""
    if not isinstance(entry, Action | ContinuousAction):
        raise ValueError(f"action_spec holds {entry!r}, which is no action; write act.Charge(), with parentheses")
    return isinstance(entry, ContinuousAction)
