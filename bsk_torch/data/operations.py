"""Penalties for time, and for states of satellites that operators avoid."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.sats.bound import BoundSatellite, SatelliteFleet
from bsk_torch.scene.base import Scenario
from bsk_torch.sim.dyn.events import EMPTY_DOWNLINKS

LOW_BATTERY, FULL_STORAGE = 0.1, 0.991
"""Charge below which, and data above which, a satellite is penalized, as fractions of its capacities."""

MOST_PENALTY = 1e30
"""Bound of penalties, so that a sum of several rewards stays finite in float32."""


class OperationsPenalty(GlobalReward):
    """Pays satellites penalties for a low battery, a full store, and downlinks of nothing.

    At the end of every step, each satellite gets

    - ``low_battery`` if its battery is below ``battery_below`` of the capacity,
    - ``full_storage`` if its store is above ``storage_above`` of the capacity,
    - ``empty_downlink`` for a downlink with ``until_empty`` that it has begun in the step with no more than a bit stored.

    Satellites without battery, store or such an action get nothing. The terms are those of a branch of BSK-RL's authors. Add them
    to other rewarders, as in ``rewarder=(RSOImageReward(), data.OperationsPenalty(empty_downlink=-1.0))``.
    """

    def __init__(
        self,
        low_battery: float = 0.0,
        full_storage: float = 0.0,
        empty_downlink: float = 0.0,
        battery_below: float = LOW_BATTERY,
        storage_above: float = FULL_STORAGE,
    ) -> None:
        """Set the three rewards, from -1e30 to 0, and the fractions of capacity below and above which two of them are paid."""
        penalties = {"low_battery": low_battery, "full_storage": full_storage, "empty_downlink": empty_downlink}
        self.penalties = {name: number(name, value, -MOST_PENALTY, 0.0) for name, value in penalties.items()}
        self.battery_below = number("battery_below", battery_below, 0.0, 1.0)
        self.storage_above = number("storage_above", storage_above, 0.0, 1.0)

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """See :meth:`GlobalReward.link`; ValueError if no satellite can earn a penalty that has been given."""
        super().link(scenario, fleet)
        needs: dict[str, tuple[str, Callable[[BoundSatellite], Tensor]]] = {
            "low_battery": ("a battery", lambda satellite: satellite.dynamics.battery_charge_fraction.double()),
            "full_storage": ("a data store", lambda satellite: satellite.dynamics.storage_level_fraction.double()),
            "empty_downlink": ("act.Downlink(until_empty=True)", _empty_downlinks),
        }
        self._reads = {name: read for name, (_, read) in needs.items() if self.penalties[name] != 0.0}
        for name, read in self._reads.items():
            if not any(_has(satellite, read) for satellite in fleet.satellites):
                raise ValueError(f"OperationsPenalty: {name}={self.penalties[name]:g} needs a satellite with {needs[name][0]}")

    def read_log(self) -> Log:
        """See :meth:`GlobalReward.read_log`; what the penalties follow from."""
        missing = {"low_battery": 1.0}
        return {name: self.fleet.each(read, missing.get(name, 0.0)) for name, read in self._reads.items()}

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        reward = torch.zeros(self.fleet.shape, dtype=torch.float64, device=self.fleet.device)
        for name, value in after.items():
            if name == "empty_downlink":
                times = value - before[name]
            else:
                times = (value < self.battery_below if name == "low_battery" else value > self.storage_above).double()
            reward = reward + self.penalties[name] * times
        return self.of_channel(reward)


def _empty_downlinks(satellite: BoundSatellite) -> Tensor:
    if EMPTY_DOWNLINKS not in satellite.memory:
        raise AttributeError(f"{satellite.name} has no act.Downlink(until_empty=True)")
    return satellite.memory[EMPTY_DOWNLINKS].double()


def _has(satellite: BoundSatellite, read: Callable[[BoundSatellite], Tensor]) -> bool:
    try:
        read(satellite)
    except AttributeError:
        return False
    return True


class TimePenalty(GlobalReward):
    """Pays every satellite ``-weight`` times the duration of the step, s, as a branch of BSK-RL's authors does.

    Add it to other rewarders for tasks that shall be done early: ``rewarder=(data.UniqueImageReward(), data.TimePenalty(1e-4))``.
    """

    def __init__(self, weight: float = 1.0) -> None:
        """Charge ``weight`` for each second, from 0 to 1e30; ValueError for anything else."""
        self.weight = number("weight", weight, 0.0, MOST_PENALTY)

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        price = -self.weight * self.step_duration
        return self.of_channel(price.unsqueeze(1).expand(self.fleet.shape).to(torch.float64))
