"""Reward for the time of scanning; counterpart of ``bsk_rl.data.nadir_data``."""

from __future__ import annotations

from collections.abc import Callable

from bsk_torch.bsk_rl.data.base import Data, DataStore, GlobalReward

__all__ = ["ScanningTime", "ScanningTimeReward", "ScanningTimeStore"]


class ScanningTime(Data):
    """Time for which the instrument has recorded, s."""

    def __init__(self, scanning_time: float = 0.0) -> None:
        """Take the time, s."""
        self.scanning_time = scanning_time

    def __add__(self, other: ScanningTime) -> ScanningTime:
        """Return the sum."""
        return type(self)(self.scanning_time + other.scanning_time)


class ScanningTimeStore(DataStore):
    """Finds the time of scanning from the data that the store of the satellite has gained."""

    data_type = ScanningTime

    def get_log_state(self) -> float:
        """Return the level of the satellite's store, bit."""
        return self.satellite.dynamics.storageUnit.storageUnitDataOutMsg.read().storageLevel

    def compare_log_states(self, old_state: float, new_state: float) -> ScanningTime:
        """Return the time in which the instrument records the gain; none where data has been lost."""
        rate = self.satellite.dynamics.instrument.nodeBaudRate
        return ScanningTime((new_state - old_state) / rate if new_state > old_state else 0.0)


class ScanningTimeReward(GlobalReward):
    """Pays for the time of scanning, of a ``scene.UniformNadirScanning`` scenario."""

    data_store_type = ScanningTimeStore

    def __init__(self, reward_fn: Callable[[float], float] | None = None) -> None:
        """Take the reward as a function of the time, s; by default it is proportional to it, ``scenario.value_per_second``."""
        super().__init__()
        self._reward_fn = reward_fn

    @property
    def reward_fn(self) -> Callable[[float], float]:
        """Reward as a function of the time, s."""
        return self._reward_fn or (lambda time: time * self.scenario.value_per_second)

    def calculate_reward(self, new_data_dict: dict[str, ScanningTime]) -> dict[str, float]:
        """See :meth:`GlobalReward.calculate_reward`."""
        return {name: self.reward_fn(data.scanning_time) for name, data in new_data_dict.items()}
