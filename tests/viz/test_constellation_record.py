"""What is recorded of an episode is what happened in it."""

import pytest
import torch
from tensordict.nn import TensorDictModule

pytest.importorskip("matplotlib")

from bsk_torch import comm, make
from bsk_torch.viz.episodes import record
from bsk_torch.viz.figures.constellation import constellation_figure

pytestmark = pytest.mark.compiled


def first_legal(env):
    group = env.groups[0].name
    return TensorDictModule(lambda mask: mask.byte().argmax(-1), in_keys=[(group, "action_mask")], out_keys=[(group, "action")])


def constellation(**options):
    return make("Constellation-v1", n_satellites=4, n_planes=2, num_envs=2, time_limit=900.0, **options)


def test_an_episode_is_recorded_as_it_was(tmp_path):
    env = constellation(n_targets=2000)
    episode = record(first_legal(env), env, seed=2)
    assert episode.times[0] == 0.0
    assert episode.times[-1] == 900.0
    assert len(episode.times) == len(episode.latitude[0]) > 10
    assert torch.bincount(episode.groups).tolist() == [2, 2]
    images = torch.bincount(episode.image_satellite, minlength=4)
    assert torch.equal(images, env.counts()["imaged"][0])
    assert int((~episode.image_paid).sum()) == int(env.counts()["duplicates"][0].sum())
    for k in range(4):
        spans = episode.tasks.spans[episode.tasks.satellite == k]
        assert spans[0, 0] == 0.0
        assert torch.equal(spans[1:, 0], spans[:-1, 1])
        assert spans[-1, 1] == 900.0
    assert episode.tasks.names == ["action_image"]
    assert not episode.died.any()
    # the nadir is nowhere farther from the equator than the orbit is inclined
    assert episode.latitude.abs().max() < 45.1
    assert episode.latitude.abs().max() > 10.0
    path = constellation_figure(episode, tmp_path / "episode.png", "four")
    assert path.stat().st_size > 20_000


def test_contacts_are_those_of_the_communicator():
    env = constellation(communicator=comm.FreeCommunication())
    episode = record(first_legal(env), env, seed=2)
    everybody = ~torch.eye(4, dtype=torch.bool)
    assert not episode.links[0].any()
    assert all(torch.equal(links | links.mT, everybody) for links in episode.links[1:])
    env = constellation(communicator=comm.NoCommunication())
    assert record(first_legal(env), env, seed=2).links is None
