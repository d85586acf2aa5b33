"""Base of observations, and how a satellite's list of them becomes one vector or one Composite."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

if TYPE_CHECKING:
    from bsk_torch.sats.satellite import Satellite

Values = dict[str, Any]
"""Observed quantities by name: tensors [N] or [N, width], or dictionaries of them."""


class Observation:
    """One entry of an ``observation_spec``."""

    def __init__(self, name: str) -> None:
        """Name of the entry in the observation."""
        self.name = name

    def link_satellite(self, satellite: Satellite) -> None:
        """Called once when the environment is built; raises where the satellite cannot be observed so."""
        self.satellite = satellite

    @property
    def simulator(self) -> Any:
        """The simulation that the satellite lives in."""
        return self.satellite.simulator

    def observables(self) -> list[Any]:
        """Functions of the observables that :meth:`get_obs` reads; see :mod:`bsk_torch.sim.observe`."""
        return []

    def get_obs(self) -> Tensor | Values:
        """What is seen now."""
        raise NotImplementedError(f"{type(self).__name__} must implement get_obs()")

    def get_vector(self) -> Tensor:
        """What is seen now as one vector, [N, width]: the leaves of :meth:`get_obs` in order."""
        return torch.cat([value for _, value in flatten({self.name: self.get_obs()})], -1)


def scaled(value: Tensor, norm: float) -> Tensor:
    """The value over its norm."""
    return value if norm == 1.0 else value / norm


def property_name(entry: dict[str, Any]) -> str:
    """Name of one observed property: its own, with ``_normd`` where it is divided by a norm."""
    default = str(entry.get("prop") or getattr(entry.get("fn"), "__name__", "fn"))
    return str(entry.get("name") or default + ("_normd" if entry.get("norm", 1.0) != 1.0 else ""))


def check_entries(entries: Sequence[dict[str, Any]], allowed: set[str], title: str) -> None:
    """Raise ValueError for dictionaries with unknown keys, or with neither or both of ``prop`` and ``fn``."""
    for entry in entries:
        unknown = set(entry) - allowed
        if unknown:
            raise ValueError(f"{title} got unknown keys {sorted(unknown)} in {entry}; allowed are {sorted(allowed)}")
        if ("prop" in entry) == ("fn" in entry):
            raise ValueError(f"{title} needs either 'prop' or 'fn' in {entry}")


def flatten(values: Values, prefix: str = "") -> Iterator[tuple[str, Tensor]]:
    """Leaves in order, as names and tensors [N, width]."""
    for name, value in values.items():
        path = f"{prefix}{name}"
        if isinstance(value, dict):
            yield from flatten(value, path + ".")
        else:
            yield path, value.unsqueeze(-1) if value.ndim == 1 else value.flatten(1)


class ObservationBuilder:
    """The observations of a satellite, in the order of its ``observation_spec``."""

    def __init__(self, spec: Sequence[Observation], satellite: Satellite) -> None:
        """Link every entry; ValueError for an empty or misused spec. Repeated names get a number."""
        if not spec:
            raise ValueError(f"{type(satellite).__name__}.observation_spec is empty; list at least one, such as obs.Time()")
        for entry in spec:
            if not isinstance(entry, Observation):
                raise ValueError(f"observation_spec holds {entry!r}, which is no observation; write obs.Time(), with parentheses")
            entry.link_satellite(satellite)
        self.entries, self.satellite = tuple(spec), satellite

    @property
    def observables(self) -> list[Any]:
        """Functions of the properties that kernels compute."""
        return [function for entry in self.entries for function in entry.observables()]

    def get_dict(self) -> Values:
        """All observations by name."""
        values: Values = {}
        for entry in self.entries:
            name, count = entry.name, 1
            while name in values:
                count += 1
                name = f"{entry.name}_{count}"
            values[name] = entry.get_obs()
        return values

    def get_vector(self, dtype: torch.dtype) -> Tensor:
        """All observations side by side, [N, width]."""
        return torch.cat([entry.get_vector() for entry in self.entries], -1).to(dtype)

    @staticmethod
    def vector(values: Values, dtype: torch.dtype) -> Tensor:
        """All values side by side, [N, width]."""
        return torch.cat([value for _, value in flatten(values)], -1).to(dtype)

    @staticmethod
    def describe(values: Values) -> list[str]:
        """Name of every entry of the vector."""
        names = []
        for name, value in flatten(values):
            names += [name] if value.shape[-1] == 1 else [f"{name}[{k}]" for k in range(value.shape[-1])]
        return names
