"""Compiling functions of packs into fused loops."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

import torch
from torch import Tensor
from torch.fx.experimental.proxy_tensor import make_fx

logger = logging.getLogger(__name__)

BACKENDS = ("compiled", "eager")

OPTIONS = {
    "max_fusion_size": 100000,
    "realize_cpu_opcount_threshold": 12,
    "realize_reads_threshold": 2,
    "cpp.enable_floating_point_contract_flag": "fast",
}
"""Inductor options without which the tick would be split into several loops."""


def compiled(function: Callable[..., Tensor], name: str) -> Callable[..., Tensor]:
    """``function`` of tensors, compiled at its first call for every size of their last dimension, the batch.

    The function is traced into a graph of tensor operations first, so that it may be written in any Python. The first batch
    must be larger than one.
    """
    fast: Callable[..., Tensor] | None = None

    def call(*packs: Tensor) -> Tensor:
        nonlocal fast
        if fast is not None:
            return fast(*packs)
        logger.info("compiling the %s for this machine; kept in torch's cache, so later starts take seconds", name)
        begin = time.perf_counter()
        batch = packs[0].shape[-1]
        graph = make_fx(lambda *inputs: function(*inputs), tracing_mode="symbolic")(*packs)
        fast = torch.compile(graph, fullgraph=True, options=OPTIONS, isolate_recompiles=True)
        for pack in packs:
            if pack.ndim and pack.shape[-1] == batch:
                torch._dynamo.mark_dynamic(pack, pack.ndim - 1)
        result = fast(*packs)
        logger.info("compiled the %s in %.1f s", name, time.perf_counter() - begin)
        return result

    return call
