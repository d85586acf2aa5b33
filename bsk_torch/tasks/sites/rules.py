"""A rule for sites: commit to what can be finished."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor
from typing_extensions import Self

from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.rules.targets import Observation, TargetReader, image_actions
from bsk_torch.tasks.sites.worth import Commitment, Number, worth

DEFAULTS = Commitment()


@dataclass(frozen=True)
class CommitRule:
    """Takes the image that is worth the most to one who commits to sites that can be finished, see :func:`worth`."""

    see: TargetReader
    images: range

    @classmethod
    def of(cls, env: SatelliteTasking) -> Self:
        """Return the rule for an environment; KeyError or ValueError unless it observes sites, as Sites-v1 does."""
        rule = cls(TargetReader.of(env), image_actions(env))
        zero = env.observation_spec.zero()
        rule.decide(zero["observation"], zero["action_mask"])
        return rule

    def decide(
        self,
        observation: Observation,
        action_mask: Tensor,
        /,
        *,
        patience: Number = DEFAULTS.patience,
        loyalty: Number = DEFAULTS.loyalty,
        each: Number = DEFAULTS.each,
        reserve: Number = DEFAULTS.reserve,
        doubt: Number = DEFAULTS.doubt,
        slew: Number = DEFAULTS.slew,
        alone: Number = DEFAULTS.alone,
        nerve: Number = DEFAULTS.nerve,
    ) -> Tensor:
        """Return actions, [N], for an observation and the legal actions [N, A]; the numbers are those of :class:`Commitment`."""
        settings = (patience, loyalty, each, reserve, doubt, slew, alone, nerve)
        numbers = Commitment(
            *(torch.as_tensor(value, dtype=torch.float32, device=action_mask.device).reshape(-1, 1) for value in settings)
        )
        values = worth(lambda name: self.see.read(observation, name), numbers)
        legal = action_mask[:, self.images.start : self.images.stop] & self.see.exist(observation)
        return self.images.start + values.masked_fill(~legal, -torch.inf).argmax(1)


def commit(env: SatelliteTasking, seed: int = 0, **numbers: Tensor) -> TensorDictModule:
    """Return a :class:`CommitRule` with other ``numbers`` for an environment that observes sites; else KeyError or ValueError."""
    decide = partial(CommitRule.of(env).decide, **numbers)
    return TensorDictModule(decide, in_keys=["observation", "action_mask"], out_keys=["action"])
