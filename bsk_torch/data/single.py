"""Rewarders of one environment, in bsk_rl's form: bases of the classes that users have written for it.

A class that derives from a rewarder of this package and is written in bsk_rl's form gets a base of this module instead; see
:class:`bsk_torch.data.base.RewarderType`. :class:`bsk_torch.data.mapped.MappedReward` runs it for each environment.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from bsk_torch.data.base import GlobalReward, NoReward, RewarderType
from bsk_torch.data.images import UniqueImageReward
from bsk_torch.data.scanning import ScanningTimeReward
from bsk_torch.data.store import Data, DataStore
from bsk_torch.data.unique_images import UniqueImageData
from bsk_torch.sim.hooks import check_class

HOOKS = (
    "link_scenario",
    "reset_overwrite_previous",
    "reset_pre_sim_init",
    "reset_during_sim_init",
    "reset_post_sim_init",
    "initial_data",
    "create_data_store",
    "calculate_reward",
    "is_terminated",
    "is_truncated",
)
"""Members of :class:`SingleReward` that subclasses may define, in addition to ``reward``."""

MIXED = "the class is in bsk_rl's form; define either that or tensors of all environments with {}"

UNUSED = {
    **{name: MIXED.format(name) for name in ("read_log", "share", "counts", "link", "selectable", "value")},
    "get_log_state": "define it in the data.DataStore that data_store_type names",
    "compare_log_states": "define it in the data.DataStore that data_store_type names",
    "update_from_logs": "define it in the data.DataStore that data_store_type names",
    "link_satellite": "define create_data_store(satellite)",
    "link_simulator": "define create_data_store(satellite)",
}
"""Names that are no hooks of rewarders in bsk_rl's form, and what to write instead."""


class SingleReward(metaclass=RewarderType):
    """Base of rewarders in bsk_rl's form.

    Subclasses set ``data_store_type``, a :class:`~bsk_torch.data.DataStore`, and define :meth:`calculate_reward`.

    Attributes:
        scenario: View of the scenario in this environment; ``scenario.targets`` lists the targets.
        data: All data that has been collected.
        cum_reward: Sum of the rewards of each satellite since the reset, by name.
        data_store_kwargs: Further arguments of stores.
    """

    is_single: ClassVar[bool] = True
    data_store_type: ClassVar[type[DataStore]]
    data_type: type[Data]
    data_store_kwargs: Mapping[str, Any] = {}
    scenario: Any
    data: Any
    cum_reward: dict[str, float]

    def __init_subclass__(cls, **options: Any) -> None:
        """Refuse definitions that no environment would use; TypeError says what to write instead."""
        super().__init_subclass__(**options)
        if "datastore_type" in vars(cls) and "data_store_type" not in vars(cls):
            cls.data_store_type = vars(cls)["datastore_type"]  # its name in earlier releases of bsk_rl
        check_class(cls, SingleReward, HOOKS, UNUSED)

    def __init__(self) -> None:
        """Find the type of data; TypeError without a store."""
        self.find_types()

    def find_types(self) -> None:
        """Set ``data_type`` to that of the store; TypeError without one."""
        if not hasattr(self, "data_store_type"):
            raise TypeError(f"{type(self).__name__} must set data_store_type, a subclass of data.DataStore")
        if not hasattr(self, "data_type"):
            self.data_type = self.data_store_type.data_type

    def link_scenario(self, scenario: Any) -> None:
        """Keep the view of the scenario; called at the start of every episode."""
        self.scenario = scenario

    def reset_overwrite_previous(self) -> None:
        """Start with empty data; called first at the start of an episode."""
        self.data, self.cum_reward = self.data_type(), {}

    def reset_pre_sim_init(self) -> None:
        """Called before the stores are made. The episode has been drawn, and satellites are at their start."""

    def reset_during_sim_init(self) -> None:
        """Called after the stores have been made."""

    def reset_post_sim_init(self) -> None:
        """Called last, before stores read their first log."""

    def initial_data(self, satellite: Any) -> Any:
        """Return the data with which the store of a satellite begins."""
        return self.data_type()

    def create_data_store(self, satellite: Any) -> None:
        """Give a satellite its store."""
        initial = self.initial_data(satellite)
        satellite.data_store = self.data_store_type(satellite, initial_data=initial, **self.data_store_kwargs)
        self.cum_reward[satellite.name] = 0.0

    def calculate_reward(self, new_data_dict: dict[str, Any]) -> dict[str, float]:
        """Return the reward of each satellite for a step, from the data that each has collected in it; by name."""
        raise NotImplementedError(f"{type(self).__name__} must implement calculate_reward(new_data_dict)")

    def reward(self, new_data_dict: dict[str, Any]) -> dict[str, float]:
        """Return the rewards of a step, and add them and the data to those of the episode."""
        found = self.calculate_reward(new_data_dict)
        for name, value in found.items():
            self.cum_reward[name] += value
        for new in new_data_dict.values():
            self.data += new
        return found

    def is_terminated(self, satellite: Any) -> bool:
        """Return whether the episode ends for a satellite."""
        return False

    def is_truncated(self, satellite: Any) -> bool:
        """Return whether the episode is cut for a satellite."""
        return False


class NoData(Data):
    """Nothing."""

    def __add__(self, other: Any) -> NoData:
        """Return nothing."""
        return type(self)()


class NoDataStore(DataStore):
    """Keeps nothing."""

    data_type = NoData

    def compare_log_states(self, old_state: Any, new_state: Any) -> NoData:
        """See :meth:`DataStore.compare_log_states`."""
        return NoData()


class SingleNoReward(SingleReward):
    """Zero for every step; see :class:`bsk_torch.data.NoReward`."""

    data_store_type = NoDataStore

    def calculate_reward(self, new_data_dict: dict[str, Any]) -> dict[str, float]:
        """See :meth:`SingleReward.calculate_reward`."""
        return dict.fromkeys(new_data_dict, 0.0)


class ScanningTime(Data):
    """Time spent recording, s."""

    def __init__(self, scanning_time: float = 0.0) -> None:
        """Keep ``scanning_time``, s."""
        self.scanning_time = scanning_time

    def __add__(self, other: ScanningTime) -> ScanningTime:
        """Return the sum."""
        return type(self)(self.scanning_time + other.scanning_time)


class ScanningTimeStore(DataStore):
    """Keeps the time that a satellite has spent recording."""

    data_type = ScanningTime

    def get_log_state(self) -> float:
        """Return the data in the store, bit."""
        return self.satellite.dynamics.storage_level

    def compare_log_states(self, old_state: float, new_state: float) -> ScanningTime:
        """Return the growth of the store over the rate of the instrument."""
        return ScanningTime(max(0.0, new_state - old_state) / self.satellite.dynamics.instrument_baud)


class SingleScanningTimeReward(SingleReward):
    """See :class:`bsk_torch.data.ScanningTimeReward`."""

    data_store_type = ScanningTimeStore

    def __init__(self, reward_fn: Callable[[float], float] | None = None) -> None:
        """Pay ``reward_fn`` of seconds; None multiplies by the scenario's ``value_per_second``."""
        super().__init__()
        self._reward_fn = reward_fn

    def reward_fn(self, seconds: float) -> float:
        """Return the reward of a step with so many seconds of recording."""
        return seconds * self.scenario.value_per_second if self._reward_fn is None else self._reward_fn(seconds)

    def calculate_reward(self, new_data_dict: dict[str, Any]) -> dict[str, float]:
        """See :meth:`SingleReward.calculate_reward`."""
        return {name: self.reward_fn(new.scanning_time) for name, new in new_data_dict.items()}


class UniqueImageStore(DataStore):
    """Keeps the targets that a satellite knows to have been imaged: it has taken an image if its first partition has grown."""

    data_type = UniqueImageData

    def get_log_state(self) -> Any:
        """Return the data in the first partition of the store, bit."""
        return self.satellite.dynamics.partition_levels[0]

    def compare_log_states(self, old_state: Any, new_state: Any) -> Any:
        """Return the image of a step, if any."""
        if new_state - old_state <= 0:
            return UniqueImageData()
        return UniqueImageData(imaged={self.satellite.latest_target})

    def update_target_colors(self, targets: Any) -> None:
        """Do nothing: bsk_rl's method of this name paints targets in Vizard."""


class HideImaged:
    """Access filter that hides the targets of which a store knows images."""

    def __init__(self, store: Any) -> None:
        """Hide the targets in ``store.data.imaged``."""
        self.store = store

    def __call__(self, opportunity: Mapping[str, Any]) -> bool:
        """Return whether an opportunity remains."""
        return opportunity["type"] != "target" or opportunity["object"] not in self.store.data.imaged


class SingleUniqueImageReward(SingleReward):
    """See :class:`bsk_torch.data.UniqueImageReward`."""

    data_store_type = UniqueImageStore

    def __init__(self, reward_fn: Callable[..., float] = lambda priority: priority) -> None:
        """Pay ``reward_fn`` of the priority of each new image."""
        super().__init__()
        self.reward_fn = reward_fn

    def initial_data(self, satellite: Any) -> Any:
        """See :meth:`SingleReward.initial_data`; all targets are known."""
        return self.data_type(known=self.scenario.targets)  # type: ignore[call-arg]

    def create_data_store(self, satellite: Any) -> None:
        """See :meth:`SingleReward.create_data_store`; imaged targets are hidden from the satellite."""
        super().create_data_store(satellite)
        satellite.add_access_filter(HideImaged(satellite.data_store))

    def calculate_reward(self, new_data_dict: dict[str, Any]) -> dict[str, float]:
        """See :meth:`SingleReward.calculate_reward`; several satellites share the reward of an image in the same step."""
        images = [target for new in new_data_dict.values() for target in new.imaged]
        return {
            name: sum((self.reward_fn(t.priority) / images.count(t) for t in new.imaged if t not in self.data.imaged), 0.0)
            for name, new in new_data_dict.items()
        }


GlobalReward.register(SingleReward)
GlobalReward.single = SingleReward
NoReward.single = SingleNoReward
ScanningTimeReward.single = SingleScanningTimeReward
UniqueImageReward.single = SingleUniqueImageReward
