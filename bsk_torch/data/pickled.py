"""User objects as bytes in saved states: only classes of the users' modules and plain data.

A state may come from a file from another source, so reading one must not run code of its choice: names of other
functions and classes than those below are rejected, both in writing and in reading.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable, Collection
from typing import Any

import numpy as np
import torch
from torch import Tensor

OWN_PACKAGE = __name__.partition(".")[0] + "."

PLAIN: frozenset[tuple[str, str]] = frozenset(
    (module, name)
    for modules, names in (
        ("builtins", "set frozenset complex bytearray slice range int float str bool list dict tuple bytes"),
        ("collections", "OrderedDict defaultdict deque Counter"),
        ("datetime", "datetime date time timedelta"),
        ("numpy numpy._core.multiarray numpy.core.multiarray", "ndarray dtype _reconstruct scalar"),
        ("numpy._core.numeric numpy.core.numeric", "_frombuffer"),
        (__name__, "tensor_of"),
    )
    for module in modules.split()
    for name in names.split()
)
"""Classes and functions of which plain data are made."""


def tensor_of(array: np.ndarray) -> Tensor:
    """Return an array as a tensor; tensors are saved as arrays."""
    return torch.from_numpy(array)


def modules_of(*kinds: type) -> set[str]:
    """Return the modules of classes and of their bases."""
    return {base.__module__ for kind in kinds for base in kind.__mro__} - {"builtins"}


def is_trusted(kind: object, modules: Collection[str]) -> bool:
    """Return whether a class is one of ``modules`` or of this package."""
    return isinstance(kind, type) and (kind.__module__ in modules or kind.__module__.startswith(OWN_PACKAGE))


class Pickler(pickle.Pickler):
    """Writes objects; TypeError for one of another class."""

    def __init__(self, file: io.BytesIO, modules: Collection[str], name_of: Callable[[Any], object]) -> None:
        """Write to ``file`` objects of classes of ``modules``; ``name_of`` names those that are found again, None for others."""
        super().__init__(file)
        self.modules, self.persistent_id = modules, name_of  # type: ignore[method-assign]

    def reducer_override(self, value: object) -> Any:
        """Return how to rebuild a tensor; reject classes that could not be read."""
        if isinstance(value, Tensor):
            return tensor_of, (value.detach().cpu().numpy(),)
        kind = value if isinstance(value, type) else type(value)
        if value is tensor_of or is_trusted(kind, self.modules) or kind.__module__.partition(".")[0] in ("numpy", "collections"):
            return NotImplemented
        if (kind.__module__, kind.__qualname__) in PLAIN or getattr(value, "__module__", "").startswith("numpy."):
            return NotImplemented
        raise TypeError(f"{value!r} is of class {kind.__qualname__} of {kind.__module__}")


class Unpickler(pickle.Unpickler):
    """Reads objects; UnpicklingError for a name that is not allowed."""

    def __init__(self, file: io.BytesIO, modules: Collection[str], find: Callable[[Any], object]) -> None:
        """Read from ``file`` objects of classes of ``modules``; ``find`` returns an object by its name."""
        super().__init__(file)
        self.modules, self.persistent_load = modules, find  # type: ignore[method-assign]

    def find_class(self, module: str, name: str) -> Any:
        """Return a class by its module and name."""
        if (module, name) in PLAIN:
            return super().find_class(module, name)
        if module in self.modules or module.startswith(OWN_PACKAGE):
            found = super().find_class(module, name)
            if is_trusted(found, self.modules):
                return found
        raise pickle.UnpicklingError(
            f"the state holds an object of {module}.{name}, which is neither plain data nor a class of {sorted(self.modules)}"
        )
