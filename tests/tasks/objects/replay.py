"""Recorded episodes of imaging of resident space objects (RSO), and how to replay them as one batch."""

import itertools
import json
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from bsk_torch import ConstellationTasking, act, obs, rand, sats
from bsk_torch.env.no_action import NO_ACTION
from bsk_torch.sim import dyn
from bsk_torch.tasks.objects import (
    ImageRSO,
    RSOImageReward,
    RSOTargetCatalog,
    RSOTargetProperties,
    RSOTargets,
    SpaceToSpaceImagingDynModel,
    SpaceToSpaceImagingFSWModel,
)
from bsk_torch.tasks.objects.obs import DEFAULT
from tests.basilisk.replay import RECORDINGS

STEPS = ["action", "reward", "terminated", "truncated", "duration", "credit"]
BOUNDARIES = ["obs", "retask", "candidates", "state", "storage", "hold", "access", "priority", "pending", "cooldown"]


class Episodes(NamedTuple):
    """Episodes with equal arguments of their actions: what each starts from, its arrays, and its images."""

    initial: list[dict[str, Any]]
    arrays: dict[str, list[np.ndarray]]
    images: list[list[Any]]
    names: list[str]

    def padded(self, key: str, k: int) -> Tensor:
        """Row k of an array of each episode, its last where there is none, [E, ...]."""
        return torch.tensor(np.array([rows[min(k, len(rows) - 1)] for rows in self.arrays[key]]), dtype=torch.float64)


def load(case: str) -> list[Episodes]:
    """Read the recording of a case."""
    file = np.load(RECORDINGS / f"rso_imaging_{case}.npz")
    ends = np.cumsum([0, *file["length"]])
    cuts = dict.fromkeys(STEPS, ends) | dict.fromkeys(BOUNDARIES, ends + np.arange(len(ends)))
    arrays = {key: [file[key][a:b] for a, b in itertools.pairwise(where)] for key, where in cuts.items()}
    initial, images, names = (json.loads(str(file[key])) for key in ("ic", "images", "obs_names"))
    groups: dict[str, list[int]] = {}
    for k, ic in enumerate(initial):
        groups.setdefault(json.dumps(ic["image"]), []).append(k)
    return [
        Episodes(
            [initial[k] for k in some],
            {key: [rows[k] for k in some] for key, rows in arrays.items()},
            [images[k] for k in some],
            names,
        )
        for some in groups.values()
    ]


class Imager(sats.AccessSatellite):
    dyn_type = (SpaceToSpaceImagingDynModel, dyn.GroundStationDynModel)
    fsw_type = SpaceToSpaceImagingFSWModel
    observation_spec = (
        obs.SatProperties(
            dict(prop="storage_level_fraction"), dict(prop="battery_charge_fraction"), dict(prop="wheel_speeds_fraction")
        ),
        obs.Eclipse(norm=5700.0, sampled=True),
        RSOTargetProperties(dict(prop="valid"), *DEFAULT, n_ahead_observe=3),  # as written out in the recorder
        RSOTargetProperties(n_ahead_observe=1, name="default_row"),
        obs.Time(),
    )


def environment(recorded: Episodes, **options: Any) -> ConstellationTasking:
    """An environment whose episodes start where the recorded ones did; no satellite flies for a target."""
    first = recorded.initial[0]

    class Camera(Imager):
        action_spec = (
            act.Charge(duration=60.0),
            act.Downlink(duration=90.0),
            act.Desat(duration=60.0),
            ImageRSO(3, **first["image"]),
        )

    def arguments(k: int) -> dict[str, Any]:
        given = [episode["sats"][k]["args"] for episode in recorded.initial]
        values = {name: torch.tensor([each[name] for each in given], dtype=torch.float64) for name in given[0]}
        return {"oe": None} | {name: rand.per_env(value) for name, value in values.items()}

    catalogs = [RSOTargetCatalog.from_dict(episode["catalog"]) for episode in recorded.initial]
    rewards = dict(first["reward"])
    taken, delivered = rewards.pop("acquisition"), rewards.pop("delivery")
    defaults = dict(
        scenario=RSOTargets(rand.per_env(catalogs), first["imagers"], block_pending_targets=first["block_pending_targets"]),
        rewarder=RSOImageReward(
            acquisition_reward_fn=lambda record, target: taken * target.priority,
            delivery_reward_fn=lambda record, target: delivered * target.priority,
            **rewards,
        ),
        world_args=dict(utc_init=rand.per_env([episode["utc_init"] for episode in recorded.initial]), **first["world"]),
        time_limit=first["time_limit"],
        sim_rate=first["sim_rate"],
        num_envs=len(recorded.initial),
        dtype=torch.float64,
        seed=0,
    )
    satellites = [Camera(name, arguments(k)) for k, name in enumerate(first["imagers"])]
    return ConstellationTasking(satellites, **(defaults | options))


def replay(env: ConstellationTasking, recorded: Episodes) -> Iterator[tuple[int, Tensor, Any]]:
    """Reset, then play the recorded actions; yield the number of each boundary, who took the step, and what it gave."""
    env.reset()
    lengths = torch.tensor([len(rows) for rows in recorded.arrays["action"]])
    yield 0, torch.ones_like(lengths, dtype=torch.bool), None
    for k in range(int(lengths.max())):
        action = recorded.padded("action", k).long()
        outputs = env.play([torch.where(action < 0, NO_ACTION, action)], k < lengths)
        yield k + 1, k < lengths, outputs
