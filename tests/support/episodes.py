"""Environments in their first episodes, and how to see that a call left them as they were."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch


def begun(env: Any) -> Any:
    """The environment or view itself, after its first reset."""
    env.reset()
    return env


@contextmanager
def unchanged(env: Any) -> Iterator[None]:
    """Fail where the saved state of an environment is another one after the block, bit for bit."""
    before = env.get_state()
    yield
    after = env.get_state()
    assert all(torch.equal(before[key], after[key]) for key in before.keys(True, True))
