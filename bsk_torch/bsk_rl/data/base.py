"""Base classes of data, data stores and rewarders; counterpart of ``bsk_rl.data.base``."""

from __future__ import annotations

import logging
import warnings
from abc import ABC, abstractmethod
from typing import Any

from bsk_torch.bsk_rl.scene.scenario import Scenario
from bsk_torch.bsk_rl.utils.functional import Resetable

logger = logging.getLogger(__name__)

LogStateType = Any
"""What a store reads from its satellite at the end of a step."""


class Data(ABC):
    """A unit of data; without arguments it is empty."""

    @abstractmethod
    def __add__(self, other: Any) -> Any:
        """Return both units together."""

    def __copy__(self) -> object:
        return type(self)() + self


class DataStore(ABC):
    """Data that a satellite has collected and received in an episode.

    Subclasses define :attr:`data_type`, :meth:`get_log_state` and :meth:`compare_log_states`.

    Attributes:
        satellite: The satellite.
        data: All data known to it.
        new_data: Data collected in the last step.
        staged_data: Data received from others, before it is added to ``data``.
    """

    data_type: type[Data]

    def __init__(self, satellite: Any, initial_data: object = None) -> None:
        """Store the data of a satellite, which begins with ``initial_data``; None for none."""
        self.satellite = satellite
        self.staged_data: list[object] = []
        self.data: Any = initial_data if initial_data else self.data_type()
        self.new_data: object = self.data_type()

    def get_log_state(self) -> LogStateType:
        """Return the state from which new data is found, by comparison with the state of the previous step."""
        return None

    @abstractmethod
    def compare_log_states(self, old_state: LogStateType, new_state: LogStateType) -> Any:
        """Return the data of a step from what :meth:`get_log_state` returned before and after it."""

    def update_from_logs(self) -> object:
        """Add the data of a step, and return it; the first call, at reset, only reads the state."""
        if not hasattr(self, "log_state"):
            self.log_state = self.get_log_state()
            return self.data_type()
        before = self.log_state
        self.log_state = self.get_log_state()
        self.new_data = self.compare_log_states(before, self.log_state)
        self.data += self.new_data
        return self.new_data

    def stage_communicated_data(self, external_data: object) -> None:
        """Stage data received from another satellite; it is not passed on in the same step."""
        self.staged_data.append(external_data)

    def update_with_communicated_data(self) -> None:
        """Add the staged data."""
        for staged in self.staged_data:
            self.data += staged
        self.staged_data = []


class _StoreAlias:
    """``datastore_type``, the name of ``data_store_type`` before bsk_rl 1.0."""

    def __get__(self, instance: object, owner: type[GlobalReward]) -> type[DataStore]:
        warnings.warn("datastore_type is deprecated; write data_store_type", DeprecationWarning, stacklevel=2)
        return owner.data_store_type


class GlobalReward(ABC, Resetable):
    """Base class of rewarders, which hold all data collected by all satellites.

    Subclasses define :attr:`data_store_type` and :meth:`calculate_reward`.

    Attributes:
        scenario: Scenario of the environment.
        data: All data collected in the episode.
        cum_reward: Sum of the rewards of each satellite in the episode, by name.
        data_store_kwargs: Further arguments of the stores.
    """

    data_store_type: type[DataStore]
    datastore_type = _StoreAlias()
    scenario: Any

    def __init__(self) -> None:
        if not hasattr(type(self), "data_store_type"):
            self.data_store_type = self.datastore_type
        self.data_type: Any = self.data_store_type.data_type
        self.data_store_kwargs: dict[str, Any] = {}

    def link_scenario(self, scenario: Scenario) -> None:
        """Store the scenario of the environment."""
        self.scenario = scenario

    def reset_overwrite_previous(self) -> None:
        """Forget data and rewards of the last episode."""
        self.data: Any = self.data_type()
        self.cum_reward: dict[str, float] = {}

    def initial_data(self, satellite: Any) -> Any:
        """Return the data known to a satellite at the start."""
        return self.data_type()

    def create_data_store(self, satellite: Any) -> None:
        """Create the data store of a satellite for the episode."""
        initial = self.initial_data(satellite)
        satellite.data_store = self.data_store_type(satellite, initial_data=initial, **self.data_store_kwargs)
        self.cum_reward[satellite.name] = 0.0

    @abstractmethod
    def calculate_reward(self, new_data_dict: dict[str, Any]) -> dict[str, float]:
        """Return the reward of a step by name of satellite, from the data that each has collected in it."""

    def reward(self, new_data_dict: dict[str, object]) -> dict[str, float]:
        """Return the reward of a step, and add it and its data to those of the episode."""
        reward = self.calculate_reward(new_data_dict)
        for name, value in reward.items():
            self.cum_reward[name] += value
        for new_data in new_data_dict.values():
            self.data += new_data
        logger.info("Total reward: %s", {name: value for name, value in reward.items() if value != 0})
        return reward

    def is_truncated(self, satellite: object) -> bool:
        """Return whether the episode is truncated for a satellite."""
        return False

    def is_terminated(self, satellite: object) -> bool:
        """Return whether the episode terminates for a satellite."""
        return False
