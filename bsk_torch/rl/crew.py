"""Constellations whose satellites are alike and decide for themselves: how policies for one satellite fly them, and how well."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bsk_torch.env import ConstellationTasking, SatelliteTasking
from bsk_torch.env.groups import AGENTS
from bsk_torch.rl.baselines import BASELINES
from bsk_torch.rl.evaluate import LONGEST, Evaluation
from bsk_torch.sats.satellite import Satellite

ACTION, LOG_PROB = (AGENTS, "action"), (AGENTS, "action_log_prob")
"""What policies write, [N, S] each."""


@dataclass(frozen=True)
class Member:
    """A constellation as what is written for the environment of one satellite wants to see it."""

    satellite: Satellite
    observation_spec: Composite
    device: torch.device


def member(env: ConstellationTasking) -> SatelliteTasking:
    """The constellation as if it were one of its satellites; ValueError unless these are alike and decide for themselves."""
    if list(env.group_map) != [AGENTS] or env.joint or env.groups[0].is_meta:
        raise ValueError(f"satellites must be alike, and each an agent of its own; the groups are {dict(env.group_map)}")
    return cast(SatelliteTasking, Member(env.satellites[0], env.observation_spec[AGENTS][:, 0], env.device))


class Crew(TensorDictModuleBase):
    """Lets a policy for one satellite decide for all that need a task; the busy and the dead go on."""

    def __init__(self, policy: TensorDictModuleBase) -> None:
        """``policy`` writes ``action`` into tensordicts [B] with ``observation`` and ``action_mask``."""
        super().__init__()
        self.policy = policy
        self.in_keys = [(AGENTS, "observation"), (AGENTS, "action_mask")]
        self.out_keys = [ACTION, LOG_PROB] if "action_log_prob" in policy.out_keys else [ACTION]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write :data:`ACTION`, and :data:`LOG_PROB` where the policy knows it: 0 for those that go on."""
        seen = tensordict[AGENTS].select("observation", "action_mask")
        legal = seen["action_mask"]
        decides = ~legal[..., -1]
        action = torch.full(decides.shape, legal.shape[-1] - 1, device=legal.device)
        log_prob = torch.zeros(decides.shape, device=legal.device)
        if bool(decides.any()):  # after the longest step, all may still be busy
            asked = seen[decides]
            asked["action_mask"] = asked["action_mask"][..., :-1]
            told = self.policy(asked)
            action[decides] = told["action"]
            if LOG_PROB in self.out_keys:
                log_prob[decides] = told["action_log_prob"]
        tensordict.set(ACTION, action)
        return tensordict.set(LOG_PROB, log_prob) if LOG_PROB in self.out_keys else tensordict


def crew_baseline(name: str, env: ConstellationTasking, seed: int = 0) -> Crew:
    """One of :data:`~bsk_torch.rl.baselines.BASELINES` for every satellite; KeyError or ValueError where it does not fit."""
    return Crew(BASELINES[name](member(env), seed))


def evaluate_crew(policy: TensorDictModuleBase, env: ConstellationTasking, *, seed: int) -> Evaluation:
    """Play one episode in each of the environment's N rows; the most probable actions are taken.

    Args:
        policy: Writes :data:`ACTION` into what the environment gives.
        env: The environment; its episodes start anew.
        seed: Seed of the episodes; the same seed gives every policy the same ones.

    Returns:
        Returns of the team; ``survived`` says whether all satellites did, decisions and counts are sums over satellites.
    """
    env.set_seed(seed)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        return _played(policy, env, env.reset())


def _played(policy: TensorDictModuleBase, env: ConstellationTasking, now: TensorDictBase) -> Evaluation:
    """Results of the episodes that begin with ``now``."""
    over = now["done"].squeeze(-1)
    seconds, decisions = (torch.zeros(len(over), dtype=torch.float64, device=env.device) for _ in range(2))
    for _ in range(LONGEST):
        if bool(over.all()):
            break
        decisions += torch.where(over, 0, _of_team(now[AGENTS, "requires_retasking"]))
        now = env.play([policy(now)[ACTION]], ~over)
        seconds += torch.where(over, 0.0, now["duration"].squeeze(-1))
        over = over | now["done"].squeeze(-1)
    lost = env.dead.sum(1)
    counts: TensorDictBase | None = now.get("counts", None)
    return Evaluation(
        returns=env.returns.clone(),
        collected=env.returns - env.failure_penalty * lost,
        survived=lost == 0,
        decisions=decisions.long(),
        seconds=seconds.to(env.dtype),
        deaths={name: env.fleet.joined([~alive]).sum(1) for name, alive in env.satellites[0].aliveness().items()},
        counts={} if counts is None else {str(name): count.sum(1) for name, count in counts.items()},
    )


def _of_team(each: Tensor) -> Tensor:
    """Sums [N] over the satellites of ``each`` [N, S, 1]."""
    return each.double().sum((1, 2))
