"""What cannot be traced, and programs that cannot be made or lowered."""

import math

import pytest
import torch

from bsk_torch.codegen.ir import Loop, UntraceableError
from bsk_torch.codegen.passes import lower
from tests.support.refusals import check_refusals, refusal


@pytest.fixture
def leaked(x):
    """A value that exists only where x is positive, and is seen outside."""
    values = []
    (x > 0.0).only(lambda: [values.append(torch.sin(x)) or x + 1.0], [x])
    return values[0]


def test_rejects_code_that_cannot_be_traced(x):
    mask = x > 0.0
    check_refusals(
        refusal(lambda: 1.0 if x > 0.0 else 2.0, UntraceableError, "torch.where"),
        refusal(lambda: max(x, 1.0), UntraceableError, "torch.where"),
        refusal(lambda: math.sqrt(x), UntraceableError, "numbers"),
        refusal(lambda: int(x), UntraceableError, "numbers"),
        refusal(lambda: torch.stack([x, x]), UntraceableError, "torch.stack", "kernel", "element"),
        refusal(lambda: torch.cat([x, x]), UntraceableError, "torch.cat", "kernel"),
        refusal(lambda: torch.cumsum(x, 0), UntraceableError, "torch.cumsum", "kernel", "FUNCTIONS"),
        refusal(lambda: x.sum(-1), UntraceableError, "Tensor.sum", "kernel"),
        refusal(lambda: x.add_(1.0), UntraceableError, "Tensor.add_", "kernel"),
        refusal(lambda: torch.tensor(1.0).add_(x), UntraceableError, "torch.add_", "kernel"),
        refusal(lambda: x.shape[0], UntraceableError, "Tensor.shape", "kernel"),
        refusal(lambda: x[0], UntraceableError, "elements"),
        refusal(lambda: list(x), UntraceableError, "elements"),
        refusal(lambda: len(x), UntraceableError, "elements"),
        refusal(lambda: x @ x, UntraceableError, "Vec3"),
        refusal(lambda: x // 2.0, UntraceableError, "torch.floor"),
        refusal(lambda: 2.0**x, UntraceableError, "operator", "kernel"),
        refusal(lambda: x**0.5, UntraceableError, "squares", "cubes"),
        refusal(lambda: x**x, UntraceableError, "squares", "cubes"),
        refusal(lambda: x * torch.ones(3), UntraceableError, "tensor", "dimensions"),
        refusal(lambda: torch.where(mask, x, torch.zeros(3)), UntraceableError, "tensor", "dimensions"),
        refusal(lambda: x + "1", UntraceableError, "'1'", "number", "value"),
        refusal(lambda: x + None, UntraceableError, "None", "number", "value"),
        refusal(lambda: torch.div(x, 2.0, rounding_mode="floor"), UntraceableError, "torch.div", "kernel", "rounding_mode"),
        refusal(lambda: x.to(torch.int64), UntraceableError, "torch.int64"),
        refusal(lambda: torch.zeros_like(x, dtype=torch.long), UntraceableError, "torch.int64"),
        refusal(lambda: mask * 2, UntraceableError, "torch.int64"),
        refusal(lambda: torch.where(mask, 1, 0), UntraceableError, "torch.int64"),
        refusal(lambda: torch.where(x, x, 0.0), UntraceableError, "where", "booleans"),
        refusal(lambda: x & x, UntraceableError, "and", "booleans"),
        refusal(lambda: ~x, UntraceableError, "not", "booleans"),
        refusal(lambda: torch.sqrt(mask), UntraceableError, "sqrt", "booleans"),
        refusal(lambda: mask < (x > 1.0), UntraceableError, "lt", "booleans"),
        refusal(lambda: x.only(lambda: [x], [x]), UntraceableError, "only", "booleans"),
    )


def test_rejects_values_outside_of_their_region(program, x, leaked):
    check_refusals(
        refusal(lambda: leaked + 1.0, UntraceableError, "mask", "only()"),
        refusal(lambda: torch.where(leaked > 0.0, leaked, 0.0), UntraceableError, "mask", "only()"),
        refusal(lambda: (x < 0.0).only(lambda: [leaked], [x]), UntraceableError, "mask", "only()"),
        refusal(lambda: (x < 0.0).only(lambda: [x], [leaked]), UntraceableError, "mask", "only()"),
        refusal(lambda: lower(Loop(program, [leaked])), UntraceableError, "mask", "only()"),
    )


def test_rejects_wrong_programs(program, x, y):
    written = Loop(program, [x + 1.0], written=[x.sin()], stop=x > 0.0)
    check_refusals(
        refusal(lambda: program.input("stat", 0), ValueError, "source", "'stat'", "'track'", "'state'"),
        refusal(lambda: Loop(program, [x], clock="tick"), ValueError, "clock", "'tick'", "'ticks'", "'start'", "'schedule'"),
        refusal(lambda: program.merge(program.root, [(x, y)]), ValueError, "root", "mask"),
        refusal(lambda: lower(written, lockstep=True), ValueError, "lockstep", "rows", "state"),
    )
