"""Scenarios of the examples with the attributes of targets that bsk_rl drew, and what else a replay puts into an environment."""

from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from bsk_torch.rand import Key
from tests.examples.recorded import Recorded


def given(scenario: Any, values: dict[str, Tensor]) -> Any:
    """A scenario that draws ``values`` [T] instead of its own, by their names in ``draw``."""

    class Given(type(scenario)):
        def draw(self, key: Key) -> dict[str, Tensor]:
            return super().draw(key) | {name: value.expand(len(key), -1) for name, value in values.items()}

    scenario.__class__ = Given
    return scenario


def clouds(module: ModuleType, recorded: Recorded) -> Any:
    """Targets under the recorded clouds."""
    named = {"cloud_cover": "cover", "cloud_forecast": "forecast", "cloud_forecast_sigma": "sigma"}
    return given(module.CloudTargets(recorded.targets), {mine: recorded.target(name) for mine, name in named.items()})


def beliefs(module: ModuleType, recorded: Recorded) -> Any:
    """Targets with the recorded forecasts and beliefs."""
    named = {"cloud_forecast": "forecast", "belief_at_start": "belief_at_start", "previous_at_start": "previous_at_start"}
    return given(module.CloudTargets(recorded.targets), {mine: recorded.target(name) for mine, name in named.items()})


def areas(module: ModuleType, recorded: Recorded) -> Any:
    """Targets in the recorded areas."""
    table = recorded.arrays["targets"]
    scenario = module.AreaTargets(len(table))
    named = {"side": "side_at_start", "acquiring_speed": "acquiring_speed", "speed": "speed"}
    values = {mine: recorded.target(name) for mine, name in named.items()}
    values |= {"target_priority": torch.from_numpy(table[:, 3].copy())}
    scenario = given(scenario, values)
    scenario.places = lambda key: {"target_r_LP_P": torch.from_numpy(table[:, :3].copy()).expand(len(key), -1, -1)}
    return scenario


def find_after(env: Any, recorded: Recorded, k: int) -> None:
    """Let the target of step k be found after the recorded time, by the lot of the decision."""
    satellite, action = env.satellite, torch.from_numpy(recorded.arrays["action"][k])
    target = satellite.find_next_opportunities(32).place.gather(1, action.unsqueeze(1)).squeeze(1)
    _, whole = env.rewarder.search_of(target, torch.zeros(1))
    number = int(satellite.simulator.memory["searches"][0])
    if float(whole) > 0.0:
        lots = env.fleet.scenario_state["lot"].clone()
        lots[0, number] = (recorded.arrays["dwell"][k] / float(whole) - 0.5) / 0.3
        env.fleet.scenario_state["lot"] = lots
