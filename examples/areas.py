"""
Your polygons as a task
=======================

Read areas from GeoJSON, let a rule and chance cover them, and draw the better flight.

On the command line::

    python examples/areas.py
    python examples/areas.py --file my_areas.geojson --cell 50e3 --swath 120e3 --figure my_areas.png

Without a file, the areas are the Mediterranean countries' rough outlines written below. An instrument fills its store whatever
lies below, so that it has to be switched on where it matters; see :mod:`bsk_torch.tasks.areas`. The example needs the extras
``areas`` and, for the figure, ``viz``.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import bsk_torch
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.tasks.areas import Areas, read_areas

OUTLINES = {
    "Iberia": [[-9.3, 37.0], [-2.0, 36.7], [3.2, 42.3], [-1.8, 43.4], [-9.2, 43.2]],
    "Italy": [
        [7.0, 44.0],
        [12.0, 41.8],
        [15.7, 38.0],
        [18.4, 40.2],
        [13.5, 43.6],
        [13.7, 46.5],
        [7.5, 46.0],
    ],
    "Anatolia": [
        [26.3, 39.5],
        [30.5, 36.5],
        [36.2, 36.2],
        [44.5, 37.3],
        [43.5, 41.2],
        [35.0, 42.0],
        [29.0, 41.2],
    ],
    "Egypt": [[25.0, 22.0], [35.5, 22.0], [34.2, 31.3], [25.0, 31.6]],
}
"""Vertices, [longitude, latitude] degrees."""


def write_outlines(path: Path) -> Path:
    """Write :data:`OUTLINES` as GeoJSON, each as important as the others."""
    features = [
        {
            "type": "Feature",
            "properties": {"name": name},
            "geometry": {"type": "Polygon", "coordinates": [[*ring, ring[0]]]},
        }
        for name, ring in OUTLINES.items()
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def main() -> None:
    """Read areas, evaluate the rule and random actions, and draw an episode of the rule."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[1])
    parser.add_argument("--file", type=Path, help="GeoJSON with polygons")
    parser.add_argument("--cell", type=float, default=100e3, help="side of a cell, m")
    parser.add_argument(
        "--swath", type=float, default=300e3, help="width of the recorded ground, m"
    )
    parser.add_argument("--num-envs", type=int, default=32)
    parser.add_argument("--time-limit", type=float, default=28500.0)
    parser.add_argument("--figure", type=Path, help="file of a map, .png")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        areas = read_areas(
            options.file or write_outlines(Path(folder) / "areas.geojson"), options.cell
        )
    print(f"{len(areas)} areas of {sum(len(area.share) for area in areas)} cells")
    common = dict(scenario=Areas(areas, options.swath), time_limit=options.time_limit)
    env = bsk_torch.make("Areas-v1", num_envs=options.num_envs, **common)
    for name in ("random", "areas"):
        result = evaluate(bsk_torch.rule(name, env), env, seed=0)
        print(
            f"{name}: return {result.mean_return}, area covered {result.measures['area_covered'].mean():.1%}"
        )
    if options.figure:
        from bsk_torch.viz.episodes import draw, record

        one = bsk_torch.make("Areas-v1", num_envs=1, **common)
        draw(
            record(bsk_torch.rule("areas", one), one, seed=0),
            options.figure,
            "the rule 'areas'",
        )


if __name__ == "__main__":
    main()
