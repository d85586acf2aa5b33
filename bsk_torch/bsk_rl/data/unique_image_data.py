"""Reward for the first image of each target; counterpart of ``bsk_rl.data.unique_image_data``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from typing_extensions import override

from bsk_torch.bsk_rl.data.base import Data, DataStore, GlobalReward
from bsk_torch.bsk_rl.scene.targets import Target
from bsk_torch.sim.places import is_target


class UniqueImageData(Data):
    """Targets that have been imaged.

    Attributes:
        imaged: Targets with an image.
        duplicates: Number of images of targets imaged before; when satellites exchange data, targets imaged in both are counted
            again.
        known: Targets that are known, imaged or not.
    """

    def __init__(
        self, imaged: Iterable[Target] | None = None, duplicates: int = 0, known: Iterable[Target] | None = None
    ) -> None:
        """Initialize with targets; repeated ones are duplicates."""
        listed = list(imaged or ())
        self.imaged = set(listed)
        self.duplicates = duplicates + len(listed) - len(self.imaged)
        self.known = set(known or ())

    def __add__(self, other: UniqueImageData) -> UniqueImageData:
        """Return the union; targets imaged in both are duplicates."""
        imaged = self.imaged | other.imaged
        both = len(self.imaged) + len(other.imaged) - len(imaged)
        return type(self)(imaged, self.duplicates + other.duplicates + both, self.known | other.known)


class UniqueImageStore(DataStore):
    """Detects images by the first partition of the data buffer: if its level has risen, ``latest_target`` was imaged."""

    data_type = UniqueImageData

    def get_log_state(self) -> float:
        """Return the level of the first partition, bit."""
        return self.satellite.dynamics.storageUnit.storageUnitDataOutMsg.read().storedData[0]

    def compare_log_states(self, old_state: float, new_state: float) -> UniqueImageData:
        """Return the target that has been imaged, if any."""
        if new_state - old_state <= 0:
            return UniqueImageData()
        target = self.satellite.latest_target
        if target is None:
            raise AssertionError(f"{self.satellite.name} has taken an image, but has no latest_target")
        self.update_target_colors([target])
        return UniqueImageData(imaged={target})

    def update_target_colors(self, targets: list[Target], vizInstance: object = None, vizSupport: object = None) -> None:
        """Color targets in Vizard."""


@dataclass(eq=False)
class HideImaged:
    """Access filter that hides the targets that a store has imaged."""

    store: Any

    def __call__(self, opportunity: Mapping[str, Any]) -> bool:
        """Return whether an opportunity is none of these."""
        return not is_target(opportunity["type"]) or opportunity["object"] not in self.store.data.imaged


def whole_priority(priority: float) -> float:
    """Return the priority, the default reward of a target."""
    return priority


class UniqueImageReward(GlobalReward):
    """Rewards the first image of each target in an episode; satellites that take it in the same step share the reward.

    Satellites know all targets from the start. Targets that a satellite knows to be imaged, by itself or through communication,
    are removed from its observations and actions.
    """

    data_store_type = UniqueImageStore

    def __init__(self, reward_fn: Callable[[float], float] = whole_priority) -> None:
        """Pay ``reward_fn`` of a target's priority for its first image."""
        super().__init__()
        self.reward_fn = reward_fn

    def initial_data(self, satellite: object) -> UniqueImageData:
        """Return all targets as known."""
        return self.data_type(known=self.scenario.targets)

    def create_data_store(self, satellite: Any) -> None:
        """Create the data store of a satellite, and hide targets imaged in it from the satellite."""
        super().create_data_store(satellite)
        satellite.add_access_filter(HideImaged(satellite.data_store))

    @override
    def calculate_reward(self, new_data_dict: dict[str, UniqueImageData]) -> dict[str, float]:
        takers = Counter(target for data in new_data_dict.values() for target in data.imaged)
        reward = {}
        for name, data in new_data_dict.items():
            new = (target for target in data.imaged if target not in self.data.imaged)
            reward[name] = sum((self.reward_fn(target.priority) / takers[target] for target in new), 0.0)
        return reward
