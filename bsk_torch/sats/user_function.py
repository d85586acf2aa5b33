"""User functions that observe satellites: batched, so called once for all satellites of a type."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

RELATIVE, ABSOLUTE = 1e-6, 1e-7
"""Differences of two results that count as rounding: relative to the largest number, and absolute."""

DOOR = "Functions of one satellite run in bsk_torch.bsk_rl, whose environments take num_envs="
"""Where code for one episode runs."""

TABLES = (
    "satellite.rows_of(table) takes the satellite's rows from a table of all satellites, such as satellite.fleet.memory['name'], "
    "and satellite.of_env(table) from a table of the environments"
)
"""How to read what rewarders and communicators keep."""

Tree = Any
"""A tensor, or a dictionary of tensors by name, which may be nested."""


class UserFunction:
    """A user function, which returns tensors [N] or [N, ...] for all N satellites of a type.

    An environment tries it when it is built, alone and in a batch.

    Attributes:
        title: What the function is, for messages.
        advice: How to write it for all satellites.
        works: Whether it has returned a result.
        results: Results of a trial; None outside of trials.
    """

    def __init__(self, title: str, advice: str) -> None:
        """Describe a function."""
        self.title, self.advice, self.works = title, advice, False
        self.results: list[Tree] | None = None

    def __call__(self, lead: Sequence[int], device: torch.device, call: Callable[[], object]) -> Tree:
        """Return the result of ``call`` for all satellites, tensors [*lead, ...]; TypeError if it fails or does not fit.

        An AttributeError for what satellites lack is passed on: those of another type may have it.
        """
        try:
            value = call()
        except Exception as error:
            lacking = isinstance(error, AttributeError) and not isinstance(error.obj, Tensor)
            if self.works or lacking:  # satellites of another type may have what this one lacks
                raise
            reason = f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
            raise TypeError(f"{self.title} fails for all satellites at once ({reason}): {self.advice}. {DOOR}") from error
        result = as_batch(self.title, value, lead, device)
        self.works = True
        if self.results is not None:
            self.results.append(result)
        return result

    def dimensions(self) -> set[int]:
        """Return the sizes of all dimensions of the results but the first."""
        return {size for tree in self.results or () for tensor in leaves_of(tree) for size in tensor.shape[1:]}

    def compare(self, together: UserFunction) -> None:
        """Raise TypeError if a trial of one environment differs from the first of several that begin with the same."""
        if not self.results or not together.results:
            return
        alone, batch = self.results[-1], together.results[-1]
        shapes = [[list(leaf.shape[1:]) for leaf in leaves_of(result)] for result in (alone, batch)]
        if shapes[0] != shapes[1]:
            raise TypeError(
                f"{self.title} has the shapes {shapes[0]} for a satellite of one environment alone, and {shapes[1]} for one of "
                f"several; {TABLES}"
            )
        if not alike(first_of(alone), first_of(batch)):
            raise TypeError(
                f"{self.title} gives an environment other values alone than in a batch: it mixes environments, or does not "
                f"follow from the satellite's state; obs.Noisy(observation, ...) adds random numbers. {self.advice}; {TABLES}"
            )


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
    description = f"of shape {list(value.shape)}" if isinstance(value, Tensor | np.ndarray) else repr(value)
    wanted = ", ".join(map(str, lead))
    raise TypeError(f"{title} is {description}; it must be of shape [{wanted}] or [{wanted}, ...]. {DOOR}")
