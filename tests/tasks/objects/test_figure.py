"""Imaging in orbit is recorded as it was, and drawn from plain tensors: skies, and images and downlinks over time."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from matplotlib.colors import to_hex
from tensordict.nn import TensorDictModule

from bsk_torch import SatelliteTasking, data
from bsk_torch.act import image_target
from bsk_torch.env.rollout import play_episodes
from bsk_torch.recording.table import Tasks
from bsk_torch.tasks.objects import RSOImageReward, RSOTargets
from bsk_torch.tasks.objects import figure as pictures
from bsk_torch.tasks.objects.candidates import Candidates
from bsk_torch.tasks.objects.figure import sky_of
from bsk_torch.viz.episodes import draw, record
from bsk_torch.viz.figures.constellation import ConstellationEpisode
from bsk_torch.viz.figures.timeline import TrackEpisode
from bsk_torch.viz.render.frames import frames
from bsk_torch.viz.render.marks import DONE, color_of
from bsk_torch.viz.render.moment import look
from tests.support.figures import check_column, figure_of
from tests.tasks.objects.objects import KEPT, Imager, catalog, environment, play

pytestmark = pytest.mark.compiled

PNG = b"\x89PNG"

CHARGE, DOWNLINK = 0, 1


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


@pytest.fixture(scope="module")
def sky():
    """Six objects: lit, dark, hidden, and with images on board or delivered."""
    return pictures.Sky(
        imager="Eye",
        time=900.0,
        ids=[f"o{k}" for k in range(6)],
        azimuth=tensor(0.0, 90.0, -90.0, 180.0, 10.0, 20.0),
        elevation=tensor(0.0, 30.0, -20.0, -40.0, -60.0, 5.0),
        limb=-24.0,
        light=tensor(1.0, 0.0, 1.0, 1.0, 0.2, 0.5),
        in_sight=torch.tensor([True, True, True, False, False, True]),
        priority=tensor(1.0, 0.0, 0.5, 0.5, 0.5, 0.5),
        pending=torch.tensor([0, 1, 0, 0, 0, 0]),
        imaged=torch.tensor([False, True, True, False, False, False]),
        candidates=torch.tensor([2, 0, 5, 3, 4]),
    )


@pytest.fixture(scope="module")
def episode():
    """Two imagers, three images of two of three objects, of which two are delivered; the second imager dies."""
    none = torch.empty(0, dtype=torch.int64)
    return pictures.RSOImagingEpisode(
        names=["A", "B"],
        ids=["one", "two", "three"],
        times=tensor(0.0, 900.0, 1800.0, 3600.0),
        light=torch.stack([tensor(1.0, 1.0, 0.0, 1.0), tensor(1.0, 1.0, 1.0, 1.0), tensor(0.0, 0.0, 0.0, 0.0)]),
        taken=tensor(60.0, 300.0, 2000.0),
        delivered=tensor(900.0, math.inf, 3600.0),
        imager=torch.tensor([0, 1, 0]),
        target=torch.tensor([1, 0, 1]),
        rewards=torch.stack([tensor(1.0, 0.0, 2.0), tensor(0.0, 0.0, math.nan)]),
        deaths=tensor(math.inf, 1800.0),
        tasks=Tasks(none, torch.empty(0, 2), none, []),
        series={},
    )


@pytest.fixture
def drawn(tmp_path):
    """Draws by a function; its figure."""
    return lambda function, what, title="Two": figure_of(function, what, tmp_path / "picture.png", title)


def legend(figure):
    return {text.get_text() for text in figure.legends[0].get_texts()}


# -- figures ---------------------------------------------------------------------------------------------------------------------


def test_a_sky_is_drawn(sky, drawn):
    figure = drawn(pictures.sky_figure, sky)
    assert figure.get_suptitle() == "Two: 4 of 6 objects in sight, 3 of them lit"
    every = {"lit", "in eclipse", "lit, hidden by the Earth", "in eclipse, hidden by the Earth"}
    assert legend(figure) == every | {"image on board", "image delivered", "Earth", "number of the action"}
    (panel,) = figure.axes
    _, lit, hidden, dark, dark_hidden, delivered, pending = panel.collections
    assert [len(dots.get_offsets()) for dots in (lit, hidden, dark, dark_hidden, delivered, pending)] == [3, 1, 1, 1, 1, 1]
    assert lit.get_offsets()[1].tolist() == pytest.approx([-0.5 * math.pi, math.radians(-20.0)])
    assert lit.get_sizes().tolist() == [pictures.LARGE, *2 * [0.5 * (pictures.SMALL + pictures.LARGE)]]
    assert pending.get_offsets()[0].tolist() == pytest.approx([0.5 * math.pi, math.radians(30.0)])
    assert to_hex(hidden.get_facecolors()[0]) == "#ffffff"
    numbers = {text.get_text(): text.xy for text in panel.texts if text.get_text().isdigit()}
    assert list(numbers) == ["0", "1", "2", "3", "4"]
    assert numbers["1"] == (0.0, 0.0)


@pytest.mark.parametrize("title", ["", "A title of a policy and a preset"])
def test_it_fits_a_column_of_a_paper(sky, episode, tmp_path, title):
    check_column(pictures.sky_figure, [sky], tmp_path, title)
    check_column(pictures.services_figure, [episode], tmp_path, title)


def test_an_empty_sky_is_drawn(sky, drawn):
    none = torch.zeros(6, dtype=torch.bool)
    empty = dataclasses.replace(sky, priority=torch.zeros(6), pending=none.long(), imaged=none, candidates=none[:0].long())
    figure = drawn(pictures.sky_figure, empty, "")
    assert not {"image on board", "image delivered", "number of the action"} & legend(figure)


def test_services_are_drawn(episode, drawn):
    figure = drawn(pictures.services_figure, episode)
    rows, board, value = figure.axes
    assert figure.get_suptitle() == "Two: 3 images of 2 of 3 objects, 2 delivered, return 3.00, 1 of 2 died"
    assert [text.get_text() for text in rows.get_yticklabels()] == ["two", "one"]
    assert {"A", "B", "image", "on board", "delivered", "object in eclipse"} == legend(figure)
    images, downlinks = ([line for line in rows.lines if line.get_marker() == marker] for marker in ("o", "v"))
    assert [line.get_xdata()[0] * 3600.0 for line in images] == pytest.approx([60.0, 300.0, 2000.0])
    assert [line.get_ydata()[0] for line in images] == [0, 1, 0]
    assert [line.get_xdata()[0] * 3600.0 for line in downlinks] == pytest.approx([900.0, 3600.0])
    assert board.lines[0].get_ydata().tolist() == [0.0, 0.0, 0.0, 0.0]  # taken and delivered between decisions
    assert board.lines[1].get_ydata().tolist() == [0.0, 1.0, 1.0, 1.0]
    assert value.lines[0].get_ydata().tolist() == [0.0, 1.0, 1.0, 3.0]


def test_an_episode_without_images_is_drawn(episode, drawn):
    nothing = torch.empty(0, dtype=torch.float64)
    change = dict.fromkeys(("taken", "delivered"), nothing) | dict.fromkeys(("imager", "target"), nothing.long())
    figure = drawn(pictures.services_figure, dataclasses.replace(episode, **change), "")
    assert legend(figure) == {"A", "B"}


def test_the_table_counts_images_and_deliveries(episode):
    table = episode.to_numpy()
    assert table["images"].tolist() == [0, 0, 1, 1, 1, 1, 2, 1]
    assert table["delivered"].tolist() == [0, 0, 1, 0, 1, 0, 2, 0]
    assert table["alive"].tolist() == [True, True, True, True, True, False, True, False]


# -- recording -------------------------------------------------------------------------------------------------------------------


def in_turns(env):
    """Images the first candidate where there is one, downlinks every third time."""
    count = torch.zeros(1, dtype=torch.int64)

    def choose(mask):
        count.add_(1)
        wanted = torch.where((count % 3 == 0) | ~mask[..., 2], DOWNLINK, 2).expand(mask.shape[:-1])
        return torch.where(mask.gather(-1, wanted.unsqueeze(-1)).squeeze(-1), wanted, mask.shape[-1] - 1)

    return TensorDictModule(choose, in_keys=[("agents", "action_mask")], out_keys=[("agents", "action")])


def test_an_episode_is_recorded_as_it_was(tmp_path):
    env = environment(imagers=2)
    episode = record(in_turns(env), env, seed=3)
    env.set_seed(3)
    policy, seen = in_turns(env), []
    for _ in play_episodes(env, policy, env.reset(), torch.arange(env.batch_size[0]) == 0):
        counts = env.rewarder.counts()
        seen.append([float(env.fleet.sim_time[0]), *(int(counts[name][0].sum()) for name in ("captured", "delivered"))])
    assert (episode.names, list(episode.ids)) == (["Imager0", "Imager1"], [f"object {k}" for k in range(4)])
    for time, captured, delivered in seen:
        assert int((episode.taken <= time).sum()) == captured
        assert int((episode.delivered <= time).sum()) == delivered
    assert 2 <= seen[-1][2] < seen[-1][1] or seen[-1][1] == seen[-1][2] >= 2
    assert (episode.delivered > episode.taken).all()
    assert float(episode.rewards.nan_to_num().sum()) == pytest.approx(float(env.returns[0]))
    light = env.scenario.views(env.satellites[0], Candidates(*(torch.arange(4).expand(4, -1), torch.ones(4, 4).bool())))
    assert episode.light[:, -1].tolist() == pytest.approx(light.target_illumination_factor[0].tolist(), abs=1e-3)
    assert "storage_level_fraction" in episode.to_numpy()
    assert draw(episode, tmp_path / "episode.png", "an episode").read_bytes()[:4] == PNG


def test_recording_changes_nothing():
    episodes = []
    for n in (1, 3):
        env = environment(num_envs=n)
        episodes.append(record(in_turns(env), env, seed=5))
    for name in ("taken", "delivered", "target", "times", "light"):
        assert torch.equal(*(getattr(episode, name) for episode in episodes)), name


def test_the_sky_is_what_is_observed():
    env = environment(imagers=2)
    env.reset()
    play(env, image_target(0), image_target(2))
    sky = sky_of(env, "Imager1", 1)
    scout = env.satellites[0]
    r_BN_N, v_BN_N = (getattr(scout.dynamics, name)[3] for name in ("r_BN_N", "v_BN_N"))
    up = r_BN_N / r_BN_N.norm()
    right = torch.linalg.cross(v_BN_N, up)
    right = right / right.norm()
    axes = torch.stack([torch.linalg.cross(up, right), right, up])
    rho = (env.scenario.r_TN_N[1] - r_BN_N) @ axes.mT
    azimuth = torch.rad2deg(torch.atan2(rho[:, 1], rho[:, 0]))
    torch.testing.assert_close(sky.azimuth, azimuth, rtol=0.0, atol=1e-8)
    elevation = torch.rad2deg(torch.asin(rho[:, 2] / rho.norm(dim=-1)))
    torch.testing.assert_close(sky.elevation, elevation, rtol=0.0, atol=1e-8)
    assert sky.in_sight.tolist() == [True, True, True, False]
    ids = env.scenario.candidate_ids(scout, 3, 4)
    assert [sky.ids[k] for k in sky.candidates.tolist()] == [name for name in ids if name is not None]
    # the horizontal distance to the horizon of a sphere
    assert math.cos(math.radians(sky.limb)) * float(r_BN_N.norm()) == pytest.approx(6378136.6, rel=1e-6)
    assert sky.pending.tolist() == env.scenario.pending[1].tolist() == sky.imaged.long().tolist() == [1, 0, 0, 0]


def test_what_has_no_sky_is_named():
    env = environment()
    env.reset()
    with pytest.raises(ValueError, match="imager='Imager1' must be one of"):
        sky_of(env, "Imager1")
    with pytest.raises(ValueError, match="env_row=2"):
        sky_of(env, env_row=2)
    other = environment(rewarder=data.NoReward())
    with pytest.raises(ValueError, match="imaging in orbit needs RSOTargets and an RSOImageReward"):
        sky_of(other)
    assert isinstance(record(in_turns(other), other, seed=1), ConstellationEpisode)


def test_one_imager_has_a_sky_and_a_timeline():
    scenario = RSOTargets(catalog(), ["Imager0"])
    env = SatelliteTasking(Imager("Imager0", KEPT), scenario, RSOImageReward(), num_envs=1, seed=0, time_limit=600.0)
    assert isinstance(record(lambda observation, mask: mask.byte().argmax(-1), env, seed=1), TrackEpisode)
    env.reset()
    assert sky_of(env).imager == "Imager0"


# -- frames ----------------------------------------------------------------------------------------------------------------------


def test_frames_show_objects_and_lines_of_sight():
    env = environment(imagers=2)
    env.reset()
    before = look(env, 1)
    assert before.in_orbit
    assert before.imaged.tolist() == [False] * 4
    assert before.worth.tolist() == [0.25, 0.5, 0.75, 1.0]
    wanted = (env.scenario.r_TN_N[1] @ env.fleet.simulators[0].world.PN[2].mT).numpy()
    assert before.targets_P == pytest.approx(wanted)
    play(env, image_target(0), image_target(3))  # the second is behind the Earth
    after = look(env, 1)
    assert after.modes == ["image_rso", "image_rso"]
    assert after.imaged.tolist() == [True, False, False, False]
    assert after.aims_P[0] == pytest.approx(after.targets_P[0])
    assert math.isnan(after.aims_P[1][0])
    assert color_of("image_rso") == color_of("image")
    picture = frames(env, rows=1, height=480)
    green = torch.tensor([int(DONE[k : k + 2], 16) for k in (1, 3, 5)], dtype=torch.uint8)
    assert bool((picture == green).all(-1).any())
