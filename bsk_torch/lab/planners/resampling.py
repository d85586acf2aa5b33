"""Resampling of futures and hidden states, and random numbers of planners; all draws are determined by keys of the episodes."""

from __future__ import annotations

from torch import Tensor

from bsk_torch.env import Tasking
from bsk_torch.rand import Key


def present_key(env: Tasking, rows: Tensor, env_ids: Tensor, name: str) -> Key:
    """Return the key of the current time of episodes, which differs at every time and is the same in every batch.

    Args:
        env: The environment, or a model of it.
        rows: Rows of the environment, [n].
        env_ids: Indices of their episodes in draws, [n].
        name: Name of the draw.
    """
    state, ticks = env.state, env.fleet.ticks
    return Key(state.seed[rows].cpu(), env_ids.cpu(), state.episode[rows].cpu(), name, moment=ticks[rows].cpu())


def reseed_copies(env: Tasking, rows: Tensor, lots: Tensor, key: Key) -> None:
    """Set the seeds of copied episodes, draw their faults to come again, and hidden values of the scenario.

    Args:
        env: A model.
        rows: Its rows with the copies, [n].
        lots: Random numbers that determine the seeds, [n] in [0, 1).
        key: Key with the indices of the episodes, [n].
    """
    seeds = (lots * 2.0**53).long()
    env.state.seed = env.state.seed.index_copy(0, rows, seeds.to(env.device))
    future = Key(seeds, key.env_id, key.episode)
    for simulator in env.fleet.simulators:
        simulator.draw_faults_again(rows, future)
    env.scenario.draw_again(rows, future, env.fleet.sim_time[rows])
