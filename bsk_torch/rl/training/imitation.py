"""Imitation of a rule before reinforcement learning.

The policy plays, the rule labels each situation with its action, and the policy learns these actions: data aggregation
(Ross et al. 2011, arXiv:1011.0686) in which the newest batch counts. The critic learns the values of what is played meanwhile.
"""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.env import SatelliteTasking
from bsk_torch.env.action_forms import form
from bsk_torch.rl.rules.baselines import BASELINES
from bsk_torch.rl.training.loss import log_probabilities, log_probability
from bsk_torch.sim.arguments.values import nearest

TEACHERS = tuple(name for name in BASELINES if name != "random")
"""Rules that can be imitated."""

CHUNK = 2048
"""Situations that the rule judges at once: some compare all pairs of targets."""

TAUGHT = "taught"
"""Key of the rule's actions."""


def check_teacher(name: str) -> None:
    """ValueError, with the nearest name, unless there is such a rule."""
    if name not in TEACHERS:
        raise ValueError(f"imitate={name!r} must be one of {list(TEACHERS)}; {nearest(str(name), TEACHERS)}")


def find_teacher(name: str, env: SatelliteTasking) -> TensorDictModuleBase:
    """Return a rule for an environment; ValueError if it does not fit, or actions are real numbers."""
    if form(env.satellite) is not None:
        raise ValueError(
            f"imitate={name!r}: rules are imitated in choices only; the actions of {env.satellite.name} are real numbers"
        )
    try:
        return BASELINES[name](env, 0)
    except (KeyError, ValueError) as error:
        reason = f"{error.args[0]}; imitate=null trains without"
        raise ValueError(f"imitate={name!r} does not fit {env.satellite.name}: {reason}") from error


@torch.no_grad()
def taught_actions(teacher: TensorDictModuleBase, situations: TensorDictBase) -> Tensor:
    """Return what the rule would do, [...], in ``situations`` [...] with ``observation`` and ``action_mask``."""
    asked = situations.select("observation", "action_mask").reshape(-1)
    return torch.cat([teacher(part)["action"] for part in asked.split(CHUNK)]).view(situations.batch_size)


def imitation_loss(sample: TensorDictBase, counts: Tensor | None = None) -> Tensor:
    """Return the mean negative log-probability of what was taught, over all decisions or those that ``counts`` marks.

    ``sample`` has the actor's logits [..., A], ``action_mask`` [..., A] and :data:`TAUGHT` [...].
    """
    surprise = -log_probability(log_probabilities(sample["logits"], sample["action_mask"]), sample[TAUGHT])
    return surprise.mean() if counts is None else surprise[counts].mean()
