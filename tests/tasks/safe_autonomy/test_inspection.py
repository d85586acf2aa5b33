"""CWInspection-v1 against episodes of AFRL's ``inspection_v0``, recorded by scripts/recorders/record_afrl_inspection.py."""

import math

import numpy as np
import pytest
import torch

import bsk_torch
from bsk_torch import rand
from bsk_torch.tasks.safe_autonomy.lit_points import Clusters, clustered, kmeans, sphere_points
from tests.tasks.safe_autonomy.replay import RECORDINGS, play, read

pytestmark = pytest.mark.compiled
ENDS = {"tour": "Timeout", "dive": "Crash", "leave": "Out of Bounds", "noise": "Out of Bounds", "chase": "Crash"}
POSITION, VELOCITY = 1e-7, 1e-10
"""Largest differences, m and m/s: steps are ten times as long as those of docking, whose differences are explained there."""

RECORDED = read("inspection.npz")
FITS = [case for name, case in RECORDED.items() if name.startswith("fit")]


@pytest.fixture(scope="module")
def episodes():
    recorded = {name: RECORDED[name] for name in ENDS}
    starts = torch.as_tensor(np.array([case["states"][0] for case in recorded.values()]))
    args = dict(relative_position=starts[:, :3], relative_velocity=starts[:, 3:], sunAngle=starts.new_zeros(len(recorded)))
    args["sunAngle"] = torch.tensor([float(case["sun"]) for case in recorded.values()], dtype=torch.float64)
    env = bsk_torch.make(
        "CWInspection-v1",
        num_envs=len(recorded),
        seed=0,
        dtype=torch.float64,
        sat_args={name: rand.per_env(value) for name, value in args.items()},
    )
    return recorded, play(env, recorded)


@pytest.mark.parametrize("name", ENDS)
def test_recorded_episodes(name, episodes):
    recorded, played = (each[name] for each in episodes)
    assert str(recorded["status"]) == ENDS[name]
    difference = np.abs(played.states[recorded["rows"]] - recorded["states"])
    assert difference[:, :3].max() < POSITION
    assert difference[:, 3:].max() < VELOCITY
    seen = played.observations[recorded["rows"]]
    np.testing.assert_allclose(seen[:, :7], recorded["observations"][:, :7], rtol=1e-6, atol=1e-6)  # recorded in float32
    np.testing.assert_array_equal(seen[:, 7], recorded["observations"][:, 7])
    np.testing.assert_array_equal(seen[:, 7], np.unpackbits(recorded["inspected"], axis=1)[:, :99].sum(1))
    np.testing.assert_allclose(played.rewards, recorded["rewards"], rtol=3e-7, atol=1e-8)
    done = played.terminated | played.truncated
    assert done.tolist() == [False] * (len(done) - 1) + [True]
    assert [played.terminated[-1], played.truncated[-1]] == recorded["flags"].tolist()
    assert played.dead == (ENDS[name] == "Crash")


@pytest.mark.parametrize("name", ENDS)
def test_directions_of_clusters(name, episodes):
    """Starts of k-means differ, but both have a cluster in the same episodes, and mostly a similar one."""
    recorded, played = (each[name] for each in episodes)
    ours, theirs = played.observations[recorded["rows"], 8:], recorded["observations"][:, 8:]
    np.testing.assert_array_equal((ours == 0.0).all(1), (theirs == 0.0).all(1))
    there = (theirs != 0.0).any(1)
    np.testing.assert_allclose(np.linalg.norm(ours[there], axis=1), 1.0, rtol=0, atol=1e-12)
    assert np.median((ours * theirs).sum(1)[there]) > math.cos(math.radians(25.0))


def test_points():
    points = np.load(RECORDINGS / "inspection.npz")["points"]
    np.testing.assert_allclose(sphere_points(100, 10.0).numpy(), points, rtol=0, atol=1e-14)


def test_kmeans_is_that_of_the_original():
    """From the same start, centers agree to rounding, unless a center is left without points, which scikit-learn moves."""
    compared = 0
    for case in FITS:
        data, start = torch.as_tensor(case["data"]), torch.as_tensor(case["start"])
        if len(start.unique(dim=0)) < len(start):
            continue
        chosen = torch.ones(1, len(data), dtype=torch.bool)
        found = kmeans(data, chosen, Clusters(start.unsqueeze(0), torch.tensor([len(start)])))
        first = torch.cdist(data, start).argmin(1)
        if len(first.unique()) < len(start):
            continue
        np.testing.assert_allclose(found.centers[0].numpy(), case["centers"], rtol=0, atol=1e-9)
        compared += 1
    assert compared > 20


def test_clusters_of_many_episodes():
    """There is one for every ten points, they are means of their points, and no episode depends on the others."""
    points, generator = sphere_points(100, 10.0), torch.Generator().manual_seed(0)
    chosen = torch.rand(64, 99, generator=generator) < torch.linspace(0.0, 1.0, 64).unsqueeze(1)
    start = Clusters(torch.zeros(64, 10, 3, dtype=torch.float64), torch.zeros(64, dtype=torch.int64))
    found = clustered(points, chosen, start)
    assert found.number.tolist() == [-(-int(row.sum()) // 10) for row in chosen]
    for k in (0, 5, 40, 63):
        alone = clustered(points, chosen[k : k + 1], Clusters(start.centers[:1], start.number[:1]))
        assert torch.equal(alone.centers[0], found.centers[k])
        centers, mine = found.centers[k, : found.number[k]], points[chosen[k]]
        label = torch.cdist(mine, centers).argmin(1) if len(centers) else mine
        for number, center in enumerate(centers):
            torch.testing.assert_close(mine[label == number].mean(0), center, rtol=0, atol=0.1)
