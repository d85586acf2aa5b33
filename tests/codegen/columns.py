"""Functions of planes as kernels that run a single tick."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from bsk_torch.codegen.ir import Loop
from bsk_torch.codegen.kernel import Kernel
from bsk_torch.codegen.trace import Tracer

Function = Callable[[Sequence[Any], Sequence[Any]], Sequence[Any]]


def mapped(function: Function, inputs: int, shared: int, name: str) -> Callable[..., Tensor]:
    """A kernel that computes ``function`` of planes, and of numbers that all columns share, for each column.

    What it gives is called with x [inputs, n] and the shared numbers [shared], and returns y [outputs, n].
    """
    program = Tracer()
    planes = [program.input("state", k) for k in range(inputs)]
    common = [program.input("shared", k) for k in range(shared)]
    outputs = function(planes, common)
    kernel = Kernel(name, Loop(program, [], (), outputs))

    def call(x: Tensor, common: Tensor | None = None) -> Tensor:
        n = x.shape[1]
        y = torch.full((n, 1, len(outputs)), torch.nan, dtype=torch.float64)
        kernel(x, torch.ones(n, dtype=torch.int64), (), shared=common, written=y)
        return y.squeeze(1).mT

    return call
