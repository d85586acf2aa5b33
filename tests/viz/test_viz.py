"""Pictures are written, and show what happened."""

import re

import pytest
import torch

import bsk_torch
from bsk_torch.rl.rules.baselines import scan_rule
from bsk_torch.viz.figures.curves import learning_curve
from bsk_torch.viz.figures.style import COLUMN, WIDTH, label, panels, save, spread
from bsk_torch.viz.figures.timeline import record_episode, timeline
from bsk_torch.viz.figures.track_map import track_map
from bsk_torch.viz.recorders.episode import union
from bsk_torch.viz.recorders.track import record_track

PNG = b"\x89PNG"


@pytest.fixture(scope="module")
def episode():
    env = bsk_torch.make("NadirScan-v1", num_envs=1, seed=0, backend="eager", time_limit=700.0)
    return record_episode(scan_rule(env), env, seed=1)


def test_a_recorded_episode_is_complete(episode):
    assert episode.times[0] == 0.0
    assert episode.times[-1] == 700.0
    assert len(episode.actions) == len(episode.times) - 1
    assert {len(rows) for rows in episode.series.values()} == {len(episode.times)}
    assert episode.series["wheel_speeds_fraction"].shape[1] == 3
    for intervals in (episode.eclipses, episode.passes):
        flat = intervals.flatten()
        assert torch.equal(flat, flat.sort().values)
        assert bool(((flat >= 0.0) & (flat <= 700.0)).all())
    assert not episode.died


def test_timeline_is_drawn(episode, tmp_path):
    path = timeline(episode, tmp_path / "timeline.png", "NadirScan-v1")
    assert path.read_bytes()[:4] == PNG
    assert path.stat().st_size > 10_000


def test_learning_curve_is_drawn(tmp_path):
    log = {"seconds": [1.0, 2.0, 3.0], "return": [-1.0, 0.0, 0.5], "survival": [0.0, 0.5, 1.0], "simulated_days": [1, 2, 3]}
    path = learning_curve(log, tmp_path / "curve.png", {"random": (-0.4, 0.1), "rule": (0.4, 0.02)}, "learning")
    assert path.read_bytes()[:4] == PNG
    assert path.stat().st_size > 10_000


def test_figures_fit_a_column_of_a_paper(tmp_path):
    env = bsk_torch.make("NadirScan-v1", num_envs=1, seed=0, backend="eager", time_limit=700.0)
    flight = record_track(scan_rule(env), env, seed=1)
    log = {"seconds": [1.0, 2.0], "return": [-1.0, 0.5], "survival": [0.0, 1.0], "simulated_days": [1, 2]}
    wide, narrow = (
        [
            timeline(flight, tmp_path / f"timeline_{width}.pdf", width=width),
            track_map(flight, tmp_path / f"map_{width}.pdf", width=width),
            learning_curve(log, tmp_path / f"curve_{width}.pdf", {"rule": (0.4, 0.02)}, "", width=width),
        ]
        for width in (WIDTH, COLUMN)
    )
    assert [media_width(path) for path in wide] == pytest.approx([72.0 * WIDTH] * 3)
    assert [media_width(path) for path in narrow] == pytest.approx([72.0 * COLUMN] * 3)


def media_width(path):
    """Width of the page of a PDF, points."""
    return float(re.search(rb"/MediaBox \[ *\S+ +\S+ +(\S+)", path.read_bytes())[1])


def test_names_of_close_lines_are_kept_apart_in_their_order():
    moved = spread([0.5, 0.48, -1.0, 0.51], 0.1)
    assert moved[2] == -1.0
    assert moved[1] < moved[0] < moved[3]
    assert min(moved[0] - moved[1], moved[3] - moved[0]) == pytest.approx(0.1, abs=1e-6)


def test_intervals_are_joined_and_cut_to_the_episode():
    joined = union({(50.0, 60.0), (-5.0, 10.0), (8.0, 20.0), (9.0, 12.0), (90.0, float("inf")), (200.0, 300.0)}, 100.0)
    assert joined.tolist() == [[0.0, 20.0], [50.0, 60.0], [90.0, 100.0]]
    assert union(set(), 100.0).shape == (0, 2)


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_equal_figures_are_equal_files(tmp_path, kind):
    files = []
    for k in range(2):
        figure, (panel,) = panels((2.0,))
        panel.plot([0.0, 1.0], [0.0, 1.0])
        label(panel, "share of all regret")
        files.append(save(figure, tmp_path / f"{k}.{kind}").read_bytes())
    assert files[0] == files[1]
    assert b"/Type3" not in files[0]  # fonts that publishers reject
