"""Imaging with services: replays of episodes on Basilisk with classes that do what a branch of bsk_rl's authors does."""

from __future__ import annotations

import itertools
import json
from collections import defaultdict
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch

from bsk_torch import SatelliteTasking, data
from bsk_torch.tasks.objects import ImageRSO, RSOImageReward, RSOTargetCatalog, RSOTargetProperties, RSOTargets
from bsk_torch.tasks.objects.preset import ServicingImager, own_properties
from tests.basilisk.replay import RECORDINGS

SLOTS = 3

BOUNDS = {
    "r": 1e-3,  # m, of orbits solved in advance
    "v": 1e-6,
    "sigma": 1e-7,
    "wheels": 1e-5,
    "battery": 1e-3,
    "obs": 1e-8,  # light of a target in penumbra
    "candidates": 0.0,
    "storage": 0.0,
    "priority": 0.0,
    "pending": 0.0,
    "cooldown": 1e-2,  # s: twice the period that follows from the first position and velocity
    "duration": 1e-11,  # a time minus a time, in Basilisk's seconds
    "reward": 1e-12,
    "parts": 1e-12,
}
"""Largest differences: those of the package's other replays; what is decided is equal."""


class Episode(NamedTuple):
    """A recorded episode: what it starts from, and its arrays."""

    initial: dict[str, Any]
    arrays: dict[str, np.ndarray]


def load() -> list[Episode]:
    """Read the recording."""
    file = np.load(RECORDINGS / "services.npz")
    ends = np.cumsum([0, *file["length"]])
    at_steps = ("action", "reward", "parts", "over", "duration")
    episodes = []
    for k, (initial, (a, b)) in enumerate(zip(json.loads(str(file["ic"])), itertools.pairwise(ends), strict=True)):
        arrays = {key: file[key][a:b] if key in at_steps else file[key][a + k : b + k + 1] for key in file if file[key].ndim}
        episodes.append(Episode(initial, arrays))
    return episodes


def environment(initial: dict[str, Any]) -> SatelliteTasking:
    """An environment whose episode starts where the recorded one did."""

    class Camera(ServicingImager):
        observation_spec = (*own_properties(), RSOTargetProperties(n_ahead_observe=SLOTS))
        action_spec = (
            *ServicingImager.action_spec[:3],
            ImageRSO(SLOTS, exposure="first", require_illumination_during_hold=False, **initial["image"]),
        )

    penalties = initial["reward"]
    return SatelliteTasking(
        Camera("SS1", initial["args"] | {"oe": None}),
        scenario=RSOTargets(RSOTargetCatalog.from_dict(initial["catalog"]), ["SS1"]),
        rewarder=(
            RSOImageReward(cooldown_orbits=2.0, delivery_share=penalties["delivery_share"]),
            data.OperationsPenalty(penalties["battery"], penalties["storage"], penalties["empty"]),
        ),
        world_args=dict(utc_init=initial["utc_init"], **initial["world"]),
        time_limit=initial["time_limit"],
        compat="bsk_rl",  # which loses passes over ground stations that go on from one segment of windows to the next
        dtype=torch.float64,
        num_envs=1,
        seed=0,
    )


@pytest.mark.compiled
@pytest.mark.parametrize("number", range(3))
def test_episodes_are_the_recorded_ones(number):
    """Attitudes, candidates, observations, exposures, holds, images, verified images, penalties and ends of steps."""
    recorded = load()[number]
    env, worst = environment(recorded.initial), defaultdict[str, float](float)
    env.reset()
    satellite, scenario, arrays = env.satellite, env.scenario, recorded.arrays
    assert len(arrays["action"]) > 20

    def compare(name: str, found: torch.Tensor, wanted: np.ndarray) -> None:
        difference = found.double().flatten() - torch.as_tensor(wanted, dtype=torch.float64).flatten()
        worst[name] = max(worst[name], float(difference.abs().max()))

    for k in range(len(arrays["action"]) + 1):
        state = arrays["state"][k]
        fields = ("r", "r_BN_N", 1), ("v", "v_BN_N", 4), ("sigma", "sigma_BN", 7), ("wheels", "Omega_WB_B", 13)
        for name, field, first in fields:
            compare(name, env.simulator.read(field), state[first : first + 3])
        compare("battery", env.simulator.read("charge"), state[16:17])
        candidates = scenario.candidates(satellite, SLOTS)
        compare("candidates", torch.where(candidates.exists, candidates.place, -1), arrays["candidates"][k])
        compare("obs", satellite.observations.get_vector(torch.float64), arrays["obs"][k])
        compare("storage", env.simulator.read("partitions"), arrays["storage"][k])
        compare("priority", scenario.priority, arrays["priority"][k])
        compare("pending", scenario.pending, arrays["pending"][k])
        until, wanted = scenario.cooldown_until, arrays["cooldown"][k]
        compare("cooldown", until, np.where(np.isfinite(wanted), wanted, 0.0))
        if k < len(arrays["action"]):
            outputs = env.play(torch.tensor([int(arrays["action"][k])]), torch.ones(1, dtype=torch.bool))
            compare("duration", outputs["duration"], arrays["duration"][k])
            compare("reward", outputs["reward"], arrays["reward"][k])
            images = env.rewarder.rewarders[0].last_reward_components
            parts = *images.values(), env.rewarder.terms["OperationsPenalty"]
            compare("parts", torch.cat(parts), arrays["parts"][k])
    assert worst.keys() == BOUNDS.keys()
    assert not {name: value for name, value in worst.items() if value > BOUNDS[name]}


def test_the_recording_has_what_distinguishes_services():
    """Images that fail at the deadline, verified images, exposures lost in a full store, downlinks of nothing, both penalties."""
    episodes = load()
    assert [episode.initial["image"]["hold_mode"] for episode in episodes] == ["cumulative", "continuous", "cumulative"]
    taken, delivered, penalty = np.concatenate([episode.arrays["parts"] for episode in episodes]).T
    assert (taken > 0.0).sum() > 10
    assert (delivered > 0.0).sum() > 5
    assert {-1.0, -0.5} <= set(penalty)
    rises = [np.diff(episode.arrays["storage"].sum(1)) for episode in episodes]
    hard = episodes[1].arrays
    late = (np.round(hard["duration"]) == 110.0) & (hard["action"] >= 3)
    assert (rises[1][late] > 0.0).any()
    full = episodes[2].arrays["storage"].sum(1)[:-1] >= 4 * 4e6
    assert full.any()
