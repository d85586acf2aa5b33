"""Arguments of satellites: vectors of which only the direction counts, and lists of parts."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TypeVar

from torch import Tensor

from bsk_torch._checks import parts
from bsk_torch.sim.component import Arg, UserArguments, Values

Part = TypeVar("Part")

AXIS_BOUNDS = -1e9, 1e9  # bounds of their components


def unit_rows(vectors: Tensor) -> Tensor:
    """Return vectors [..., 3] scaled to length one."""
    return vectors / vectors.norm(dim=-1, keepdim=True)


def check_axis(name: str) -> Callable[[Values], None]:
    """Return a check that the vectors [..., 3] of the argument ``name`` have directions."""

    def check(args: Values) -> None:
        if bool((args[name].norm(dim=-1) <= 0.0).any()):
            raise ValueError(f"{name}=[0, 0, 0] has length zero; give three numbers in B, not all zero, such as [0, 0, 1]")

    return check


def of_each(arg: Arg, count: int, default: object) -> Arg:
    """Return an argument as that of so many parts: a value for each, of which one number stands for those of all."""
    one = arg.shape[1:] if arg.shape else ()
    return replace(arg, kind="scalar", default=default, shape=(count, *one), spread=not one)


def described(
    arguments: UserArguments, name: str, numbers: Iterable[Arg], kind: type[Part], what: str
) -> tuple[Part, ...] | None:
    """Return the parts that the argument ``name`` lists, ``what`` in messages; None for the default ones.

    ValueError for entries of another kind, and for their ``numbers`` without them.
    """
    if arguments.get(name) is not None:
        return parts(f"sat_args: {name}", arguments[name], kind, what)
    for arg in numbers:
        if arguments.get(arg.name) is not None:
            raise ValueError(f"sat_args: {arg.name} is given without {name}; give {name}=[dyn.{kind.__name__}(...), ...]")
    return None
