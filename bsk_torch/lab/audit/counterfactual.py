"""Search for actions that would have saved a satellite, and for proofs that none exist.

Actions are verified by playing them from the start of the episode. An episode counts as lost only with a proof: every sequence of
actions was tried until death, or until the charge fell below the bound of :mod:`bsk_torch.lab.audit.charge_bound`.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from bsk_torch.env import SatelliteTasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.lab.audit.charge_bound import check_bounded, least_charge, longest_action, most_power
from bsk_torch.rl.evaluation.evaluate import start_episodes
from bsk_torch.rl.evaluation.replay import OVER, fly, script

MARGIN = 1.0
"""Margin below the bound, W s, at which a satellite counts as lost: far more than rounding in five orbits."""

SAVED, LOST, OPEN = "saved", "lost", "open"

PLAN_LENGTH = 40
"""Number of actions of random plans."""

LEAST_DEMANDING = 4
"""Index of the plan that desaturates ten times and then charges to the end."""


class Counterfactual(NamedTuple):
    """For n episodes, the best plan: whether it saves the episode [n], its actions [n, T], and its return [n]."""

    saved: Tensor
    actions: Tensor
    returns: Tensor


class Verdict(NamedTuple):
    """Result of an exhaustive search.

    Attributes:
        outcome: :data:`SAVED`, :data:`LOST`, or :data:`OPEN` for an aborted search.
        actions: Surviving actions from the start, [T], of which the last is repeated; None if none were found.
        states: Number of visited states.
    """

    outcome: str
    actions: Tensor | None
    states: int


def check_searchable(env: SatelliteTasking) -> None:
    """Raise ValueError for environments without the actions, arguments or orbits needed to explain failures."""
    for name in ("action_charge", "action_desat"):
        action_number(env, name)
    check_bounded(env)
    longest_action(env)


# -- plans -----------------------------------------------------------------------------------------------------------------------


def action_number(env: SatelliteTasking, name: str) -> int:
    """Return the index of an action; ValueError if the satellite has no such action."""
    names = env.satellite.action_description
    if name not in names:
        has = ", ".join(entry.name for entry in env.satellite.actions.entries)
        raise ValueError(f"rescues need an action {name!r}, which the satellite does not have; it has {has}")
    return names.index(name)


def candidate_plans(env: SatelliteTasking, n_random: int = 32) -> Tensor:
    """Return candidate sequences of actions, [P, 1 + K]; the last action, charging, is repeated.

    They charge at once, after some desaturation or another action, or with some desaturation in between; others are random.
    """
    charge, desat = action_number(env, "action_charge"), action_number(env, "action_desat")
    n = env.satellite.actions.n_actions
    runs = [[charge]] + [[desat] * k for k in (1, 2, 4, 10)]
    runs += [[other] * k for other in range(n) if other not in (charge, desat) for k in (1, 2, 4)]
    runs += [[charge] * wait + [desat] * k for wait in (3, 10, 20) for k in (2, 5, 10)]
    runs += _random_runs(n, charge, n_random)
    plans = torch.full((len(runs), 1 + max(map(len, runs))), charge, dtype=torch.int64)
    for row, run in enumerate(runs):
        plans[row, : len(run)] = torch.tensor(run)
    return plans


def _random_runs(n: int, charge: int, count: int) -> list[list[int]]:
    """Return random sequences of runs of one to eight equal actions; charging is three times as likely as other actions."""
    generator = torch.Generator().manual_seed(0)
    weight = torch.ones(n, dtype=torch.float32).index_fill(0, torch.tensor([charge]), 3.0)
    runs = []
    for _ in range(count):
        kinds = torch.multinomial(weight, PLAN_LENGTH, replacement=True, generator=generator)
        runs.append(kinds.repeat_interleave(torch.randint(1, 9, (PLAN_LENGTH,), generator=generator))[:PLAN_LENGTH].tolist())
    return runs


def spliced(actions: Tensor, count: Tensor, plans: Tensor) -> Tensor:
    """Return the first ``count`` [n] of the actions [n, T], then a plan [n, L] whose last action is repeated, [n, T + L]."""
    column = torch.arange(actions.shape[1] + plans.shape[1])
    first = actions[:, column.clamp(max=actions.shape[1] - 1)]
    after = (column - count.unsqueeze(1)).clamp(0, plans.shape[1] - 1)
    return torch.where(column < count.unsqueeze(1), first, plans.gather(1, after))


def try_plans(env: SatelliteTasking, seeds: Tensor, actions: Tensor, count: Tensor, plans: Tensor) -> Counterfactual:
    """Play the first ``count`` [n] of the actions [n, T] in the episodes of ``seeds`` [n], then each plan of [P, L]."""
    n, p = len(seeds), len(plans)
    episode = torch.arange(n).repeat_interleave(p)
    paths = spliced(actions[episode], count[episode], plans.repeat(n, 1))
    flights = fly(env, seeds[episode], paths)
    returns, best = torch.where(flights.survived, flights.returns, -torch.inf).view(n, p).max(1)
    return Counterfactual(returns > -torch.inf, paths.view(n, p, -1)[torch.arange(n), best], returns)


def last_chance(env: SatelliteTasking, seeds: Tensor, actions: Tensor, plans: Tensor) -> tuple[Tensor, Counterfactual]:
    """Return the index of the last decision [n] from which a plan saves each episode failed by ``actions`` [n, T].

    The search bisects, because an episode that can be saved at one decision can be saved at every earlier one. The index is
    :data:`OVER` if no plan saves the episode from its start. The returned rescue starts at the last such decision.
    """
    best = try_plans(env, seeds, actions, torch.zeros_like(seeds), plans)
    low = torch.where(best.saved, 0, OVER)
    high = torch.where(best.saved, (actions != OVER).sum(1), 0)
    while bool((high - low > 1).any()):
        middle = ((low + high) // 2).clamp(min=0)
        tried = try_plans(env, seeds, actions, middle, plans)
        better = tried.saved & (high - low > 1)
        low, high = torch.where(better, middle, low), torch.where(tried.saved, high, middle)
        best = Counterfactual(
            best.saved,
            torch.where(better.unsqueeze(1), tried.actions, best.actions),
            torch.where(better, tried.returns, best.returns),
        )
    return low, best


# -- proofs ----------------------------------------------------------------------------------------------------------------------


def exhaust(env: SatelliteTasking, seed: int, actions: Tensor, count: int, bound: bool = True) -> Verdict:
    """Try all possible actions after the first ``count`` of the actions [T] in the episode of ``seed``.

    Breadth-first search: all actions from all states, without states in which the satellite is dead or, with ``bound``, has less
    charge than needed. The states are kept in the environment's rows. If there are too many, only permanent charging is tried
    from each.
    """
    rows = torch.arange(len(env.env_ids), device=env.device)
    now = start_episodes(env, [seed])
    need = least_charge(most_power(env, rows[:1]) * env.simulator.h, longest_action(env))[0]
    need = need if bound else torch.full_like(need, -torch.inf)
    for action in actions[:count]:
        now = env.play(torch.full_like(rows, int(action)), rows < 1)
    choices = torch.arange(env.satellite.actions.n_actions, device=env.device)
    living, paths, states = _hopeful(env, need, rows[:1]), actions[:count].expand(1, -1), 1
    while 0 < len(living) * len(choices) <= len(rows):
        m = len(living) * len(choices)
        _put(env, living.repeat_interleave(len(choices)))
        action = choices.repeat(len(living))
        now = env.play(torch.nn.functional.pad(action, (0, len(rows) - m)), rows < m)
        paths = torch.cat([paths[living].repeat_interleave(len(choices), 0), action.unsqueeze(1)], 1)
        survivors = torch.nonzero((now["done"].squeeze(-1) & ~env.dead)[:m]).squeeze(-1)
        if len(survivors):
            return Verdict(SAVED, paths[survivors[0]], states + m)
        living, states = _hopeful(env, need, rows[:m]), states + m
    if len(living):
        return _charged(env, now, living, paths, states)
    return Verdict(LOST, None, states)


def _hopeful(env: SatelliteTasking, need: Tensor, rows: Tensor) -> Tensor:
    """Return the ``rows`` that are alive and have more charge than the bound ``need`` [T + 1]."""
    charge = env.satellite.dynamics.battery_charge[rows]
    return rows[~env.dead[rows] & (charge > need[env.simulator.ticks[rows]] - MARGIN)]


def _put(env: SatelliteTasking, sources: Tensor) -> None:
    """Copy the rows ``sources`` [m] to the first m rows."""
    size = len(env.env_ids)
    index = torch.nn.functional.pad(sources, (0, size - len(sources)))
    env.reset(TensorDict({"state": env.get_state()[index]}, [size]), set_state=True)


def _charged(env: SatelliteTasking, now: TensorDictBase, living: Tensor, paths: Tensor, states: int) -> Verdict:
    """Return whether any of the rows ``living`` survives by charging from ``now`` to the end."""
    rows, charge = torch.arange(len(env.env_ids), device=env.device), action_number(env, "action_charge")
    for _ in play_episodes(env, script(torch.full_like(rows, charge).unsqueeze(1)), now, torch.isin(rows, living)):
        pass
    survivors = living[~env.dead[living]]
    if len(survivors):
        return Verdict(SAVED, torch.cat([paths[survivors[0]], torch.tensor([charge])]), states)
    return Verdict(OPEN, None, states)
