"""An inspection is recorded as it was, and drawn from plain tensors."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from matplotlib.figure import Figure
from tensordict.nn import TensorDictModule, TensorDictSequential

import bsk_torch
from bsk_torch.astro.relative import cd2hill
from bsk_torch.env.rollout import play_episodes
from bsk_torch.recording.table import Tasks
from bsk_torch.tasks.inspection import figure as pictures
from bsk_torch.viz.episodes import draw, record
from bsk_torch.viz.figures.constellation import ConstellationEpisode
from bsk_torch.viz.figures.style import PALETTE
from tests.support.figures import check_column, figure_of
from tests.tasks.inspection.inspecting import RSO, Inspector, chief_args, inspection, inspector_args

PNG = b"\x89PNG"


def points(n: int) -> torch.Tensor:
    """Directions that are spread over the sphere, [n, 3]."""
    return torch.as_tensor(bsk_torch.astro.relative.fibonacci_sphere(n))


@pytest.fixture(scope="module")
def episode():
    """Two inspectors on circles of 100 and 300 m for two hours; the second dies after one."""
    times = torch.arange(0.0, 7201.0, 60.0, dtype=torch.float64)
    angle = 2.0 * torch.pi * times / 7200.0
    circle = torch.stack([torch.cos(angle), torch.sin(angle), 0.5 * torch.sin(angle)], 1)
    n, none = torch.arange(10), torch.empty(0, dtype=torch.int64)
    return pictures.InspectionEpisode(
        names=["A", "B"],
        times=torch.tensor([0.0, 1800.0, 3600.0, 7200.0], dtype=torch.float64),
        rewards=torch.zeros(2, 3),
        tasks=Tasks(none, torch.empty(0, 2), none, []),
        series={},
        path_times=times,
        rho_H=torch.stack([100.0 * circle, 300.0 * circle]),
        illumination=((times < 1800.0) | (times > 3600.0)).double(),
        fuel=torch.tensor([[10.0, 9.0, 9.0, 8.5], [10.0, 10.0, 9.0, 9.0]], dtype=torch.float64),
        points=points(10),
        lit_at=torch.where(n < 8, 1800.0 * (1 + n % 2), torch.inf).double(),
        inspected_at=torch.where(n < 6, 3600.0, torch.inf).double(),
        deaths=torch.tensor([math.inf, 3600.0], dtype=torch.float64),
        completed=7200.0,
        reach=250.0,
    )


@pytest.fixture
def drawn(tmp_path):
    """Draws an episode; its figure."""
    return lambda episode, title="Two": figure_of(pictures.inspection_figure, episode, tmp_path / "inspection.png", title)


def legend(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_an_episode_is_drawn(episode, drawn):
    figure = drawn(episode)
    whole, near, normal, world, counts, fuel, _ = figure.axes
    assert figure.get_suptitle() == "Two: 6 of 8 lit points inspected, complete after 2.0 h, 2.50 m/s, 1 of 2 died"
    assert legend(figure)[:2] == ["A", "B"]
    assert {"start", "end", "died", "maneuver", "reach of the instrument", "complete", "eclipse"} < set(legend(figure))
    assert whole.get_xlim()[1] == pytest.approx(1.08 * 300.0)
    assert near.get_xlim()[1] < 1.08 * 300.0
    assert (near.get_ylabel(), normal.get_ylabel()) == ("radial, m", "orbit normal, m")
    # not lit, lit, inspected
    assert [len(dots.get_offsets()) for dots in world.collections[:3]] == [2, 2, 6]
    assert [line.get_ydata().tolist() for line in counts.lines[:2]] == [[0, 4, 8, 8], [0, 0, 6, 6]]
    assert fuel.lines[0].get_ydata().tolist() == [10.0, 9.0, 9.0, 8.5]
    assert counts.patches[0].get_x() == 0.5
    assert counts.patches[0].get_width() == pytest.approx(0.5 + 1.0 / 60.0)  # the first sample in the light ends it


@pytest.mark.parametrize("title", ["", "A title of a policy and a preset"])
def test_it_fits_a_column_of_a_paper(episode, tmp_path, title):
    check_column(pictures.inspection_figure, [episode], tmp_path, title)


def test_manoeuvres_are_where_they_were_made(episode, drawn):
    assert episode.spent.tolist() == [[1.0, 0.0, 0.5], [0.0, 1.0, 0.0]]
    marks = [dots.get_offsets().tolist() for dots in drawn(episode).axes[0].collections]
    for found, wanted in zip(marks, ([[0.0, 100.0], [0.0, -100.0]], [[300.0, 0.0]]), strict=True):
        torch.testing.assert_close(torch.tensor(found), torch.tensor(wanted), rtol=0.0, atol=1e-4)


def test_paths_end_with_death(episode, drawn):
    paths = [line for line in drawn(episode).axes[0].lines if line.get_marker() in ("None", None, "")]
    assert [len(line.get_xdata()) for line in paths] == [121, 61]
    assert [line.get_color() for line in paths] == list(PALETTE[:2])
    far = dataclasses.replace(episode, rho_H=torch.where(episode.path_times.unsqueeze(1) > 3600.0, 9e9, episode.rho_H))
    assert far.extent(near=False) == 9e9  # of the survivor
    assert dataclasses.replace(far, deaths=torch.full((2,), 3600.0)).extent(near=False) == pytest.approx(300.0)


def test_an_episode_without_events_is_drawn(episode, drawn):
    never = torch.full((10,), math.inf, dtype=torch.float64)
    change = dict(illumination=torch.ones(121), fuel=torch.zeros(2, 4), lit_at=never, inspected_at=never)
    quiet = dataclasses.replace(episode, **change, deaths=torch.full((2,), math.inf), completed=math.inf, reach=math.inf)
    figure = drawn(quiet, title="")
    assert quiet.outcome == "0 of 0 lit points inspected, 0.00 m/s"
    assert not {"died", "maneuver", "reach of the instrument", "complete", "eclipse"} & set(legend(figure))


# -- recording -------------------------------------------------------------------------------------------------------------------


class Fixed(Inspector):
    """An inspector without a tank."""

    observation_spec = (bsk_torch.obs.Time(),)
    fsw_type = bsk_torch.tasks.inspection.RSOInspectorFSWModel


FIXED = inspector_args(100.0, 0.0, 0.0)


def first_legal(mask):
    return mask.byte().argmax(-1)


def crew(env):
    """Points the RSO and lets the inspectors look at it, in each group its first action."""
    groups = [group.name for group in env.groups]
    return TensorDictSequential(
        *(TensorDictModule(first_legal, in_keys=[(group, "action_mask")], out_keys=[(group, "action")]) for group in groups)
    )


@pytest.fixture(scope="module")
def recorded():
    """An environment, the observers of its flights, and a recorded episode of it."""
    env = inspection(num_envs=2)
    observers = list(env.fleet.flight_observers)
    return env, observers, record(crew(env), env, seed=3)


def test_an_episode_is_recorded_as_it_was(recorded):
    env, observers, episode = recorded
    env.set_seed(3)
    seen = []
    for _ in play_episodes(env, crew(env), env.reset(), torch.arange(2) == 0):
        chief, inspector = env.satellites
        r, v = (getattr(chief.dynamics, name)[:1] for name in ("r_BN_N", "v_BN_N"))
        rho, _ = cd2hill(r, v, inspector.dynamics.r_BN_N[:2], inspector.dynamics.v_BN_N[:2])
        seen.append((float(env.fleet.sim_time[0]), rho, env.rewarder.inspected[0].sum(), env.rewarder.illuminated[0].sum()))
    assert env.fleet.flight_observers == observers
    assert episode.names == ["Above", "Behind"]
    torch.testing.assert_close(episode.path_times, torch.arange(0.0, 300.1, 5.0, dtype=torch.float64))
    for time, rho, inspected, lit in seen:
        sample = int((episode.path_times - time).abs().argmin())
        # the normal of two positions five seconds apart is that of position and velocity, up to perturbations
        torch.testing.assert_close(episode.rho_H[:, sample], rho, rtol=0.0, atol=1e-3)
        assert int((episode.inspected_at <= time).sum()) == int(inspected)
        assert int((episode.lit_at <= time).sum()) == int(lit)
    assert float(episode.times[-1]) == 300.0
    assert 0 < int(torch.isfinite(episode.inspected_at).sum()) < 40
    assert episode.reach == 300.0
    assert episode.deaths.isinf().all()
    assert episode.fuel[:, 0].tolist() == [100.0, 100.0]


def test_recording_does_not_depend_on_the_batch(recorded):
    alone = inspection(num_envs=1)
    episode = record(crew(alone), alone, seed=3)
    for name in ("rho_H", "illumination", "lit_at", "inspected_at", "fuel", "times"):
        assert torch.equal(getattr(episode, name), getattr(recorded[2], name)), name


def test_rules_of_the_preset_are_recorded_and_drawn(tmp_path):
    """Manoeuvres are those of the rule; the tank of ten metres per second shows them."""
    env = bsk_torch.make("RSOInspection-v1", num_envs=1, time_limit=1300.0)
    episode = record(bsk_torch.rule("circumnavigate", env), env, seed=1)
    assert type(episode) is pictures.InspectionEpisode
    assert episode.times.tolist()[:2] == [0.0, 600.0]
    assert float(episode.times[-1]) == float(episode.path_times[-1]) == float(env.fleet.sim_time[0])
    assert float(episode.spent[0, 0]) > 0.0
    assert (episode.reach, len(episode.points)) == (250.0, 100)
    assert draw(episode, tmp_path / "episode.png", "an episode").read_bytes()[:4] == PNG


def test_other_rewards_are_drawn_as_a_constellation():
    env = inspection([RSO("RSO", chief_args()), Fixed("A", FIXED)], rewarder=bsk_torch.data.NoReward(), time_limit=100.0)
    assert isinstance(record(crew(env), env, seed=1), ConstellationEpisode)


def test_inspectors_without_a_tank_spend_nothing():
    reward = bsk_torch.tasks.inspection.RSOInspectionReward()
    env = inspection([RSO("RSO", chief_args()), Fixed("A", FIXED)], rewarder=reward, time_limit=100.0)
    episode = record(crew(env), env, seed=1)
    assert not episode.fuel.any()
