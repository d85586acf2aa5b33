"""An imaging episode is recorded as it was flown, and drawn."""

import dataclasses
import math

import pytest
import torch
from tensordict.nn import TensorDictModule

import bsk_torch
from bsk_torch.astro.frames import lla_to_fixed, sin_elevation
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.access.visibility.planned import position_between, take_rows
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, fixed
from bsk_torch.sim.orbit.arcs import ARC
from bsk_torch.vec3 import Vec3
from bsk_torch.viz.episodes import record
from bsk_torch.viz.figures import ground_track as pictures
from bsk_torch.viz.figures.ground_track import IMAGED, LOST, NONE, OPEN, UNPAID
from bsk_torch.viz.figures.timeline import timeline
from bsk_torch.viz.figures.world import ground
from tests.support.figures import check_column

PNG = b"\x89PNG"

DEGREES = 1e-5
"""Angle to which sub-satellite points agree, degrees: a meter on the ground, as positions between keyframes of a recording."""

sixth = TensorDictModule(lambda mask: torch.full((len(mask),), 5), in_keys=["action_mask"], out_keys=["action"])
"""Images the target whose window closes sixth: soon, but after a slew."""


def make(time_limit):
    options = dict(num_envs=1, seed=0, backend="eager", sim_rate=1.0, n_targets=(8000, 9000), time_limit=time_limit)
    return bsk_torch.make("AEOS-v1", **options)


@pytest.fixture(scope="module")
def env():
    return make(170.0)


@pytest.fixture(scope="module")
def episode(env):
    return record(sixth, env, seed=1)


def directions(r_P):
    longitude, latitude = (torch.deg2rad(angle) for angle in ground(r_P))
    return lla_to_fixed(latitude, longitude, torch.zeros_like(latitude))


def angle(a, b):
    """Largest angle, degrees, between vectors [n, 3]."""
    a, b = (x / x.norm(dim=-1, keepdim=True) for x in (a, b))
    return math.degrees(float((a - b).norm(dim=-1).max()))


def test_images_and_rewards_are_those_of_the_environment(env, episode):
    assert int(episode.imaged.sum()) == int(env.satellite.imaged[0]) >= 3
    assert set(episode.chosen[episode.imaged].tolist()) == set(torch.nonzero(env.rewarder.imaged[0]).squeeze(-1).tolist())
    # rewards are float32
    torch.testing.assert_close(episode.rewards, episode.worth * episode.imaged, rtol=1e-6, atol=0.0)
    assert episode.total == pytest.approx(float(env.scenario.priority[0][env.rewarder.imaged[0]].sum()), rel=1e-6)
    assert episode.names == ["action_image"]
    assert set(episode.actions.tolist()) == {0}


def test_chosen_targets_exist(env, episode):
    assert int(episode.exists.sum()) == int(env.scenario.available[0].sum()) < len(episode.exists)
    assert bool(episode.exists[episode.chosen].all())
    assert bool((episode.fate[~episode.exists] == OPEN).all())


def test_sub_satellite_points_lie_below_the_satellite(env, episode):
    assert angle(directions(episode.r_BN_P), episode.r_BN_P) < DEGREES
    assert torch.equal(episode.r_BN_P[-1], env.satellite.dynamics.r_BN_P[0])
    at = torch.searchsorted(episode.track_times, episode.times)
    torch.testing.assert_close(episode.track_times[at], episode.times, rtol=0.0, atol=1e-9)
    assert angle(episode.track[at], episode.r_BN_P) < DEGREES


def test_the_track_is_the_arc_that_was_flown(env, episode):
    simulator, time = env.simulator, episode.track_times
    assert float(time.diff().max()) <= 30.0
    assert float(time.diff().min()) > 0.0
    flown, ephemeris = (
        take_rows(samples, torch.zeros(len(time), dtype=torch.int64)) for samples in simulator.arcs.tracks((ARC, EPHEMERIS_TRACK))
    )
    r_N, around = position_between(flown, ephemeris, time)
    assert angle(episode.track, fixed(around, r_N).stack()) < DEGREES


def test_recording_changes_nothing(episode):
    env = make(float(episode.times[3]))
    env.set_seed(1)
    rollout = env.rollout(20, sixth)
    assert rollout["next", "reward"].flatten().double().tolist() == episode.rewards[:3].tolist()
    assert rollout["next", "duration"].flatten().tolist() == episode.times[:4].diff().tolist()


def test_targets_at_the_edge_of_the_reach_are_seen_at_the_least_elevation(episode):
    radius = float(episode.track.norm(dim=-1).mean())
    place = Vec3(*torch.tensor([math.cos(episode.reach), math.sin(episode.reach), 0.0], dtype=torch.float64)) * R_EARTH
    above = Vec3(*torch.tensor([radius, 0.0, 0.0], dtype=torch.float64))
    assert math.asin(float(sin_elevation(above, place))) == pytest.approx(episode.least_elevation, abs=1e-12)


def test_decisions_for_the_same_target_in_a_row_are_one(episode):
    chosen = torch.tensor([3, 3, 5, 5, NONE, 5, 7, 7])
    imaged = torch.tensor([0, 1, 0, 0, 0, 1, 1, 0]).bool()
    rewards = torch.tensor([0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.2, 0.0])
    drawn = dataclasses.replace(episode, chosen=chosen, imaged=imaged, rewards=rewards)
    assert drawn.outcomes.tolist() == [IMAGED, IMAGED, LOST, LOST, OPEN, UNPAID, IMAGED, LOST]
    assert drawn.fate[:9].tolist() == [OPEN, OPEN, OPEN, IMAGED, OPEN, UNPAID, OPEN, IMAGED, OPEN]


def test_the_close_up_shows_the_most_images(episode):
    times = torch.cat([torch.tensor([0.0, 100.0]), torch.arange(2000.0, 2500.0, 100.0), torch.tensor([4000.0])])
    drawn = dataclasses.replace(episode, times=times, imaged=torch.ones(len(times) - 1, dtype=torch.bool))
    assert pictures.busiest(drawn) == (1970.0, 2570.0)
    assert pictures.busiest(dataclasses.replace(drawn, imaged=torch.zeros_like(drawn.imaged))) == (1700.0, 2300.0)
    assert pictures.busiest(episode) == (0.0, 170.0)


def test_distances_along_and_across_the_track():
    flight = torch.deg2rad(torch.linspace(-5.0, 5.0, 11, dtype=torch.float64))
    path = lla_to_fixed(torch.zeros_like(flight), flight, torch.full_like(flight, 8e5))  # eastwards along the equator
    north, east = torch.deg2rad(torch.tensor([[2.0, -3.0], [4.0, -1.0]], dtype=torch.float64))
    along, across = pictures.along_and_across(lla_to_fixed(north, east, torch.zeros_like(north)), path)
    torch.testing.assert_close(along, east * R_EARTH / 1e3)
    torch.testing.assert_close(across, north * R_EARTH / 1e3)


def test_an_episode_is_drawn(episode, tmp_path):
    for draw in (pictures.ground_track, timeline):
        path = draw(episode, tmp_path / f"{draw.__name__}.png", "AEOS-v1")
        assert path.read_bytes()[:4] == PNG
        assert path.stat().st_size > 10_000


@pytest.mark.parametrize("title", ["", "A title of a policy and a preset"])
def test_it_fits_a_column_of_a_paper(episode, tmp_path, title):
    check_column(pictures.ground_track, [episode], tmp_path, title)


def test_other_modes_deaths_and_a_track_over_the_date_line_are_drawn(episode, tmp_path):
    actions, chosen = torch.ones_like(episode.actions), episode.chosen.clone()
    actions[1], chosen[1] = 0, NONE
    x, y, z = episode.track.unbind(-1)
    turned = torch.stack([-x.abs(), y - y.mean(), z], -1)  # to longitudes about 180 degrees
    drawn = dataclasses.replace(
        episode,
        names=["action_charge", "action_image"],
        actions=actions,
        chosen=chosen,
        track=turned,
        rewards=episode.rewards - 10.0,
        stations=episode.r_LP_P[:2],
        passes=torch.tensor([[10.0, 60.0]]),
        died=True,
    )
    longitudes = ground(turned)[0]
    assert float(longitudes.diff().abs().max()) > 180.0
    assert pictures.ground_track(drawn, tmp_path / "died.png", "AEOSPower-v1").stat().st_size > 10_000
