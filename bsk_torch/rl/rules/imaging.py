"""Rules for satellites that image targets, by the order of the targets in view."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.rules.targets import Observation, TargetReader, image_actions, read

LEVEL, OPENS = "sat_props.storage_level_fraction", "ground_station.ground_station_0.opportunity_open_normd"
"""Paths of the observed level of the store, and of the time to the next pass."""

FULL = 0.95
"""Data level, fraction of the store, from which a pass is used for downlink."""

SLEW = 58.0
"""Seconds in which the agile satellites of the presets turn by one radian; the time grows as the root of the angle."""

PATIENCE = 25.0
"""Seconds of waiting that make an image e times less attractive."""

Worth = Callable[[TargetReader, Observation], Tensor]
"""Values of targets [N, n]; the largest is imaged first."""


def by_priority(see: TargetReader, observation: Observation) -> Tensor:
    """The most valuable target first."""
    return see.read(observation, "priority")


def by_closing(see: TargetReader, observation: Observation) -> Tensor:
    """The target whose window closes next first: targets are observed in this order."""
    return -torch.arange(see.n, dtype=torch.float32, device=observation.device).expand(*observation.shape[:1], -1)


def by_discounted_priority(see: TargetReader, observation: Observation) -> Tensor:
    """Priority, discounted by the time that the image will take; targets that will be gone by then come last."""
    angle, opens, closes = (see.read(observation, name) for name in ("target_angle", "opportunity_open", "opportunity_close"))
    seconds = torch.maximum(opens, SLEW * angle.clamp(min=0.0).sqrt())
    return see.read(observation, "priority") * torch.exp(-seconds / PATIENCE) - (seconds > closes).to(opens.dtype)


@dataclass(frozen=True)
class ImagingRule:
    """Images the most preferred of the existing, legal targets; otherwise takes a legal action.

    Satellites that can downlink empty a full store where a station is in view; they have to observe :data:`LEVEL` and
    :data:`OPENS`.
    """

    see: TargetReader
    images: range
    worth: Worth
    description: Sequence[str]
    actions: Sequence[str]

    @classmethod
    def of(cls, env: SatelliteTasking, worth: Worth) -> ImagingRule:
        """For an environment; ValueError or KeyError where it has no targets, or does not show what is needed."""
        satellite = env.satellite
        see = TargetReader.of(env)
        images = image_actions(env)[: see.n]
        return cls(see, images, worth, satellite.observation_description, satellite.action_description)

    def decide(self, observation: Observation, action_mask: Tensor) -> Tensor:
        """Actions [N], by what is observed and which actions are legal [N, A]."""
        legal = action_mask[:, self.images.start : self.images.stop]
        n = legal.shape[1]
        wanted = legal & self.see.exist(observation)[:, :n]
        worth = self.worth(self.see, observation)[:, :n].masked_fill(~wanted, -torch.inf)
        image = self.images.start + worth.argmax(1)
        action = torch.where(wanted.any(1), image, action_mask.long().argmax(1))
        if "action_downlink" not in self.actions:
            return action
        downlink = self.actions.index("action_downlink")
        level, opens = (read(observation, self.description, path) for path in (LEVEL, OPENS))
        return torch.where((level > FULL) & (opens <= 0.0) & action_mask[:, downlink], downlink, action)


def imaging_rule(worth: Worth) -> Callable[[SatelliteTasking, int], TensorDictModule]:
    """:class:`ImagingRule` as a function of the environment and a seed; KeyError or ValueError where it does not fit."""

    def make(env: SatelliteTasking, seed: int = 0) -> TensorDictModule:
        rule = ImagingRule.of(env, worth)
        zero = env.observation_spec.zero()
        rule.decide(zero["observation"], zero["action_mask"])
        return TensorDictModule(rule.decide, in_keys=["observation", "action_mask"], out_keys=["action"])

    return make
