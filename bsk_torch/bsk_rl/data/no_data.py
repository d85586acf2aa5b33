"""No data and no reward; counterpart of ``bsk_rl.data.no_data``."""

from __future__ import annotations

from typing_extensions import override

from bsk_torch.bsk_rl.data.base import Data, DataStore, GlobalReward


class NoData(Data):
    """Empty data."""

    def __add__(self, other: object) -> NoData:
        return type(self)()


class NoDataStore(DataStore):
    """A store without data."""

    data_type = NoData

    def compare_log_states(self, old_state: object, new_state: object) -> NoData:
        """Return nothing."""
        return self.data_type()


class NoReward(GlobalReward):
    """Zero reward in every step."""

    data_store_type = NoDataStore

    @override
    def calculate_reward(self, new_data_dict: dict[str, NoData]) -> dict[str, float]:
        return dict.fromkeys(new_data_dict, 0.0)
