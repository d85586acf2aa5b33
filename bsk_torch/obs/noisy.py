"""Noise on observations."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.obs.base import Observation, Reader, Values, flatten, link
from bsk_torch.rand import Choice, Distribution, Key, Normal
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sats.user_function import UserFunction
from bsk_torch.sim.names import nearest
from bsk_torch.sim.readout.observables import Function

Noise = float | Distribution | Mapping[str, float | Distribution]
"""Standard deviation of normal noise, or a distribution, of all numbers observed or by name."""

MOST_NOISE = 1e30
"""Upper limit of standard deviations, so that noise is finite in float32."""

OWNER = "noise_env"
"""Memory of the environment's index at the start of an episode: copies of the episode share its noise."""


class Noisy(Observation):
    """An observation with noise, as from imperfect sensors and navigation.

    Noise is added to the observation after division by its norms. It depends only on the environment's seed, index and episode,
    the satellite, the time and the name of the observation. It differs between decisions, is the same whenever one decision is
    observed again, and does not depend on the batch. Rewards, flight software and action masks use the true state;
    ``noisy.observation.get_obs()`` is the observation without noise.
    """

    def __init__(self, observation: Observation, noise: Noise = 0.0, bias: Noise = 0.0, name: str | None = None) -> None:
        """Add noise to an observation.

        Args:
            observation: An observation, such as ``obs.SatProperties(...)``.
            noise: Noise of each decision: the standard deviation of normal noise, a distribution of :mod:`bsk_torch.rand`, or a
                dictionary of these by the names of properties; other properties have no noise.
            bias: Noise drawn once for each episode, likewise.
            name: Name of the entry (default: that of the observation).
        """
        if not isinstance(observation, Observation):
            raise ValueError(f"obs.Noisy({observation!r}): it must be an observation; write obs.Time(), with parentheses")
        if isinstance(observation, Noisy):
            raise ValueError(f"obs.Noisy of {observation.name!r}, which has noise already: give that one the larger noise")
        super().__init__(observation.name if name is None else name)
        self.observation = observation
        self._parts = [(_parse(noise, "noise"), False), (_parse(bias, "bias"), True)]
        self._plans: list[list[tuple[Distribution, list[int]]]] | None = None

    def __deepcopy__(self, memo: dict[int, object]) -> Noisy:
        made = copy.copy(self)
        made.observation = copy.deepcopy(self.observation, memo)
        return made

    @override
    def link_satellite(self, satellite: BoundSatellite) -> None:
        super().link_satellite(satellite)
        link(self.observation, satellite)
        self._reader = Reader(self.observation)
        if OWNER not in satellite.simulator.memory:
            satellite.simulator.memory.declare(OWNER, -1, low=-1)
            satellite.fleet.beginnings.append(self._own)

    @property
    @override
    def functions(self) -> list[UserFunction]:
        return self._reader.functions

    @override
    def observables(self) -> list[Function]:
        return self.observation.observables()

    @override
    def trace(self) -> None:
        self.observation.trace()

    @override
    def get_obs(self) -> Tensor | Values:
        values = self._reader.values()
        leaves = list(flatten({self.name: values}, len(self.simulator.ticks)))
        noise = self._noise(leaves).split([leaf.shape[-1] for _, leaf in leaves], -1)
        return _with_noise(values, iter(noise))

    @override
    def get_vector(self) -> Tensor:
        vector = self._reader.vector()
        if self._plans is None:
            self.get_obs()
        return vector + self._noise_of(vector)

    def _noise(self, leaves: list[tuple[str, Tensor]]) -> Tensor:
        if self._plans is None:
            columns = _columns(leaves, getattr(self.observation, "exact", ()))
            self._plans = [_plan(part, columns, self.name) for part, _ in self._parts]
        return self._noise_of(torch.cat([leaf for _, leaf in leaves], -1))

    def _noise_of(self, vector: Tensor) -> Tensor:
        """Return noise for the observed numbers [N, width]."""
        assert self._plans is not None
        noise = torch.zeros_like(vector, dtype=torch.float64)
        if any(self._plans):
            key = self._key()
            for plan, (_, of_episode), title in zip(self._plans, self._parts, ("noise", "bias"), strict=True):
                row_key = key if of_episode else replace(key, moment=self.simulator.ticks.cpu())
                for number, (distribution, columns) in enumerate(plan):
                    drawn = _draw(distribution, row_key.named(f"{self.unique_name} {title} {number}"), len(columns)).to(
                        vector.device
                    )
                    noise = noise.index_add(1, torch.tensor(columns, device=vector.device), drawn)
        return noise

    def _own(self, envs: Tensor) -> None:
        """Store the index of the environments ``envs`` [n], whose episodes have begun."""
        state, memory = self.simulator.state, self.simulator.memory
        rows = state.rows_of(envs)
        memory[OWNER] = memory[OWNER].index_copy(0, rows, state.of_env(self.satellite.fleet.env_ids)[rows])

    def _key(self) -> Key:
        fleet, k = self.satellite.fleet, self.satellite.type_index
        key = fleet.key().of_satellites(fleet.columns[k].cpu())
        return replace(key, env_id=self.simulator.memory[OWNER].cpu())


def _parse(noise: object, title: str) -> dict[str | None, Distribution]:
    """Return distributions by name, or under None for all numbers, without those that have no noise."""
    parts = dict(noise) if isinstance(noise, Mapping) else {None: noise}
    distributions: dict[str | None, Distribution] = {}
    for name, value in parts.items():
        if isinstance(value, Distribution):
            distributions[name] = value
        elif isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value < MOST_NOISE:
            if value:
                distributions[name] = Normal(0.0, float(value))
        else:
            raise ValueError(
                f"obs.Noisy: {title}={value!r}{'' if name is None else f' of {name!r}'} must be a standard deviation from 0 on, "
                "a distribution of bsk_torch.rand, or a dictionary of these by name"
            )
    return distributions


def _columns(leaves: list[tuple[str, Tensor]], exact: tuple[str, ...]) -> list[tuple[str, list[int]]]:
    """Return the path and the columns of each observed quantity, without those that never have noise."""
    columns, first = [], 0
    for path, leaf in leaves:
        if path.rpartition(".")[2] not in exact:
            columns.append((path, list(range(first, first + leaf.shape[-1]))))
        first += leaf.shape[-1]
    return columns


def _plan(
    part: dict[str | None, Distribution], columns: list[tuple[str, list[int]]], title: str
) -> list[tuple[Distribution, list[int]]]:
    """Return each distribution with the columns that it is drawn for."""
    plan = []
    for name, distribution in part.items():
        chosen = [numbers for path, numbers in columns if name is None or name in path.split(".") or name == path]
        if not chosen:
            names = sorted({path.rpartition(".")[2] for path, _ in columns})
            raise ValueError(f"obs.Noisy: {name!r} is not observed in {title!r}; {nearest(str(name), names)}")
        plan.append((distribution, [column for numbers in chosen for column in numbers]))
    return plan


def _draw(distribution: Distribution, key: Key, count: int) -> Tensor:
    """Draw ``count`` numbers for each row of the key, [n, count]."""
    bounds = (getattr(distribution, name, 0.0) for name in ("low", "high"))
    wide = any(not isinstance(bound, int | float) for bound in bounds)  # these set the number of values
    if dataclasses.is_dataclass(distribution) and getattr(distribution, "size", 0) is None and not wide:
        if isinstance(distribution, Choice):
            return torch.as_tensor(Choice(distribution.options, count).draw(key), dtype=torch.float64)
        return torch.as_tensor(replace(distribution, size=count).draw(key), dtype=torch.float64)
    drawn = torch.as_tensor(distribution.draw(key), dtype=torch.float64)
    drawn = drawn.unsqueeze(-1) if drawn.ndim == 1 else drawn
    if drawn.shape != (len(key), count):
        raise ValueError(f"obs.Noisy: {distribution!r} gives shape {list(drawn.shape)[1:]}; {count} numbers are observed")
    return drawn


def _with_noise(values: Any, noise: Any) -> Any:
    """Return named observations plus their noise, which comes leaf by leaf as [N, width]."""
    if isinstance(values, dict):
        return {name: _with_noise(value, noise) for name, value in values.items()}
    return values + next(noise).reshape(values.shape)
