"""User functions that observe satellites: called once for all of them, or for one after the other where they need that.

Functions written for bsk_rl expect one satellite. Many work on tensors of all satellites without a change, which is
fast. Some fail, and some give a wrong result without failing: ``np.linalg.norm(satellite.dynamics.r_BN_N)`` of positions [N, 3]
is a single number. So a function is tried on all satellites, and compared with what it gives for one; see :class:`UserFunction`.
"""

from __future__ import annotations

import functools
import logging
import warnings
from collections.abc import Callable, Sequence
from types import FunctionType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bsk_torch._checks import no_gradient

logger = logging.getLogger(__name__)

RELATIVE, ABSOLUTE = 1e-6, 1e-7
"""Differences of two results that count as rounding: relative to the largest number, and absolute."""

TABLES = (
    "satellite.rows_of(table) takes the satellite's rows from a table of all satellites, such as satellite.fleet.memory['name'], "
    "and satellite.of_env(table) from a table of the environments"
)
"""How to read what rewarders and communicators keep."""

Tree = Any
"""A tensor, or a dictionary of tensors by name, which may be nested."""


MARK = "called_per_environment"
"""Attribute of functions that :func:`adapted` has marked."""


def adapted(function: Any) -> Any:
    """Return a function that may be called for each satellite; it is marked, or, where it takes no attributes, wrapped."""
    marked = function if isinstance(function, FunctionType) else functools.partial(function)
    setattr(marked, MARK, True)
    return marked


def is_adapted(function: Any) -> bool:
    """Return whether a function, a property, or a partial of one has been marked by :func:`adapted`."""
    if isinstance(function, property | functools.cached_property):
        return is_adapted(function.fget if isinstance(function, property) else function.func)
    return hasattr(function, MARK) or (isinstance(function, functools.partial) and is_adapted(function.func))


class UserFunction:
    """A user function, called for all N satellites at once if this gives the same result as separate calls.

    The first call decides: it compares the result of all with that of the first satellite. If the function fails for a single
    satellite, it was written for tensors, and only its shape is checked. If it fails for all, or differs, it is called for each
    satellite if it is :func:`adapted`, else rejected with an error.

    Attributes:
        title: What the function is, for messages.
        adapted: Whether it may be called for each satellite.
        mapped: Whether it is called for each satellite; None before the first call.
        why: Why it is mapped.
        results: Results of a trial, during which nothing is logged; None outside of trials.
    """

    def __init__(self, title: str, advice: str, function: object) -> None:
        """Describe a function; ``advice`` describes how to write it for all satellites."""
        self.title, self.advice, self.adapted = title, advice, is_adapted(function)
        self.mapped: bool | None = None
        self.why = ""
        self.results: list[Tree] | None = None

    def __call__(
        self, lead: Sequence[int], device: torch.device, whole: Callable[[], object], one: Callable[[int], object]
    ) -> Tree:
        """Return the result for all satellites, tensors [*lead, ...].

        Args:
            lead: Leading dimensions of the result: the number N of satellites, perhaps followed by others.
            device: Device of the result.
            whole: The call for all satellites.
            one: The call for the satellite of a row.

        Raises:
            TypeError: For a function that can be called neither way, or only for each satellite without being adapted, or whose
                results do not fit.
        """
        if self.mapped is None:
            found = self._decide(lead, device, whole, one)
        elif self.mapped:
            found = self._map(lead, device, one)
        else:
            found = as_batch(self.title, whole(), lead, device)
        if self.results is not None:
            self.results.append(found)
        return found

    def _decide(
        self, lead: Sequence[int], device: torch.device, whole: Callable[[], object], one: Callable[[int], object]
    ) -> Tree:
        failure: Exception | None = None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # NumPy and torch warn of what the comparison below finds
                batched = as_batch(self.title, whole(), lead, device)
        except Exception as error:
            batched, failure = None, error
        try:
            first = self._map((1, *lead[1:]), device, one)
        except Exception as error:
            if isinstance(failure, AttributeError) and isinstance(error, AttributeError):
                raise failure from None  # satellites of another type may have it
            if failure is not None:
                raise TypeError(
                    f"{self.title} fails for all satellites at once ({_told(failure)}), and for one of them ({_told(error)}); "
                    f"{self.advice}"
                ) from error
            self.mapped = False
            return batched
        if failure is None and alike(first_of(batched), first):
            self.mapped = False
            return batched
        why = _told(failure) if failure else "it mixes environments if it is called for all of them"
        if not self.adapted:
            tables = "" if failure else f"; {TABLES}"
            raise TypeError(
                f"{self.title} works for one satellite, but not for all at once ({why.replace(self.title, 'it')}): {self.advice}"
                f"{tables}. Or let bsk_torch.per_environment(function) call it for one environment after the other, which is slow"
            ) from failure
        self._map_because(why, lead[0])
        return self._map(lead, device, one)

    def _map(self, lead: Sequence[int], device: torch.device, one: Callable[[int], object]) -> Tree:
        return as_batch(self.title, stacked(self.title, [one(row) for row in range(lead[0])]), lead, device)

    def _map_because(self, why: str, rows: int) -> None:
        """Map the function from now on; with a note in the log, except on a trial and of a single satellite."""
        self.mapped, self.why = True, why
        if self.results is None and rows > 1:
            logger.warning("%s is called for one environment after the other, which is slow: %s. To call it once for all, %s",
                           self.title, self.why, self.advice)  # fmt: skip

    # -- trials -------------------------------------------------------------------------------------------------------

    def dimensions(self) -> set[int]:
        """Return the sizes of all dimensions of the results but the first."""
        return {size for tree in self.results or () for tensor in leaves_of(tree) for size in tensor.shape[1:]}

    def adopt(self, alone: UserFunction, together: UserFunction, rows: int) -> None:
        """Decide how ``rows`` satellites are observed, by trials with one environment and with several that begin with the same.

        Raises:
            TypeError: If the result of an environment depends on the others.
        """
        if not alone.results or not together.results:
            return
        tries = (alone, together)
        agree = alike(first_of(alone.results[-1]), first_of(together.results[-1]))
        shapes = [[list(leaf.shape[1:]) for leaf in leaves_of(each.results[-1])] for each in tries if each.results]
        if shapes[0] != shapes[1]:
            raise TypeError(
                f"{self.title} has the shapes {shapes[0]} for a satellite of one environment alone, and {shapes[1]} for one of "
                f"several; {TABLES}"
            )
        if not agree and (alone.mapped or together.mapped):
            raise TypeError(
                f"{self.title} gives different values for the same state of a satellite, called alone and in a batch; it must "
                f"follow from the state of the satellite alone. obs.Noisy(observation, ...) adds random numbers; {TABLES}"
            )
        if not agree:
            raise TypeError(f"{self.title} mixes environments: an environment gives other values in a batch; {self.advice}")
        if why := next((each.why for each in tries if each.mapped), None):
            self._map_because(why, rows)
        else:
            self.mapped = False


def _told(error: Exception) -> str:
    """Return the first line of an error."""
    text = str(error).partition("\n")[0]
    return f"{type(error).__name__}: {text}"


def leaves_of(tree: Tree) -> list[Tensor]:
    """Return the tensors of a result."""
    return [leaf for part in tree.values() for leaf in leaves_of(part)] if isinstance(tree, dict) else [tree]


def first_of(tree: Tree) -> Tree:
    """Return the first row of each tensor, [1, ...]."""
    return {name: first_of(part) for name, part in tree.items()} if isinstance(tree, dict) else tree[:1]


def alike(a: Tree, b: Tree) -> bool:
    """Return whether two results agree in names, shapes, and values up to rounding."""
    if isinstance(a, dict) or isinstance(b, dict):
        return isinstance(a, dict) and isinstance(b, dict) and a.keys() == b.keys() and all(alike(a[n], b[n]) for n in a)
    if a.shape != b.shape:
        return False
    a, b = a.double(), b.double()
    scale = torch.cat([a.flatten(), b.flatten()]).abs().nan_to_num(0.0, 0.0, 0.0)
    tolerance = ABSOLUTE + RELATIVE * float(scale.max()) if scale.numel() else 0.0
    return bool(torch.isclose(a, b, rtol=0.0, atol=tolerance, equal_nan=True).all())


def as_batch(title: str, value: object, lead: Sequence[int], device: torch.device) -> Tree:
    """Return the result for all satellites as tensors [*lead, ...].

    Tensors and NumPy arrays are returned unchanged; a list of tensors [*lead] and numbers becomes [*lead, len(list)].

    Raises:
        TypeError: For a result without the leading dimensions.
    """
    if isinstance(value, dict):
        return {str(name): as_batch(f"{title}[{name!r}]", part, lead, device) for name, part in value.items()}
    if isinstance(value, list | tuple) and any(isinstance(part, Tensor | np.ndarray) and part.ndim for part in value):
        parts = [torch.as_tensor(part, device=device) for part in value]
        if any(part.ndim and tuple(part.shape) != tuple(lead) for part in parts):
            raise TypeError(f"{title} is a list of shapes {[list(p.shape) for p in parts]}; the shape must be {list(lead)}")
        value = torch.stack([part.double().expand(*lead) for part in parts], -1)
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "biuf":
        value = torch.from_numpy(np.array(value))
    if isinstance(value, Tensor) and value.is_complex():
        raise TypeError(f"{title} is complex; it must be real: return value.real, value.imag or both side by side")
    if isinstance(value, Tensor) and tuple(value.shape[: len(lead)]) == tuple(lead):
        return value.to(device)
    given = f"of shape {list(value.shape)}" if isinstance(value, Tensor | np.ndarray) else repr(value)
    wanted = ", ".join(map(str, lead))
    raise TypeError(f"{title} is {given}; it must be of shape [{wanted}] or [{wanted}, ...]")


def stacked(title: str, values: Sequence[Any]) -> Tree:
    """Return the results of several satellites as one tensor [n, ...], float64 unless they are booleans.

    Raises:
        TypeError: For results that are not numbers, or of different shapes.
    """
    if isinstance(values[0], dict):
        return {name: stacked(f"{title}[{name!r}]", [value[name] for value in values]) for name in values[0]}
    parts = [no_gradient(title, value).cpu().numpy() if isinstance(value, Tensor) else np.asarray(value) for value in values]
    if any(part.shape != parts[0].shape for part in parts):
        raise TypeError(f"{title} has shapes {sorted({part.shape for part in parts})} in different environments; they must agree")
    if any(part.dtype.kind not in "biuf" for part in parts):
        raise TypeError(f"{title} is {values[0]!r}; it must be a number or an array of numbers")
    table = np.stack(parts)
    return torch.from_numpy(table if table.dtype.kind == "b" else table.astype(np.float64))
