"""Seeds of episodes, and those that only ``bsk-torch bench`` plays."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from bsk_torch._checks import whole

SEED_LIMIT = 2**63
"""Exclusive upper limit of seeds."""

SUITE_SEEDS = range(2**60, 2**60 + 2**20)
"""Held-out seeds: those of the episodes of suites (:mod:`bsk_torch.lab.suites.suite`), which no environment starts elsewhere."""

_benched: ContextVar[bool] = ContextVar("benched", default=False)


@contextmanager
def suite_episodes() -> Iterator[None]:
    """Allow :data:`SUITE_SEEDS` in the block, in which ``bsk-torch bench`` plays a suite."""
    token = _benched.set(True)
    try:
        yield
    finally:
        _benched.reset(token)


def episode_seed(seed: object) -> int:
    """Return the seed of episodes that are to start; ValueError for other values, and for :data:`SUITE_SEEDS`.

    Every seed that enters an environment passes here.
    """
    number = whole("seed", seed, 0, SEED_LIMIT - 1)
    if number in SUITE_SEEDS and not _benched.get():
        raise ValueError(
            f"seed={number}: the seeds from {SUITE_SEEDS[0]} to {SUITE_SEEDS[-1]} are held out for suites, which only "
            "bsk-torch bench plays; choose another seed"
        )
    return number
