"""Base class of observations, and the vector or Composite that a satellite's ``observation_spec`` forms."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from bsk_torch.sim.hooks import check_class, check_tensor, defined_first

if TYPE_CHECKING:
    from bsk_torch.sats.satellite import Satellite

HOOKS = ("link_satellite", "observables", "get_obs", "get_vector")
"""Members of :class:`Observation` that subclasses may define."""

MEMORY = (
    "keep values that start anew with every episode in satellite.simulator.memory; declare them in link_satellite(satellite): "
    "memory.declare(name, initial_value)"
)

UNUSED = {
    "get_observation": "define get_obs()",
    "observation_space": "shapes follow from a trial call of get_obs()",
    "space": "shapes follow from a trial call of get_obs()",
    "observation_description": "names follow from a trial call of get_obs(), which may return a dictionary",
    "link_simulator": "define link_satellite(satellite), which finds the simulation in satellite.simulator",
    "reset_overwrite_previous": MEMORY,
    "reset_pre_sim_init": MEMORY,
    "reset_during_sim_init": MEMORY,
    "reset_post_sim_init": MEMORY,
}
"""Names that are no hooks of observations, those of bsk_rl among them, and what to write instead."""

Values = dict[str, Any]
"""Observed quantities by name: tensors [N] or [N, width], or dictionaries of them."""


class Observation:
    """One entry of an ``observation_spec``. Subclasses define :meth:`get_obs`.

    N is the number of satellites of the type.

    Attributes:
        name: Name of the entry in the observation.
        satellite: The satellites, once an environment has been built.
    """

    satellite: Any

    def __init__(self, name: str) -> None:
        """Name the entry."""
        self.name = name

    def __init_subclass__(cls, **options: Any) -> None:
        """Refuse definitions that no environment would use; TypeError says what to write instead."""
        super().__init_subclass__(**options)
        check_class(cls, Observation, HOOKS, UNUSED)
        if "get_vector" in vars(cls) and "get_obs" not in vars(cls):
            raise TypeError(
                f"{cls.__name__} defines get_vector() without get_obs(), so named observations would not use it; define "
                "get_obs(), from which vectors are made, too"
            )

    def link_satellite(self, satellite: Satellite) -> None:
        """Prepare for a satellite; called once when an environment is built.

        Overriding methods call ``super().link_satellite(satellite)`` first, and raise ValueError for a satellite that cannot be
        observed in this way.
        """
        self.satellite = satellite

    @property
    def simulator(self) -> Any:
        """Simulation of the satellites."""
        return self.satellite.simulator

    def observables(self) -> list[Any]:
        """Return functions of observables that :meth:`get_obs` reads, so that one kernel computes them together.

        See :mod:`bsk_torch.sim.readout.observables`. Observables that are not listed are computed one by one.
        """
        return []

    def get_obs(self) -> Tensor | Values:
        """Return the present observation: a tensor [N] or [N, ...], or a dictionary of them by name, which may be nested."""
        raise NotImplementedError(f"{type(self).__name__} must implement get_obs()")

    def get_vector(self) -> Tensor:
        """Return the present observation as one vector [N, width], the leaves of :meth:`get_obs` side by side.

        A class may define a faster way beside its ``get_obs``; a subclass that overrides only ``get_obs`` gets this one again.
        """
        return torch.cat([value for _, value in flatten({self.name: self.get_obs()}, len(self.simulator.ticks))], -1)


def scaled(value: Tensor, norm: float) -> Tensor:
    """Return the value divided by its norm."""
    return value if norm == 1.0 else value / norm


def property_name(entry: dict[str, Any]) -> str:
    """Return the name of an observed property: ``name``, or that of the property, with ``_normd`` if a norm divides it."""
    default = str(entry.get("prop") or getattr(entry.get("fn"), "__name__", "fn"))
    return str(entry.get("name") or default + ("_normd" if entry.get("norm", 1.0) != 1.0 else ""))


def check_entries(entries: Sequence[dict[str, Any]], allowed: set[str], title: str) -> None:
    """Raise ValueError for dictionaries with unknown keys, with neither or both of ``prop`` and ``fn``, or with equal names."""
    for entry in entries:
        unknown = set(entry) - allowed
        if unknown:
            raise ValueError(f"{title} got unknown keys {sorted(unknown)} in {entry}; allowed are {sorted(allowed)}")
        if ("prop" in entry) == ("fn" in entry):
            raise ValueError(f"{title} needs either 'prop' or 'fn' in {entry}")
    names = [property_name(entry) for entry in entries]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"{title} has several properties called {twice}; tell them apart by the key 'name'")


def flatten(values: Values, count: int | None = None, prefix: str = "") -> Iterator[tuple[str, Tensor]]:
    """Yield the leaves in order, as dotted names and tensors [N, width].

    Raises:
        TypeError: For a leaf that is no tensor [N] or [N, ...], with N = ``count`` if that is given.
    """
    for name, value in values.items():
        path = f"{prefix}{name}"
        if isinstance(value, dict):
            yield from flatten(value, count, path + ".")
        elif isinstance(value, Tensor) and value.ndim and count in (None, value.shape[0]):
            yield path, value.unsqueeze(-1) if value.ndim == 1 else value.flatten(1)
        else:
            given = f"a tensor of shape {list(value.shape)}" if isinstance(value, Tensor) else repr(value)
            raise TypeError(
                f"observation {path!r} is {given}; it must be a tensor of shape [{count or 'N'}] or [{count or 'N'}, ...]"
            )


class ObservationBuilder:
    """The observations of a satellite type, in the order of its ``observation_spec``.

    Attributes:
        entries: The entries.
    """

    def __init__(self, spec: Sequence[Observation], satellite: Satellite) -> None:
        """Link every entry to the satellite.

        Raises:
            ValueError: For an empty spec or an entry that is no observation.
            TypeError: For an entry whose ``link_satellite`` does not call that of its base class.
        """
        if not spec:
            raise ValueError(f"{type(satellite).__name__}.observation_spec is empty; list at least one, such as obs.Time()")
        for entry in spec:
            if not isinstance(entry, Observation):
                raise ValueError(f"observation_spec holds {entry!r}, which is no observation; write obs.Time(), with parentheses")
            entry.link_satellite(satellite)
            if getattr(entry, "satellite", None) is not satellite:
                raise TypeError(f"{type(entry).__name__}.link_satellite(satellite) must call super().link_satellite(satellite)")
        self.entries, self.satellite = tuple(spec), satellite
        # get_vector() belongs to the get_obs() of the same class: a subclass that overrides only the latter does not use it
        self._has_vector = [defined_first(entry, "get_vector", "get_obs") == "get_vector" for entry in self.entries]
        self._compared = False

    @property
    def observables(self) -> list[Any]:
        """Functions of the observables that entries read."""
        return [function for entry in self.entries for function in entry.observables()]

    def get_dict(self) -> Values:
        """Return all observations by name; repeated names get a number, as in ``target_2``."""
        values: Values = {}
        for entry in self.entries:
            name, number = entry.name, 1
            while name in values:
                number += 1
                name = f"{entry.name}_{number}"
            values[name] = entry.get_obs()
        for _ in flatten(values, len(self.satellite.simulator.ticks)):
            pass  # raises for leaves of a wrong shape
        return values

    def get_vector(self, dtype: torch.dtype) -> Tensor:
        """Return all observations side by side, [N, width].

        Raises:
            TypeError: At the first call, for a vector of a user's class that has not the width of its named observations.
        """
        pairs = list(zip(self.entries, self._has_vector, strict=True))
        parts = [entry.get_vector() if own else Observation.get_vector(entry) for entry, own in pairs]
        if not self._compared:
            for entry, part in zip(self.entries, parts, strict=True):
                if not type(entry).__module__.startswith("bsk_torch."):
                    check_tensor(f"{type(entry).__name__}.get_vector()", part, Observation.get_vector(entry).shape)
            self._compared = True
        return torch.cat(parts, -1).to(dtype)

    @staticmethod
    def vector(values: Values, dtype: torch.dtype) -> Tensor:
        """Return named observations side by side, [N, width]."""
        return torch.cat([value for _, value in flatten(values)], -1).to(dtype)

    @staticmethod
    def describe(values: Values) -> list[str]:
        """Return the name of every entry of the vector."""
        names = []
        for name, value in flatten(values):
            names += [name] if value.shape[-1] == 1 else [f"{name}[{k}]" for k in range(value.shape[-1])]
        return names
