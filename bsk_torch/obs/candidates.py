"""Observations of the candidates that actions choose from, ranked for each satellite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number, switch, text, whole
from bsk_torch.obs.base import Observation, Values, joined
from bsk_torch.sim.names import nearest


class Entry(NamedTuple):
    """A property of candidates, its name in the observation, and its divisor."""

    prop: str
    name: str
    norm: float


def parsed(title: str, given: Mapping[str, Any], properties: Sequence[str]) -> Entry:
    """Return an entry of a user; ValueError for a wrong one."""
    if not isinstance(given, Mapping):
        example = f"dict(prop={properties[0]!r}, norm=2)"
        raise ValueError(f"{title} has the entry {given!r}; it must be a dictionary, such as {example}")
    for key in given:
        if key not in ("prop", "norm", "name"):
            raise ValueError(f"{title} has the key {key!r} in {dict(given)}; {nearest(str(key), ('prop', 'norm', 'name'))}")
    prop = str(given.get("prop"))
    if prop not in properties:
        raise ValueError(f"{title}: prop={prop!r} is no property of candidates; {nearest(prop, properties)}")
    norm = 1.0 if given.get("norm") is None else number(f"{title}: norm of {prop!r}", given["norm"])
    if norm == 0.0:
        raise ValueError(f"{title}: norm of {prop!r} is 0; it must not be zero")
    return Entry(prop, text(f"{title}: name", given.get("name", prop)), norm)


class CandidateProperties(Observation):
    """Properties of the first n candidates of a satellite. Subclasses define :meth:`read_candidates`.

    Attributes:
        properties: Allowed values of ``prop``.
        usual: Entries where none are given.
        title: Name of the class in messages.
        in_orbit: Whether the candidates are objects in orbit.
    """

    properties: ClassVar[Sequence[str]] = ()
    usual: ClassVar[Sequence[dict[str, Any]]] = ()
    title: ClassVar[str] = ""
    in_orbit: ClassVar[bool] = False

    def __init__(self, *properties: dict[str, Any], n_ahead_observe: int, name: str, as_set: bool) -> None:
        """Observe the first ``n_ahead_observe`` candidates; for the arguments, see the subclasses."""
        super().__init__(name)
        self.entries = tuple(parsed(self.title, given, self.properties) for given in properties or self.usual)
        names = [entry.name for entry in self.entries]
        if len(set(names)) < len(names):
            raise ValueError(f"{self.title} has the names {names}; they must be unique")
        self.n_ahead_observe, self.as_set = whole("n_ahead_observe", n_ahead_observe, 1), switch("as_set", as_set)
        self.exact = ("mask",) if as_set else ()  # not changed by obs.Noisy

    def read_candidates(self, wanted: frozenset[str]) -> tuple[dict[str, Tensor], Tensor]:
        """Return at least the wanted properties by ``prop``, [N, n] or [N, n, 3], and which candidates exist, [N, n]."""
        raise NotImplementedError(f"{type(self).__name__} must implement read_candidates(wanted)")

    def _columns(self) -> tuple[dict[str, Tensor], Tensor]:
        """Return the properties of the candidates by name, [N, n] or [N, n, 3], and which of them exist, [N, n]."""
        known, exists = self.read_candidates(frozenset(entry.prop for entry in self.entries))
        return {entry.name: _blank(known[entry.prop] / entry.norm, exists) for entry in self.entries}, exists

    @override
    def get_obs(self) -> Values:
        columns, exists = self._columns()
        if self.as_set:
            return {"rows": joined(columns), "mask": exists.double()}
        return {f"{self.name}_{k}": {name: column[:, k] for name, column in columns.items()} for k in range(self.n_ahead_observe)}

    def get_vector(self) -> Tensor:
        """See :meth:`Observation.get_vector`; one candidate after the other."""
        columns, exists = self._columns()
        rows = joined(columns).flatten(1)
        return torch.cat([rows, exists.to(rows.dtype)], -1) if self.as_set else rows


def _blank(column: Tensor, exists: Tensor) -> Tensor:
    """Return a column [N, n, ...] with zeros for candidates that do not exist."""
    return torch.where(exists.view(*exists.shape, *[1] * (column.ndim - 2)), column, 0.0)
