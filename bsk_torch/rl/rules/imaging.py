"""Rules for imaging satellites, which rank the targets in view."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from bsk_torch.env import SatelliteTasking
from bsk_torch.env.rollout import ACTION_VALUE
from bsk_torch.rl.rules.targets import Observation, TargetReader, image_actions, read

LEVEL, OPENS = "sat_props.storage_level_fraction", "ground_station.ground_station_0.opportunity_open_normd"
"""Paths of the observed buffer level and of the time to the next pass."""

FULL = 0.95
"""Buffer level, as a fraction, above which a pass is used for downlink."""

SLEW = 58.0
"""Time for a turn of one radian by the agile satellites of the presets, s; it grows with the square root of the angle."""

PATIENCE = 25.0
"""Waiting time that divides the value of an image by e, s."""

FORESIGHT, TOUR = 50.0, 3
"""The same for a rule that looks beyond the next image, and the number of further images that it counts."""

URGENCY = 1e6
"""Value of an action that comes before all images; its negative is that of an action that comes after them."""

Worth = Callable[[TargetReader, Observation], Tensor]
"""Function for the values of targets [N, n]; the target with the largest value is imaged first."""


def by_priority(see: TargetReader, observation: Observation) -> Tensor:
    """Rank targets by priority."""
    return see.read(observation, "priority")


def by_closing(see: TargetReader, observation: Observation) -> Tensor:
    """Rank targets by the end of their windows, the order in which they are observed."""
    return -torch.arange(see.n, dtype=torch.float32, device=observation.device).expand(*observation.shape[:1], -1)


def look_seconds(see: TargetReader, observation: Observation) -> Tensor | float:
    """Return the duration of looks at requests, [N, n] s; 0 where it is not observed."""
    return see.read(observation, "look_duration") if "look_duration" in see.column else 0.0


def by_discounted_priority(see: TargetReader, observation: Observation) -> Tensor:
    """Rank targets by priority discounted over the time needed for the image, or the look; unreachable targets come last."""
    angle, opens, closes = (see.read(observation, name) for name in ("target_angle", "opportunity_open", "opportunity_close"))
    seconds = torch.maximum(opens, SLEW * angle.clamp(min=0.0).sqrt()) + look_seconds(see, observation)
    return see.read(observation, "priority") * torch.exp(-seconds / PATIENCE) - (seconds > closes).to(opens.dtype)


def by_tour(see: TargetReader, observation: Observation) -> Tensor:
    """Rank targets by the discounted priorities of a tour that starts with each; see :func:`tours`."""
    return tours(see, observation, see.read(observation, "priority"))


def tours(see: TargetReader, observation: Observation, priority: Tensor, slew: float = SLEW) -> Tensor:
    """Return the values of tours that start with each target, [N, n]; unreachable targets come last, nearest first.

    The value of a tour is the sum of the discounted ``priority`` [N, n] of its targets. From a target, a tour continues with the
    best of the others that is reached before its window closes, :data:`TOUR` times. The duration of a turn between two targets is
    estimated from the angle between their present directions, and the satellite is assumed to reach each target when it would if
    it turned there first. The same target may be counted twice. With these simplifications, all tours take n^2 operations. A turn
    of one radian takes ``slew`` seconds. Targets that are requests are left after their looks.
    """
    angle, opens, closes = (see.read(observation, name) for name in ("target_angle", "opportunity_open", "opportunity_close"))
    direction = see.read_vector(observation, "r_LB_H")
    look = look_seconds(see, observation)
    closes, arrival = closes - look, torch.maximum(opens, slew * angle.clamp(min=0.0).sqrt())
    x, y, z = (direction / direction.norm(dim=-1, keepdim=True).clamp(min=1e-9)).unbind(-1)
    cosine = sum(part.unsqueeze(2) * part.unsqueeze(1) for part in (x, y, z))
    turned = (arrival + look).unsqueeze(2) + slew * torch.acos(cosine.clamp(-1.0, 1.0)).sqrt()
    following = torch.maximum(turned, opens.unsqueeze(1))
    other = (direction.unsqueeze(2) != direction.unsqueeze(1)).any(-1)  # padding of vectors repeats a target
    possible = other & see.exist(observation).unsqueeze(1) & (following <= closes.unsqueeze(1))
    factor = torch.where(possible, torch.exp((arrival.unsqueeze(2) - following) / FORESIGHT), 0.0)
    later = torch.zeros_like(priority)
    for _ in range(TOUR):
        later = (factor * (priority + later).unsqueeze(1)).amax(2)
    return torch.where(arrival > closes, -arrival, (priority + later) * torch.exp(-arrival / FORESIGHT))


IMAGING_RULES: dict[str, Worth] = {
    "greedy": by_priority,
    "nearest": by_closing,
    "hasty": by_discounted_priority,
    "farsighted": by_tour,
}
"""Rules for imaging by name."""


@dataclass(frozen=True)
class ImagingRule:
    """Images the highest-ranked of the existing, legal targets; without one, takes another legal action.

    Satellites with a downlink action empty a full buffer when a station is in view. They must observe :data:`LEVEL` and
    :data:`OPENS`.
    """

    see: TargetReader
    images: range
    worth: Worth
    description: Sequence[str]
    actions: Sequence[str]

    @classmethod
    def of(cls, env: SatelliteTasking, worth: Worth) -> ImagingRule:
        """Return the rule for an environment; ValueError or KeyError without targets or the required observations."""
        satellite = env.satellite
        see = TargetReader.of(env)
        if see.entry.in_orbit:
            raise ValueError(f"{satellite.name} images objects in orbit, for which there are other rules, such as 'rate'")
        images = image_actions(env)[: see.n]
        return cls(see, images, worth, satellite.observation_description, satellite.action_description)

    def worths(self, observation: Observation, action_mask: Tensor) -> Tensor:
        """Return the values of all actions, [N, A], for an observation and the legal actions [N, A].

        A needed downlink is worth more than any image, other actions and images of padding are worth less, by :data:`URGENCY`;
        illegal actions have the value -inf.
        """
        legal = action_mask[:, self.images.start : self.images.stop]
        n = legal.shape[1]
        images = self.worth(self.see, observation)[:, :n]
        worths = torch.full(action_mask.shape, -URGENCY, dtype=images.dtype, device=images.device)
        exist = self.see.exist(observation)[:, :n]
        worths[:, self.images.start : self.images.start + n] = torch.where(exist, images, -URGENCY)
        if "action_downlink" in self.actions:
            level, opens = (read(observation, self.description, path) for path in (LEVEL, OPENS))
            downlink = self.actions.index("action_downlink")
            worths[:, downlink] = torch.where((level > FULL) & (opens <= 0.0), URGENCY, -URGENCY).to(images.dtype)
        return worths.masked_fill(~action_mask, -torch.inf)

    def decide(self, observation: Observation, action_mask: Tensor) -> tuple[Tensor, Tensor]:
        """Return actions [N] for an observation and the legal actions [N, A], and the ranking of targets [N, A].

        The action is the first of those with the largest value. Actions that are not ranked have NaN.
        """
        worths = self.worths(observation, action_mask)
        return worths.argmax(1), worths.masked_fill(worths.abs() >= URGENCY, torch.nan)


def ranking_rule(ranking: Callable[[SatelliteTasking], ImagingRule]) -> Callable[[SatelliteTasking, int], TensorDictModule]:
    """Return a function from environment and seed to a rule; it raises KeyError or ValueError if unsuitable.

    The rule writes ``action``, and its ranking as ``action_value``.
    """

    def make(env: SatelliteTasking, seed: int = 0) -> TensorDictModule:
        rule = ranking(env)
        zero = env.observation_spec.zero()
        rule.decide(zero["observation"], zero["action_mask"])
        return TensorDictModule(rule.decide, in_keys=["observation", "action_mask"], out_keys=["action", ACTION_VALUE])

    return make
