"""Actions of one satellite, and how they are chosen."""

from __future__ import annotations

from abc import ABC, abstractmethod
from copy import deepcopy
from typing import TYPE_CHECKING, Any, ClassVar

from typing_extensions import override

from bsk_torch.bsk_rl.utils.functional import Part, ResetableGroup

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite


def select_action_builder(satellite: Satellite) -> ActionBuilder:
    """Return the builder of a satellite's actions.

    Raises:
        ValueError: For a satellite without actions.
        NotImplementedError: For actions of several kinds, as in bsk_rl.
    """
    if not satellite.action_spec:
        raise ValueError(f"{type(satellite).__name__}.action_spec is empty; give it at least one action")
    kinds = {entry.builder_type for entry in satellite.action_spec}
    if len(kinds) != 1:
        raise NotImplementedError(
            f"{type(satellite).__name__}.action_spec mixes actions of {sorted(kind.__name__ for kind in kinds)}: give it "
            "discrete actions alone, or one continuous action"
        )
    return kinds.pop()(satellite)


class ActionBuilder(ABC, ResetableGroup):
    """Chooses among the actions of a satellite, ``action_spec``: copies of those of its class."""

    def __init__(self, satellite: Satellite) -> None:
        self.satellite = satellite
        self.simulator: Any = None
        self.action_spec: Any = deepcopy(list(satellite.action_spec))
        for entry in self.action_spec:
            entry.link_satellite(satellite)

    @override
    def _parts(self) -> list[Action]:
        return self.action_spec

    @override
    def reset_post_sim_init(self) -> None:
        self.simulator = self.satellite.simulator
        for entry in self.action_spec:
            entry.link_simulator(self.simulator)
        super().reset_post_sim_init()

    @property
    @abstractmethod
    def action_space(self) -> object:
        """Space of the actions."""

    @property
    @abstractmethod
    def action_description(self) -> object:
        """Names of the actions."""

    @abstractmethod
    def set_action(self, action: object) -> None:
        """Begin an action."""


class Action(ABC, Part):
    """An action. Subclasses define :meth:`set_action`."""

    builder_type: ClassVar[type[ActionBuilder]]

    def __init__(self, name: str = "act") -> None:
        self.name = name

    @property
    def may_hold_attitude(self) -> bool:
        """Whether the action may command an attitude set-point; those of users' classes may."""
        return not type(self).__module__.startswith(__name__.partition(".")[0] + ".")

    @abstractmethod
    def set_action(self, action: Any) -> Any:
        """Begin the action."""
