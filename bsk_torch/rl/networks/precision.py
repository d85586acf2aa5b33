"""The type of weights: float32, whatever torch's default type is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


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
