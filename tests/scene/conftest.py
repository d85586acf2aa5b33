"""A satellite that holds what scenarios draw, as an environment would."""

from __future__ import annotations

import copy
from collections.abc import Callable
from types import SimpleNamespace

import pytest
import torch

from bsk_torch import rand, scene

MANY = 20_000


def key(n: int = 4, seed: int = 7, episode: int = 0) -> rand.Key:
    ids = torch.arange(n)
    return rand.Key(torch.full_like(ids, seed), ids, torch.full_like(ids, episode))


def rows_of(whole: rand.Key, rows: list[int]) -> rand.Key:
    return rand.Key(whole.seed[rows], whole.env_id[rows], whole.episode[rows], whole.name)


class HoldingSimulator:
    """Arguments of N environments and their time."""

    def __init__(self, n: int) -> None:
        self.n, self.sim_time, self.drawn = n, torch.zeros(n, dtype=torch.float64), {}

    def remember(self, rows: torch.Tensor, values: dict[str, torch.Tensor]) -> None:
        for name, value in values.items():
            assert value.dtype == torch.float64, name
            assert len(value) in (1, len(rows)), name
            if name not in self.drawn:
                self.drawn[name] = torch.zeros(self.n, *value.shape[1:], dtype=torch.float64)
            self.drawn[name][rows] = value

    def argument(self, name: str) -> torch.Tensor:
        return self.drawn[name]


@pytest.fixture
def begin() -> Callable[..., scene.TargetScenario]:
    """A copy of a scenario at the start of N episodes."""

    def start(scenario: scene.TargetScenario, whole: rand.Key | int = 4) -> scene.TargetScenario:
        whole = key(whole) if isinstance(whole, int) else whole
        simulator, linked = HoldingSimulator(len(whole)), copy.copy(scenario)
        linked.link_satellite(SimpleNamespace(name="Imager", target_types=("target",), simulator=simulator))
        simulator.remember(torch.arange(len(whole)), scenario.draw(whole))
        linked.reset(torch.arange(len(whole)))
        return linked

    return start


@pytest.fixture
def move() -> Callable[..., None]:
    """Moves a linked scenario to a time, s, the same for all environments or one for each."""

    def to(scenario: scene.TargetScenario, time: float | torch.Tensor) -> None:
        simulator = scenario.satellite.simulator
        simulator.sim_time = torch.as_tensor(time, dtype=torch.float64).expand(simulator.n).clone()
        scenario.after_step(simulator.sim_time)

    return to
