"""Readers of observations by name and in units, for rules."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor

from bsk_torch.env import Tasking
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.obs import Noisy, Observation
from bsk_torch.obs.candidates import CandidateObservation
from bsk_torch.rl.policies.shared_policy import member_view
from bsk_torch.rl.rules.targets import WIDTHS
from bsk_torch.sim.names import nearest

__all__ = ["ObservationReader", "reader"]

NORMD = "_normd"
"""End of the names of properties that a norm divides."""


class Quantity(NamedTuple):
    """What a name stands for in an observation.

    Attributes:
        columns: Its columns in the vector.
        keys: Keys of its parts in a named observation.
        places: Its places in these parts, flattened and joined.
        shape: Shape of the quantity of one satellite; empty for a number.
        norm: Divisor, a number or one for each component.
    """

    columns: list[int]
    keys: list[tuple[str, ...]]
    places: list[int]
    shape: tuple[int, ...]
    norm: Any


class ObservationReader:
    """Reads quantities of observations by name, multiplied by the norms that divide them: in the units of their properties.

    These are SI units: seconds, meters, radians; fractions stay fractions. :class:`bsk_torch.obs.Time` and
    :class:`bsk_torch.obs.Eclipse` without a norm are fractions of the time limit and of the period.

    Attributes:
        quantities: The quantities by their full names, such as ``"target.priority"``.
    """

    def __init__(self, satellite: SatelliteGroup) -> None:
        """Read the observations of a ``satellite``."""
        self.quantities: dict[str, Quantity] = {}
        description = satellite.observation_description
        keys = [tuple(name.partition("[")[0].split(".")) for name in description]
        widths, starts = Counter(keys), {key: keys.index(key) for key in dict.fromkeys(keys)}
        for entry in satellite.observations.entries:
            own = [k for k, key in enumerate(keys) if key[0] == entry.unique_name]
            for name, (columns, shape, norm) in _quantities(entry, own, keys).items():
                parts = list(dict.fromkeys(keys[k] for k in columns))
                before = {part: sum(widths[p] for p in parts[:k]) for k, part in enumerate(parts)}
                places = [before[keys[k]] + k - starts[keys[k]] for k in columns]
                self.quantities[name] = Quantity(columns, parts, places, shape, norm)

    def __call__(self, observation: Tensor | TensorDictBase | Mapping[str, object], name: str) -> Tensor:
        """Return a quantity, [N], [N, width], or of n candidates [N, n] or [N, n, width].

        Args:
            observation: The observation, a vector [N, F] or a tensordict or dictionary of its parts.
            name: Name of the property, or its full name, such as ``"target.priority"``, if several parts of the observation have
                it. In observations of candidates with ``as_set=True``, ``"target.mask"`` tells which of them exist.

        Raises:
            KeyError: If there is no such name, or several.
        """
        quantity = self.quantity(name)
        if isinstance(observation, Tensor):
            flat = observation[..., quantity.columns]
        else:
            batch = observation.batch_dims if isinstance(observation, TensorDictBase) else 1
            parts = [_part(observation, key) for key in quantity.keys]
            flat = torch.cat([p.unsqueeze(-1) if p.ndim == batch else p.flatten(batch) for p in parts], -1)[..., quantity.places]
        value = flat.unflatten(-1, quantity.shape) if quantity.shape else flat.squeeze(-1)
        norm = torch.as_tensor(quantity.norm, dtype=value.dtype, device=value.device)
        return value * norm

    def quantity(self, name: str) -> Quantity:
        """Return what a name stands for; KeyError as from a call."""
        if name in self.quantities:
            return self.quantities[name]
        full = [each for each in self.quantities if each.rpartition(".")[2] == name]
        if len(full) > 1:
            raise KeyError(f"{name!r} is observed several times; name one of {', '.join(full)}")
        if not full:
            short = [each.rpartition(".")[2] for each in self.quantities]
            raise KeyError(f"{name!r} is not observed; {nearest(name, [*self.quantities, *short])}")
        return self.quantities[full[0]]


def reader(env: Tasking) -> ObservationReader:
    """Return a reader of the observations of an environment by name, for your own rules.

    Example:
        >>> see = bsk_torch.reader(env)
        >>> def rule(observation):
        ...     return torch.where(see(observation, "battery_charge_fraction") < 0.2, 1, 0)

    Args:
        env: An environment with one satellite, or a constellation of equal ones, whose satellites each observe the same.

    Raises:
        ValueError: For satellites of several kinds.
    """
    return ObservationReader(member_view(env).satellite)


def _part(observation: Any, key: tuple[str, ...]) -> Tensor:
    for name in key:
        observation = observation[name]
    return observation


def _quantities(
    entry: Observation, own: Sequence[int], keys: Sequence[tuple[str, ...]]
) -> dict[str, tuple[list[int], tuple[int, ...], object]]:
    """Return columns, shape and norm by full name of what an ``entry`` observes in the columns ``own``."""
    top, source = entry.unique_name, entry.observation if isinstance(entry, Noisy) else entry
    norms = dict(map(_named, getattr(source, "entries", ())))
    alone = getattr(source, "norm", None)
    quantities: dict[str, tuple[list[int], tuple[int, ...], object]] = {}
    if isinstance(source, CandidateObservation) and source.as_set:
        return _of_set(source, top, norms, own)
    n = source.n_ahead_observe if isinstance(source, CandidateObservation) else 1
    last = list(dict.fromkeys(keys[k][2:] if n > 1 or isinstance(source, CandidateObservation) else keys[k][1:] for k in own))
    for rest in last:
        columns = [k for k in own if keys[k][len(keys[k]) - len(rest) :] == rest] if rest else list(own)
        width, label = len(columns) // n, ".".join(rest)
        shape = (() if n == 1 else (n,)) + (() if width == 1 else (width,))
        norm = norms.get(label, (1.0 if alone is None else alone) if not rest else 1.0)
        name = label.removesuffix(NORMD) if label in norms else label
        quantities[f"{top}.{name}" if name else top] = columns, shape, norm
    return quantities


def _of_set(
    entry: CandidateObservation, top: str, norms: Mapping[str, object], own: Sequence[int]
) -> dict[str, tuple[list[int], tuple[int, ...], object]]:
    """Return the same for candidates observed as a set: rows [n, F], then the mask [n]."""
    n = entry.n_ahead_observe
    total = len(own) // n - 1
    widths = {name: WIDTHS.get(name.removesuffix(NORMD), 1) for name in norms}
    if sum(widths.values()) != total:
        raise ValueError(
            f"{top!r} has {total} columns, not {sum(widths.values())}: a function gives several; read these by column"
        )
    quantities: dict[str, tuple[list[int], tuple[int, ...], object]] = {}
    at = 0
    for name, width in widths.items():
        columns = [own[row * total + at + k] for row in range(n) for k in range(width)]
        shape = (() if n == 1 else (n,)) + (() if width == 1 else (width,))
        quantities[f"{top}.{name.removesuffix(NORMD)}"] = columns, shape, norms[name]
        at += width
    return quantities | {f"{top}.mask": (list(own[n * total :]), () if n == 1 else (n,), 1.0)}


def _named(entry: Any) -> tuple[str, Any]:
    """Return name and norm of a described property."""
    return (entry["name"], entry["norm"]) if isinstance(entry, Mapping) else (entry.name, entry.norm)
