"""Clouds hide targets from satellites that do not see through them, and from these only."""

import pytest
import torch

from bsk_torch import ConstellationTasking, act, comm, data, obs, sats, scene

pytestmark = pytest.mark.compiled

PRIORITIES = [0.5, 0.25, 1.0, 0.125]


class Optical(sats.ImagingSatellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Image(n_ahead_image=2),)


class Radar(Optical):
    sees_through_clouds = True


def cluster(*kinds, **options):
    """Two episodes with satellites of these classes, and four targets, of which the first two are under clouds."""
    targets = scene.Targets([[6378e3, 1e5 * k, 0.0] for k in range(4)], PRIORITIES)
    clouds = scene.CloudyTargets(targets, cover=[0.9, 0.8, 0.7, 0.1], forecast_sigma=0.0)
    satellites = [kind(f"S{k}") for k, kind in enumerate(kinds)]
    settings = dict(rewarder=data.CloudFreeImageReward(), num_envs=2, seed=0, time_limit=60.0)
    env = ConstellationTasking(satellites, clouds, communicator=comm.FreeCommunication(), **(settings | options))
    env.reset()
    return env


def value(env, *targets):
    """Rewards of the satellites of both episodes for images of these targets; None for no image."""
    target = torch.tensor([[target or 0 for target in targets]] * 2)
    taken = torch.tensor([[target is not None for target in targets]] * 2)
    reward = env.rewarder.value(target, taken)
    assert torch.equal(reward[0], reward[1])
    return reward[0].tolist()


def hidden(env):
    """Targets that each satellite of the first episode may no longer choose."""
    return [torch.nonzero(~row).squeeze(-1).tolist() for row in env.rewarder.selectable()[0]]


def share(env):
    env.rewarder.share(~torch.eye(3, dtype=torch.bool).expand(2, 3, 3))


def test_clouds_matter_to_optical_satellites_only():
    env = cluster(Optical, Radar, Optical)
    assert (value(env, 0, 1, 2), env.rewarder.memory["covered"][0].tolist()) == ([0.0, 0.25, 1.0], [1, 0, 0])
    assert torch.nonzero(env.rewarder.imaged[0]).squeeze(-1).tolist() == [1, 2]
    env = cluster(Optical, Radar, Optical)
    assert (value(env, 1, 1, None), value(env, 3, 3, None)) == ([0.0, 0.25, 0.0], [0.0625, 0.0625, 0.0])
    env = cluster(Radar, Radar, Radar)
    assert value(env, 0, 1, 2) == [0.5, 0.25, 1.0]
    assert not env.rewarder.memory["covered"].any()
    env = cluster(Optical, Optical, Optical)
    assert value(env, 0, None, 2) == [0.0, 0.0, 1.0]
    share(env)
    assert hidden(env) == [[0, 2]] * 3


def test_a_cloudy_image_hides_the_target_from_those_who_know_and_cannot_see_it():
    env = cluster(Optical, Radar, Optical)
    value(env, 0, None, None)
    assert hidden(env) == [[0], [], []]
    share(env)
    assert (hidden(env), value(env, None, 0, None)) == ([[0], [], [0]], [0.0, 0.5, 0.0])
    share(env)
    assert (hidden(env), value(env, None, 0, None)) == ([[0], [0], [0]], [0.0, 0.0, 0.0])
    assert env.rewarder.memory["duplicates"][0].tolist() == [0, 1, 0]


def test_knowledge_of_clouds_is_saved_with_the_episodes():
    env = cluster(Optical, Radar, Optical)
    value(env, 0, None, None)
    other = cluster(Optical, Radar, Optical)
    other.restore(env)
    assert hidden(other) == [[0], [], []]
    env.reset()
    assert hidden(env) == [[], [], []]
