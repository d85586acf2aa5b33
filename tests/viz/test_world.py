"""The map shows the Earth's land, and lines run across its edges."""

import math

import pytest
import torch
from matplotlib.figure import Figure
from matplotlib.path import Path as MapPath

from bsk_torch.viz.figures.world import land, pieces, world_map


@pytest.mark.parametrize(
    ("longitude", "latitude", "dry"),
    [
        (-105.0, 39.7, True),  # Denver
        (13.4, 52.5, True),  # Berlin
        (151.0, -33.5, True),  # inland of Sydney
        (0.0, -85.0, True),  # Antarctica
        (-105.0, 39.7 - 60.0, False),  # Pacific
        (51.0, 42.0, False),  # Caspian Sea
        (0.0, 0.0, False),  # Gulf of Guinea
    ],
)
def test_places_are_on_land_or_at_sea(longitude, latitude, dry):
    rings = [MapPath(ring) for ring in land().to_polygons(closed_only=False)]
    assert sum(ring.contains_point((longitude, latitude)) for ring in rings) % 2 == dry  # twice: an inland sea


def test_land_covers_29_percent_of_the_earth():
    area = 0.0  # of all rings: the integral of -sin(latitude) over longitude, inland seas count against
    for ring in land().to_polygons(closed_only=False):
        x, y = torch.deg2rad(torch.tensor(ring)).unbind(-1)
        area -= float((x.diff() * 0.5 * (torch.sin(y[1:]) + torch.sin(y[:-1]))).sum())
    # 29.2 % of the Earth is land; outlines at 1:110 million leave small islands out and straighten coasts
    assert area / (4.0 * math.pi) == pytest.approx(0.292, abs=0.005)


def test_the_map_is_the_whole_world():
    panel = Figure().subplots()
    world_map(panel)
    assert (panel.get_xlim(), panel.get_ylim()) == ((-180.0, 180.0), (-90.0, 90.0))
    assert [text.get_text() for text in panel.get_yticklabels()] == ["90°S", "60°S", "30°S", "0°", "30°N", "60°N", "90°N"]


def test_a_line_over_the_date_line_reaches_both_edges():
    longitude, latitude = torch.tensor([170.0, 178.0, -176.0, -170.0]), torch.tensor([0.0, 4.0, 7.0, 9.0])
    plain, torn, _ = pieces(longitude, latitude)
    assert plain[:2].tolist() == [[170.0, 0.0], [178.0, 4.0]]
    assert bool(plain[2:].isnan().all())
    assert torn[:2].tolist() == [[178.0, 4.0], [184.0, 7.0]]
    assert bool(torn[2].isnan().all())
    assert torn[3:].tolist() == [[-182.0, 4.0], [-176.0, 7.0]]
    back = pieces(longitude.flip(0), latitude.flip(0))[1]
    assert back[:2].tolist() == [[-176.0, 7.0], [-182.0, 4.0]]
    assert back[3:].tolist() == [[184.0, 7.0], [178.0, 4.0]]
