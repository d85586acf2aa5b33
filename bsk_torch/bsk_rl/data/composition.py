"""Combinations of several rewarders; counterpart of ``bsk_rl.data.composition``. Environments combine a list or tuple."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Any

from bsk_torch.bsk_rl.data.base import Data, DataStore, GlobalReward
from bsk_torch.bsk_rl.later import not_yet
from bsk_torch.bsk_rl.scene.scenario import Scenario

__all__ = ["ComposedData", "ComposedDataStore", "ComposedReward"]

logger = logging.getLogger(__name__)


def _found(parts: Iterable[Any], name: str, kind: str) -> Any:
    """Return an attribute of the first part that has it; AttributeError if none has."""
    for part in parts:
        if hasattr(part, name):
            return getattr(part, name)
    raise AttributeError(f"{kind} has no part with attribute {name!r}")


class ComposedData(Data):
    """One unit of each kind of data; its attributes are those of the first that has them."""

    def __init__(self, *data: Data) -> None:
        """Combine units of data, one of each kind."""
        self.data = data

    def __add__(self, other: ComposedData) -> ComposedData:
        """Return the sums of units; none at all counts as empty ones. ValueError for different numbers of units."""
        if not self.data:
            return ComposedData(*(type(unit)() + unit for unit in other.data))
        if not other.data:
            return ComposedData(*(unit + type(unit)() for unit in self.data))
        if len(self.data) != len(other.data):
            raise ValueError(f"data of {len(self.data)} kinds cannot be added to data of {len(other.data)} kinds")
        return ComposedData(*(mine + theirs for mine, theirs in zip(self.data, other.data, strict=True)))

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the first unit that has it."""
        return _found(self.__dict__.get("data", ()), name, "ComposedData")

    def __repr__(self) -> str:
        """Return the units."""
        return f"ComposedData({', '.join(map(repr, self.data))})"


class ComposedDataStore(DataStore):
    """One store of each kind; its attributes are those of the first that has them."""

    data_type = ComposedData

    def __init__(
        self,
        satellite: Any,
        *data_store_types: type[DataStore],
        initial_data: ComposedData | None = None,
        data_store_kwargs: list[dict[str, Any]] | None = None,
    ) -> None:
        """Create the stores.

        Args:
            satellite: The satellite.
            data_store_types: Types of the stores.
            initial_data: Data known at the start.
            data_store_kwargs: Further arguments of each store.
        """
        super().__init__(satellite, initial_data)
        kwargs = [{}] * len(data_store_types) if data_store_kwargs is None else data_store_kwargs
        if len(kwargs) != len(data_store_types):
            raise ValueError(f"there are {len(data_store_types)} data_store_types, but {len(kwargs)} data_store_kwargs")
        self.data_stores = tuple(make(satellite, **given) for make, given in zip(data_store_types, kwargs, strict=True))
        self.pass_data()

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the first store that has it."""
        return _found(self.__dict__.get("data_stores", ()), name, "ComposedDataStore")

    def pass_data(self) -> None:
        """Pass each store its unit of the data."""
        for store, unit in zip(self.data_stores, self.data.data, strict=False):
            store.data = unit

    def get_log_state(self) -> list[Any]:
        """See :meth:`DataStore.get_log_state`; those of all stores."""
        return [store.get_log_state() for store in self.data_stores]

    def compare_log_states(self, prev_state: list[Any], new_state: list[Any]) -> ComposedData:
        """See :meth:`DataStore.compare_log_states`; those of all stores."""
        each = zip(self.data_stores, prev_state, new_state, strict=True)
        return ComposedData(*(store.compare_log_states(before, after) for store, before, after in each))

    def update_from_logs(self) -> Any:
        """See :meth:`DataStore.update_from_logs`."""
        new_data = super().update_from_logs()
        self.pass_data()
        return new_data

    def update_with_communicated_data(self) -> None:
        """See :meth:`DataStore.update_with_communicated_data`."""
        super().update_with_communicated_data()
        self.pass_data()


class ComposedReward(GlobalReward):
    """The sum of several rewarders; its attributes are those of the first that has them.

    As in bsk_rl, the ``create_data_store`` of the rewarders is not called: targets that have been imaged are not hidden.
    """

    data_store_type = ComposedDataStore

    def __init__(self, *rewarders: GlobalReward) -> None:
        """Combine rewarders, whose rewards are added."""
        super().__init__()
        self.rewarders = rewarders

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the first rewarder that has it."""
        return _found(self.__dict__.get("rewarders", ()), name, "ComposedReward")

    def pass_data(self) -> None:
        """Pass each rewarder its unit of the data."""
        for rewarder, unit in zip(self.rewarders, self.data.data, strict=False):
            rewarder.data = unit

    def reset_overwrite_previous(self) -> None:
        """See :meth:`Resetable.reset_overwrite_previous`; of all rewarders."""
        super().reset_overwrite_previous()
        for rewarder in self.rewarders:
            rewarder.reset_overwrite_previous()

    def reset_pre_sim_init(self) -> None:
        """See :meth:`Resetable.reset_pre_sim_init`; of all rewarders."""
        super().reset_pre_sim_init()
        for rewarder in self.rewarders:
            rewarder.reset_pre_sim_init()

    def reset_post_sim_init(self) -> None:
        """See :meth:`Resetable.reset_post_sim_init`; of all rewarders."""
        super().reset_post_sim_init()
        for rewarder in self.rewarders:
            rewarder.reset_post_sim_init()

    def link_scenario(self, scenario: Scenario) -> None:
        """See :meth:`GlobalReward.link_scenario`."""
        super().link_scenario(scenario)
        for rewarder in self.rewarders:
            rewarder.link_scenario(scenario)

    def initial_data(self, satellite: Any) -> ComposedData:
        """See :meth:`GlobalReward.initial_data`."""
        return ComposedData(*(rewarder.initial_data(satellite) for rewarder in self.rewarders))

    def create_data_store(self, satellite: Any) -> None:
        """Give a satellite one store of each kind."""
        satellite.data_store = ComposedDataStore(
            satellite,
            *(rewarder.data_store_type for rewarder in self.rewarders),
            initial_data=self.initial_data(satellite),
            data_store_kwargs=[rewarder.data_store_kwargs for rewarder in self.rewarders],
        )
        for rewarder in (self, *self.rewarders):
            rewarder.cum_reward[satellite.name] = 0.0

    def calculate_reward(self, new_data_dict: dict[str, ComposedData]) -> dict[str, float]:
        """See :meth:`GlobalReward.calculate_reward`; each rewarder may leave satellites out."""
        counts = {len(data.data) for data in new_data_dict.values()}
        if len(counts) > 1:
            raise AssertionError(f"satellites have data of {sorted(counts)} kinds; they must have equally many")
        reward: dict[str, float] = {}
        if counts == {0}:
            return reward
        for k, rewarder in enumerate(self.rewarders):
            part = rewarder.calculate_reward({name: data.data[k] for name, data in new_data_dict.items()})
            if any(part.values()):
                logger.info("%s reward: %s", type(rewarder).__name__, {name: value for name, value in part.items() if value})
            for name, value in part.items():
                reward[name] = reward.get(name, 0.0) + value
                rewarder.cum_reward[name] += value
        return reward

    def reward(self, new_data_dict: dict[str, ComposedData]) -> dict[str, float]:
        """See :meth:`GlobalReward.reward`."""
        reward = super().reward(new_data_dict)
        self.pass_data()
        return reward

    def is_truncated(self, satellite: Any) -> bool:
        """See :meth:`GlobalReward.is_truncated`; of any rewarder."""
        return any(rewarder.is_truncated(satellite) for rewarder in self.rewarders)

    def is_terminated(self, satellite: Any) -> bool:
        """See :meth:`GlobalReward.is_terminated`; of any rewarder."""
        return any(rewarder.is_terminated(satellite) for rewarder in self.rewarders)


__getattr__ = not_yet(__name__)
