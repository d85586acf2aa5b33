"""Actions chosen by an integer."""

from __future__ import annotations

import logging
from abc import abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from gymnasium import spaces
from typing_extensions import override

from bsk_torch.act.base import LONGEST
from bsk_torch.bsk_rl.act.actions import Action, ActionBuilder

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite


logger = logging.getLogger(__name__)


class DiscreteActionBuilder(ActionBuilder):
    """Selects an action by its index; ``prev_action_key`` was returned by the last one, None at the start of an episode."""

    @override
    def __init__(self, satellite: Satellite) -> None:
        super().__init__(satellite)
        self.prev_action_key: object = None

    def reset_post_sim_init(self) -> None:
        """See :meth:`ActionBuilder.reset_post_sim_init`; there is no last action."""
        super().reset_post_sim_init()
        self.prev_action_key = None

    @property
    @override
    def action_space(self) -> spaces.Discrete:
        return spaces.Discrete(sum(entry.n_actions for entry in self.action_spec))

    @property
    @override
    def action_description(self) -> list[str]:
        return [
            entry.name if entry.n_actions == 1 else f"{entry.name}_{k}"
            for entry in self.action_spec
            for k in range(entry.n_actions)
        ]

    def set_action(self, action: Any) -> None:
        """Start the action with an index; other values are passed to ``set_action_override``. ValueError if none accepts it."""
        self.satellite.disable_timed_terminal_event()
        if not np.issubdtype(type(action), np.integer):
            self._override(action)
            return
        first = 0
        for entry in self.action_spec:
            if first + entry.n_actions > action:
                self.prev_action_key = entry.set_action(action - first, prev_action_key=self.prev_action_key)
                return
            first += entry.n_actions
        raise ValueError(f"Action index {action} out of range.")

    def _override(self, action: object) -> None:
        logger.warning("Action '%s' is not an integer. Will attempt to use compatible set_action_override method.", action)
        for entry in self.action_spec:
            try:
                self.prev_action_key = entry.set_action_override(action, prev_action_key=self.prev_action_key)
            except (AttributeError, TypeError):
                continue
            return
        raise ValueError(f"Action '{action}' is not an integer and no compatible set_action_override method found.")


class DiscreteAction(Action):
    """One or more actions selected by an integer.

    Subclasses may define ``set_action_override(action, prev_action_key)`` for actions that are not integers.
    """

    builder_type = DiscreteActionBuilder

    def __init__(self, name: str = "discrete_act", n_actions: int = 1) -> None:
        """Initialize the entry, which represents ``n_actions`` actions."""
        super().__init__(name=name)
        self.n_actions = n_actions

    @abstractmethod
    def set_action(self, action: int, prev_action_key: object = None) -> object:
        """Start the action with an index in this entry; return a key that identifies it."""


class DiscreteFSWAction(DiscreteAction):
    """Calls a flight software command and lasts for a fixed time."""

    def __init__(self, fsw_action: str, name: str | None = None, duration: float | None = None, reset_task: bool = False) -> None:
        """Initialize the action.

        Args:
            fsw_action: Name of the flight software method, such as ``"action_charge"``.
            name: Name of the action (default: name of the method).
            duration: Duration of the action, s; None for 1e9 s.
            reset_task: Whether a repeated action calls the command again.
        """
        super().__init__(name=fsw_action if name is None else name)
        self.fsw_action, self.reset_task = fsw_action, reset_task
        self.duration = LONGEST if duration is None else duration

    @override
    def set_action(self, action: int, prev_action_key: object = None) -> object:
        assert action == 0
        self.satellite.logger.info("%s tasked for %s seconds", self.name, self.duration)
        self.satellite.update_timed_terminal_event(self.simulator.sim_time + self.duration, info=f"for {self.fsw_action}")
        if self.reset_task or prev_action_key != self.fsw_action:
            getattr(self.satellite.fsw, self.fsw_action)()
        return self.fsw_action


class FSWCommand(DiscreteFSWAction):
    """An action whose class names the flight software command."""

    command: ClassVar[str]
    resets: ClassVar[bool] = False

    @override
    def __init__(self, name: str | None = None, duration: float | None = None) -> None:
        super().__init__(self.command, name, duration, self.resets)


class Charge(FSWCommand):
    """Points the solar panel at the Sun."""

    command = "action_charge"


class Drift(FSWCommand):
    """Turns off attitude control."""

    command = "action_drift"


class NadirPoint(FSWCommand):
    """Aligns the body with the Hill frame."""

    command = "action_nadir_point"


class Desat(FSWCommand):
    """Desaturates the wheels with thrusters."""

    command, resets = "action_desat", True


class Downlink(FSWCommand):
    """Transmits data to ground stations in view."""

    command = "action_downlink"


class Scan(FSWCommand):
    """Records the ground below."""

    command = "action_nadir_scan"


class Image(DiscreteAction):
    """Images the target of one of the next opportunities."""

    def __init__(self, n_ahead_image: int, max_duration: float | None = None, name: str = "action_image") -> None:
        """Initialize actions for the next ``n_ahead_image`` opportunities, each lasting at most ``max_duration`` s."""
        super().__init__(name=name, n_actions=n_ahead_image)
        self.max_duration = max_duration

    def image(self, target: Any, prev_action_key: Any = None) -> Any:
        """Image a target, given as an index, an id or the target; repeating the last target continues its task."""
        target = self.satellite.parse_target_selection(target)
        begin = self.satellite.enable_target_window if target.id == prev_action_key else self.satellite.task_target_for_imaging
        begin(target, max_duration=self.max_duration)
        return target.id

    @override
    def set_action(self, action: int, prev_action_key: object = None) -> object:
        self.satellite.logger.info("target index %s tasked", action)
        return self.image(action, prev_action_key)

    def set_action_override(self, action: object, prev_action_key: object = None) -> object:
        """Image a target, given as itself or its id."""
        return self.image(action, prev_action_key)


class Broadcast(DiscreteAction):
    """Makes the satellite share its data, with a communication method that checks for this action."""

    broadcast_pending: bool

    def __init__(self, name: str = "action_broadcast", duration: float | None = None) -> None:
        """Initialize the action, which lasts ``duration`` s; None for 1e9 s."""
        super().__init__(name=name)
        self.duration = LONGEST if duration is None else duration

    def reset_post_sim_init(self) -> None:
        """See :meth:`Action.reset_post_sim_init`; nothing is to be shared."""
        super().reset_post_sim_init()
        self.broadcast_pending = False

    @override
    def set_action(self, action: int, prev_action_key: object = None) -> object:
        assert action == 0
        self.broadcast_pending = True
        self.satellite.update_timed_terminal_event(self.simulator.sim_time + self.duration, info="for broadcast")
        return self.name
