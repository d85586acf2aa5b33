"""Rules for imagers of objects in orbit, which rank the objects of the catalog, or those that are observed.

A branch of bsk_rl's authors flies policies next to such rules. They use the observations and actions of
:mod:`bsk_torch.presets.services`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from bsk_torch.act import ImageRSO
from bsk_torch.env import SatelliteTasking
from bsk_torch.env.action_forms import form
from bsk_torch.rl.rules.observation_columns import Columns
from bsk_torch.scene import RSOTargets
from bsk_torch.sim.catalog.candidates import HIGHEST, LOWEST, Candidates

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
        full: Data above which the satellite waits for one.
    """

    low: float = 0.2
    fast: float = 0.7
    worth: float = 0.1
    full: float = 0.99

    def wishes(self, see: Columns) -> dict[str, Tensor]:
        """Return masks [N] of needed actions, in ascending order of urgency."""
        level = see["storage_level_fraction"]
        return {
            "action_downlink": ((see["opportunity_open_normd"] <= 0.0) & (level >= self.worth)) | (level > self.full),
            "action_desat": see.all("wheel_speeds_fraction").abs().amax(-1) > self.fast,
            "action_charge": see["battery_charge_fraction"] < self.low,
        }


@dataclass(frozen=True)
class Catalog:
    """The G objects as N imagers see them, [N, G]: what the rules rank.

    Attributes:
        eligible: Objects that can be chosen.
        in_view: Objects at an elevation from -21 to 90 degrees.
        angle: Angle between instrument and object, degrees.
        distance: Distance, m.
        priority: Priority.
    """

    eligible: Tensor
    in_view: Tensor
    angle: Tensor
    distance: Tensor
    priority: Tensor


def by_angle(seen: Catalog) -> Tensor:
    """Rank objects by their angle from the instrument, those in view first."""
    return torch.where(seen.in_view, seen.angle, TURNED + seen.angle)


def by_angle_and_priority(seen: Catalog) -> Tensor:
    """Rank objects by the ratio of angle and priority, those in view first."""
    ratio = seen.angle / seen.priority.clamp(min=LEAST_PRIORITY)
    return torch.where(seen.in_view, ratio, TURNED + seen.angle)


def by_distance(seen: Catalog) -> Tensor:
    """Rank objects by distance; of the ten nearest, those in view come first."""
    distance = torch.where(seen.eligible, seen.distance, torch.inf)
    order = distance.argsort(dim=1, stable=True).argsort(dim=1, stable=True)
    return torch.where(seen.in_view & (order < NEAREST), order, order + seen.angle.shape[1]).to(seen.distance.dtype)


RANKS: dict[str, Callable[[Catalog], Tensor]] = {
    "angle": by_angle,
    "priority_angle": by_angle_and_priority,
    "distance": by_distance,
}
"""Rules over the whole catalog by name: functions for ranks [N, G]; the eligible object of the smallest rank is imaged."""


@dataclass(frozen=True)
class ServicingRule:
    """Images the best object, and otherwise keeps battery, wheels and store in order; without an object, the satellite charges.

    Attributes:
        satellite: The imagers of an environment, which the rule commands.
        images: Numbers of the actions that image candidates.
        rank: One of :data:`RANKS`; None to image the candidate of the highest priority.
        upkeep: When the satellite does something else.
    """

    satellite: Any
    images: range
    rank: Callable[[Catalog], Tensor] | None
    upkeep: Upkeep = Upkeep()

    def decide(self, observation: Tensor, action_mask: Tensor) -> Tensor:
        """Return actions [...] for observations [..., F] and legal actions [..., A].

        Raises:
            ValueError: For observations of another environment, where the rule looks at the whole catalog.
        """
        see = Columns(observation, self.satellite.observation_description)
        names: Sequence[str] = self.satellite.action_description
        wish, exists = self._image(see, action_mask)
        wish = torch.where(exists, wish, names.index("action_charge"))
        for name, wanted in self.upkeep.wishes(see).items():
            wish = torch.where(wanted, names.index(name), wish)
        return wish

    def _image(self, see: Columns, action_mask: Tensor) -> tuple[Tensor, Tensor]:
        """Return the action that images the best object, and whether there is one, [...] each."""
        legal = action_mask[..., self.images.start : self.images.stop]
        if self.rank is None:
            worth = torch.where(legal, see.all("priority"), -torch.inf)
            return self.images.start + worth.argmax(-1), legal.any(-1)
        charge = see["battery_charge_fraction"]
        own = self.satellite.dynamics.battery_charge_fraction.to(charge.dtype)
        if charge.numel() != own.numel() or not torch.equal(charge.flatten(), own):
            raise ValueError(
                f"this rule looks at the whole catalog, and so decides in the environment that it was made for, "
                f"{self.satellite.name!r}, for its present state only"
            )
        seen = whole_catalog(self.satellite)
        rank = torch.where(seen.eligible, self.rank(seen), torch.inf)
        action = torch.where(seen.eligible.any(1), -1 - rank.argmin(1), 0)
        return action.view(charge.shape), seen.eligible.any(1).view(charge.shape)


def whole_catalog(satellite: Any) -> Catalog:
    """Return all objects as the imagers of a type see them now."""
    scenario: RSOTargets = satellite.scenario
    eligible = satellite.of_env(scenario.eligible)
    place = torch.arange(scenario.n_targets, device=eligible.device).expand_as(eligible)
    views = scenario.views(satellite, Candidates(place, torch.ones_like(eligible)))
    elevation = views.target_elevation_angle
    return Catalog(
        eligible,
        (elevation >= LOWEST) & (elevation <= HIGHEST),
        views.angle_to_target,
        views.target_distance,
        satellite.of_env(scenario.priority),
    )


def servicing_rule(name: str) -> Callable[[SatelliteTasking, int], TensorDictModule]:
    """Return a function from environment and seed to a rule, with KeyError or ValueError if it does not apply.

    The rules of :data:`RANKS` look at the whole catalog, ``candidate_priority`` at the observed candidates.
    """

    def make(env: SatelliteTasking, seed: int = 0) -> TensorDictModule:
        satellite = env.satellite
        rule = ServicingRule(satellite, rso_actions(satellite), RANKS.get(name))
        if satellite.obs_type is dict:
            raise ValueError(f"the rule {name!r} reads observations from vectors; leave out obs_type=dict")
        zero = env.observation_spec.zero()
        see = Columns(zero["observation"], satellite.observation_description)
        for action in rule.upkeep.wishes(see):
            if action not in satellite.action_description:
                raise ValueError(f"the rule {name!r} needs {action!r}; the actions are {satellite.action_description}")
        if rule.rank is None:
            rule.decide(zero["observation"], zero["action_mask"])
        return TensorDictModule(rule.decide, in_keys=["observation", "action_mask"], out_keys=["action"])

    return make


def rso_actions(satellite: Any) -> range:
    """Return the numbers of the actions that image candidates of a catalog; ValueError if there are none."""
    first = 0
    for entry in satellite.actions.entries if form(satellite) is None else ():
        if isinstance(entry, ImageRSO):
            return range(first, first + entry.n_actions)
        first += entry.n_actions
    raise ValueError(f"{satellite.name} images no objects of a catalog; its actions are {satellite.action_description}")
