"""One policy for all satellites of a constellation, each of which decides by what it observes itself."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.data import Binary, Composite

from bsk_torch._deprecated import deprecated_names
from bsk_torch.env import ConstellationTasking, SatelliteTasking, Tasking
from bsk_torch.env.agents import AGENTS
from bsk_torch.rl.rules.baselines import BASELINES
from bsk_torch.sats.satellite import Satellite

ACTION, LOG_PROB = (AGENTS, "action"), (AGENTS, "action_log_prob")
"""Keys of actions and of their log-probabilities, [N, S] each."""


@dataclass(frozen=True)
class MemberView:
    """The attributes of an environment of one satellite, for one satellite of a constellation."""

    satellite: Satellite
    observation_spec: Composite
    device: torch.device


def member_view(env: Tasking) -> SatelliteTasking:
    """Return an environment as one of its satellites meets it, so that networks and rules can be built for that satellite.

    Args:
        env: An environment of one satellite, which is returned itself, or a constellation.

    Raises:
        ValueError: Unless the satellites of a constellation are alike, and each is an agent of its own.
    """
    if isinstance(env, SatelliteTasking):
        return env
    assert isinstance(env, ConstellationTasking)
    if list(env.group_map) != [AGENTS] or env.joint or env.groups[0].is_meta:
        raise ValueError(f"satellites must be alike, and each an agent of its own; the groups are {dict(env.group_map)}")
    seen, n = env.observation_spec[AGENTS][:, 0], env.satellites[0].actions.n_actions
    mask = Binary(n, shape=(*seen.shape, n), dtype=torch.bool, device=env.device)  # without the action that continues
    spec = Composite({"observation": seen["observation"], "action_mask": mask}, shape=seen.shape, device=env.device)
    return cast(SatelliteTasking, MemberView(env.satellites[0], spec, env.device))


class SharedPolicy(TensorDictModuleBase):
    """Applies a policy for one satellite to all satellites that need a task; busy and dead ones continue."""

    def __init__(self, policy: TensorDictModuleBase) -> None:
        """Wrap ``policy``, which writes ``action`` into tensordicts [B] with ``observation`` and ``action_mask``."""
        super().__init__()
        self.policy = policy
        self.in_keys = [(AGENTS, "observation"), (AGENTS, "action_mask")]
        self.out_keys = [ACTION, LOG_PROB] if "action_log_prob" in policy.out_keys else [ACTION]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write :data:`ACTION`, and :data:`LOG_PROB` if the policy returns it: 0 for satellites that continue."""
        seen = tensordict[AGENTS].select("observation", "action_mask")
        legal = seen["action_mask"]
        decides = ~legal[..., -1]
        action = torch.full(decides.shape, legal.shape[-1] - 1, device=legal.device)
        log_prob = torch.zeros(decides.shape, device=legal.device)
        if bool(decides.any()):  # after the longest step, all may still be busy
            deciding = seen[decides]
            deciding["action_mask"] = deciding["action_mask"][..., :-1]
            decided = self.policy(deciding)
            action[decides] = decided["action"]
            if LOG_PROB in self.out_keys:
                log_prob[decides] = decided["action_log_prob"]
        tensordict.set(ACTION, action)
        return tensordict.set(LOG_PROB, log_prob) if LOG_PROB in self.out_keys else tensordict


def shared(policy: TensorDictModuleBase, env: Tasking) -> TensorDictModuleBase:
    """Return a policy for one satellite as it acts in ``env``: in a constellation as a :class:`SharedPolicy`."""
    return policy if isinstance(env, SatelliteTasking) else SharedPolicy(policy)


def shared_baseline(name: str, env: Tasking, seed: int = 0) -> TensorDictModuleBase:
    """Return one of the ``BASELINES`` for every satellite; KeyError or ValueError if it does not fit."""
    return shared(BASELINES[name](member_view(env), seed), env)


def shared_baselines(env: Tasking, seed: int = 0) -> dict[str, TensorDictModuleBase]:
    """Return the ``BASELINES`` that fit an environment, for every satellite, by name."""
    fitting = {}
    for name in BASELINES:
        with suppress(KeyError, ValueError):  # a rule for other observations or actions
            fitting[name] = shared_baseline(name, env, seed)
    return fitting


if not TYPE_CHECKING:
    __getattr__ = deprecated_names(__name__)
