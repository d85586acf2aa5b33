"""Base class of observations, and the vector or Composite that a satellite's ``observation_spec`` forms."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import isnan
from typing import Any

import torch
from torch import Tensor

from bsk_torch._checks import text
from bsk_torch.sats.bound import BoundSatellite, link_entry
from bsk_torch.sats.user_function import UserFunction
from bsk_torch.sim.hooks import check_class, check_tensor, defined_first, is_of_package
from bsk_torch.sim.names import snake
from bsk_torch.sim.readout.observables import Function
from bsk_torch.sim.simulator import Simulator

HOOKS = ("link_satellite", "observables", "get_obs", "get_vector")
"""Members of :class:`Observation` that subclasses may define."""

ADVICE = (
    "let it return [N] or [N, ...] for all satellites: properties are tensors, whose first dimension is the satellite, such as "
    "self.satellite.dynamics.r_BN_N [N, 3], and torch.linalg.norm(r, dim=-1) takes the place of np.linalg.norm(r)"
)
"""How to write an observation for all satellites."""

Values = dict[str, Any]
"""Observed quantities by name: tensors [N] or [N, width], or dictionaries of them."""


def joined(columns: dict[str, Tensor]) -> Tensor:
    """Return columns [N, n] or [N, n, width] of n items next to each other, [N, n, features]."""
    return torch.cat([column.unsqueeze(-1) if column.ndim == 2 else column for column in columns.values()], -1)


class Observation:
    """One entry of an ``observation_spec``. Subclasses define :meth:`get_obs`.

    N is the number of satellites of the type.

    Attributes:
        name: Name of the entry in the observation.
        unique_name: The name, numbered if several entries of the satellite share it, as in ``target_2``.
        satellite: The satellites, once an environment has been built.
        simulator: Their simulation.
    """

    satellite: BoundSatellite
    simulator: Simulator
    unique_name: str

    def __init__(self, name: str | None = None) -> None:
        """Name the entry, by default after its class: ``Latitude()`` is ``latitude``. ValueError unless the name is a string."""
        self.name = snake(type(self).__name__) if name is None else text("name", name)

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_class(cls, Observation, HOOKS)
        if "get_vector" in vars(cls) and "get_obs" not in vars(cls):
            raise TypeError(
                f"{cls.__name__} defines get_vector() without get_obs(), so named observations would not use it; define "
                "get_obs(), from which vectors are made, too"
            )

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """Prepare for a satellite; called once when an environment is built.

        Overriding methods call ``super().link_satellite(satellite)`` first, and raise ValueError for a satellite without the
        observed quantities.
        """
        self.satellite, self.simulator = satellite, satellite.simulator

    @property
    def functions(self) -> list[UserFunction]:
        """User functions called by the observation; an environment tries them when it is built."""
        return []

    def observables(self) -> list[Function]:
        """Return functions of observables read by :meth:`get_obs`, for computation in one kernel.

        See :mod:`bsk_torch.sim.readout.observables`. Observables not listed are computed one by one.
        """
        return []

    def trace(self) -> None:
        """Let the kernel of observables compute users' functions (default: there are none); called after they have been tried."""

    def get_obs(self) -> Tensor | Values:
        """Return the current observation: a tensor [N] or [N, ...], or a (possibly nested) dictionary of them by name.

        Numbers must be finite: an environment raises FloatingPointError for NaN and infinity in what users' classes and functions
        return. Write absent values as a finite number, such as 0, next to a flag.

        NumPy arrays may replace tensors.
        """
        raise NotImplementedError(f"{type(self).__name__} must implement get_obs()")

    def get_vector(self) -> Tensor:
        """Return the current observation as one vector [N, width], the concatenated leaves of :meth:`get_obs`.

        A class may define a faster version for its ``get_obs``; a subclass that overrides only ``get_obs`` uses this one again.
        """
        return side_by_side(self.name, self.get_obs(), self.simulator.state.rows)


def side_by_side(name: str, value: Tensor | Values, count: int) -> Tensor:
    """Return the observation ``name`` of ``count`` satellites as a vector [N, width]; TypeError as from :func:`flatten`."""
    if isinstance(value, Tensor) and value.ndim and value.shape[0] == count:
        return value.unsqueeze(-1) if value.ndim == 1 else value.flatten(1)
    return torch.cat([leaf for _, leaf in flatten({name: value}, count)], -1)


def flatten(values: Values, count: int | None = None, prefix: str = "") -> Iterator[tuple[str, Tensor]]:
    """Yield the leaves in order, as dotted names and tensors [N, width]."""
    for name, value in values.items():
        path = f"{prefix}{name}"
        if isinstance(value, dict):
            yield from flatten(value, count, path + ".")
        elif isinstance(value, Tensor) and value.ndim and count in (None, value.shape[0]):
            yield path, value.unsqueeze(-1) if value.ndim == 1 else value.flatten(1)
        else:
            description = f"a tensor of shape {list(value.shape)}" if isinstance(value, Tensor) else repr(value)
            raise TypeError(
                f"observation {path!r} is {description}; it must be a tensor of shape [{count or 'N'}] or [{count or 'N'}, ...]"
            )


def link(entry: object, satellite: BoundSatellite) -> None:
    """Link an observation to a satellite; ValueError for an entry that is not an observation, TypeError if linking failed."""
    if not isinstance(entry, Observation):
        raise ValueError(f"observation_spec holds {entry!r}, which is not an observation; write obs.Time(), with parentheses")
    link_entry(entry, satellite)


class Reader:
    """Reads an observation, by name or as a vector; what a user's class returns is checked."""

    def __init__(self, entry: Observation) -> None:
        """Read an ``entry`` linked to its satellites."""
        self.entry = entry
        # get_vector() belongs to the get_obs() of the same class: a subclass that overrides only the latter does not use it
        self._has_vector = defined_first(entry, "get_vector", "get_obs") == "get_vector"
        self._compared = is_of_package(type(entry)) or not self._has_vector
        owner = next(cls for cls in type(entry).__mro__ if "get_obs" in vars(cls))
        self._function = None if is_of_package(owner) else UserFunction(f"{type(entry).__name__}.get_obs()", ADVICE)

    @property
    def functions(self) -> list[UserFunction]:
        """User functions called by the observation, including the function of its class."""
        return [*([] if self._function is None else [self._function]), *self.entry.functions]

    def values(self) -> Tensor | Values:
        """Return the observation, a tensor [N] or [N, ...] or a dictionary of them."""
        entry = self.entry
        if self._function is None:
            return entry.get_obs()
        simulator = entry.simulator
        return self._function((len(simulator.ticks),), simulator.device, entry.get_obs)

    def vector(self) -> Tensor:
        """Return the observation as a vector, [N, width]."""
        if not self._has_vector:
            return self._flat()
        vector = self.entry.get_vector()
        if not self._compared:
            check_tensor(f"{type(self.entry).__name__}.get_vector()", vector, self._flat().shape)
            self._compared = True
        return vector

    def _flat(self) -> Tensor:
        return side_by_side(self.entry.name, self.values(), self.entry.simulator.state.rows)


class ObservationBuilder:
    """The observations of a satellite type, in the order of its ``observation_spec``."""

    def __init__(self, spec: Sequence[Observation], satellite: BoundSatellite) -> None:
        """Link every entry to the satellite."""
        if not spec:
            raise ValueError(f"{type(satellite).__name__}.observation_spec is empty; list at least one, such as obs.Time()")
        for entry in spec:
            link(entry, satellite)
        self.entries, self.satellite = tuple(spec), satellite
        self._readers = [Reader(entry) for entry in self.entries]
        self._width: int | None = None
        self._calls_user = bool(self.functions)
        names: list[str] = []
        for entry in self.entries:
            number = 1 + sum(entry.name == other.name for other in self.entries[: len(names)])
            names.append(entry.name if number == 1 else f"{entry.name}_{number}")
            entry.unique_name = names[-1]

    @property
    def functions(self) -> list[UserFunction]:
        """User functions called by entries, and entries of users' classes."""
        return [function for reader in self._readers for function in reader.functions]

    @property
    def observables(self) -> list[Function]:
        """Functions of the observables read by entries."""
        return [function for entry in self.entries for function in entry.observables()]

    def trace(self) -> None:
        """Let the kernel of observables compute what users have written on tensors, where it can."""
        for entry in self.entries:
            entry.trace()

    def get_dict(self) -> Values:
        """Return all observations by name; repeated names get a number, as in ``target_2``."""
        values: Values = {}
        for reader in self._readers:
            values[reader.entry.unique_name] = reader.values()
        leaves = [leaf for _, leaf in flatten(values, len(self.satellite.simulator.ticks))]
        if self._calls_user:
            self._check_numbers(torch.cat(leaves, -1), lambda: values)
        return values

    def get_vector(self, dtype: torch.dtype) -> Tensor:
        """Return all observations, concatenated, [N, width]; FloatingPointError for NaN or infinity in those of users."""
        vector = torch.cat([reader.vector() for reader in self._readers], -1)
        if vector.shape[-1] != self._width:
            if self._width is not None:
                raise TypeError(
                    f"the observation of {self.satellite.name} has {vector.shape[-1]} numbers, but had {self._width} before; it "
                    "must always have as many"
                )
            self._width = vector.shape[-1]
        if self._calls_user:
            self._check_numbers(vector, self.get_dict)
        return vector.to(dtype)

    def _check_numbers(self, vector: Tensor, named: Callable[[], Values]) -> None:
        """Raise FloatingPointError for a vector [N, width] with NaN or infinity, from which no network learns."""
        if float((vector * 0.0).sum()) != 0.0:  # which is NaN with a number that is not finite
            rows, columns = torch.nonzero(~torch.isfinite(vector)).unbind(1)
            name, value = self.describe(named())[int(columns[0])], float(vector[rows[0], columns[0]])
            raise FloatingPointError(
                f"{name!r} in the observation of {self.satellite.title(int(rows[0]))} is {'NaN' if isnan(value) else value} "
                f"({len(rows.unique())} rows in all); it must be a finite number"
            )

    @staticmethod
    def vector(values: Values, dtype: torch.dtype) -> Tensor:
        """Return named observations, concatenated, [N, width]."""
        return torch.cat([value for _, value in flatten(values)], -1).to(dtype)

    @staticmethod
    def describe(values: Values) -> list[str]:
        """Return the name of every entry of the vector."""
        names = []
        for name, value in flatten(values):
            names += [name] if value.shape[-1] == 1 else [f"{name}[{k}]" for k in range(value.shape[-1])]
        return names
