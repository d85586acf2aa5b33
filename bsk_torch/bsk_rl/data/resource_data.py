"""Reward for the change of any quantity; counterpart of ``bsk_rl.data.resource_data``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from typing_extensions import override

from bsk_torch.bsk_rl.data.base import Data, DataStore, GlobalReward

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite


def nothing(satellite: object) -> float:
    """Return zero, the quantity of a rewarder that is given none."""
    return 0.0


@dataclass(eq=False)
class ResourceData(Data):
    """Change of a quantity."""

    resource_accumulated: float = 0.0

    def __add__(self, other: ResourceData) -> ResourceData:
        return ResourceData(self.resource_accumulated + other.resource_accumulated)


class ResourceDataStore(DataStore):
    """Computes the change of a quantity of the satellite in each step."""

    data_type = ResourceData

    def __init__(
        self, satellite: Satellite, initial_data: object = None, *, resource_fn: Callable[[Satellite], float] = nothing
    ) -> None:
        """See :class:`DataStore`; ``resource_fn`` is a function of the satellite that returns the quantity."""
        super().__init__(satellite, initial_data)
        self.resource_fn = resource_fn

    def get_log_state(self) -> float:
        """Return the current quantity."""
        return self.resource_fn(self.satellite)

    def compare_log_states(self, prev_state: float, new_state: float) -> ResourceData:
        """Return the change."""
        return ResourceData(new_state - prev_state)


class ResourceReward(GlobalReward):
    """Rewards the change of a quantity, such as fuel or time: ``reward_weight`` times the change in each step."""

    data_store_type = ResourceDataStore

    def __init__(
        self, reward_weight: float | Callable[[], float] = 1.0, resource_fn: Callable[[Satellite], float] = nothing
    ) -> None:
        """Initialize the rewarder.

        Args:
            reward_weight: Reward per unit of the quantity, or a function that draws it for each episode.
            resource_fn: Function of the satellite that returns the quantity.
        """
        super().__init__()
        self._reward_weight, self.resource_fn = reward_weight, resource_fn
        self.data_store_kwargs = {"resource_fn": resource_fn}

    def reset_pre_sim_init(self) -> None:
        """Draw the weight."""
        self.reward_weight = self._reward_weight() if callable(self._reward_weight) else self._reward_weight
        super().reset_pre_sim_init()

    def reset_post_sim_init(self) -> None:
        """Pass the weight to the observations ``obs.ResourceRewardWeight`` of the satellites."""
        for satellite in self.scenario.satellites:
            for observation in satellite.observation_builder.observation_spec:
                if hasattr(observation, "weight_vector"):
                    observation.weight_vector.append(self.reward_weight)
        super().reset_post_sim_init()

    @override
    def calculate_reward(self, new_data_dict: dict[str, ResourceData]) -> dict[str, float]:
        return {name: self.reward_weight * data.resource_accumulated for name, data in new_data_dict.items()}
