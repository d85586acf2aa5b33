"""Certificates of suites: the first episodes of a task, flown again on Basilisk itself."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import cast

import gymnasium
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Composite

from bsk_torch.env import SatelliteTasking
from bsk_torch.env.rollout import Policy, decide
from bsk_torch.env.seeds import suite_episodes
from bsk_torch.lab.basilisk.flight import FLOWN, Flight, Pilot, Problem, Start, lacking, problem_of, replay_pilot, starts_of
from bsk_torch.lab.bounds.schedule import ScheduledPolicy
from bsk_torch.lab.planners.planner import Planner
from bsk_torch.lab.suites.suite import Entrant, Task, enter
from bsk_torch.rl.evaluation.evaluate import Evaluation, evaluate

__all__ = ["TOLERANCE", "Certificate", "certify"]

TOLERANCE = 1e-6
"""Largest difference of returns, decisions being the same, that certifies."""

SEEN = {"observation", "action_mask"}
"""What a policy may read in order to decide by what Basilisk shows."""

TARGETS = "target"
"""Name of the observation of targets."""


@dataclass(frozen=True)
class Certificate:
    """Episodes flown in bsk_torch and on Basilisk, n of them.

    Attributes:
        seeds: Their seeds, n.
        replayed: Whether Basilisk flew the actions that had been chosen in bsk_torch; otherwise the policy decided again there.
        returns: Returns in bsk_torch with ``compat="bsk_rl"`` and on Basilisk, [2, n].
        survived: Whether the satellite survived, likewise, [2, n].
        decisions: Numbers of decisions, likewise, [2, n].
        agreed: Number of first decisions that are the same, [n].
    """

    seeds: tuple[int, ...]
    replayed: bool
    returns: Tensor
    survived: Tensor
    decisions: Tensor
    agreed: Tensor

    @property
    def same(self) -> Tensor:
        """Whether all decisions are the same, and both or none survived, [n]."""
        return (self.agreed == self.decisions).all(0) & (self.survived[0] == self.survived[1])

    @property
    def largest_difference(self) -> float:
        """Largest difference of the returns."""
        return float((self.returns[0] - self.returns[1]).abs().max())

    @property
    def agrees(self) -> bool:
        """Whether all episodes are the same, and their returns up to :data:`TOLERANCE`."""
        return bool(self.same.all()) and self.largest_difference <= TOLERANCE

    def summary(self) -> dict[str, object]:
        """Plain values for a file."""
        return {
            "agrees": self.agrees,
            "decided": "in bsk_torch" if self.replayed else "on both sides",
            "same": int(self.same.sum()),
            "largest_difference": self.largest_difference,
            "returns": self.returns[0].tolist(),
            "returns_basilisk": self.returns[1].tolist(),
            "survived": self.survived[0].tolist(),
            "survived_basilisk": self.survived[1].tolist(),
            "decisions": self.decisions[0].tolist(),
            "decisions_basilisk": self.decisions[1].tolist(),
            "decisions_agreed": self.agreed.tolist(),
        }


@suite_episodes()
def certify(task: Task, entrant: Entrant, episodes: int, **options: object) -> Certificate | None:
    """Fly the first ``episodes`` of a task with the policy that ``entrant`` enters here and on Basilisk; None if it has none.

    Both fly by the rules of ``compat="bsk_rl"``. On Basilisk the policy decides again by what is observed there. The
    actions of planners, recurrent or random policies, and functions without declared inputs are replayed.

    Args:
        task: One of the presets in :data:`~bsk_torch.lab.basilisk.flight.FLOWN`.
        entrant: See :data:`~bsk_torch.lab.suites.suite.Entrant`.
        episodes: Number of episodes, at most ``task.at_once``.
        **options: ``backend`` and ``device`` of the environment.

    Raises:
        ImportError: Without Basilisk; the message lists what to install.
        TypeError, ValueError: For other presets and numbers of episodes, and as :func:`~bsk_torch.lab.suites.suite.enter`.
    """
    if task.preset not in FLOWN:
        raise ValueError(f"preset {task.preset!r} cannot be flown on Basilisk; {', '.join(FLOWN)} can")
    if not 1 <= episodes <= task.at_once:
        raise ValueError(f"episodes={episodes} must lie in [1, {task.at_once}] to be flown on Basilisk")
    if missing := lacking():
        raise ImportError(missing)
    as_there = replace(task, options={**task.options, "compat": "bsk_rl"})
    entered = enter(as_there, entrant, episodes, **options)
    if entered is None:
        return None
    env, policy = cast(SatelliteTasking, entered[0]), entered[1]
    batch, starts, actions = flown_here(env, policy, task.seeds(episodes))
    problem, form = problem_and_form(as_there, env)
    by_seed = {start.seed: actions[:k, row].numpy() for row, (start, k) in enumerate(zip(starts, batch.decisions, strict=True))}
    replayed = not decides_by_sight(policy)
    pilot = replay_pilot(by_seed) if replayed else sighted(policy, env, form)
    flights = flown_there(problem, starts, pilot)
    return Certificate(
        seeds=tuple(start.seed for start in starts),
        replayed=replayed,
        returns=torch.stack([batch.returns.cpu(), torch.tensor([flight.returns for flight in flights], dtype=torch.float64)]),
        survived=torch.stack([batch.survived.cpu(), torch.tensor([flight.survived for flight in flights])]),
        decisions=torch.stack([batch.decisions.cpu(), torch.tensor([flight.decisions for flight in flights])]),
        agreed=torch.tensor([agreed(by_seed[flight.seed].tolist(), flight.actions.tolist()) for flight in flights]),
    )


def agreed(actions: Sequence[int], reference: Sequence[int]) -> int:
    """Number of first actions that are the same."""
    pairs = list(zip(actions, reference, strict=False))
    return next((k for k, (a, b) in enumerate(pairs) if a != b), len(pairs))


# -- in bsk_torch ------------------------------------------------------------------------------------------------------


def flown_here(
    env: SatelliteTasking, policy: TensorDictModuleBase, seeds: Sequence[int]
) -> tuple[Evaluation, list[Start], Tensor]:
    """Results of the episodes of n seeds, one in each row of ``env``, what they start from, and their actions [T, n]."""
    starts, actions = list[Start](), list[Tensor]()

    def note_starts(*_: object) -> None:
        if not actions:
            starts.extend(starts_of(env, seeds))

    def note_action(policy: TensorDictModuleBase, inputs: object, decided: TensorDict) -> None:
        actions.append(decided["action"].cpu().clone())

    with policy.register_forward_pre_hook(note_starts), policy.register_forward_hook(note_action), torch.no_grad():
        result = evaluate(policy, env, seeds=seeds)
    return result, starts, torch.stack(actions)


def problem_and_form(task: Task, env: SatelliteTasking) -> tuple[Problem, Callable[[Tensor], object]]:
    """What bsk_rl is to build, which observes a vector, and the function of that vector that the policy has been made for."""
    if not isinstance(env.observation_spec["observation"], Composite):
        return problem_of(env, task.preset), lambda vector: vector
    shielded = {"shielded": env.satellite.shielded} if hasattr(env.satellite, "shielded") else {}
    plain = cast(SatelliteTasking, task.environment(1, as_set=False, backend="eager", **shielded))
    problem = problem_of(plain, task.preset)
    return problem, lambda vector: as_sets(vector, problem.observed)


def as_sets(vector: Tensor, observed: Sequence[str]) -> TensorDict:
    """Return the observations of presets with ``as_set=True`` from the vector [n, F] of those without, whose entries are named.

    Targets become ``rows`` [n, T, features] with a ``mask`` [n, T], which is 0 for repetitions of the last target.
    """
    columns: dict[tuple[str, ...], list[int]] = {}
    for k, name in enumerate(observed):
        path = tuple(name.partition("[")[0].split("."))
        columns.setdefault((TARGETS, "rows") if path[0] == TARGETS else path, []).append(k)
    parts = TensorDict({}, vector.shape[:1])
    for path, where in columns.items():
        parts[path] = vector[:, where] if "[" in observed[where[0]] else vector[:, where[0]]
    if (TARGETS, "rows") in columns:
        count = len({name.split(".")[1] for name in observed if name.startswith(f"{TARGETS}.")})
        rows = vector[:, columns[TARGETS, "rows"]].unflatten(1, (count, -1))
        new = (rows[:, 1:] != rows[:, :-1]).any(-1)
        parts[TARGETS, "rows"], parts[TARGETS, "mask"] = rows, torch.cat([new[:, :1] | True, new], 1).to(vector.dtype)
    return parts


# -- on Basilisk -------------------------------------------------------------------------------------------------------


def decides_by_sight(policy: Policy) -> bool:
    """Whether a policy declares that it reads only observation and mask, and keeps nothing for its next decision."""
    if isinstance(policy, Planner | ScheduledPolicy):  # these read the state of the environment, too
        return False
    reads, writes = (list(getattr(policy, name, [])) for name in ("in_keys", "out_keys"))
    first = {key if isinstance(key, str) else key[0] for key in reads}
    return bool(first) and first <= SEEN and not any(key != "next" and key[0] == "next" for key in writes)


def sighted(policy: Policy, env: SatelliteTasking, form: Callable[[Tensor], object]) -> Pilot:
    """The decisions of a policy, called with its original batch size and the same observation in every row."""
    n, device, dtype = env.batch_size[0], env.device, env.dtype

    def pilot(td: TensorDict, seeds: Sequence[int], step: int) -> tuple[Tensor, Tensor]:
        inputs = TensorDict({"observation": form(td["observation"].to(dtype)), "action_mask": td["action_mask"]}, [1])
        decision = decide(policy, inputs.expand(n).clone().to(device))
        return decision["action"][:1].cpu(), torch.zeros(1, 0, dtype=torch.float64)

    return pilot


def flown_there(problem: Problem, starts: Sequence[Start], pilot: Pilot) -> list[Flight]:
    """The same episodes on Basilisk, one after the other."""
    with names_kept(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Overriding environment|.*already in registry", UserWarning)
        from bsk_torch.lab.basilisk.reference_env import fly_there
    with quiet():
        return [fly_there(problem, start, pilot) for start in starts]


@contextmanager
def names_kept() -> Iterator[None]:
    """Keep the environments of Gymnasium's registry, whose names bsk_rl gives to its own when it is imported."""
    environments = dict(gymnasium.registry)
    try:
        yield
    finally:
        gymnasium.registry.update(environments)


@contextmanager
def quiet() -> Iterator[None]:
    """Discard what Basilisk prints to the standard output, past Python's."""
    sys.stdout.flush()
    stdout, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(stdout, 1)
        os.close(stdout)
        os.close(nowhere)
