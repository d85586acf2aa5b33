"""Play many episodes, given by their seeds, with a policy or with lists of actions."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.env import SatelliteTasking
from bsk_torch.env.rollout import Policy, play_episodes
from bsk_torch.rl.evaluation.evaluate import start_episodes

OVER = -1
"""Stands for no action after the end of an episode."""

NOTED = {"charge_fraction": "battery_charge_fraction", "wheel_speeds": "wheel_speeds"}
"""Recorded properties of the dynamics model, by their names in the record."""


class Flown(NamedTuple):
    """n whole episodes.

    Attributes:
        survived: Whether the satellite survived, [n].
        returns: Sum of rewards, [n].
        actions: Index of each action, :data:`OVER` after the end, [n, T].
        series: Series of :func:`look` by name, [n, T + 1, ...].
        deaths: Whether each aliveness check failed at the end, [n] by name.
    """

    survived: Tensor
    returns: Tensor
    actions: Tensor
    series: dict[str, Tensor]
    deaths: dict[str, Tensor]


def look(env: SatelliteTasking) -> dict[str, Tensor]:
    """Return time, s, fraction of charge, wheel speeds, rad/s, and seconds until sunlight, [N, ...] each."""
    dynamics, now = env.satellite.dynamics, env.simulator.sim_time
    dusk, dawn = env.satellite.next_eclipse()
    dark = torch.where(dawn < dusk, dawn - now, 0.0)
    return {"time": now.clone(), **{name: getattr(dynamics, read) for name, read in NOTED.items()}, "dark": dark}


def fly(env: SatelliteTasking, seeds: Tensor, player: Policy | Tensor, notes: bool = False) -> Flown:
    """Play the episodes of any number of ``seeds`` [n] to their ends.

    Args:
        env: The environment, with N episodes at once.
        seeds: See :func:`~bsk_torch.rl.evaluation.evaluate.start_episodes`.
        player: A policy, or actions [n, T], of which the last is repeated.
        notes: Whether to record the series of :func:`look`.
    """
    return _joined([_fly(env, seeds, rows, player, notes) for rows in torch.arange(len(seeds)).split(len(env.env_ids))])


def _fly(env: SatelliteTasking, seeds: Tensor, numbers: Tensor, player: Policy | Tensor, notes: bool) -> Flown:
    """Play the episodes ``numbers`` [m] of those of ``seeds`` [n], at most as many as there are rows."""
    m, spare = len(numbers), len(env.env_ids) - len(numbers)
    policy = script(player[torch.nn.functional.pad(numbers, (0, spare))]) if isinstance(player, Tensor) else player
    start = start_episodes(env, seeds[numbers].tolist())
    rows = torch.arange(m + spare, device=env.device) < m
    returns = torch.zeros(len(rows), dtype=torch.float64, device=env.device)
    actions, entries = [], [look(env)] if notes else []
    for playing, step in play_episodes(env, policy, start, rows):
        actions.append(torch.where(playing, step["action"], OVER)[:m])
        returns += torch.where(playing, step["next", "reward"].squeeze(-1).double(), 0.0)
        if notes:
            entries.append(look(env))
    series = {name: torch.stack([entry[name][:m] for entry in entries], 1) for name in (entries[0] if entries else ())}
    deaths = {name: ~alive[:m] for name, alive in env.satellite.aliveness().items()}
    return Flown(~env.dead[:m], returns[:m], torch.stack(actions, 1), series, deaths)


def script(actions: Tensor) -> Policy:
    """Return a policy that takes the actions [N, T] one after the other, and repeats the last one."""
    steps = itertools.chain(range(actions.shape[1]), itertools.repeat(-1))
    return lambda tensordict: tensordict.set("action", actions[:, next(steps)])


def _joined(parts: list[Flown]) -> Flown:
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
