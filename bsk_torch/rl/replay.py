"""Flies many episodes, chosen by their seeds, in the rows of one environment: as a policy decides, or by a list of actions."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.evaluate import LONGEST
from bsk_torch.wrappers.gymnasium import reseed

OVER = -1
"""Stands for no action, where an episode has ended."""

NOTED = {"charge_fraction": "battery_charge_fraction", "wheel_speeds": "wheel_speeds"}
"""Properties of the dynamics that are noted, by the names that they get."""

Choice = Callable[[TensorDictBase, int, Tensor], Tensor]
"""Actions [N] by what the rows see, the number of the decision, and which episode each row plays [N]."""


class Flown(NamedTuple):
    """Episodes that have been flown to their ends, n of them.

    Attributes:
        survived: Whether the satellite lives, [n].
        returns: Sum of rewards, [n].
        actions: Number of each action, :data:`OVER` after the end, [n, T].
        series: What was noted at each decision by name, [n, T + 1, ...]; see :func:`look`.
        deaths: Whether each aliveness check failed at the end, [n] by name.
    """

    survived: Tensor
    returns: Tensor
    actions: Tensor
    series: dict[str, Tensor]
    deaths: dict[str, Tensor]


def by_policy(policy: TensorDictModuleBase) -> Choice:
    """What a policy chooses, with its memory if it has one; see :func:`bsk_torch.rl.evaluate.evaluate`."""
    kept = TensorDict()

    def choose(now: TensorDictBase, step: int, rows: Tensor) -> Tensor:
        told = policy(now.update(kept if step else {}))
        kept.update(told.get("next", {}))
        return told["action"]

    return choose


def by_list(actions: Tensor) -> Choice:
    """The actions [n, T] of a list, the last one again and again."""
    return lambda now, step, rows: actions[rows, min(step, actions.shape[1] - 1)]


def look(env: SatelliteTasking) -> dict[str, Tensor]:
    """What is noted at a decision: time, s, fraction of charge, wheel speeds, rad/s, seconds until sunlight, [N, ...] each."""
    dynamics, now = env.satellite.dynamics, env.simulator.sim_time
    dusk, dawn = env.satellite.next_eclipse()
    dark = torch.where(dawn < dusk, dawn - now, 0.0)
    return {"time": now.clone(), **{name: getattr(dynamics, read) for name, read in NOTED.items()}, "dark": dark}


def begin(env: SatelliteTasking, seeds: Tensor) -> TensorDictBase:
    """Start the first episode of the seeds [n], at most N, in as many rows, and of the last one in the others.

    They are those that ``reset(seed=...)`` starts in one Gymnasium environment. ValueError unless ``env_ids`` are all 0.
    """
    if bool(env.env_ids.any()):
        raise ValueError("seeds name episodes of environment 0; make the environment with env_ids=[0] * num_envs")
    spare = len(env.env_ids) - len(seeds)
    reseed(env, [*seeds.tolist(), *[int(seeds[-1])] * spare], torch.ones_like(env.dead))
    return env.reset()


def fly(env: SatelliteTasking, seeds: Tensor, choose: Choice, notes: bool = False) -> Flown:
    """Fly the episodes of ``seeds`` [n], however many, to their ends; with ``notes``, note what :func:`look` sees."""
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        parts = [_fly(env, seeds, rows, choose, notes) for rows in torch.arange(len(seeds)).split(len(env.env_ids))]
    return _joined(parts)


def _fly(env: SatelliteTasking, seeds: Tensor, numbers: Tensor, choose: Choice, notes: bool) -> Flown:
    """The episodes ``numbers`` [m] among those of ``seeds`` [n], at most as many as there are rows."""
    m, now = len(numbers), begin(env, seeds[numbers])
    rows = torch.nn.functional.pad(numbers, (0, len(env.env_ids) - m))
    over = torch.arange(len(rows), device=env.device) >= m
    returns = torch.zeros(len(over), dtype=torch.float64, device=env.device)
    actions, seen = [], [look(env)] if notes else []
    for step in range(LONGEST):
        if bool(over.all()):
            break
        action = choose(now, step, rows)
        now = env.play(action, ~over)
        actions.append(torch.where(over, OVER, action)[:m])
        returns += torch.where(over, 0.0, now["reward"].squeeze(-1).double())
        over = over | now["done"].squeeze(-1)
        if notes:
            seen.append(look(env))
    series = {name: torch.stack([there[name][:m] for there in seen], 1) for name in (seen[0] if seen else ())}
    deaths = {name: ~alive[:m] for name, alive in env.satellite.aliveness().items()}
    return Flown(~env.dead[:m], returns[:m], torch.stack(actions, 1), series, deaths)


def _joined(parts: list[Flown]) -> Flown:
    """The episodes of all parts, filled up at their ends."""

    def long(tables: list[Tensor], fill: float) -> Tensor:
        width = max(table.shape[1] for table in tables)
        pad = [[0, 0] * (table.ndim - 2) + [0, width - table.shape[1]] for table in tables]
        return torch.cat([torch.nn.functional.pad(t, p, value=fill) for t, p in zip(tables, pad, strict=True)])

    return Flown(
        torch.cat([part.survived for part in parts]),
        torch.cat([part.returns for part in parts]),
        long([part.actions for part in parts], OVER),
        {name: long([part.series[name] for part in parts], torch.nan) for name in parts[0].series},
        {name: torch.cat([part.deaths[name] for part in parts]) for name in parts[0].deaths},
    )
