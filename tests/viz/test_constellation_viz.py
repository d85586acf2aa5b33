"""A constellation's episode is drawn from plain tensors, and shows what happened."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from matplotlib.figure import Figure

from bsk_torch.astro.frames import fixed_to_lla, rotate_z
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.constants import MU_EARTH
from bsk_torch.formations import walker_delta
from bsk_torch.recording.table import Tasks
from bsk_torch.viz.figures import constellation as pictures
from bsk_torch.viz.figures.style import PALETTE
from tests.support.figures import check_column, figure_of


def flown(oe: torch.Tensor, times: torch.Tensor) -> dict[str, torch.Tensor]:
    """Ground tracks, degrees [S, K], of Kepler orbits with elements [S, 6] over a turning Earth."""
    f = oe[:, 5:] + torch.sqrt(MU_EARTH / oe[:, :1] ** 3) * times
    r_N, _ = elements_to_rv(Elements(*(oe[:, k : k + 1].expand_as(f) for k in range(5)), f))
    turn = 7.2921e-5 * times
    latitude, longitude, _ = fixed_to_lla(rotate_z(r_N, torch.cos(turn), torch.sin(turn)).stack())
    return {"latitude": torch.rad2deg(latitude), "longitude": torch.rad2deg(longitude)}


@pytest.fixture(scope="module")
def episode():
    """Walker 60:6/3/1 for an hour and a half; the satellites image by turns, and those of a plane are in contact later on."""
    times = torch.arange(0.0, 5401.0, 60.0, dtype=torch.float64)
    track = flown(walker_delta(6, 3, 0.5, 800e3, 60.0), times)
    links = torch.zeros(len(times), 6, 6, dtype=torch.bool)
    for pair in ((0, 1), (2, 3), (4, 5)):
        links[30:60, pair[0], pair[1]] = True  # one direction is enough
    links[30:40, 0, 2] = True
    who, when = torch.arange(18) % 6, 300.0 * torch.arange(18)
    at = (when / 60.0).long()
    return pictures.ConstellationEpisode(
        names=[f"Sat-{k}" for k in range(6)],
        times=times,
        **track,
        groups=torch.arange(6) // 2,
        links=links,
        image_times=when,
        image_satellite=who,
        image_latitude=track["latitude"][who, at],
        image_longitude=track["longitude"][who, at],
        image_paid=torch.arange(18) % 5 > 0,
        target_latitude=torch.tensor([10.0, 20.0]),
        target_longitude=torch.tensor([0.0, -170.0]),
        tasks=Tasks(
            torch.arange(12) % 6,
            torch.tensor([[0.0, 2700.0]] * 6 + [[2700.0, 5400.0]] * 6),
            torch.arange(12) // 6,
            ["action_image", "action_charge"],
        ),
        deaths=torch.tensor([math.inf, math.inf, 4000.0, math.inf, math.inf, math.inf]),
        rewards=torch.zeros(6, 90),
        series={},
    )


@pytest.fixture
def drawn(tmp_path):
    """Draws an episode; its figure."""
    return lambda episode: figure_of(pictures.constellation_figure, episode, tmp_path / "constellation.png", "Walker")


def legend(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.mark.parametrize("title", ["", "A title of a policy and a preset"])
def test_it_fits_a_column_of_a_paper(episode, tmp_path, title):
    check_column(pictures.constellation_figure, [episode], tmp_path, title)


def test_an_episode_is_drawn(episode, drawn):
    figure = drawn(episode)
    world, rows = figure.axes
    assert figure.get_suptitle() == "Walker: 18 images by 6 satellites, 1 of 6 satellites died"
    assert legend(figure)[:3] == ["plane 1", "plane 2", "plane 3"]
    assert {"image taken", "image without reward", "target", "contact", "image", "charge", "died"} < set(legend(figure))
    assert "satellites at 0:39 h" in world.get_title(loc="left")
    assert [text.get_text() for text in rows.get_yticklabels()] == episode.names
    assert rows.get_yticklabels()[5].get_color() == PALETTE[2]
    assert rows.get_xlim() == (0.0, 1.5)
    assert len(world.texts) == 6


def test_an_episode_without_events_is_drawn(episode, drawn):
    none, rows = torch.empty(0), torch.empty(0, dtype=torch.int64)
    events = dict.fromkeys(("image_times", "image_latitude", "image_longitude", "target_latitude", "target_longitude"), none)
    events |= dict(image_satellite=rows, image_paid=rows.bool(), tasks=Tasks(rows, torch.empty(0, 2), rows, []))
    quiet = dataclasses.replace(episode, groups=None, links=None, deaths=torch.full((6,), math.inf), **events)
    figure = drawn(quiet)
    assert figure.get_suptitle() == "Walker: 0 images by 6 satellites"
    assert legend(figure) == list(episode.names)  # each its own group
    assert "ticks" not in figure.axes[1].get_title(loc="left")
    crowd = dataclasses.replace(
        quiet,
        names=[f"S{k}" for k in range(60)],
        deaths=torch.full((60,), math.inf),
        **flown(walker_delta(60, 6, 0.0, 5e5, 53.0), quiet.times),
    )
    figure = drawn(crowd)
    assert figure.legends[0].get_texts() == []  # more groups than colours
    assert figure.get_size_inches()[1] < 17.0


def test_the_moment_of_the_map_is_the_last_with_the_most_contacts(episode):
    assert episode.contacts.sum((-1, -2))[[0, 29, 30, 39, 40, 59, 60]].tolist() == [0, 0, 8, 8, 6, 6, 0]
    assert episode.moment == 39
    assert dataclasses.replace(episode, links=None).moment == len(episode.times) - 1


def test_the_dead_are_in_contact_with_nobody(episode):
    early = dataclasses.replace(episode, deaths=torch.tensor([math.inf, math.inf, 2100.0] + [math.inf] * 3))
    contacts = early.contacts
    assert contacts[35, 2].nonzero().flatten().tolist() == [0, 3]  # at 2100 s, both directions
    assert not contacts[36:, 2].any()
    assert not contacts[36:, :, 2].any()
    assert early.died.tolist() == [False, False, True, False, False, False]
    assert dataclasses.replace(episode, deaths=torch.full((6,), 5400.0)).died.all()  # with the episode
    assert early.ends.tolist() == [5400.0, 5400.0, 2100.0, 5400.0, 5400.0, 5400.0]


def test_tasks_end_with_death(episode, drawn):
    _, rows = drawn(episode).axes
    ends = {}
    for bars in rows.collections:
        for path in bars.get_paths() if hasattr(bars, "get_paths") else []:
            box = path.get_extents()
            if abs(box.height - (pictures.BAR[1] - pictures.BAR[0])) < 1e-9 and box.width > 0.0:
                row = round(box.y0 - pictures.BAR[0])
                ends[row] = max(ends.get(row, 0.0), box.x1)
    assert ends == pytest.approx({0: 1.5, 1: 1.5, 2: 4000.0 / 3600.0, 3: 1.5, 4: 1.5, 5: 1.5})


def test_great_circles():
    longitude, latitude = pictures.great_circle(torch.tensor([0.0, 0.0]), torch.tensor([10.0, 100.0]), 3)
    assert longitude.tolist() == pytest.approx([10.0, 55.0, 100.0])
    assert latitude.tolist() == pytest.approx([0.0, 0.0, 0.0])
    longitude, latitude = pictures.great_circle(torch.tensor([60.0, 60.0]), torch.tensor([0.0, 180.0]), 3)
    assert latitude.tolist() == pytest.approx([60.0, 90.0, 60.0])  # over the pole
    longitude, _ = pictures.great_circle(torch.tensor([20.0, 20.0]), torch.tensor([170.0, -170.0]), 5)
    assert (longitude.abs() >= 170.0 - 1e-12).all()  # over the date line
