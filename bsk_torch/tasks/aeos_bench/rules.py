"""Rules of AEOS-Bench: the nearest task, kept while it is within reach, and the task that is completed first."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, cast

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from bsk_torch.env import ConstellationTasking, SatelliteTasking
from bsk_torch.env.base import Tasking
from bsk_torch.rl.rules.baselines import TeamPolicy
from bsk_torch.rl.rules.targets import Observation, TargetReader, image_actions
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sim.readout.observables import Now
from bsk_torch.tasks.aeos_bench.act import PointAtTask
from bsk_torch.tasks.aeos_bench.files import EARTH_RADIUS
from bsk_torch.tasks.aeos_bench.obs import MATCHED
from bsk_torch.tasks.aeos_bench.scene import ASSIGNED, PLACES, AEOSBench
from bsk_torch.vec3 import Mat3

SOONEST = "soonest_task"
"""Name of the rule for candidates."""

REACH = math.cos(math.pi / 3.0)
"""Cosine of the largest angle from the nadir within reach."""


def earth_axes(now: Now) -> Mat3:
    """Return the DCM from N to P."""
    return now.PN


class TaskTeam(NamedTuple):
    """An environment of AEOS-Bench, its satellites, their only action, and its scenario."""

    env: ConstellationTasking
    satellite: BoundSatellite
    entry: PointAtTask
    scenario: AEOSBench


def task_team(env: Tasking) -> TaskTeam:
    """Return the team; ValueError unless the only action of its satellites, of one type, is ``PointAtTask``."""
    fits = isinstance(env, ConstellationTasking) and len(env.satellites) == 1 and isinstance(env.scenario, AEOSBench)
    entries: Any = env.satellites[0].actions.entries if fits else ()
    if not fits or len(entries) != 1 or not isinstance(entries[0], PointAtTask):
        raise ValueError("the rule needs AEOSBench and satellites of one type whose only action is PointAtTask")
    return TaskTeam(cast("ConstellationTasking", env), env.satellites[0], entries[0], cast("AEOSBench", env.scenario))


class NearestTask:
    """Chooses for each satellite the nearest offered task, or the one that it has, while it is within reach.

    A satellite whose nearest task is out of reach gets none, even if the one that it has is within reach; several satellites may
    choose the same task. Reach has no test of the horizon: near tasks beyond it count, as in the benchmark. Positions of
    satellites are rounded to float32, as there.
    """

    def __init__(self, env: Tasking) -> None:
        """ValueError as :func:`task_team`, and for satellites that choose among candidates."""
        self.env, self.satellite, self.entry, self.scenario = task_team(env)
        if self.entry.n_candidates is not None:
            raise ValueError("nearest_task chooses among all tasks; make the environment without candidates")
        self.satellite.simulator.observer.want([earth_axes])

    def module(self) -> TeamPolicy:
        """Return the rule as a policy of the environment."""
        group = next(iter(self.env.group_map))
        return TeamPolicy(self, [(group, "action_mask")], [(group, "action")])

    def __call__(self, action_mask: Tensor) -> Tensor:
        """Return actions [N, S] for legal actions [N, S, n + 1]."""
        action = self.tasks() + 1
        if self.entry.sensor == "chosen":
            action = action + self.scenario.n_tasks + 1
        # the first action is legal unless the satellite has to stay, which is the last
        return torch.where(action_mask[..., 0], action, action_mask.shape[-1] - 1)

    def tasks(self) -> Tensor:
        """Return the task of each satellite, [N, S]; -1 for none."""
        scenario, fleet = self.scenario, self.scenario.fleet
        r_N = self.satellite.dynamics.r_BN_N.float()
        PN = self.satellite.dynamics.observed(earth_axes)
        radius = r_N.norm(dim=-1).double().view(fleet.shape)
        r_P = (PN @ r_N.double().unsqueeze(-1)).view(*fleet.shape, 3)
        # the distance from the satellite falls with r . p; with zero instead of p, what is not offered is out of reach
        height = r_P @ (scenario.drawn(PLACES) * self.entry.offered.unsqueeze(2)).mT
        highest, nearest = height.max(2)
        old = self.satellite.simulator.memory[ASSIGNED].view(fleet.shape)
        kept = height.gather(2, old.clamp(min=0).unsqueeze(2)).squeeze(2)
        task = torch.where((old >= 0) & within_reach(kept, radius), old, nearest)
        return torch.where(within_reach(highest, radius), task, -1)


def nearest_task(env: Tasking) -> TeamPolicy:
    """Return the greedy rule of the benchmark; ValueError if it does not apply."""
    return NearestTask(env).module()


def within_reach(height: Tensor, radius: Tensor) -> Tensor:
    """Return which places p are within reach of satellites at r, [...], given ``r . p`` and ``|r|`` in m^2 and m.

    With the distance d, the angle from the nadir has the cosine ``(d^2 + r^2 - R^2) / (2 d r)``, which must exceed 1/2, and d
    must be below the Earth's radius R.
    """
    distance2 = radius.square() + EARTH_RADIUS * EARTH_RADIUS - 2.0 * height
    distance = distance2.clamp(min=1.0).sqrt()
    cosine = (distance2 + radius.square() - EARTH_RADIUS * EARTH_RADIUS) / (2.0 * distance * radius)
    return (distance < EARTH_RADIUS) & (cosine > REACH)


def soonest_rule(env: SatelliteTasking, seed: int = 0) -> TensorDictModule:
    """Return the rule: each satellite takes its match, or without one its first candidate, with another satellite.

    For the matching, see :func:`bsk_torch.tasks.aeos_bench.outlook.match`. ValueError or KeyError if the rule does not apply.
    """
    images, see = image_actions(env), TargetReader.of(env)
    if not isinstance(env.satellite.scenario, AEOSBench):
        raise ValueError(f"the rule {SOONEST!r} needs AEOSBench")

    def decide(observation: Observation, action_mask: Tensor) -> Tensor:
        """Return actions [...] for observations [..., F] and legal actions [..., A]."""
        legal = action_mask[..., images.start : images.stop]
        matched = legal & (see.read(observation, MATCHED)[..., : len(images)] > 0.5)
        choice = torch.where(matched.any(-1), matched.long().argmax(-1), 0)
        return torch.where(legal.any(-1), images.start + choice, images.start - 1)

    zero = env.observation_spec.zero()
    decide(zero["observation"], zero["action_mask"])
    return TensorDictModule(decide, in_keys=["observation", "action_mask"], out_keys=["action"])
