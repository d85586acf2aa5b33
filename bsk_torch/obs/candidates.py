"""Observations of the candidates that actions choose from, ranked for each satellite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, NamedTuple

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


def parsed(title: str, entry: Mapping[str, object], properties: Sequence[str]) -> Entry:
    """Return an entry of a user; ValueError for a wrong one."""
    if not isinstance(entry, Mapping):
        example = f"dict(prop={properties[0]!r}, norm=2)"
        raise ValueError(f"{title} has the entry {entry!r}; it must be a dictionary, such as {example}")
    for key in entry:
        if key not in ("prop", "norm", "name"):
            raise ValueError(f"{title} has the key {key!r} in {dict(entry)}; {nearest(str(key), ('prop', 'norm', 'name'))}")
    prop = str(entry.get("prop"))
    if prop not in properties:
        raise ValueError(f"{title}: prop={prop!r} is no property of candidates; {nearest(prop, properties)}")
    norm = 1.0 if entry.get("norm") is None else number(f"{title}: norm of {prop!r}", entry["norm"])
    if norm == 0.0:
        raise ValueError(f"{title}: norm of {prop!r} is 0; it must not be zero")
    return Entry(prop, text(f"{title}: name", entry.get("name", prop)), norm)


class CandidateObservation(Observation):
    """Properties of the first n candidates among which actions choose. Subclasses define :meth:`columns`.

    Attributes:
        in_orbit: Whether the candidates are objects in orbit.
    """

    in_orbit: ClassVar[bool] = False

    def __init__(self, n_ahead_observe: int, name: str, as_set: bool) -> None:
        """Observe candidates.

        Args:
            n_ahead_observe: Number of candidates n.
            name: Name of the observation.
            as_set: Whether to return ``rows`` [N, n, features] and ``mask`` [N, n] (1, or 0 where there are fewer candidates)
                instead of named numbers, for permutation-invariant policies.
        """
        super().__init__(name)
        self.n_ahead_observe, self.as_set = whole("n_ahead_observe", n_ahead_observe, 1), switch("as_set", as_set)
        self.exact = ("mask",) if as_set else ()  # not changed by obs.Noisy

    def columns(self) -> tuple[dict[str, Tensor], Tensor]:
        """Return the properties of the candidates by name, [N, n] or [N, n, width], and which of them exist, [N, n]."""
        raise NotImplementedError(f"{type(self).__name__} must implement columns()")

    @override
    def get_obs(self) -> Values:
        columns, exists = self.columns()
        if self.as_set:
            return {"rows": joined(columns), "mask": exists.double()}
        return {f"{self.name}_{k}": {name: column[:, k] for name, column in columns.items()} for k in range(self.n_ahead_observe)}

    @override
    def get_vector(self) -> Tensor:
        rows, exists = self.side_by_side()
        return rows.flatten(1) if exists is None else torch.cat([rows.flatten(1), exists.to(rows.dtype)], -1)

    def side_by_side(self) -> tuple[Tensor, Tensor | None]:
        """Return the properties of the candidates, [N, n, features], and for a set which candidates exist, [N, n]."""
        columns, exists = self.columns()
        return joined(columns), exists if self.as_set else None


class CandidateProperties(CandidateObservation):
    """Candidates described by a table of properties, zero for those that do not exist.

    Attributes:
        properties: Allowed values of ``prop``.
        usual: Entries where none are given.
        title: Name of the class in messages.
    """

    properties: ClassVar[Sequence[str]] = ()
    usual: ClassVar[Sequence[Mapping[str, object]]] = ()
    title: ClassVar[str] = ""

    def __init__(self, *properties: Mapping[str, object], n_ahead_observe: int, name: str, as_set: bool) -> None:
        """See :class:`CandidateObservation`; properties are dictionaries with ``prop``, and optionally ``norm`` and ``name``."""
        super().__init__(n_ahead_observe, name, as_set)
        self.entries = tuple(parsed(self.title, entry, self.properties) for entry in properties or self.usual)
        names = [entry.name for entry in self.entries]
        if len(set(names)) < len(names):
            raise ValueError(f"{self.title} has the names {names}; they must be unique")

    def read_candidates(self, wanted: frozenset[str]) -> tuple[dict[str, Tensor], Tensor]:
        """Return at least the wanted properties by ``prop``, [N, n] or [N, n, 3], and which candidates exist, [N, n]."""
        raise NotImplementedError(f"{type(self).__name__} must implement read_candidates(wanted)")

    @override
    def columns(self) -> tuple[dict[str, Tensor], Tensor]:
        values, exists = self.read_candidates(frozenset(entry.prop for entry in self.entries))
        columns = {entry.name: values[entry.prop] / entry.norm for entry in self.entries}
        wide = {name: exists.view(*exists.shape, *[1] * (column.ndim - 2)) for name, column in columns.items()}
        return {name: torch.where(wide[name], column, 0.0) for name, column in columns.items()}, exists
