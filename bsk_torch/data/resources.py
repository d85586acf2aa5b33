"""Rewards for resources."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import no_gradient, number
from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.rand import Distribution, Key, seeded
from bsk_torch.sats.bound import BoundSatellite, SatelliteFleet
from bsk_torch.sats.user_function import UserFunction
from bsk_torch.scene.base import Scenario
from bsk_torch.sim.state import FINITE

ADVICE = (
    "let it return [N] for all satellites: properties such as satellite.dynamics.battery_charge_fraction are tensors [N], and "
    "torch's functions take the place of NumPy's"
)

MEMORY = "resource_weight"
"""Prefix of the memory names of drawn weights."""

Weight = float | Distribution | Callable[[], float]


class ResourceReward(GlobalReward):
    """Reward proportional to the change of a resource: reward_weight * (resource_after - resource_before)."""

    def __init__(self, reward_weight: Weight = 1.0, resource_fn: object = None) -> None:
        """Reward a resource.

        Args:
            reward_weight: Reward for one unit of the resource: a number, or a value drawn for each environment and episode from a
                distribution of :mod:`bsk_torch.rand` or by a function without arguments. NumPy's global generator is seeded
                before each call of the function.
            resource_fn: Function that returns the resource of the satellites of a type, [N], such as
                ``lambda sat: sat.dynamics.battery_charge_fraction``.
        """
        if not callable(resource_fn):
            advice = "; write resource_fn= before it: the first argument is the weight" if callable(reward_weight) else ""
            raise TypeError(f"resource_fn={resource_fn!r} must be a function of the satellite{advice}")
        if not callable(reward_weight) and not isinstance(reward_weight, Distribution):
            reward_weight = number("reward_weight", reward_weight)
        self.resource_fn, self.weight = resource_fn, reward_weight

    @override
    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        super().link(scenario, fleet)
        self._functions: dict[int, UserFunction] = {}
        self._name: str | None = None
        if not isinstance(self.weight, float):
            number = sum(name.startswith(MEMORY) for name in fleet.memory)
            self._name = f"{MEMORY}_{number}"
            fleet.memory.declare(self._name, float("nan"), low=-FINITE, high=FINITE)
            fleet.beginnings.append(self._draw)

    @property
    def reward_weight(self) -> Any:
        """Current weight of each environment, [N] float64; the argument itself before an environment is built."""
        if not hasattr(self, "fleet"):
            return self.weight
        fleet = self.fleet
        if self._name is not None:
            return fleet.memory[self._name]
        return torch.full((fleet.num_envs,), self.weight, dtype=torch.float64, device=fleet.device)  # type: ignore[arg-type]

    def _draw(self, envs: Tensor) -> None:
        memory, name = self.fleet.memory, str(self._name)
        drawn = draw_weights(self.weight, self.fleet.key().named(name), envs.tolist())
        memory[name] = memory[name].index_copy(0, envs, drawn.to(memory.device))

    @property
    def resource_weights(self) -> tuple[Tensor, ...]:
        """The current weight, observed by :class:`bsk_torch.obs.ResourceRewardWeight`."""
        return (self.reward_weight,)

    def read_log(self) -> Log:
        """See :meth:`GlobalReward.read_log`; the resource."""
        return {"resource": self.fleet.each(self._resource)}

    def _resource(self, satellite: BoundSatellite) -> Tensor:
        simulator = satellite.simulator
        function = self._functions.setdefault(id(satellite), UserFunction("resource_fn of data.ResourceReward", ADVICE))
        rows = len(simulator.ticks)
        resource = function((rows,), simulator.device, lambda: self.resource_fn(satellite))
        if resource.shape != (rows,):
            raise TypeError(f"{function.title} gives shape {list(resource.shape)}; it must give one number for each satellite")
        return resource.double().clone()

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        return self.reward_weight.unsqueeze(-1) * (after["resource"] - before["resource"])


def draw_weights(weight: Any, key: Key, rows: list[int]) -> Tensor:
    """Draw weights for some ``rows`` of a key, [len(rows)] float64."""
    part = key.take(rows)
    if isinstance(weight, Distribution):
        drawn = torch.as_tensor(weight.draw(part), dtype=torch.float64)
    else:
        with seeded(part) as each:
            drawn = torch.tensor([float(no_gradient("reward_weight", weight())) for _ in each], dtype=torch.float64)
    if drawn.shape != (len(rows),) or not bool(torch.isfinite(drawn).all()):
        raise ValueError(f"reward_weight={weight!r} gives {drawn.tolist()[:5]}; it must give a finite number for each episode")
    return drawn
