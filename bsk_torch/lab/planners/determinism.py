"""Check that equal states have equal futures, so that episodes can be copied."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from bsk_torch.env import Tasking
from bsk_torch.lab.planners.agent_table import AgentTable

STEPS = 2
"""Number of compared decisions."""


def check_copyable(env: Tasking, slots: AgentTable) -> None:
    """Check that equal seeds start equal episodes, and that equal states have equal futures.

    In a separate environment, two rows start the same episode twice and execute the same decisions twice.

    Raises:
        TypeError: For an object that is not an environment of this package.
        ValueError: If anything differs; the message names it. The cause is a user function that draws random numbers without a
            seed, or keeps values outside the state.
    """
    twins = env.like(2, env_ids=[0, 0])
    begun = []
    for _ in range(2):
        twins.set_seed(0)
        twins.reset()
        begun.append(twins.get_state())
    _compare(begun, "two episodes of the same seed begin with different")
    seen = []
    for _ in range(2):
        twins.restore(begun[0])
        now: TensorDictBase = twins.observe()
        for _ in range(STEPS):
            slots.neutral(now)
            now = slots.play(twins, now, ~now["done"].squeeze(-1))
        seen.append(now)
    _compare(seen, "copies of one state are followed by different")


def _compare(found: list[TensorDictBase], words: str) -> None:
    """ValueError unless both tensordicts [2] are equal, and their rows, too."""
    first, second = (dict(part.items(True, True)) for part in found)
    for key, value in first.items():
        if not (_same(value[0], value[1]) and _same(value, second[key])):
            name = key if isinstance(key, str) else ".".join(key)
            raise ValueError(
                f"the environment cannot be copied: {words} {name!r}. Planning needs functions that repeat their results for an "
                "episode: draw random numbers from a key of bsk_torch.rand or, at reset, from the seeded global generators of "
                "NumPy or Python, and declare values kept within an episode (fleet.memory.declare)"
            )


def _same(one: Tensor, other: Tensor) -> bool:
    return torch.equal(torch.nan_to_num(one), torch.nan_to_num(other)) if one.is_floating_point() else torch.equal(one, other)
