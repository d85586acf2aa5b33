"""Rules for inspectors of another spacecraft: drift, natural-motion circumnavigation, and a survey by waypoints.

They use the observations of :mod:`bsk_torch.tasks.inspection.preset`, and return velocity changes and drifts, or transfers of a
:class:`bsk_torch.act.HillWaypoint`, depending on the action of the satellites.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from bsk_torch.act import HillWaypoint, ImpulsiveThrustHill
from bsk_torch.astro.clohessy_wiltshire import circumnavigation
from bsk_torch.astro.linear_motion import about_circle
from bsk_torch.astro.relative import fibonacci_sphere
from bsk_torch.astro.transfers import Transfers, transfers
from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.rules.observation_columns import Columns
from bsk_torch.tasks.inspection.preset import NEAR, SLOW

MEAN_MOTION = 1.04e-3
"""Mean motion of the orbits of the presets, rad/s. It is not observed; drawn orbits differ by up to 6 percent."""

SAMPLES = 12
"""Number of times at which a transfer is evaluated."""

VIEW = math.radians(12.0), math.radians(45.0)
"""Angles between the center of a region and the inspector below which all of its points are in view, and above which none is."""

LIGHT = math.radians(42.0), math.radians(78.0)
"""Corresponding angles between the center of a region and the Sun."""

SHADOW = math.cos(math.radians(115.0))
"""Cosine of the angle between zenith and Sun below which the RSO is in the Earth's shadow."""

CLOSE, FAR, REACH = 15.0, 900.0, 250.0
"""Minimum and maximum distance on a transfer, and maximum distance for inspection, m."""

POINT, FUEL = 0.03, 0.1
"""Value of a region of three points, and cost of 1 m/s."""

SECOND, HURRIED_SECOND = 2e-5, 4e-4
"""Costs of 1 s in a survey, and in one with little time: the best of five in 32 episodes of RSOInspection-v1 in 1.5 orbits."""

DRIFT = 600.0
"""Time between two decisions of rules that hardly thrust, s."""


@dataclass(frozen=True)
class Situation:
    """Observations of N inspectors."""

    rho: Tensor  # position in the Hill frame of the RSO, [N, 3] m
    velocity: Tensor  # velocity in that frame, [N, 3] m/s
    sun: Tensor  # direction of the Sun, [N, 3]
    inspected: Tensor  # fraction of inspected points in each region, [N, R]
    centers: Tensor  # directions of the regions, [R, 3]

    @staticmethod
    def of(observation: Tensor, description: Sequence[str]) -> Situation:
        """Read an observation [N, F]; KeyError for a missing entry."""
        see = Columns(observation.double(), description)
        inspected = see.all("imaged_regions")
        centers = torch.as_tensor(fibonacci_sphere(inspected.shape[-1])).to(inspected.device)
        rho, velocity = see.all("r_DC_Hc_normd") * NEAR, see.all("v_DC_Hc_normd") * SLOW
        return Situation(rho, velocity, see.all("sun_hat_Hc"), inspected, centers)

    @property
    def n(self) -> Tensor:
        """Mean motion, [N] rad/s."""
        return torch.full_like(self.rho[:, 0], MEAN_MOTION)


def sun_at(sun: Tensor, angle: Tensor) -> Tensor:
    """Return the direction of the Sun [..., 3] after the Hill frame has rotated by ``angle`` [...] rad about the orbit normal."""
    s, c = torch.sin(angle), torch.cos(angle)
    x, y, z = sun.unbind(-1)
    return torch.stack(torch.broadcast_tensors(c * x + s * y, c * y - s * x, z), -1)


def new_regions(situation: Situation, ahead: Transfers) -> Tensor:
    """Return the approximate number of uninspected regions revealed by transfers, [N, D, K].

    A region counts by the fraction of its points in view and lit at the best time of the transfer: fully below the first of the
    angles :data:`VIEW` and :data:`LIGHT` between its center and the inspector or the Sun, and not at all above the second.
    """
    best = torch.zeros(*ahead.cost.shape, len(situation.centers), dtype=ahead.cost.dtype, device=ahead.cost.device)
    for k in range(ahead.samples):  # a loop over few times, since computing all at once would need that many times the memory
        position = ahead.position(k)
        distance = torch.linalg.vector_norm(position, dim=-1, keepdim=True)
        sun = sun_at(situation.sun[:, None], situation.n[:, None] * ahead.motion.time[k])
        lit = part(sun @ situation.centers.mT, LIGHT) * (sun[..., :1] > SHADOW)
        visible = part(position @ situation.centers.mT / distance, VIEW) * (distance < REACH)
        best = torch.maximum(best, visible * lit[:, None])
    return (best * (1.0 - situation.inspected)[:, None, None]).sum(-1)


def part(cosine: Tensor, angles: tuple[float, float]) -> Tensor:
    """Return 1 for cosines of angles below the first of two, rad, 0 above the second, and values in between between them."""
    high, low = math.cos(angles[0]), math.cos(angles[1])
    return ((cosine - low) / (high - low)).clamp(0.0, 1.0)


def survey_worth(situation: Situation, ahead: Transfers, max_dv: float, time_cost: float) -> Tensor:
    """Return the values of transfers, [N, D, K]: revealed regions minus costs of fuel and time; unsafe transfers come last.

    ``time_cost`` is the cost of 1 s.
    """
    nearest, farthest = ahead.distances()
    worth = POINT * new_regions(situation, ahead) - FUEL * ahead.cost - time_cost * ahead.motion.time[-1]
    unsafe = (nearest < CLOSE) | (farthest > FAR) | (ahead.cost > max_dv)
    # if none is safe, return from too far away
    return torch.where(unsafe, -1e3 - farthest, worth)


@dataclass(frozen=True)
class InspectionRule:
    """A rule for the inspectors of an environment."""

    entry: HillWaypoint | ImpulsiveThrustHill  # action of the inspectors
    description: Sequence[str]  # names of the observed values
    time_cost: float = SECOND  # cost of 1 s of a transfer for the survey, in units of the reward

    @classmethod
    def of(cls, env: SatelliteTasking, time_cost: float = SECOND) -> InspectionRule:
        """Return the rule for an environment; ValueError unless its satellites inspect another one."""
        entry = env.satellite.action_spec[0]
        if not isinstance(entry, HillWaypoint | ImpulsiveThrustHill):
            raise ValueError(f"rules of inspection need a HillWaypoint or ImpulsiveThrustHill; the action is {entry!r}")
        return cls(entry, env.satellite.observation_description, time_cost)

    def survey(self, observation: Tensor, action_mask: Tensor | None = None) -> Tensor:
        """Choose the transfer with the highest value; see :func:`survey_worth`."""
        situation = Situation.of(observation, self.description)
        way = self.entry if isinstance(self.entry, HillWaypoint) else WAYPOINTS
        most = torch.full_like(situation.n, self.entry.max_dv)
        device = situation.n.device
        motion = about_circle(situation.n, way.durations.to(device), SAMPLES)
        ahead = transfers(motion, situation.rho, situation.velocity, way.waypoints.to(device), most)
        worth = survey_worth(situation, ahead, self.entry.max_dv, self.time_cost).flatten(1)
        if action_mask is not None:
            return worth.masked_fill(~action_mask, -torch.inf).argmax(1)
        best = worth.argmax(1)
        duration = way.durations.to(device)[best % len(way.durations)]
        return torch.cat([ahead.manoeuvre(best), duration.unsqueeze(1)], 1)

    def circumnavigate(self, observation: Tensor) -> Tensor:
        """Stop the along-track drift, and fly around the RSO without further maneuvers."""
        situation = Situation.of(observation, self.description)
        dv = circumnavigation(situation.rho, situation.n) - situation.velocity
        dv[:, 2] = 0.0
        return torch.cat([dv, torch.full_like(dv[:, :1], DRIFT)], 1)

    def drift(self, observation: Tensor) -> Tensor:
        """Never thrust."""
        situation = Situation.of(observation, self.description)
        return torch.cat([torch.zeros_like(situation.rho), torch.full_like(situation.rho[:, :1], DRIFT)], 1)

    def module(self, name: str) -> TensorDictModule:
        """Return a method of the rule as a policy; ValueError for one that returns other actions than those of the satellites."""
        waypoints = isinstance(self.entry, HillWaypoint)
        if waypoints and name != "survey":
            raise ValueError(f"the rule {name!r} returns changes of velocity; the actions are waypoints")
        keys = ["observation", "action_mask"] if waypoints else ["observation"]
        return TensorDictModule(getattr(self, name), in_keys=keys, out_keys=["action"])


WAYPOINTS = HillWaypoint("RSO")
"""Transfers considered by the survey for satellites with velocity changes as actions."""


def inspection_rule(name: str, time_cost: float = SECOND) -> Callable[[SatelliteTasking, int], TensorDictModule]:
    """Return a function from environment and seed to a rule, with KeyError or ValueError if it does not apply.

    ``name`` is a method of :class:`InspectionRule`, ``time_cost`` that of the survey.
    """

    def make(env: SatelliteTasking, seed: int = 0) -> TensorDictModule:
        return InspectionRule.of(env, time_cost).module(name)

    return make


drift = inspection_rule("drift")
circumnavigate = inspection_rule("circumnavigate")
survey = inspection_rule("survey")
hurried_survey = inspection_rule("survey", HURRIED_SECOND)
