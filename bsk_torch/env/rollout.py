"""Play whole episodes, with one satellite or several."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

LONGEST = 1_000_000
"""Number of steps after which an unfinished rollout raises an error."""

ACTION_VALUE = "action_value"
"""Key under which a policy may write what it expects of each action, [..., A]; TorchRL's networks of values use it too."""

Policy = Callable[[TensorDictBase], TensorDictBase]
"""Writes actions into a tensordict [N] with observations and action masks, and returns it."""


@torch.no_grad()
def decide(policy: Policy, tensordict: TensorDictBase) -> TensorDictBase:
    """Let a policy write its most probable actions, without gradients."""
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        return policy(tensordict)


def play_episodes(
    env: EnvBase,
    policy: Policy,
    start: TensorDictBase | None = None,
    playing: Tensor | None = None,
    max_steps: int = LONGEST,
) -> Iterator[tuple[Tensor, TensorDictBase]]:
    """Step N episodes until each has ended; ended episodes are not stepped further.

    Entries written by the policy under ``next``, such as the hidden state of a recurrent policy, are passed to it at the next
    step. Nothing else is carried over between steps.

    Args:
        env: The environment, N episodes.
        policy: Chooses actions.
        start: Tensordict returned by ``env.reset`` or ``step_mdp`` (default: call ``env.reset()``).
        playing: Episodes to play, [N] booleans (default: all that have not ended at ``start``).
        max_steps: Maximum number of steps.

    Yields:
        For every step, the episodes that took it, [N] booleans, and the tensordict of ``env.step``, with the inputs and outputs
        of the policy at its root and the results under ``next``.

    Raises:
        RuntimeError: If an episode has not ended after ``max_steps`` steps.

    Example:
        >>> returns = torch.zeros(env.batch_size)
        >>> for playing, step in play_episodes(env, policy, env.reset()):
        ...     returns += torch.where(playing, step["next", "reward"].squeeze(-1), 0.0)
    """
    now = env.reset() if start is None else start
    unfinished = ~now["done"].squeeze(-1)
    playing = unfinished if playing is None else playing & unfinished
    for _ in range(max_steps):
        if not bool(playing.any()):
            return
        now = env.step(decide(policy, now).set("_step", playing))
        yield playing, now
        now = step_mdp(now, keep_other=False)
        playing = playing & ~now["done"].squeeze(-1)
    if bool(playing.any()):
        raise RuntimeError(f"{int(playing.sum())} episodes have not ended after max_steps={max_steps} steps")
