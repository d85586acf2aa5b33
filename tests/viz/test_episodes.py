"""One function records, and one draws, an episode of any kind of environment."""

import pytest
import torch
from tensordict.nn import TensorDictModule

import bsk_torch
from bsk_torch.rl.rules import BASELINES
from bsk_torch.viz.episodes import draw, record
from bsk_torch.viz.figures.constellation import ConstellationEpisode
from bsk_torch.viz.figures.ground_track import ImagingEpisode
from bsk_torch.viz.figures.timeline import TrackEpisode

SHORT = dict(num_envs=1, time_limit=60.0, backend="eager")


@pytest.mark.parametrize(
    ("env", "policy", "kind"),
    [
        (lambda: bsk_torch.make("NadirScan-v1", **SHORT), BASELINES["rule"], TrackEpisode),
        (lambda: bsk_torch.make("AEOS-v1", n_targets=300, **SHORT), BASELINES["nearest"], ImagingEpisode),
        (
            lambda: bsk_torch.make("Constellation-v1", n_satellites=3, n_targets=300, **SHORT),
            lambda env, seed: bsk_torch.rule("nearest", env, seed),
            ConstellationEpisode,
        ),
    ],
    ids=["scanner", "imager", "constellation"],
)
def test_every_kind_is_recorded_and_drawn(env, policy, kind, tmp_path):
    env = env()
    episode = record(policy(env, 0), env, seed=1)
    assert type(episode) is kind
    path = draw(episode, str(tmp_path / "episode.png"), "an episode")
    assert path == tmp_path / "episode.png"
    assert path.read_bytes()[:4] == b"\x89PNG"


def test_a_satellite_that_could_image_is_recorded_as_one_whatever_it_does():
    """The kind follows from the actions that there are, not from those that are chosen."""
    env = bsk_torch.make("AEOSPower-v1", n_targets=300, **SHORT)
    charge = TensorDictModule(lambda mask: torch.zeros(mask.shape[0], dtype=torch.int64), ["action_mask"], ["action"])
    assert isinstance(record(charge, env, seed=1), ImagingEpisode)
