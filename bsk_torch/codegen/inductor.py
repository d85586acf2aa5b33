"""Just-in-time compilation of functions of tensors by torch's inductor.

It serves devices other than CPUs, and tensor code that cannot be traced into a kernel. Every set of shapes is compiled by itself:
those of a simulation never change, so CUDA graphs can replay a whole function.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.fx.experimental.proxy_tensor import make_fx

logger = logging.getLogger(__name__)

BACKENDS = ("compiled", "eager")

OPTIONS: dict[str, Any] = {
    "max_fusion_size": 100000,
    "realize_cpu_opcount_threshold": 12,
    "realize_reads_threshold": 2,
    "cpp.enable_floating_point_contract_flag": "fast",
}
"""Inductor options for one fused loop; inductor changes the dictionary that it is given, so it gets copies."""

CUDA_OPTIONS = {"triton.cudagraphs": True}
"""Replay all kernels of a call at once; its inputs stay where they are or are copied there."""

Kernel = Callable[..., Tensor]


def just_in_time(function: Kernel, name: str) -> Kernel:
    """Return ``function`` of tensors, compiled for each set of shapes, types and devices when it is first called with it.

    The function is traced into a graph of tensor operations first, so that it may be written in any Python.

    Args:
        function: Function of tensors that returns tensors.
        name: What messages call it.
    """
    kernels: dict[tuple[object, ...], Kernel] = {}

    def call(*tensors: Tensor) -> Tensor:
        key = tuple((tensor.shape, tensor.dtype, tensor.device) for tensor in tensors)
        if key not in kernels:
            kernels[key] = _compiled(function, name, tensors)
        return kernels[key](*tensors)

    return call


def _compiled(function: Kernel, name: str, tensors: tuple[Tensor, ...]) -> Kernel:
    begin = time.perf_counter()
    logger.info("compiling the %s for tensors of these sizes; it takes a minute or so", name, extra={"kernel": name})
    graph = make_fx(lambda *inputs: function(*inputs), _allow_non_fake_inputs=True)(*tensors)
    options = OPTIONS | (CUDA_OPTIONS if tensors[0].device.type == "cuda" else {})
    fast: Kernel = torch.compile(graph, fullgraph=True, dynamic=False, options=options)
    fast(*tensors)
    seconds = time.perf_counter() - begin
    logger.info("compiled the %s in %.1f s", name, seconds, extra={"kernel_seconds": seconds, "folder": ""})
    return fast
