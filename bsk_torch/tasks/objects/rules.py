"""Rules for imagers of objects in orbit, which rank the objects of the catalog, or those that are observed.

A branch of BSK-RL's authors flies policies next to such rules. They use the observations and actions of
:mod:`bsk_torch.tasks.objects.preset`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.rules.observation_columns import Columns
from bsk_torch.rl.rules.targets import Observation, TargetReader, image_actions
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.tasks.objects.candidates import HIGHEST, LOWEST, Views
from bsk_torch.tasks.objects.obs import EXPECTED_RATE
from bsk_torch.tasks.objects.outlook import LIT, PER_DEGREE, START, by_priority_per_second, by_priority_per_second_ahead
from bsk_torch.tasks.objects.scene import Order, RSOTargets

LEAST_PRIORITY = 1e-6
"""Priority by which angles are divided at least."""

NEAREST = 10
"""Number of nearest objects among which the rule ``distance`` looks for one in view."""

TURNED = 1e9
"""Rank of objects that come after all that are in view."""


@dataclass(frozen=True)
class Upkeep:
    """When imagers do something else than take images. Thresholds are fractions of the capacity or the maximum speed.

    Args:
        low: Battery charge below which the satellite charges.
        fast: Wheel speed above which the wheels are desaturated.
        worth: Data in the store from which on a pass is used for a downlink.
        full: Data from which on the satellite waits for one.
    """

    low: float = 0.2
    fast: float = 0.7
    worth: float = 0.1
    full: float = 0.99

    def wishes(self, see: Columns) -> dict[str, Tensor]:
        """Return masks [...] of needed actions, in ascending order of urgency."""
        level = see["storage_level_fraction"]
        return {
            "action_downlink": ((see["opportunity_open_normd"] <= 0.0) & (level >= self.worth)) | (level >= self.full),
            "action_desat": see.all("wheel_speeds_fraction").abs().amax(-1) > self.fast,
            "action_charge": see["battery_charge_fraction"] < self.low,
        }


def whole_catalog(scenario: RSOTargets, satellite: BoundSatellite) -> tuple[Views, Tensor]:
    """Return how satellites see all objects of a catalog, and which are at an elevation from -21 to 90 degrees, [N, G] each."""
    views = scenario.views(satellite, scenario.all_targets(satellite))
    return views, (views.target_elevation_angle >= LOWEST) & (views.target_elevation_angle <= HIGHEST)


def by_angle(scenario: RSOTargets, satellite: BoundSatellite) -> Tensor:
    """Rank objects by their angle from the instrument, those in view first."""
    views, in_view = whole_catalog(scenario, satellite)
    return torch.where(in_view, views.angle_to_target, TURNED + views.angle_to_target)


def by_angle_and_priority(scenario: RSOTargets, satellite: BoundSatellite) -> Tensor:
    """Rank objects by the ratio of angle and priority, those in view first."""
    views, in_view = whole_catalog(scenario, satellite)
    ratio = views.angle_to_target / satellite.of_env(scenario.priority).clamp(min=LEAST_PRIORITY)
    return torch.where(in_view, ratio, TURNED + views.angle_to_target)


def by_distance(scenario: RSOTargets, satellite: BoundSatellite) -> Tensor:
    """Rank objects by distance; of the ten nearest, those in view come first."""
    views, in_view = whole_catalog(scenario, satellite)
    distance = torch.where(scenario.eligible_for(satellite), views.target_distance, torch.inf)
    place = distance.argsort(dim=1, stable=True).argsort(dim=1, stable=True)
    return torch.where(in_view & (place < NEAREST), place, place + scenario.n_targets).double()


ORDERS: dict[str, Order] = {
    "angle": by_angle,
    "priority_angle": by_angle_and_priority,
    "distance": by_distance,
    "rate": by_priority_per_second,
    "rate_ahead": by_priority_per_second_ahead,
}
"""Rules over the whole catalog by name: the first eligible object of the order is imaged."""


Worth = Callable[[TargetReader, Observation], Tensor]
"""Returns the worth of observed candidates, [..., n]."""


def observed(prop: str) -> Worth:
    """Return the worth that is an observed property."""
    return lambda see, observation: see.read(observation, prop)


def rate_of(see: TargetReader, observation: Observation) -> Tensor:
    """Return the priorities that images of candidates bring per second, [..., n]; zero for those in the dark.

    As in :func:`~bsk_torch.tasks.objects.by_priority_per_second`.
    """
    lit = see.read(observation, "target_illumination_factor") >= LIT
    return lit * see.read(observation, "priority") / (START + PER_DEGREE * see.read(observation, "angle_to_target"))


def sighted_rate_of(see: TargetReader, observation: Observation) -> Tensor:
    """Return what :func:`rate_of` does, [..., n], but zero also for candidates that the Earth hides."""
    return see.read(observation, "in_sight") * rate_of(see, observation)


WORTHS: dict[str, Worth] = {
    "candidate_priority": observed("priority"),
    "candidate_rate": rate_of,
    "candidate_rate_ahead": observed(EXPECTED_RATE),
    "prompt": sighted_rate_of,
    "prompt_ahead": observed(EXPECTED_RATE),
}
"""Rules over the observed candidates by name: the candidate of the largest worth is imaged."""

TEAMWORK = Upkeep(low=0.3, worth=1e-9, full=0.8)
"""When imagers of the studies of teams do something else than take images; every bit is worth a downlink during a pass."""

IDLE = dict.fromkeys(("prompt", "prompt_ahead"), ("action_desat", TEAMWORK))
"""Action of rules without an object, and their upkeep, where these are not charging and the default."""


Choice = Callable[[Observation, Tensor], tuple[Tensor, Tensor]]
"""Returns the action that images the best object, and whether there is one, [...] each, for an observation and legal actions."""


@dataclass(frozen=True)
class ServicingRule:
    """Images the best object, and otherwise keeps battery, wheels and store in order; without an object, it waits."""

    satellite: BoundSatellite
    choose: Choice
    upkeep: Upkeep
    wait: str
    """Action without an object."""

    def decide(self, observation: Observation, action_mask: Tensor) -> Tensor:
        """Return actions [...] for observations [..., F] and legal actions [..., A].

        Raises:
            ValueError: For observations of another environment, where the rule looks at the whole catalog.
        """
        see = Columns(observation, self.satellite.observation_description)
        names: Sequence[str] = self.satellite.action_description
        wish, exists = self.choose(observation, action_mask)
        wish = torch.where(exists, wish, names.index(self.wait))
        for name, mask in self.upkeep.wishes(see).items():
            wish = torch.where(mask, names.index(name), wish)
        return wish


def first_of_catalog(satellite: BoundSatellite, order: Order) -> Choice:
    """Return the choice of the first eligible object in an order of the whole catalog.

    It raises ValueError for observations of another environment.
    """

    def choose(observation: Observation, action_mask: Tensor) -> tuple[Tensor, Tensor]:
        charge = Columns(observation, satellite.observation_description)["battery_charge_fraction"]
        battery = satellite.dynamics.battery_charge_fraction.to(charge.dtype)
        if charge.numel() != battery.numel() or not torch.equal(charge.flatten(), battery):
            raise ValueError(
                f"this rule looks at the whole catalog, and so decides in the environment that it was made for, "
                f"{satellite.name!r}, for its present state only"
            )
        scenario: RSOTargets = satellite.scenario
        eligible = scenario.eligible_for(satellite)
        rank = torch.where(eligible, order(scenario, satellite), torch.inf)
        action = torch.where(eligible.any(1), -1 - rank.argmin(1), 0)
        return action.view(charge.shape), eligible.any(1).view(charge.shape)

    return choose


def best_candidate(see: TargetReader, images: range, worth: Worth) -> Choice:
    """Return the choice of the legal candidate of the largest positive worth."""

    def choose(observation: Observation, action_mask: Tensor) -> tuple[Tensor, Tensor]:
        legal = action_mask[..., images.start : images.stop]
        best, k = torch.where(legal, worth(see, observation)[..., : len(images)], 0.0).max(-1)
        return images.start + k, best > 0.0

    return choose


def servicing_rule(name: str) -> Callable[[SatelliteTasking, int], TensorDictModule]:
    """Return a function from environment and seed to a rule, with KeyError or ValueError if it does not apply.

    The rules of :data:`ORDERS` look at the whole catalog, those of :data:`WORTHS` at the observed candidates.
    """

    def make(env: SatelliteTasking, seed: int = 0) -> TensorDictModule:
        satellite, images = env.satellite, imaged_candidates(env)
        if name in ORDERS and not isinstance(env, SatelliteTasking):
            raise ValueError(
                f"the rule {name!r} looks at the whole catalog, for one satellite; for teams, there is the rule 'local'"
            )
        see = TargetReader.of(env)
        choose = first_of_catalog(satellite, ORDERS[name]) if name in ORDERS else best_candidate(see, images, WORTHS[name])
        wait, upkeep = IDLE.get(name, ("action_charge", Upkeep()))
        rule = ServicingRule(satellite, choose, upkeep, wait)
        zero = env.observation_spec.zero()
        for action in rule.upkeep.wishes(Columns(zero["observation"], satellite.observation_description)):
            if action not in satellite.action_description:
                raise ValueError(f"the rule {name!r} needs {action!r}; the actions are {satellite.action_description}")
        if name in WORTHS:
            rule.decide(zero["observation"], zero["action_mask"])
        return TensorDictModule(rule.decide, in_keys=["observation", "action_mask"], out_keys=["action"])

    return make


def imaged_candidates(env: SatelliteTasking) -> range:
    """Return the numbers of the actions that image candidates of a catalog; ValueError if there are none."""
    images = image_actions(env)
    scenario = env.satellite.scenario
    if not isinstance(scenario, RSOTargets):
        raise ValueError(f"{env.satellite.name} images no objects of a catalog; its scenario is {type(scenario).__name__}")
    return images


angle = servicing_rule("angle")
priority_angle = servicing_rule("priority_angle")
distance = servicing_rule("distance")
rate = servicing_rule("rate")
rate_ahead = servicing_rule("rate_ahead")
candidate_priority = servicing_rule("candidate_priority")
candidate_rate = servicing_rule("candidate_rate")
candidate_rate_ahead = servicing_rule("candidate_rate_ahead")
prompt = servicing_rule("prompt")
prompt_ahead = servicing_rule("prompt_ahead")
