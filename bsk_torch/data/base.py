"""Base class of rewarders."""

from __future__ import annotations

import inspect
from abc import ABCMeta
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor

from bsk_torch.data.store import Data, DataStore  # noqa: F401  bsk_rl has them in this module, too
from bsk_torch.sim.hooks import check_class

if TYPE_CHECKING:
    from bsk_torch.sats.fleet import SatelliteFleet
    from bsk_torch.scene.base import Scenario
    from bsk_torch.sim.state import StateTable

Log = dict[str, Tensor]
"""Properties of the satellites at a decision boundary by name, [N, S, ...] each."""

HOOKS = ("link", "read_log", "calculate_reward", "share", "counts", "is_terminated", "is_truncated")
"""Members of :class:`GlobalReward` that subclasses may define."""

LOGS = "define read_log(), and calculate_reward(before, after), which gets what it returned before and after a step"
MEMORY = (
    "keep values that are reset with every episode in fleet.memory, where link(scenario, fleet) declares them: "
    "memory.declare(name, initial_value, *shape)"
)

UNUSED = {
    "reward": "define calculate_reward(before, after)",
    "get_log_state": LOGS,
    "compare_log_states": LOGS,
    "update_from_logs": LOGS,
    "link_scenario": "define link(scenario, fleet)",
    "link_satellite": "define link(scenario, fleet); fleet.each(function) reads a property of all satellites",
    "link_simulator": "define link(scenario, fleet)",
    "stage_communicated_data": "define share(links)",
    "update_with_communicated_data": "define share(links)",
    "reset_overwrite_previous": MEMORY,
    "reset_pre_sim_init": MEMORY,
    "reset_during_sim_init": MEMORY,
    "reset_post_sim_init": MEMORY,
}
"""Names that are not hooks of rewarders, including bsk_rl's, and their replacements."""


MARKS = ("data_store_type", "datastore_type", "data_type", "create_data_store", "initial_data")
"""Names defined only by rewarders in bsk_rl's form."""

SINGLE_ARGUMENTS = {"calculate_reward": (1, 2), "is_terminated": (1, 0), "is_truncated": (1, 0)}
"""Methods with different arguments in bsk_rl's form: the number of arguments there and here, without ``self``."""


def is_single_form(body: Mapping[str, Any]) -> bool:
    """Return whether the body of a class is in bsk_rl's form: rewards of one environment, from data of each satellite."""
    return any(name in body for name in MARKS) or any(
        takes(body[name], theirs) and not takes(body[name], ours)
        for name, (theirs, ours) in SINGLE_ARGUMENTS.items()
        if inspect.isfunction(body.get(name))
    )


def takes(function: Callable[..., object], count: int) -> bool:
    """Return whether a method can be called with ``count`` arguments in addition to ``self``."""
    try:
        inspect.signature(function).bind(*[None] * (count + 1))
    except TypeError:
        return False
    return True


class RewarderType(ABCMeta):
    """Class of rewarders. Those whose body is in bsk_rl's form derive from bases of that form, which run per environment."""

    def __new__(cls, name: str, bases: tuple[type, ...], body: dict[str, Any], **options: object) -> RewarderType:
        """Make a class; TypeError for one in bsk_rl's form whose base has no counterpart there."""
        if is_single_form(body):
            bases = tuple(cls._single(name, base) for base in bases)
        return super().__new__(cls, name, bases, body, **options)

    @staticmethod
    def _single(name: str, base: type) -> type:
        if not isinstance(base, RewarderType) or getattr(base, "is_single", False):
            return base
        if (found := vars(base).get("single")) is None:
            raise TypeError(
                f"{name} is in bsk_rl's form, for which {base.__name__} has no counterpart; derive from data.GlobalReward, "
                "NoReward, ScanningTimeReward or UniqueImageReward, or define read_log() and calculate_reward(before, after)"
            )
        return found


class GlobalReward(metaclass=RewarderType):
    """Base class of rewarders, which compute rewards from logs read before and after a step.

    Subclasses define :meth:`calculate_reward`, and :meth:`read_log` to read the values it needs; the other hooks are optional. N
    is the number of episodes, S the number of satellites in each. :meth:`bsk_torch.sim.fleet.Fleet.each` reads a property of all
    satellites.

    A subclass may also be in bsk_rl's form, with ``data_store_type`` and ``calculate_reward(new_data_dict)``; see
    :mod:`bsk_torch.data.single`. Such a subclass is called once per environment, which is slow.

    Attributes:
        single: Base class of subclasses in bsk_rl's form.
        scenario: The scenario, once an environment has been built.
        fleet: The satellites, once an environment has been built.
    """

    single: ClassVar[type | None] = None
    scenario: Scenario
    fleet: SatelliteFleet

    total_name: str
    """Field of the state with :attr:`cum_reward`; see :mod:`bsk_torch.data.totals`."""

    def __init_subclass__(cls, **options: object) -> None:
        """Raise TypeError, suggesting a replacement, for definitions that no environment would use."""
        super().__init_subclass__(**options)
        check_class(cls, GlobalReward, HOOKS, UNUSED)

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """Prepare for a scenario and its satellites; called once when an environment is built.

        Overriding methods call ``super().link(scenario, fleet)`` first, and raise ValueError for an unsuitable scenario or
        satellites.
        """
        self.scenario, self.fleet = scenario, fleet

    @property
    def memory(self) -> StateTable:
        """Tensors [N, ...] reset with every episode; ``memory.declare(name, initial, *shape)`` in ``link`` adds one."""
        return self.fleet.memory

    @property
    def cum_reward(self) -> dict[str, Tensor]:
        """Total reward of each satellite in the current episodes, without failure penalties: [N] float64 by name.

        AttributeError for a rewarder outside an environment.
        """
        if not hasattr(self, "total_name"):
            raise AttributeError("cum_reward is read from the rewarder of an environment: env.rewarder.cum_reward")
        return dict(zip(self.fleet.names, self.fleet.state[self.total_name].unbind(1), strict=True))

    @property
    def step_duration(self) -> Tensor:
        """Duration of the current step, [N] s; for :meth:`calculate_reward`."""
        return (self.fleet.ticks - self.fleet.since).double() * self.fleet.h

    def read_log(self) -> Log:
        """Return the log of the current state, read at every decision: tensors [N, S, ...] by name."""
        return {}

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """Return the reward of each satellite for a step, [N, S] float64, from the logs before and after it."""
        raise NotImplementedError(f"{type(self).__name__} must implement calculate_reward(before, after)")

    def share(self, links: Tensor) -> None:
        """Share knowledge of collected data after a step.

        Args:
            links: Links by episode, sender and receiver, [N, S, S] bool.
        """

    def counts(self) -> dict[str, Tensor]:
        """Return counters of the current episodes by name, [N, S] int64 each; environments return them under ``counts``."""
        return {}

    def is_terminated(self) -> Tensor:
        """Return the satellites whose episode the rewarder terminates, [N, S] bool."""
        return torch.zeros(self.fleet.shape, dtype=torch.bool, device=self.fleet.device)

    def is_truncated(self) -> Tensor:
        """Return the satellites whose episode the rewarder truncates, [N, S] bool."""
        return torch.zeros(self.fleet.shape, dtype=torch.bool, device=self.fleet.device)


class NoReward(GlobalReward):
    """Zero for every step."""

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """See :meth:`GlobalReward.calculate_reward`."""
        return torch.zeros(self.fleet.shape, dtype=torch.float64, device=self.fleet.device)
