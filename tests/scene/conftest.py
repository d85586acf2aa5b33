"""A fleet that holds what scenarios draw, as an environment would."""

import copy
from collections.abc import Callable
from types import SimpleNamespace

import pytest
import torch

from bsk_torch import rand, scene
from bsk_torch.sim.draw_table import DrawTable

MANY = 20_000


def key(n: int = 4, seed: int = 7, episode: int = 0) -> rand.Key:
    ids = torch.arange(n)
    return rand.Key(torch.full_like(ids, seed), ids, torch.full_like(ids, episode))


def rows_of(whole: rand.Key, rows: list[int]) -> rand.Key:
    return rand.Key(whole.seed[rows], whole.env_id[rows], whole.episode[rows], whole.name)


class HoldingFleet:
    """What the scenario has drawn for N episodes of one satellite, and their time."""

    def __init__(self, n: int) -> None:
        self.num_envs, self.sim_time, self.scenario_state = n, torch.zeros(n, dtype=torch.float64), DrawTable(n)
        self.satellites = (SimpleNamespace(name="Imager", target_types=("target",)),)

    def keep(self, envs: torch.Tensor, asked: dict[str, torch.Tensor]) -> None:
        for name, value in asked.items():
            assert value.dtype == torch.float64, name
            assert len(value) in (1, len(envs)), name
            if name not in self.scenario_state:
                self.scenario_state.declare(name, None, *value.shape[1:], dtype=torch.float64)
            self.scenario_state[name][envs] = value


@pytest.fixture
def begin() -> Callable[..., scene.TargetScenario]:
    """A copy of a scenario at the start of N episodes."""

    def start(scenario: scene.TargetScenario, whole: rand.Key | int = 4) -> scene.TargetScenario:
        whole = key(whole) if isinstance(whole, int) else whole
        fleet, linked = HoldingFleet(len(whole)), copy.copy(scenario)
        linked.link(fleet)
        fleet.keep(torch.arange(len(whole)), scenario.draw(whole))
        linked.reset(torch.arange(len(whole)))
        return linked

    return start


@pytest.fixture
def move() -> Callable[..., None]:
    """Moves a linked scenario to a time, s, the same for all environments or one for each."""

    def to(scenario: scene.TargetScenario, time: float | torch.Tensor) -> None:
        fleet = scenario.fleet
        fleet.sim_time = torch.as_tensor(time, dtype=torch.float64).expand(fleet.num_envs).clone()
        scenario.after_step(fleet.sim_time)

    return to
