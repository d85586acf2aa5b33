"""Write bsk_torch/formats/stations.csv from the ground stations in brahe, which must be installed: pip install brahe.

Of stations that networks share, the first network's entry is kept.
"""

from __future__ import annotations

import csv
from pathlib import Path

import brahe

NETWORKS = ("ksat", "nasa nen", "nasa dsn", "ssc")
TABLE = Path(__file__).parents[2] / "bsk_torch" / "formats" / "stations.csv"


def main() -> None:
    """Write the table."""
    rows = {}
    for network in NETWORKS:
        for station in brahe.datasets.groundstations.load(network):
            rows.setdefault(station.get_name(), (station.get_name(), station.lat, station.lon, network))
    with TABLE.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("name", "latitude", "longitude", "network"))
        writer.writerows(rows.values())


if __name__ == "__main__":
    main()
