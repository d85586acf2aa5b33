"""Compiling functions of packs into fused loops, once for each machine.

On the CPU a function becomes an ahead-of-time package in the user's cache folder (``BSK_TORCH_CACHE`` moves it), named by a hash
of its operations, of torch's version and of the processor: whatever changes them builds another one. A call of a package costs a
few microseconds. Elsewhere, and where a function calls operators of its own or holds tensors, ``torch.compile`` serves.
"""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import platformdirs
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
"""Inductor options for one fused loop; inductor adds to what it is given, so it gets copies."""

TRACED_BATCH = 13
"""Batch size of the trace, unlike any other size that occurs: the tracer takes equal sizes for the same."""

Kernel = Callable[..., Tensor]


def compiled(function: Kernel, name: str, batched: tuple[bool, ...]) -> Kernel:
    """``function`` of tensors, compiled at its first call for every size of the batch, at least two.

    The batch is the last dimension of the arguments for which ``batched`` is true. The function is traced into a graph of
    tensor operations first, so that it may be written in any Python.
    """
    fast: Kernel | None = None

    def call(*packs: Tensor) -> Tensor:
        nonlocal fast
        if fast is None:
            fast = _prepare(function, name, packs, batched)
        return fast(*packs)

    return call


def _prepare(function: Kernel, name: str, packs: Sequence[Tensor], batched: tuple[bool, ...]) -> Kernel:
    examples = [p.new_zeros((*p.shape[:-1], TRACED_BATCH)) if b else p for p, b in zip(packs, batched, strict=True)]
    trace = make_fx(lambda *inputs: function(*inputs), tracing_mode="symbolic", _allow_non_fake_inputs=True)
    graph = trace(*examples)
    if all(_is_plain(node) for node in graph.graph.nodes) and packs[0].device.type == "cpu":
        return _packaged(graph, name, examples, batched)
    return _just_in_time(graph, name, packs, batched)


def _is_plain(node: torch.fx.Node) -> bool:
    """Whether the traced code says all: no operators of others, and no tensors made inside, whose values it does not show."""
    return node.op != "get_attr" and getattr(node.target, "namespace", "aten") in ("aten", "prims")


def _announce(name: str) -> float:
    logger.info("compiling the %s for this machine, once; it takes a minute or so", name)
    return time.perf_counter()


def _just_in_time(graph: torch.fx.GraphModule, name: str, packs: Sequence[Tensor], batched: tuple[bool, ...]) -> Kernel:
    begin = _announce(name)
    fast: Kernel = torch.compile(graph, fullgraph=True, options=dict(OPTIONS), isolate_recompiles=True)  # type: ignore[call-overload]
    for pack, varies in zip(packs, batched, strict=True):
        if varies:
            torch._dynamo.mark_dynamic(pack, pack.ndim - 1)
    fast(*packs)
    logger.info("compiled the %s in %.1f s", name, time.perf_counter() - begin)
    return fast


# -- packages --------------------------------------------------------------------------------------------------------------


def cache_folder() -> Path:
    """Where packages are kept."""
    return Path(os.environ.get("BSK_TORCH_CACHE") or platformdirs.user_cache_path("bsk_torch"))


def _processor() -> str:
    """What code for this machine may not run on another one."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    described = sorted({line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))})
    return "\n".join([platform.machine(), platform.processor(), torch.backends.cpu.get_cpu_capability(), *described])


def _key(graph: torch.fx.GraphModule, examples: Sequence[Tensor]) -> str:
    shapes = [(str(example.dtype), tuple(example.shape)) for example in examples]
    parts = [graph.code, str(shapes), str(OPTIONS), torch.__version__, _processor()]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]


def _packaged(graph: torch.fx.GraphModule, name: str, examples: Sequence[Tensor], batched: tuple[bool, ...]) -> Kernel:
    path = cache_folder() / f"{_key(graph, examples)}.pt2"
    if not path.exists():
        begin = _announce(name)
        _build(graph, examples, batched, path)
        logger.info("compiled the %s in %.1f s; kept in %s", name, time.perf_counter() - begin, path.parent)
    run = torch._inductor.aoti_load_package(str(path)).loader.run

    def call(*packs: Tensor) -> Tensor:
        result: Tensor = run([pack.contiguous() for pack in packs])[0]  # packages trust strides
        return result

    return call


class _Wrapped(torch.nn.Module):
    """A graph as the module that the exporter wants."""

    def __init__(self, graph: torch.fx.GraphModule) -> None:
        super().__init__()
        self.graph = graph

    def forward(self, *packs: Tensor) -> Tensor:
        result: Tensor = self.graph(*packs)
        return result


def _build(graph: torch.fx.GraphModule, examples: Sequence[Tensor], batched: tuple[bool, ...], path: Path) -> None:
    """Build a package and move it into place whole, so that several processes may start at once."""
    batch = torch.export.Dim("batch", min=2, max=2**24)
    shapes = tuple({example.ndim - 1: batch} if varies else None for example, varies in zip(examples, batched, strict=True))
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # of torch, about torch
        exported = torch.export.export(_Wrapped(graph), tuple(examples), dynamic_shapes=(shapes,), strict=False)
        package = torch._inductor.aoti_compile_and_package(
            exported, package_path=str(Path(folder) / "kernel.pt2"), inductor_configs=dict(OPTIONS)
        )
        os.replace(package, path)
