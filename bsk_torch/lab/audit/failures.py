"""Explanations of a policy's failures: whether and until when they could have been avoided."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from bsk_torch.constants import RPM
from bsk_torch.env import SatelliteTasking
from bsk_torch.env.action_forms import form
from bsk_torch.lab.audit.counterfactual import (
    LEAST_DEMANDING,
    LOST,
    OPEN,
    SAVED,
    Counterfactual,
    candidate_plans,
    exhaust,
    last_chance,
    try_plans,
)
from bsk_torch.rl.evaluation.replay import OVER, Flown, fly
from bsk_torch.rl.policies.shared_policy import as_policy
from bsk_torch.wrappers.policies import Actor

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Moment:
    """A decision of an episode: its index, time (s), action and state.

    ``charge`` is a fraction of the capacity, ``wheel_rpm`` the speed of the fastest wheel, and ``dark`` the time to sunlight, s.
    """

    decision: int
    time: float
    action: str
    charge: float
    wheel_rpm: float
    dark: float


@dataclass(frozen=True)
class Failure:
    """An episode in which the satellite died, and whether it could have been saved.

    Attributes:
        seed: Seed of the episode.
        cause: Failed aliveness checks.
        died: Time of death, s.
        outcome: Outcome of the search from the start: :data:`SAVED`, :data:`LOST` or :data:`OPEN`.
        start: The first decision.
        last_chance: The last decision at which it could still be saved; None if there is none.
        lost_from: Index of the first decision proven to be too late; the number of decisions if only death itself is too late.
        best_return: Largest return of the verified rescues.
        rescue: Actions of the latest rescue, from the start; the last one is repeated.
    """

    seed: int
    cause: str
    died: float
    outcome: str
    start: Moment
    last_chance: Moment | None
    lost_from: int
    best_return: float | None
    rescue: list[int] | None


def explain(
    policy: Actor, env: SatelliteTasking, seeds: Tensor, tell: Callable[[str], object] = logger.info
) -> tuple[Flown, list[Failure]]:
    """Play the episodes of ``seeds`` [n] with a policy, and search for actions that would have avoided its failures.

    Args:
        policy: Chooses actions; see :func:`~bsk_torch.rl.policies.as_policy`.
        env: The environment.
        seeds: Seeds of the episodes.
        tell: Called with a description of each stage of the search.

    Returns:
        The played episodes, and the failures in the order of the seeds.

    Raises:
        ValueError: For satellites with continuous actions.
    """
    if form(env.satellite) is not None:
        raise ValueError(f"failures are explained by other numbered actions; those of {env.satellite.name} are real numbers")
    flown = fly(env, seeds, as_policy(policy, env))
    failed = torch.nonzero(~flown.survived).squeeze(-1)
    n = len(failed)
    if not n:
        return flown, []
    tell(f"looking for the last chances in {n} episode{'s' * (n > 1)} that ended in death")
    seeds, actions = seeds[failed], flown.actions[failed]
    noted = fly(env, seeds, actions.clamp(min=0), notes=True)
    last, rescue = last_chance(env, seeds, actions, candidate_plans(env))
    failures = []
    for k, seed in enumerate(seeds):
        tell(f"searching death {k + 1} of {n} for a later chance")
        failures.append(_failure(env, noted, int(seed), k, int(last[k]), rescue))
    return flown, failures


def can_be_saved(env: SatelliteTasking, seeds: Tensor) -> Tensor:
    """Return whether a plan survives each episode of ``seeds`` [n] from its start, [n]; the least demanding plan is first."""
    plans = candidate_plans(env)
    saved = fly(env, seeds, plans[LEAST_DEMANDING].expand(len(seeds), -1)).survived
    left = torch.nonzero(~saved).squeeze(-1)
    if len(left):
        none = torch.zeros_like(left)
        saved[left] = try_plans(env, seeds[left], none.unsqueeze(1), none, plans).saved
    return saved


def _failure(env: SatelliteTasking, flown: Flown, seed: int, row: int, last: int, rescue: Counterfactual) -> Failure:
    """Explain row ``row`` of the failures; ``last`` is the last decision from which a plan saves it, or OVER."""
    actions, decisions = flown.actions[row], int((flown.actions[row] != OVER).sum())
    found = rescue.actions[row] if last > OVER else None
    returns = [float(rescue.returns[row])] if last > OVER else []
    tried = last + 1
    while tried < decisions:
        verdict = exhaust(env, seed, actions, tried)
        if verdict.outcome == LOST:
            break
        if verdict.actions is not None:
            again = fly(env, torch.tensor([seed]), verdict.actions.unsqueeze(0))
            if not bool(again.survived):
                raise RuntimeError(f"the actions that saved seed {seed} in the search do not when flown from the start")
            last, found, returns = tried, verdict.actions, [*returns, float(again.returns)]
        tried += 1
    return Failure(
        seed=seed,
        cause=", ".join(name for name, failed in flown.deaths.items() if bool(failed[row])),
        died=float(flown.series["time"][row, decisions]),
        outcome=SAVED if last > OVER else LOST if tried == 0 else OPEN,
        start=_moment(env, flown, row, 0),
        last_chance=_moment(env, flown, row, last) if last > OVER else None,
        lost_from=tried,
        best_return=max(returns, default=None),
        rescue=None if found is None else trimmed(found.tolist()),
    )


def trimmed(actions: list[int]) -> list[int]:
    """Return the actions without trailing repetitions of the last one."""
    while len(actions) > 1 and actions[-1] == actions[-2]:
        actions = actions[:-1]
    return actions


def _moment(env: SatelliteTasking, flown: Flown, row: int, decision: int) -> Moment:
    there = {name: values[row, decision] for name, values in flown.series.items()}
    return Moment(
        decision=decision,
        time=float(there["time"]),
        action=env.satellite.action_description[int(flown.actions[row, decision])],
        charge=float(there["charge_fraction"]),
        wheel_rpm=float(there["wheel_speeds"].abs().max()) / RPM,
        dark=float(there["dark"]),
    )
