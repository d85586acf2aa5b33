"""Results of operations known when a program is made.

Only what no rounding and no special number could contradict is folded: ``x * 0`` stays, because x may be NaN; ``x + 0`` does not,
though it loses the sign of a negative zero.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from bsk_torch.codegen.ir import Program, Value


def _divide(a: float, b: float) -> float:
    if b != 0.0:
        return a / b
    return math.nan if a == 0.0 or math.isnan(a) else math.copysign(math.inf, a) * math.copysign(1.0, b)


ARITHMETIC: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": _divide,
    "neg": operator.neg,
    "sqrt": lambda x: math.sqrt(x) if x >= 0.0 else math.nan,
    "abs": abs,
    "minimum": min,
    "maximum": max,
    **{name: getattr(operator, name) for name in ("gt", "lt", "ge", "le", "eq", "ne")},
    "and": operator.and_,
    "or": operator.or_,
    "xor": operator.xor,
    "not": operator.not_,
    "cast": lambda x: x,
}
"""Operations whose results on constants equal those of a kernel."""

NEUTRAL = {"add": 0.0, "sub": 0.0, "mul": 1.0, "div": 1.0}
"""Right sides that change nothing but the sign of zero."""


def fold(program: Program[Any], op: str, args: tuple[Value, ...], dtype: torch.dtype) -> Any:
    """Return the value that ``op(args)`` equals, or None if it must be computed."""
    numbers = [arg.number for arg in args]
    if op in ARITHMETIC and None not in numbers:
        return program.constant(ARITHMETIC[op](*numbers), dtype)
    if op == "where":
        return args[1] if numbers[0] is True or args[1] is args[2] else args[2] if numbers[0] is False else None
    if op == "cast":
        return _fold_cast(program, args[0], dtype)
    if op == "neg" and args[0].op == "neg":
        return args[0].args[0]
    if op in NEUTRAL and numbers[1] == NEUTRAL[op]:
        return args[0]
    if op in ("add", "mul") and numbers[0] == NEUTRAL[op]:
        return args[1]
    return None


def _fold_cast(program: Program[Any], value: Value, dtype: torch.dtype) -> Any:
    """Fold the cast of a mask that was cast before, or of a choice between constants: float64 needs no float32 in between."""
    if value.op == "cast" and value.args[0].dtype == torch.bool:
        return program.cast(value.args[0], dtype)
    if value.op == "where" and None not in (value.args[1].number, value.args[2].number):
        mask, *choices = value.args
        return program.operation("where", (mask, *(program.cast(choice, dtype) for choice in choices)), dtype)
    return None
