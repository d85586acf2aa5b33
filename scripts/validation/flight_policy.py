"""Policies that fly, trained ones and baselines, the same in bsk_torch and on Basilisk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bsk_torch.env import SatelliteTasking
from bsk_torch.lab.basilisk.certificate import as_sets
from bsk_torch.lab.basilisk.flight import FLOWN, Pilot
from bsk_torch.lab.planners.named import PREFIX, named_planner
from bsk_torch.presets import make
from bsk_torch.rl.policies.files import check_fits, policy_of_file, read_card
from bsk_torch.rl.policies.pretrained import pretrained_file
from bsk_torch.rl.rules.baselines import BASELINES
from bsk_torch.sim.arguments.values import nearest

RANDOM = "random"
"""Name of the policy whose actions depend on the episode's seed and the number of the decision only."""

PRETRAINED = "pretrained"
"""Name of the policy that comes with the package for a preset."""


@dataclass(frozen=True)
class Flyer:
    """A policy and the environment that it flies in: what a run has kept, or a baseline in a preset.

    ``options`` are arguments of the preset. Where they ask for targets ``as_set``, both sides observe a vector like bsk_rl, and
    :func:`as_sets` makes of it what the policy is used to. ``plan`` are options NAME=VALUE of a planner, ``plan:NAME``: it
    decides here, by copies of the state, and Basilisk flies the actions.
    """

    policy: str
    preset: str
    options: dict[str, Any]
    plan: tuple[str, ...] = ()

    @property
    def plans(self) -> bool:
        """Whether the policy is a planner."""
        return self.policy.startswith(PREFIX)

    def environment(self, num_envs: int, **options: Any) -> SatelliteTasking:
        """The environment with bsk_rl's windows and float64 outputs: rewards are summed, and observations compared, unrounded."""
        where = {"num_envs": num_envs, "env_ids": [0] * num_envs, "dtype": torch.float64, "device": "cpu", "compat": "bsk_rl"}
        asked = self.options | options
        return make(self.preset, **(asked | where | ({"as_set": False} if "as_set" in asked else {})))

    def check(self) -> None:
        """ValueError or KeyError where the policy does not fit its environment."""
        if self.preset not in FLOWN:
            raise ValueError(f"preset {self.preset!r} cannot be flown on Basilisk; {', '.join(FLOWN)} can")
        if self.plans:
            named_planner(self.policy, self.preset, self.plan).actor(self.environment(1, backend="eager"))
            return
        if self.policy in BASELINES:
            self.pilot(())
            return
        try:
            env = make(self.preset, **(self.options | {"backend": "eager"}))
        except TypeError as error:
            raise ValueError(
                f"preset {self.preset!r} does not take the options of the training, {self.options}: {error}"
            ) from error
        check_fits(read_card(self.policy), env, self.preset)

    def pilot(self, observed: Sequence[str]) -> Pilot:
        """Return the pilot, the same on both sides; ``observed`` names the entries of the observation."""
        if self.policy == RANDOM:
            return random_action
        if self.policy in BASELINES:
            return policy_pilot(BASELINES[self.policy](self.environment(1, backend="eager"), 0))
        return policy_pilot(policy_of_file(self.policy), observed if self.options.get("as_set") else ())


def recruit(policy: str, preset: str | None, plan: Sequence[str] = ()) -> Flyer:
    """Return the policy that a command line names, with options of a planner.

    Raises:
        ValueError: For an unknown name, or a file without data that this version needs.
    """
    if plan and not policy.startswith(PREFIX):
        raise ValueError(f"--plan {plan[0]} is an option of a planner, such as {PREFIX}rollout; POLICY={policy!r} is none")
    if policy in BASELINES or policy.startswith(PREFIX):
        return Flyer(policy, preset or FLOWN[0], {}, tuple(plan))
    if policy == PRETRAINED:
        policy = str(pretrained_file(preset or FLOWN[0]))
    try:
        card = read_card(policy)
    except FileNotFoundError as error:
        raise ValueError(f"POLICY={policy!r} is no baseline either: {nearest(policy, BASELINES)}; {error}") from error
    return Flyer(policy, preset or card["preset"], card["options"])


def random_action(seen: TensorDict, seeds: Sequence[int], step: int) -> tuple[Tensor, Tensor]:
    """Legal actions with equal probability, drawn from the episode's seed and the decision's number only."""
    legal = seen["action_mask"].cumsum(-1)
    draws = [np.random.default_rng((seed, step)).random() for seed in seeds]
    chosen = torch.tensor(draws, dtype=torch.float64) * legal[:, -1]
    return (legal <= chosen.unsqueeze(-1)).sum(-1), seen["action_mask"].new_zeros(len(seeds), 0, dtype=torch.float64)


def planner_pilot(flyer: Flyer, env: SatelliteTasking) -> Pilot:
    """The decisions of a planner in the current state of ``env``, whose episodes it copies."""
    planner = named_planner(flyer.policy, flyer.preset, flyer.plan).actor(env)

    def decide(seen: TensorDict, seeds: Sequence[int], step: int) -> tuple[Tensor, Tensor]:
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            return planner(env.observe())["action"], torch.zeros(len(seeds), 0, dtype=torch.float64)

    return decide


def policy_pilot(policy: TensorDictModuleBase, observed: Sequence[str] = ()) -> Pilot:
    """The most probable action of a policy, which sees observations in float32 as in training, ``as_sets`` if they are named."""
    memory: dict[int, Tensor] = {}  # of a recurrent policy, by seed

    def decide(seen: TensorDict, seeds: Sequence[int], step: int) -> tuple[Tensor, Tensor]:
        vector = seen["observation"].float()
        what = as_sets(vector, observed) if observed else vector
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            asked = TensorDict({"observation": what, "action_mask": seen["action_mask"]}, seen.batch_size)
            if step and memory:
                asked["memory"] = torch.stack([memory[seed] for seed in seeds])
            done = policy(asked)
        if ("next", "memory") in done.keys(include_nested=True):
            memory.update(zip(seeds, done["next", "memory"], strict=True))
        return done["action"], done.get("logits", torch.zeros(len(seeds), 0)).double()

    return decide
