"""Make `bsk_torch/viz/figures/land_110m.geojson`, the land that maps show, from Natural Earth's countries at 1:110 million.

    pip install pyshp shapely
    pip download --no-deps geopandas==0.14.4
    python scripts/tools/make_coastlines.py geopandas-0.14.4-py3-none-any.whl

The wheel is the last one of geopandas that carries the data; nothing else of it is used. Natural Earth is in the public domain
(https://www.naturalearthdata.com/about/terms-of-use). Borders between countries are dissolved, so only coasts are left.
"""

from __future__ import annotations

import argparse
import io
import json
import zipfile
from pathlib import Path

import shapefile
from shapely import orient_polygons, set_precision, unary_union
from shapely.geometry import MultiPolygon, mapping, shape

LAND_FILE = Path(__file__).resolve().parents[2] / "bsk_torch/viz/figures/land_110m.geojson"

COUNTRIES = "geopandas/datasets/naturalearth_lowres/naturalearth_lowres.{}"

SNAP = 1e-6
"""Degrees within which neighbors share a border."""

DIGITS = 2
"""Decimals of degrees that are kept: a kilometer, where the data are good to tens of them."""

SLIVER = 0.02
"""Smaller areas, degrees^2, are gaps between neighbors or would not be seen."""


def countries(wheel: Path) -> list[shapefile.Shape]:
    """Outlines of all countries in the wheel of geopandas."""
    with zipfile.ZipFile(wheel) as archive:
        parts = {kind: io.BytesIO(archive.read(COUNTRIES.format(kind))) for kind in ("shp", "shx", "dbf")}
    return list(shapefile.Reader(**parts).shapes())


def land(outlines: list[shapefile.Shape]) -> MultiPolygon:
    """All countries as one, with seas inside such as the Caspian; outer rings run counterclockwise, inner ones clockwise."""
    whole = unary_union([set_precision(shape(outline.__geo_interface__), SNAP) for outline in outlines])
    parts = [part for part in whole.geoms if part.area > SLIVER]
    kept = [type(part)(part.exterior, [hole for hole in part.interiors if type(part)(hole).area > SLIVER]) for part in parts]
    return orient_polygons(MultiPolygon(sorted(kept, key=lambda part: -part.area)))


def main() -> None:
    """Read the wheel that the command line names, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheel", type=Path, help="geopandas-0.14.4-py3-none-any.whl")
    parser.add_argument("--out", type=Path, default=LAND_FILE, metavar="FILE.geojson")
    options = parser.parse_args()
    polygons = mapping(land(countries(options.wheel)))["coordinates"]
    rounded = [[[[round(x, DIGITS), round(y, DIGITS)] for x, y in ring] for ring in polygon] for polygon in polygons]
    source = "Natural Earth, 1:110 million, public domain; made by scripts/tools/make_coastlines.py"
    written = {"type": "MultiPolygon", "source": source, "coordinates": rounded}
    options.out.write_text(json.dumps(written, separators=(",", ":")) + "\n")
    print(f"{options.out}: {len(rounded)} pieces of land, {options.out.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
