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

Threshold = Tensor | float
"""A number, or one for each row, [N]."""


@dataclass(frozen=True)
class CommitRule:
    """Takes the image that brings the most of a site that can be finished, and of those that cannot what it pays alone.

    With the time t until an image of a site is taken and n images that are left, their value is::

        finish * chance^nerve * (1 + loyalty * done / size) * exp(-(t + (n - 1) * each) / patience)

    if ``t + (n - 1) * each`` is less than the time until the window closes plus ``slack``; and further
    ``alone * step * (1 - risk) * exp(-t / patience)``.
    """

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
        *,
        patience: Threshold = 86.0,
        loyalty: Threshold = 5.0,
        each: Threshold = 21.4,
        slack: Threshold = 63.0,
        slew: Threshold = 45.0,
        alone: Threshold = 0.77,
        nerve: Threshold = 0.5,
    ) -> Tensor:
        """Return actions, [N], for an observation and the legal actions [N, A].

        The defaults are the best of 128 settings in 6,272 episodes of Sites-v1, rounded.

        Args:
            observation: The observation.
            action_mask: The legal actions.
            patience: Time that divides the value of what is finished later by e, s.
            loyalty: Additional value of a site as it approaches completion.
            each: Time for each further image of a site, s.
            slack: Time by which the last image may be estimated to be late, s.
            slew: Time for a turn of one radian, s; it grows with the square root of the angle.
            alone: Weight of what an image pays without the others.
            nerve: Exponent of the probability that all images are clear: 0 for a rule that does not look at the forecast.
        """
        numbers = (patience, loyalty, each, slack, slew, alone, nerve)
        patience, loyalty, each, slack, slew, alone, nerve = (
            torch.as_tensor(value, device=action_mask.device).reshape(-1, 1) for value in numbers
        )

        def read(name: str) -> Tensor:
            return self.see.read(observation, name)

        taken = torch.maximum(read("opportunity_open"), slew * read("target_angle").clamp(min=0.0).sqrt())
        closes = read("opportunity_close")
        last = taken + (read("site_left") - 1.0).clamp(min=0.0) * each
        whole = (
            read("site_finish")
            * read("site_chance") ** nerve
            * (1.0 + loyalty * read("site_done") / read("site_size").clamp(min=1.0))
        )
        value = torch.where(last < closes + slack, whole * torch.exp(-last / patience), 0.0)
        value = value + alone * read("site_step") * (1.0 - read("risk")) * torch.exp(-taken / patience)
        value = torch.where(taken < closes, value, -1.0 - 1e-6 * taken)
        legal = action_mask[:, self.images.start : self.images.stop] & self.see.exist(observation)
        return self.images.start + value.masked_fill(~legal, -torch.inf).argmax(1)


def commit(env: SatelliteTasking, seed: int = 0, **numbers: float) -> TensorDictModule:
    """Return a :class:`CommitRule` with other ``numbers`` for an environment that observes sites; else KeyError or ValueError."""
    decide = partial(CommitRule.of(env).decide, **numbers)
    return TensorDictModule(decide, in_keys=["observation", "action_mask"], out_keys=["action"])
