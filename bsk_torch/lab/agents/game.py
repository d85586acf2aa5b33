"""A set of cases that are decided one by one, with looks ahead in copies of the episode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from bsk_torch.env import SatelliteTasking, Tasking
from bsk_torch.rl.evaluation.evaluate import failed_checks, start_episodes
from bsk_torch.sim.names import nearest

MOST_PLANS, MOST_ACTIONS = 32, 8
"""Plans of a look ahead, and actions of a plan or a commitment."""

DIGITS = 6
"""Significant digits of the numbers that are shown."""


def shown(number: float | Tensor) -> float:
    """Return a number with the digits that are shown."""
    return float(f"{float(number):.{DIGITS}g}")


class Game:
    """The cases of some seeds, in order; each begins when the one before it ends.

    Attributes:
        names: Names of the actions, by their numbers.
        results: Results of the cases that have ended.
    """

    def __init__(self, env: Tasking, seeds: Sequence[int]) -> None:
        """Begin the first case in ``env``, one episode whose ``env_ids`` is 0.

        ValueError unless one satellite observes a vector and chooses among numbered actions.
        """
        if not isinstance(env, SatelliteTasking) or not env.satellite.actions.n_actions:
            raise ValueError("tools need one satellite that chooses among numbered actions")
        self.env, self.seeds, self.branches = env, seeds, env.like(MOST_PLANS)
        self.names: list[str] = list(env.satellite.action_description)
        self.results: list[dict[str, Any]] = []
        self.situation: TensorDictBase | None
        self._begin()
        assert self.situation is not None
        if self.situation["observation"].ndim != 2:
            raise ValueError("tools need a satellite that observes a vector")

    @torch.no_grad()
    def _begin(self) -> None:
        self.decisions = self.looks = 0
        case = len(self.results)
        self.situation = start_episodes(self.env, [self.seeds[case]]) if case < len(self.seeds) else None

    def observe(self) -> dict[str, object]:
        """Return the situation of the present case, observations by name; where all cases have ended, only that they have."""
        if self.situation is None:
            return {"finished": True, "cases": len(self.seeds)}
        limit = float(self.env.time_limit[0])
        return {
            "case": len(self.results) + 1,
            "cases": len(self.seeds),
            "seed": self.seeds[len(self.results)],
            "decisions": self.decisions,
            "time_s": shown(self.env.fleet.sim_time[0]),
            "time_limit_s": shown(limit) if limit < float("inf") else None,
            "return": shown(self.env.returns[0]),
            "observation": self._observation(self.situation, 0),
        }

    def _observation(self, situation: TensorDictBase, row: int) -> dict[str, float]:
        names = self.env.satellite.observation_description
        return {name: shown(value) for name, value in zip(names, situation["observation"][row].tolist(), strict=True)}

    def actions(self) -> dict[str, bool]:
        """Return all actions by name, and whether they are legal now."""
        return dict(zip(self.names, self._running()["action_mask"][0].tolist(), strict=True))

    def _running(self) -> TensorDictBase:
        if self.situation is None:
            raise ValueError("all cases have ended; report tells their results")
        return self.situation

    def _numbers(self, actions: Sequence[str]) -> list[int]:
        for action in actions:
            if action not in self.names:
                raise ValueError(f"action {action!r} is unknown; {nearest(action, self.names)}")
        return [self.names.index(action) for action in actions]

    @torch.no_grad()
    def what_if(self, plans: Sequence[Sequence[str]]) -> list[dict[str, object]]:
        """Fly each plan in a copy of the present case; return what becomes of them.

        A plan ends early with the episode, or before an action that is illegal at its time. ValueError for unknown actions.
        """
        self._running()
        numbers = [self._numbers(plan) for plan in plans]
        longest = max(map(len, numbers))
        table = torch.tensor([row + [-1] * (longest - len(row)) for row in numbers + [[]] * (MOST_PLANS - len(plans))])
        self.looks += len(plans)
        branches, n = self.branches, MOST_PLANS
        branches.restore(self.env, envs=range(n), source=[0] * n)
        begin = self.env.fleet.sim_time[0].clone()
        legal = self._running()["action_mask"].expand(n, -1)
        rewards, taken = torch.zeros(n, dtype=torch.float64), torch.zeros(n, dtype=torch.int64)
        going, futures, ended = torch.ones(n, dtype=torch.bool), None, torch.zeros(n, dtype=torch.bool)
        for column in table.T:
            going = going & ~ended & (column >= 0)
            going = going & legal.gather(1, column.clamp(min=0).unsqueeze(1)).squeeze(1)
            futures = branches.play(column.clamp(min=0), going)
            rewards += torch.where(going, futures["reward"].squeeze(-1).double(), 0.0)
            taken += going
            ended, legal = ended | (going & futures["done"].squeeze(-1)), futures["action_mask"]
        assert futures is not None
        return [
            {
                "plan": list(plan),
                "taken": int(taken[k]),
                "reward": shown(rewards[k]),
                "seconds": shown(branches.fleet.sim_time[k] - begin),
                "alive": not bool(branches.dead[k]),
                "ended": bool(ended[k]),
                "observation": self._observation(futures, k),
            }
            for k, plan in enumerate(plans)
        ]

    @torch.no_grad()
    def commit(self, actions: Sequence[str]) -> dict[str, object]:
        """Take actions in the present case, one after the other, until it ends; the next case begins then.

        ValueError for unknown actions and one that is illegal at its time; those before it have been taken.
        """
        numbers, rewards = self._numbers(actions), 0.0
        begin = float(self.env.fleet.sim_time[0])
        for k, number in enumerate(numbers):
            if not bool(self._running()["action_mask"][0, number]):
                raise ValueError(f"action {actions[k]!r}, number {k + 1}, is illegal now; {k} actions have been taken")
            self.situation = self.env.play(torch.tensor([number]))
            self.decisions += 1
            rewards += float(self.situation["reward"])
            if bool(self.situation["done"]):
                return self._outcome(k + 1, rewards, begin) | {"ended": True, "result": self._end()}
        return self._outcome(len(numbers), rewards, begin) | {"ended": False}

    def _outcome(self, taken: int, rewards: float, begin: float) -> dict[str, object]:
        return {"taken": taken, "reward": shown(rewards), "seconds": shown(float(self.env.fleet.sim_time[0]) - begin)}

    def _end(self) -> dict[str, object]:
        """Note the result of the case that has ended, and begin the next."""
        causes = [name for name, failed in failed_checks(self.env).items() if bool(failed[0].any())]
        self.results.append(
            {
                "seed": self.seeds[len(self.results)],
                "return": shown(self.env.returns[0]),
                "alive": not bool(self.env.dead[0]),
                "failed": causes,
                "decisions": self.decisions,
                "looks": self.looks,
            }
        )
        self._begin()
        return self.results[-1]

    def report(self) -> dict[str, object]:
        """Return the results of all cases that have ended, and their means."""
        n = len(self.results)
        sums = {"mean_return": sum(r["return"] for r in self.results), "survival": sum(r["alive"] for r in self.results)}
        means = {name: shown(total / n) if n else None for name, total in sums.items()}
        return {"ended": n, "cases": len(self.seeds), "results": self.results} | means
