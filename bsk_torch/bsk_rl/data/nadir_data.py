"""Reward for scanning time; counterpart of ``bsk_rl.data.nadir_data``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from typing_extensions import override

from bsk_torch.bsk_rl.data.base import Data, DataStore, GlobalReward


@dataclass(eq=False)
class ScanningTime(Data):
    """Time for which the instrument has recorded, s."""

    scanning_time: float = 0.0

    def __add__(self, other: ScanningTime) -> ScanningTime:
        return type(self)(self.scanning_time + other.scanning_time)


class ScanningTimeStore(DataStore):
    """Computes the scanning time from the data added to the satellite's data buffer."""

    data_type = ScanningTime

    def get_log_state(self) -> float:
        """Return the level of the satellite's data buffer, bit."""
        return self.satellite.dynamics.storageUnit.storageUnitDataOutMsg.read().storageLevel

    def compare_log_states(self, old_state: float, new_state: float) -> ScanningTime:
        """Return the time in which the instrument records the added data; zero if the buffer holds less than before."""
        rate = self.satellite.dynamics.instrument.nodeBaudRate
        return ScanningTime((new_state - old_state) / rate if new_state > old_state else 0.0)


class ScanningTimeReward(GlobalReward):
    """Rewards scanning time, in a ``scene.UniformNadirScanning`` scenario."""

    data_store_type = ScanningTimeStore

    def __init__(self, reward_fn: Callable[[float], float] | None = None) -> None:
        """Pay ``reward_fn`` of the scanning time, s; by default, the time multiplied by the scenario's ``value_per_second``."""
        super().__init__()
        self._reward_fn = reward_fn

    @property
    def reward_fn(self) -> Callable[[float], float]:
        """Reward as a function of the time, s."""
        return self._reward_fn or (lambda time: time * self.scenario.value_per_second)

    @override
    def calculate_reward(self, new_data_dict: dict[str, ScanningTime]) -> dict[str, float]:
        return {name: self.reward_fn(data.scanning_time) for name, data in new_data_dict.items()}
