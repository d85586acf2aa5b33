"""Recorded episodes of inspection, and how to replay them as one batch."""

import functools
import itertools
import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from bsk_torch import ConstellationTasking, act, data, obs, rand, sats
from bsk_torch.astro.relative import fibonacci_sphere
from bsk_torch.env.no_action import NO_ACTION
from bsk_torch.sim import dyn, fsw
from bsk_torch.tasks.inspection import RSODynModel, RSOInspectionReward, RSOInspectorDynModel, RSOInspectorFSWModel, SphericalRSO
from bsk_torch.tasks.inspection.obs import rso_imaged_regions
from tests.basilisk.replay import RECORDINGS

STEPS = ["action", "rso_action", "reward", "inspection", "fuel", "duration", "terminated", "truncated"]
BOUNDARIES = ["retask", "alive", "agents", "obs", "state", "wheels", "sun", "inspected", "illuminated"]


@dataclass
class Episodes:
    """A recording: what each episode starts from, and its arrays, those of steps and those of boundaries."""

    initial: list[dict[str, Any]]
    arrays: dict[str, list[np.ndarray]]
    bonus_time: np.ndarray
    death: np.ndarray
    names: list[str]

    def __len__(self) -> int:
        return len(self.initial)

    @property
    def lengths(self) -> list[int]:
        return [len(rows) for rows in self.arrays["action"]]


def load(case: str) -> Episodes:
    """Read the recording of a case."""
    file = np.load(RECORDINGS / f"inspection_{case}.npz")
    ends = np.cumsum([0, *file["length"]])
    cuts = dict.fromkeys(STEPS, ends) | dict.fromkeys(BOUNDARIES, ends + np.arange(len(ends)))
    arrays = {key: [file[key][a:b] for a, b in itertools.pairwise(where)] for key, where in cuts.items()}
    return Episodes(json.loads(str(file["ic"])), arrays, file["bonus_time"], file["death"], json.loads(str(file["obs_names"])))


class RSO(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.NadirPoint(duration=1e9),)
    dyn_type = (dyn.ConjunctionDynModel, RSODynModel)
    fsw_type = fsw.FSWModel


class TumblingRSO(RSO):
    action_spec = (act.Drift(duration=1e9),)
    fsw_type = fsw.TumblingFSWModel


class Inspector(sats.Satellite):
    observation_spec = (
        obs.ResourceRewardWeight(),
        obs.RelativeProperties(
            dict(fn=rso_imaged_regions, name="six_hill"),
            dict(name="six_body", fn=functools.partial(rso_imaged_regions, frame="chief_body")),
            dict(name="fifteen_hill", fn=functools.partial(rso_imaged_regions, region_centers=fibonacci_sphere(15))),
            chief_name="RSO",
        ),
    )
    action_spec = (
        act.ImpulsiveThrustHill(chief_name="RSO", max_dv=1.0, max_drift_duration=11400.0, fsw_action="action_inspect_rso"),
    )
    dyn_type = (dyn.MaxRangeDynModel, dyn.ConjunctionDynModel, RSOInspectorDynModel)
    fsw_type = (fsw.MagicOrbitalManeuverFSWModel, RSOInspectorFSWModel)


class SteeringInspector(Inspector):
    fsw_type = (fsw.SteeringFSWModel, fsw.MagicOrbitalManeuverFSWModel, RSOInspectorFSWModel)


def arguments(initial: list[dict[str, Any]], k: int) -> dict[str, Any]:
    """Arguments of satellite k, environment by environment."""
    given = [episode["sats"][k] for episode in initial]
    values: dict[str, Any] = {"oe": None}
    for name in set(given[0]):
        each = [satellite[name] for satellite in given]
        if isinstance(each[0], bool | str | None):
            values[name] = each[0]
        else:
            values[name] = rand.per_env(torch.tensor(each, dtype=torch.float64))
    return values


def resource(satellite) -> Tensor:
    """Fuel, zero for satellites without a tank."""
    return (
        satellite.fsw.dv_available if hasattr(satellite.fsw, "dv_available") else torch.zeros_like(satellite.simulator.sim_time)
    )


def environment(recorded: Episodes, **options: Any) -> ConstellationTasking:
    """An environment whose episodes start where the recorded ones did."""
    first = recorded.initial[0]
    kind = SteeringInspector if "servo_P" in first["sats"][1] else Inspector
    chief = TumblingRSO if any(first["sats"][0]["omega_init"]) else RSO
    kinds = [chief, *[kind] * (len(first["sats"]) - 1)]
    names = ["RSO", *(f"Inspector{k}" for k in range(1, len(kinds)))]
    defaults = dict(
        scenario=SphericalRSO(**first["scenario"]),
        rewarder=(
            RSOInspectionReward(**first["reward"]),
            data.ResourceReward(reward_weight=first["fuel_weight"], resource_fn=resource),
        ),
        world_args=dict(utc_init=rand.per_env([episode["utc_init"] for episode in recorded.initial])),
        time_limit=first["time_limit"],
        sim_rate=first["sim_rate"],
        num_envs=len(recorded),
        orbit="integrated",
        dtype=torch.float64,
        seed=0,
        compat="bsk_rl",
    )
    satellites = [kind(name, arguments(recorded.initial, k)) for k, (kind, name) in enumerate(zip(kinds, names, strict=True))]
    return ConstellationTasking(satellites, **(defaults | options))


class Step(NamedTuple):
    """A step of a replay: its number, the episodes that took it, and what it gave."""

    number: int
    moves: Tensor
    outputs: Any


def padded(recorded: Episodes, key: str, k: int) -> Tensor:
    """Row k of an array of each episode, its last where there is none, [E, ...]."""
    rows = [array[min(k, len(array) - 1)] for array in recorded.arrays[key]]
    return torch.tensor(np.array(rows), dtype=torch.float64)


def replay(env: ConstellationTasking, recorded: Episodes) -> Iterator[Step]:
    """Play the recorded actions, step after step."""
    env.reset()
    lengths = torch.tensor(recorded.lengths)
    for k in range(max(recorded.lengths)):
        moves = k < lengths
        rso = torch.where(padded(recorded, "rso_action", k).unsqueeze(1) == 0, 0, 1).long()
        inspectors = padded(recorded, "action", k).nan_to_num(NO_ACTION)
        yield Step(k, moves, env.play([rso, inspectors], moves))
