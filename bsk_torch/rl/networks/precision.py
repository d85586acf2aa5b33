"""The type of weights, float32 whatever torch's default type is, and that of arithmetic in gradient steps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

import torch

FLOAT32, BFLOAT16 = "float32", "bfloat16"
PRECISIONS = (FLOAT32, BFLOAT16)
"""Types that networks can compute in while they learn."""


@contextmanager
def float32_weights() -> Iterator[None]:
    """Let modules built inside have float32 weights; a context, or a decorator of the function that builds them.

    Modules take torch's default type, which programs may have set: policies from files would then not fit observations.
    """
    default = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)
    try:
        yield
    finally:
        torch.set_default_dtype(default)


def has_bfloat16(device: torch.device) -> bool:
    """Whether a device multiplies matrices of bfloat16, instead of converting them to float32 and back."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return any(bool(available) for name, available in torch.cpu.get_capabilities().items() if "bf16" in name)


def reduced(precision: str, device: torch.device) -> AbstractContextManager[object]:
    """Return a context, to be entered any number of times, in which networks compute with a precision of :data:`PRECISIONS`.

    Weights, gradients, logarithms of probabilities and the loss remain float32.

    ValueError for ``"bfloat16"`` on a device that has no such arithmetic.
    """
    if precision == FLOAT32:
        return nullcontext()
    if not has_bfloat16(device):
        name = torch.cuda.get_device_name(device) if device.type == "cuda" else "the processor"
        raise ValueError(f"precision={precision!r}: {name} has no bfloat16 arithmetic, and would be slower than with {FLOAT32!r}")
    return torch.autocast(device.type, torch.bfloat16)
