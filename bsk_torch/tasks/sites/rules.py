"""A rule for sites: commit to what can be finished."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor
from typing_extensions import Self

from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.rules.targets import Observation, TargetReader, image_actions
from bsk_torch.tasks.sites.worth import CONFIRMING, COORDINATED, Commitment, Number, worth

DEFAULTS = Commitment()


@dataclass(frozen=True)
class CommitRule:
    """Takes the image that is worth the most to one who commits to sites that can be finished, see :func:`worth`.

    Attributes:
        see: Reader of the observed images.
        images: Actions that take them.
        more: Properties observed in some tasks only, by which :func:`worth` tells what to do: ``"site_claims"`` for
            leaving what other satellites are about to take to them, ``"wide"`` for wide looks.
    """

    see: TargetReader
    images: range
    more: frozenset[str]

    @classmethod
    def of(cls, env: SatelliteTasking) -> Self:
        """Return the rule for an environment; KeyError or ValueError unless it observes sites, as Sites-v1 does."""
        see = TargetReader.of(env)
        rule = cls(see, image_actions(env), frozenset({"site_claims", "wide"} & set(see.column)))
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
        yielding: Number = DEFAULTS.yielding,
        hope: Number = DEFAULTS.hope,
        rush: Number = DEFAULTS.rush,
        busy: Number = DEFAULTS.busy,
    ) -> Tensor:
        """Return actions, [N], for an observation and the legal actions [N, A]; the numbers are those of :class:`Commitment`."""
        settings = (patience, loyalty, each, reserve, doubt, slew, alone, nerve, yielding, hope, rush, busy)
        numbers = Commitment(
            *(torch.as_tensor(value, dtype=torch.float32, device=action_mask.device).reshape(-1, 1) for value in settings)
        )
        values = worth(lambda name: self.see.read(observation, name), numbers, self.more)
        legal = action_mask[:, self.images.start : self.images.stop] & self.see.exist(observation)
        return self.images.start + values.masked_fill(~legal, -torch.inf).argmax(1)


def commit(env: SatelliteTasking, seed: int = 0, *, coordinated: bool = True, **numbers: Number) -> TensorDictModule:
    """Return a :class:`CommitRule` for an environment that observes sites; else KeyError or ValueError.

    Args:
        env: The environment.
        seed: Not used.
        coordinated: Whether to leave what other satellites are about to take to them, in a team.
        **numbers: Numbers of :class:`Commitment` that replace the defaults, :data:`COORDINATED` in a team and
            :data:`CONFIRMING` with wide looks.
    """
    rule = CommitRule.of(env)
    defaults = COORDINATED if "site_claims" in rule.more else CONFIRMING if "wide" in rule.more else DEFAULTS
    more = rule.more if coordinated else rule.more - {"site_claims"}
    decide = partial(replace(rule, more=more).decide, **(defaults._asdict() | numbers))
    return TensorDictModule(decide, in_keys=["observation", "action_mask"], out_keys=["action"])
