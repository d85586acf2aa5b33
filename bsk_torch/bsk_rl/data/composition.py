"""Combinations of several rewarders; counterpart of ``bsk_rl.data.composition``.

Environments combine a list or tuple to a :class:`ComposedReward`. A :class:`MixedReward` has rewarders for some satellites each.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterable, Mapping, Sequence
from copy import copy
from typing import TYPE_CHECKING, Any

from typing_extensions import override

from bsk_torch.bsk_rl.data.base import Data, DataStore, GlobalReward
from bsk_torch.bsk_rl.scene.composition import MixedScenario
from bsk_torch.bsk_rl.scene.scenario import Scenario
from bsk_torch.bsk_rl.utils.functional import ResetableGroup
from bsk_torch.data.mixed import check_channels, check_no_ids, scenario_id
from bsk_torch.scene.mixed import as_dictionary, check_known, names_by_key

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite


logger = logging.getLogger(__name__)


def _attribute_of_first(parts: Iterable[object], name: str, kind: str) -> object:
    for part in parts:
        if hasattr(part, name):
            return getattr(part, name)
    raise AttributeError(f"{kind} has no part with attribute {name!r}")


class ComposedData(Data):
    """One unit of each kind of data; its attributes are those of the first that has them."""

    def __init__(self, *data: Data) -> None:
        self.data = data

    def __add__(self, other: ComposedData) -> ComposedData:
        """Return the sums of units; none at all counts as empty ones. ValueError for different numbers of units."""
        if not self.data:
            return ComposedData(*(type(unit)() + unit for unit in other.data))
        if not other.data:
            return ComposedData(*(unit + type(unit)() for unit in self.data))
        if len(self.data) != len(other.data):
            raise ValueError(f"data of {len(self.data)} kinds cannot be added to data of {len(other.data)} kinds")
        return ComposedData(*(first + second for first, second in zip(self.data, other.data, strict=True)))

    def __getattr__(self, name: str) -> Any:
        return _attribute_of_first(self.__dict__.get("data", ()), name, "ComposedData")

    def __repr__(self) -> str:
        return f"ComposedData({', '.join(map(repr, self.data))})"


class PassingStore(DataStore):
    """A store of several, which pass their data on to it and get them back after every change."""

    def pass_data(self) -> None:
        """Pass each store its data."""

    @override
    def update_from_logs(self) -> object:
        new_data = super().update_from_logs()
        self.pass_data()
        return new_data

    @override
    def update_with_communicated_data(self) -> None:
        super().update_with_communicated_data()
        self.pass_data()


class ComposedDataStore(PassingStore):
    """One store of each kind; its attributes are those of the first that has them."""

    data_type = ComposedData

    def __init__(
        self,
        satellite: Satellite,
        *data_store_types: type[DataStore],
        initial_data: ComposedData | None = None,
        data_store_kwargs: list[dict[str, object]] | None = None,
    ) -> None:
        """Create stores of ``data_store_types``, each with further arguments; ValueError for another number of these."""
        super().__init__(satellite, initial_data)
        kwargs = [{}] * len(data_store_types) if data_store_kwargs is None else data_store_kwargs
        if len(kwargs) != len(data_store_types):
            raise ValueError(f"there are {len(data_store_types)} data_store_types, but {len(kwargs)} data_store_kwargs")
        self.data_stores = tuple(make(satellite, **options) for make, options in zip(data_store_types, kwargs, strict=True))
        self.pass_data()

    def __getattr__(self, name: str) -> Any:
        return _attribute_of_first(self.__dict__.get("data_stores", ()), name, "ComposedDataStore")

    def pass_data(self) -> None:
        """Pass each store its unit of the data."""
        for store, unit in zip(self.data_stores, self.data.data, strict=False):
            store.data = unit

    def get_log_state(self) -> list[object]:
        """See :meth:`DataStore.get_log_state`; those of all stores."""
        return [store.get_log_state() for store in self.data_stores]

    def compare_log_states(self, prev_state: list[Any], new_state: list[Any]) -> ComposedData:
        """See :meth:`DataStore.compare_log_states`; those of all stores."""
        each = zip(self.data_stores, prev_state, new_state, strict=True)
        return ComposedData(*(store.compare_log_states(before, after) for store, before, after in each))


class RewarderGroup(ResetableGroup, GlobalReward):
    """A sum of rewarders, which it passes their data."""

    def pass_data(self) -> None:
        """Pass each rewarder its data."""

    def rewarders_of(self, satellite: object) -> Collection[GlobalReward]:
        """Return the rewarders that reward a satellite."""
        raise NotImplementedError(f"{type(self).__name__} must implement rewarders_of(satellite)")

    @override
    def reward(self, new_data_dict: dict[str, object]) -> dict[str, float]:
        reward = super().reward(new_data_dict)
        self.pass_data()
        return reward

    @override
    def is_truncated(self, satellite: object) -> bool:
        return any(rewarder.is_truncated(satellite) for rewarder in self.rewarders_of(satellite))

    @override
    def is_terminated(self, satellite: object) -> bool:
        return any(rewarder.is_terminated(satellite) for rewarder in self.rewarders_of(satellite))


class ComposedReward(RewarderGroup):
    """The sum of several rewarders; its attributes are those of the first that has them.

    As in bsk_rl, the ``create_data_store`` of the rewarders is not called: targets that have been imaged are not hidden.
    """

    data_store_type = ComposedDataStore

    def __init__(self, *rewarders: GlobalReward) -> None:
        super().__init__()
        self.rewarders = rewarders

    def __getattr__(self, name: str) -> Any:
        return _attribute_of_first(self.__dict__.get("rewarders", ()), name, "ComposedReward")

    @override
    def pass_data(self) -> None:
        for rewarder, unit in zip(self.rewarders, self.data.data, strict=False):
            rewarder.data = unit

    @override
    def _parts(self) -> tuple[GlobalReward, ...]:
        return self.rewarders

    @override
    def rewarders_of(self, satellite: object) -> tuple[GlobalReward, ...]:
        return self.rewarders

    @override
    def reset_during_sim_init(self) -> None:
        """Do nothing: as in bsk_rl, this hook of the rewarders is not called."""

    @override
    def link_scenario(self, scenario: Scenario) -> None:
        super().link_scenario(scenario)
        for rewarder in self.rewarders:
            rewarder.link_scenario(scenario)

    @override
    def initial_data(self, satellite: object) -> ComposedData:
        return ComposedData(*(rewarder.initial_data(satellite) for rewarder in self.rewarders))

    def create_data_store(self, satellite: Satellite) -> None:
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


def _attribute_of_one(parts: Mapping[str, object], name: str, kind: str) -> object:
    having = [key for key, part in parts.items() if hasattr(part, name)]
    if len(having) == 1:
        return getattr(parts[having[0]], name)
    if having:
        raise AttributeError(f"Ambiguous attribute {name!r}: the channels {having} of {kind} have it; choose one of them")
    raise AttributeError(f"{kind} has no channel with attribute {name!r}")


class MixedData(Data):
    """Data by channel; its attributes are those that the data of one channel has.

    A channel may be missing, and without channels the unit is empty.
    """

    def __init__(self, data: Mapping[str, Data] | None = None) -> None:
        self.data = dict(data or {})

    def __add__(self, other: MixedData) -> MixedData:
        """Return the sums by channel; TypeError for data of different types in one channel."""
        if not isinstance(other, MixedData):
            return NotImplemented
        merged = {key: copy(unit) for key, unit in self.data.items()}
        for key, unit in other.data.items():
            if key in merged and type(self.data[key]) is not type(unit):
                kinds = type(self.data[key]).__name__, type(unit).__name__
                raise TypeError(f"channel {key!r} has {kinds[0]}, to which {kinds[1]} cannot be added")
            merged[key] = self.data[key] + unit if key in merged else copy(unit)
        return MixedData(merged)

    def __getattr__(self, name: str) -> Any:
        return _attribute_of_one(self.__dict__.get("data", {}), name, "MixedData")

    def __repr__(self) -> str:
        return f"MixedData({self.data!r})"


class MixedDataStore(PassingStore):
    """A store for each channel in which a satellite collects data; received data of other channels is kept.

    Its attributes are those that one of its stores has.
    """

    data_type = MixedData

    def __init__(self, satellite: Satellite, data_stores: Mapping[str, DataStore], initial_data: MixedData | None = None) -> None:
        """Combine the store of each channel; the data at the start is that of the stores unless ``initial_data`` is given."""
        self.data_stores = dict(data_stores)
        data = MixedData({key: store.data for key, store in self.data_stores.items()})
        super().__init__(satellite, data if initial_data is None else initial_data)
        self.pass_data()

    def __getattr__(self, name: str) -> Any:
        return _attribute_of_one(self.__dict__.get("data_stores", {}), name, "MixedDataStore")

    def pass_data(self) -> None:
        """Pass each store the data of its channel."""
        for key, store in self.data_stores.items():
            store.data = self.data.data[key]

    def get_log_state(self) -> dict[str, object]:
        """See :meth:`DataStore.get_log_state`; those of all stores."""
        return {key: store.get_log_state() for key, store in self.data_stores.items()}

    def compare_log_states(self, prev_state: dict[str, Any], new_state: dict[str, Any]) -> MixedData:
        """See :meth:`DataStore.compare_log_states`; those of all stores."""
        return MixedData(
            {key: store.compare_log_states(prev_state[key], new_state[key]) for key, store in self.data_stores.items()}
        )

    def update_from_logs(self) -> object:
        """See :meth:`DataStore.update_from_logs`; stores begin with the data that the satellite has now."""
        self.pass_data()
        return super().update_from_logs()


class MixedReward(RewarderGroup):
    """Rewarders of channels, each for some satellites and one scenario; a satellite gets the sum over its channels.

    Stores are those of the rewarders, with what these install, such as the filter of images that have been taken. Only the
    channels of a satellite terminate or truncate its episode. All satellites know the data of all channels that they receive.
    """

    data_store_type = MixedDataStore

    def __init__(
        self,
        rewarders: Mapping[str, GlobalReward],
        satellite_mapping: Mapping[str, Sequence[str]],
        scenario_mapping: Mapping[str, str] | None = None,
    ) -> None:
        """Combine rewarders.

        Args:
            rewarders: Rewarder of each channel.
            satellite_mapping: Names of the satellites that collect the data of each channel; some may collect none.
            scenario_mapping: Id of the scenario of each channel in a ``scene.MixedScenario``; None with other scenarios.

        Raises:
            ValueError: For mappings with other channels, and for a rewarder under two channels.
        """
        super().__init__()
        self.rewarders: dict[str, GlobalReward] = as_dictionary("rewarders", rewarders)
        self.satellite_mapping = names_by_key("satellite_mapping", satellite_mapping)
        self.scenario_mapping = None if scenario_mapping is None else as_dictionary("scenario_mapping", scenario_mapping)
        check_channels(self.rewarders, self.satellite_mapping, self.scenario_mapping)

    def link_scenario(self, scenario: Scenario) -> None:
        """Give each rewarder its scenario.

        Raises:
            ValueError: For an unknown scenario or satellite, satellites outside the scenario of their channel, and where
                ``scenario_mapping`` is missing or without use.
        """
        super().link_scenario(scenario)
        names = [satellite.name for satellite in scenario.satellites]
        for key, group in self.satellite_mapping.items():
            check_known(f"satellite_mapping[{key!r}]", group, names)
        if not isinstance(scenario, MixedScenario):
            check_no_ids(self.scenario_mapping, scenario)
            for rewarder in self.rewarders.values():
                rewarder.link_scenario(scenario)
            return
        for key, rewarder in self.rewarders.items():
            chosen = scenario_id(key, self.satellite_mapping[key], self.scenario_mapping, scenario.satellite_mapping)
            rewarder.link_scenario(scenario.scenarios[chosen])

    @override
    def pass_data(self) -> None:
        for key, rewarder in self.rewarders.items():
            rewarder.data = self.data.data.setdefault(key, rewarder.data_type())

    @override
    def _parts(self) -> Collection[GlobalReward]:
        self.pass_data()
        return self.rewarders.values()

    @override
    def rewarders_of(self, satellite: object) -> Collection[GlobalReward]:
        return self.channels_of(satellite).values()

    @override
    def reset_overwrite_previous(self) -> None:
        super().reset_overwrite_previous()
        self.pass_data()

    def channels_of(self, satellite: Any) -> dict[str, GlobalReward]:
        """Return the rewarders of the channels in which a satellite collects data."""
        return {key: rewarder for key, rewarder in self.rewarders.items() if satellite.name in self.satellite_mapping[key]}

    def initial_data(self, satellite: Satellite) -> MixedData:
        """See :meth:`GlobalReward.initial_data`; that of the satellite's channels."""
        return MixedData({key: rewarder.initial_data(satellite) for key, rewarder in self.channels_of(satellite).items()})

    def create_data_store(self, satellite: Satellite) -> None:
        """Give a satellite the stores of its channels, as their rewarders make them."""
        stores = {}
        for key, rewarder in self.channels_of(satellite).items():
            rewarder.create_data_store(satellite)
            stores[key] = satellite.data_store
        satellite.data_store = MixedDataStore(satellite, stores)
        self.cum_reward[satellite.name] = 0.0

    def calculate_reward(self, new_data_dict: dict[str, MixedData]) -> dict[str, float]:
        """See :meth:`GlobalReward.calculate_reward`; ValueError for a reward of a satellite outside of the channel."""
        self.pass_data()
        reward = dict.fromkeys(new_data_dict, 0.0)
        for key, rewarder in self.rewarders.items():
            parts = {
                name: data.data[key]
                for name, data in new_data_dict.items()
                if name in self.satellite_mapping[key] and key in data.data
            }
            for name, value in rewarder.calculate_reward(parts).items() if parts else ():
                if name not in parts:
                    raise ValueError(f"the rewarder of channel {key!r} rewards {name!r}, which is not one of its satellites")
                reward[name] += value
                rewarder.cum_reward[name] += value
        return reward
