"""Compiling functions of packs into fused loops."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
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
"""Inductor options without which the tick would be split into several loops."""


TRACED_BATCH = 13
"""Batch size of the trace, unlike any other size that occurs: the tracer takes equal sizes for the same."""


def compiled(function: Callable[..., Tensor], name: str, batched: tuple[bool, ...]) -> Callable[..., Tensor]:
    """``function`` of tensors, compiled at its first call for every size of the batch, at least two.

    The batch is the last dimension of the arguments for which ``batched`` is true. The function is traced into a graph of
    tensor operations first, so that it may be written in any Python.
    """
    fast: Callable[..., Tensor] | None = None

    def call(*packs: Tensor) -> Tensor:
        nonlocal fast
        if fast is not None:
            return fast(*packs)
        logger.info("compiling the %s for this machine; kept in torch's cache, so later starts take seconds", name)
        begin = time.perf_counter()
        graph = _traced(function, packs, batched)
        fast = torch.compile(graph, fullgraph=True, options=OPTIONS, isolate_recompiles=True)  # type: ignore[call-overload]
        for pack, varies in zip(packs, batched, strict=True):
            if varies:
                torch._dynamo.mark_dynamic(pack, pack.ndim - 1)
        result: Tensor = fast(*packs)
        logger.info("compiled the %s in %.1f s", name, time.perf_counter() - begin)
        return result

    return call


def _traced(function: Callable[..., Tensor], packs: Sequence[Tensor], batched: tuple[bool, ...]) -> torch.fx.GraphModule:
    examples = [p.new_zeros((*p.shape[:-1], TRACED_BATCH)) if b else p for p, b in zip(packs, batched, strict=True)]
    return make_fx(lambda *inputs: function(*inputs), tracing_mode="symbolic")(*examples)
