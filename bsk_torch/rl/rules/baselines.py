"""Baselines: the random policy and hand-written rules."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor

from bsk_torch._rooms import Entries
from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.rules.continuous import Bounds, bounds_of, spread
from bsk_torch.rl.rules.cooperative import CooperativeRule
from bsk_torch.rl.rules.imaging import IMAGING_RULES, ImagingRule, ranking_rule
from bsk_torch.rl.rules.observation_columns import Columns

LOT = "lot"
"""Key of uniform numbers [N], written by evaluations so that random actions do not depend on the batch."""


class TeamPolicy(TensorDictModule):
    """A policy that decides for all satellites of an environment, by looking at all of them."""


class RandomPolicy(TensorDictModuleBase):
    """Chooses legal actions with equal probability, using the random numbers in the tensordict if present."""

    in_keys: ClassVar[list[str]] = ["action_mask", LOT]
    out_keys: ClassVar[list[str]] = ["action"]

    def __init__(self, generator: torch.Generator) -> None:
        """Draw from ``generator``."""
        super().__init__()
        self.generator = generator

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action``, chosen from ``action_mask`` [..., A]."""
        mask, lot = tensordict["action_mask"], tensordict.get(LOT, None)
        if lot is None:
            lot = torch.rand(mask.shape[:-1], dtype=torch.float64, device=mask.device, generator=self.generator)
        rank = mask.cumsum(-1)
        choice = mask & (rank == (lot.unsqueeze(-1) * rank[..., -1:]).long() + 1)
        return tensordict.set("action", choice.long().argmax(-1))


class RandomNumbers(TensorDictModuleBase):
    """Draws continuous actions uniformly within their bounds, with the random numbers of :class:`RandomPolicy`."""

    in_keys: ClassVar[list[str]] = [LOT]
    out_keys: ClassVar[list[str]] = ["action"]

    def __init__(self, bounds: Bounds, generator: torch.Generator) -> None:
        """Draw within ``bounds`` from ``generator``."""
        super().__init__()
        self.bounds, self.generator = bounds, generator

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action``, [..., A] float32."""
        lot = tensordict.get(LOT, None)
        if lot is None:
            shape, device = tensordict.batch_size, self.generator.device
            lot = torch.rand(shape, dtype=torch.float64, device=device, generator=self.generator)
        return tensordict.set("action", spread(lot, self.bounds).float())


def random_policy(env: SatelliteTasking, seed: int) -> RandomPolicy | RandomNumbers:
    """Return the random policy for an environment; ValueError for continuous actions with infinite bounds."""
    generator = torch.Generator(env.device).manual_seed(seed)
    bounds = bounds_of(env)
    return RandomNumbers(bounds, generator) if bounds else RandomPolicy(generator)


@dataclass(frozen=True)
class ScanRule:
    """Scans unless another action is more urgent. Thresholds are fractions of the capacity or the maximum speed.

    The defaults are among the best of eighty random choices, each evaluated in twenty episodes of NadirScan-v1.

    Args:
        fast: Wheel speed above which the wheels are desaturated.
        low: Battery charge below which the satellite charges.
        enough: Charge up to which charging continues once the panel faces the Sun.
        facing: Angle between panel normal and Sun below which the panel faces the Sun, as a fraction of half a turn.
        worth: Buffer level above which a pass is used for downlink.
        full: Buffer level above which scanning is useless.
    """

    fast: float = 0.75
    low: float = 0.14
    enough: float = 0.25
    facing: float = 0.1
    worth: float = 0.5
    full: float = 0.97

    def decide(self, observation: Tensor, description: Sequence[str], actions: Sequence[str]) -> Tensor:
        """Return actions [N] for ``observation`` [N, F], whose entries are named by ``description``."""
        see = Columns(observation, description)
        wish = torch.full_like(see["storage_level_fraction"], actions.index("action_nadir_scan"), dtype=torch.int64)
        for name, rows in self.wishes(see).items():
            wish = torch.where(rows, actions.index(name), wish)
        return wish

    def wishes(self, see: Columns) -> dict[str, Tensor]:
        """Return masks [N] of needed actions other than scanning, in ascending order of urgency."""
        charge, level = see["battery_charge_fraction"], see["storage_level_fraction"]
        passing = (see["opportunity_open_normd"] <= 0.0) & (level > self.worth)
        needy = (charge < self.low) | (self.can_go_on_charging(see) & (charge < self.enough))
        return {
            "action_downlink": passing,
            "action_charge": (needy & ~passing) | (charge < 0.5 * self.low) | ((level > self.full) & ~passing),
            "action_desat": see.all("wheel_speeds_fraction").abs().amax(-1) > self.fast,
        }

    def can_go_on_charging(self, see: Columns) -> Tensor:
        """Return where the panel faces the Sun, [N]."""
        return see["solar_pointing_error_normd"] < self.facing


CAUTIOUS = ScanRule(fast=0.16, low=0.08, enough=0.15, facing=0.12, worth=0.38, full=0.895)
"""Thresholds for satellites whose parts fail: about the best of 121 random choices in 256 episodes of FaultyScan-v1."""


@dataclass(frozen=True)
class ScienceRule(ScanRule):
    """The same for observations without pointing errors: the satellite charges up to ``enough`` only in sunlight.

    The defaults are about the best of 85 random choices, each evaluated in 64 episodes of NadirScience-v1.
    """

    fast: float = 0.31
    low: float = 0.065
    enough: float = 0.115
    full: float = 0.87

    def can_go_on_charging(self, see: Columns) -> Tensor:
        """Return where the satellite is in sunlight, [N]."""
        eclipse = see.all("eclipse")
        return eclipse[..., 0] < eclipse[..., 1]


def scan_rule(env: SatelliteTasking, seed: int = 0, thresholds: ScanRule = ScanRule()) -> TensorDictModule:
    """Return a :class:`ScanRule` for observations and actions like those of NadirScan-v1; else KeyError or ValueError."""
    description, actions = env.satellite.observation_description, env.satellite.action_description
    thresholds.decide(torch.zeros(1, len(description), dtype=torch.float64), description, actions)
    return TensorDictModule(
        lambda observation: thresholds.decide(observation, description, actions), in_keys=["observation"], out_keys=["action"]
    )


def science_rule(env: SatelliteTasking, seed: int = 0) -> TensorDictModule:
    """Return a :class:`ScienceRule` for observations and actions like those of NadirScience-v1; else KeyError or ValueError."""
    if any("pointing_error" in entry for entry in env.satellite.observation_description):
        raise ValueError("the satellite observes pointing errors, for which there is the rule 'rule'")
    return scan_rule(env, seed, ScienceRule())


THRESHOLDS: dict[str, ScanRule] = {"rule": ScanRule(), "cautious": CAUTIOUS, "science": ScienceRule()}
"""Rules with thresholds by name; :func:`bsk_torch.tune` searches for better ones."""

RANKINGS: dict[str, Callable[[SatelliteTasking], ImagingRule]] = {
    **{name: partial(ImagingRule.of, worth=worth) for name, worth in IMAGING_RULES.items()},
    "cooperative": CooperativeRule.in_cluster,
}
"""Rules by name that rank all actions: functions of the environment."""

SERVICING = (
    "angle",
    "priority_angle",
    "distance",
    "rate",
    "rate_ahead",
    "candidate_priority",
    "candidate_rate",
    "candidate_rate_ahead",
    "prompt",
    "prompt_ahead",
)
"""Names of the rules of :mod:`bsk_torch.tasks.objects.rules`."""

BASELINES: Entries[Callable[[SatelliteTasking, int], TensorDictModuleBase]] = Entries(
    {
        "random": random_policy,
        "rule": scan_rule,
        "cautious": partial(scan_rule, thresholds=CAUTIOUS),
        "science": science_rule,
        **{name: ranking_rule(ranking) for name, ranking in RANKINGS.items()},
        **{name: f"bsk_torch.tasks.inspection.rules:{name}" for name in ("drift", "circumnavigate", "survey", "hurried_survey")},
        **{name: f"bsk_torch.tasks.safe_autonomy.rules:{name}_rule" for name in ("glide", "seek")},
        **{name: f"bsk_torch.tasks.objects.rules:{name}" for name in SERVICING},
        "areas": "bsk_torch.tasks.areas.rules:area_rule",
        "commit": "bsk_torch.tasks.sites.rules:commit",
        "soonest_task": "bsk_torch.tasks.aeos_bench.rules:soonest_rule",
    }
)
"""Baselines by name: functions of the environment and a seed, which raise KeyError or ValueError if they do not apply."""
