"""A rule for the candidates of AEOS-Bench: satellites share the tasks, each taking what it completes first."""

from __future__ import annotations

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from bsk_torch.env import SatelliteTasking
from bsk_torch.obs.aeos_tasks import MATCHED
from bsk_torch.rl.rules.targets import Observation, TargetReader, image_actions
from bsk_torch.scene import AEOSBench

SOONEST = "soonest_task"
"""Name of the rule."""


def soonest_rule(env: SatelliteTasking, seed: int = 0) -> TensorDictModule:
    """Return the rule: each satellite takes its match, or without one its first candidate, with another satellite.

    For the matching, see :func:`bsk_torch.scene.aeos_outlook.match`. ValueError or KeyError if the rule does not apply.
    """
    images, see = image_actions(env), TargetReader.of(env)
    if not isinstance(env.satellite.scenario, AEOSBench):
        raise ValueError(f"the rule {SOONEST!r} needs scene.AEOSBench")

    def decide(observation: Observation, action_mask: Tensor) -> Tensor:
        """Return actions [...] for observations [..., F] and legal actions [..., A]."""
        legal = action_mask[..., images.start : images.stop]
        matched = legal & (see.read(observation, MATCHED)[..., : len(images)] > 0.5)
        choice = torch.where(matched.any(-1), matched.long().argmax(-1), 0)
        return torch.where(legal.any(-1), images.start + choice, images.start - 1)

    zero = env.observation_spec.zero()
    decide(zero["observation"], zero["action_mask"])
    return TensorDictModule(decide, in_keys=["observation", "action_mask"], out_keys=["action"])
