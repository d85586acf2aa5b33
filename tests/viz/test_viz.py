"""Pictures are written, and show what happened."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from matplotlib.colors import to_rgb

import bsk_torch
from bsk_torch.lab.audit.figure import regret_figure
from bsk_torch.rl.rules.baselines import scan_rule
from bsk_torch.viz.episodes import record
from bsk_torch.viz.figures.curves import learning_curve, performance_profiles
from bsk_torch.viz.figures.style import COLUMN, PALETTE, WIDTH, label, panels, save, spread
from bsk_torch.viz.figures.timeline import timeline, track_map
from tests.support.figures import check_column, media_width, unreadable

PNG = b"\x89PNG"


@pytest.fixture(scope="module")
def episode():
    env = bsk_torch.make("NadirScan-v1", num_envs=1, seed=0, time_limit=700.0)
    return record(scan_rule(env), env, seed=1)


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


def regrets():
    """Regrets of 40 decisions, as an audit has them."""
    rows = [SimpleNamespace(chosen=name, share=share) for name, share in (("nadir scan", 0.75), ("downlink", 0.25))]
    regret = torch.linspace(-1.0, 1.0, 40, dtype=torch.float64).clamp(min=0.0)
    return SimpleNamespace(regret=regret, time=torch.arange(40) * 60.0, by_action=lambda: rows)


@pytest.mark.parametrize("title", ["", "A title of a policy, a preset and some seeds"])
def test_figures_fit_a_column_of_a_paper(tmp_path, episode, title):
    thresholds = torch.linspace(0.0, 1.5, 7)
    fraction = (1.0 - thresholds / 1.5).clamp(0.0, 1.0)
    profiles = dict.fromkeys(("the pretrained policy", "the rule", "random actions"), (fraction, 0.9 * fraction, fraction))
    check_column(timeline, [episode], tmp_path, title)
    check_column(track_map, [episode], tmp_path, title)
    check_column(performance_profiles, [thresholds, profiles], tmp_path, title)
    check_column(regret_figure, [regrets()], tmp_path, title)


@pytest.mark.parametrize("title", ["", "learning"])
def test_learning_curves_fit_a_column_of_a_paper(tmp_path, title):
    log = {"seconds": [1.0, 2.0], "return": [-1.0, 0.5], "survival": [0.0, 1.0], "simulated_days": [1, 2]}
    for width in (WIDTH, COLUMN):
        path = learning_curve(log, tmp_path / f"{width}.pdf", {"rule": (0.4, 0.02)}, title, width=width)
        assert media_width(path) == pytest.approx(width)


def test_texts_that_do_not_fit_are_found():
    figure, (panel,) = panels((1.0,), COLUMN)
    panel.set_xticks([0.0, 0.01, 1.0], ["begin", "later", "end"], fontsize=6.0)
    figure.text(0.99, 0.5, "reaches over the edge", fontsize=9.0)
    found = unreadable(figure)
    assert "'begin' has 6.0 points" in found
    assert "'begin' overlaps 'later'" in found
    assert "'reaches over the edge' is cut off" in found


SEEN = {
    "normal": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
"""Linear RGB as seen, from Machado, Oliveira and Fernandes, 2009, severity 1.0."""

TO_XYZ = [[0.4339, 0.3762, 0.1899], [0.2127, 0.7152, 0.0722], [0.0178, 0.1095, 0.8727]]
"""CIE XYZ of linear sRGB, over that of the white point D65."""


@pytest.mark.parametrize("sight", SEEN)
def test_colors_are_distinct_for_the_color_blind(sight):
    """Also green and red, which the tracks of imagers have for images and for what was not imaged."""
    rgb = np.array([to_rgb(color) for color in PALETTE])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ np.transpose(SEEN[sight]), 0.0, 1.0)
    x, y, z = np.cbrt(seen @ np.transpose(TO_XYZ)).T
    lab = np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], -1)
    apart = np.linalg.norm(lab[:, None] - lab[None], axis=-1)
    assert apart[np.triu_indices(len(PALETTE), 1)].min() > 11.0


def test_names_of_close_lines_are_kept_apart_in_their_order():
    moved = spread([0.5, 0.48, -1.0, 0.51], 0.1)
    assert moved[2] == -1.0
    assert moved[1] < moved[0] < moved[3]
    assert min(moved[0] - moved[1], moved[3] - moved[0]) == pytest.approx(0.1, abs=1e-6)


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
