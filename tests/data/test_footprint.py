"""Images of targets whose true places lie near the believed ones, at which satellites point."""

import math

import pytest
import torch

import bsk_torch
from bsk_torch import data, scene

pytestmark = pytest.mark.compiled

SHARP = dict(imageAttErrorRequirement=0.001)
"""Images are taken with pointing errors of up to 0.004 rad."""


def imaging(sigma, half_angle, n=4, name="AEOS-v1", **options):
    hide = {"hide_missed": options.pop("hide_missed")} if "hide_missed" in options else {}
    parts = dict(
        scenario=scene.UncertainTargets(scene.UniformTargets(1500), sigma=sigma),
        rewarder=data.FootprintImageReward(half_angle, **hide),
    )
    fixed = dict(num_envs=n, seed=4, time_limit=3000.0, dtype=torch.float64)
    return bsk_torch.make(name, **(fixed | parts | options))


def angle_to(env, place):
    """The angle between the instrument's axis and a place [N, 3], by the law of cosines of unit vectors."""
    ray = place - env.satellite.dynamics.r_BN_P
    cosine = (ray / ray.norm(dim=-1, keepdim=True) * env.satellite.fsw.c_hat_P).sum(-1)
    return torch.acos(cosine.clamp(-1.0, 1.0))


def fly(env, steps=8):
    """Step by step: reward, target, whether an image was taken, and the angle to the true place at the end, [K, N] each."""
    td, found, before = env.reset(), [], 0
    for _ in range(steps):
        before = env.satellite.dynamics.partition_levels[:, 0].clone()
        td = env.step(td.set("action", torch.zeros(len(before), dtype=torch.int64)))["next"]
        target = env.satellite.latest_target
        place = env.scenario.look_up(env.scenario.true_r_LP_P, target.unsqueeze(1)).squeeze(1)
        taken = env.satellite.dynamics.partition_levels[:, 0] > before
        worth = env.scenario.priority.gather(1, target.unsqueeze(1)).squeeze(1)
        found.append((td["reward"].squeeze(-1), worth, taken, angle_to(env, place)))
    return [torch.stack(part) for part in zip(*found, strict=True)]


def test_images_show_targets_in_view():
    env = imaging(8e3, 0.01, sat_args=SHARP)
    reward, worth, taken, angle = fly(env)
    inside = taken & (angle <= 0.01)
    assert torch.equal(reward > 0.0, inside)
    torch.testing.assert_close(reward[inside], worth[inside])
    off = env.counts()["off_target"].flatten()
    assert torch.equal(off, (taken & ~inside).sum(0))
    assert 0 < int(off.sum()) < int(taken.sum())
    # The angle of view is the largest pointing error, 4 atan(0.001), and what the body turns in two ticks at 0.01 rad/s.
    env = imaging(0.0, 0.014, sat_args=SHARP)
    reward, _, taken, angle = fly(env)
    # an image of the previous target, stored in the first tick of a step, counts for the next one, which it does not show
    late = taken & (angle > 0.1)
    assert torch.equal(reward > 0.0, taken & ~late)
    assert torch.equal(env.counts()["off_target"].flatten(), late.sum(0))
    assert int(late.sum()) < 2


@pytest.mark.parametrize("hide_missed", [True, False])
def test_missed_targets_stay_where_asked(hide_missed):
    env = imaging(1e5, 0.001, sat_args=SHARP, hide_missed=hide_missed)
    env.reset()
    target = torch.zeros(4, 1, dtype=torch.int64)
    assert not env.rewarder.shows(target).any()
    assert env.rewarder.value(target, torch.ones(4, 1, dtype=torch.bool)).tolist() == [[0.0]] * 4
    assert env.satellite.allowed("target")[:, 0].tolist() == [not hide_missed] * 4


def test_an_image_does_not_show_the_other_side_of_the_earth():
    env = imaging(0.0, 0.5 * math.pi)
    env.reset()
    axis = env.satellite.fsw.c_hat_P
    everything = torch.arange(1500).expand(4, 1500)
    shown = torch.cat([env.rewarder.shows(everything[:, k : k + 1]) for k in range(0, 1500, 5)], 1)
    r = env.satellite.dynamics.r_BN_P.unsqueeze(1)
    place = env.scenario.r_LP_P[:, ::5]
    risen = (place * (r - place)).sum(-1) > 0.0
    assert torch.equal(shown, risen & (((place - r) * axis.unsqueeze(1)).sum(-1) >= 0.0))


def test_rewards_do_not_depend_on_the_batch_and_are_counted_for_each_satellite():
    few, many = (fly(imaging(8e3, 0.01, n=n, sat_args=SHARP), 3)[0] for n in (2, 5))
    assert torch.equal(few, many[:, :2])
    env = imaging(5e3, 0.02, 2, "AEOSConstellation-v1", sat_args=SHARP)
    td = env.reset()
    for _ in range(6):
        td = env.rand_step(td)["next"]
    assert env.counts()["off_target"].shape == (2, 3)
