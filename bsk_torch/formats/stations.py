"""Ground stations by name from a table of public networks, or from a file."""

from __future__ import annotations

import functools
from pathlib import Path

from bsk_torch.formats.places import PlaceList, read_csv
from bsk_torch.sim.names import nearest

TABLE = Path(__file__).with_name("stations.csv")
"""Stations of KSAT, NASA's Near Space and Deep Space Networks and SSC, as in the data sets of brahe 1.8.0 (MIT license).

Places are given to 0.01 degrees or better, without heights. ``scripts/tools/station_table.py`` makes the table.
"""


@functools.cache
def _table() -> dict[str, dict[str, object]]:
    return {str(station["name"]): station for station in _stations(read_csv(TABLE))}


def station_names() -> list[str]:
    """Return the names of the stations of the table."""
    return list(_table())


def ground_stations(*names: str) -> list[dict[str, object]]:
    """Return stations of the table as ``world_args["groundStationsData"]``: dictionaries of name, lat, long (degrees), elev (m).

    ValueError for an unknown name; :func:`station_names` lists all.
    """
    table = _table()
    for name in names:
        if name not in table:
            raise ValueError(f"{name!r} is not in the table of ground stations; {nearest(name, table)}")
    return [dict(table[name]) for name in names]


def read_stations(source: str | Path) -> list[dict[str, object]]:
    """Return the stations of a CSV file as ``world_args["groundStationsData"]``; columns as in :func:`~.places.read_csv`.

    ValueError for a file that cannot be read as such, or equal names.
    """
    stations = _stations(read_csv(source))
    names = [station["name"] for station in stations]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{str(source)!r} has {names.count(name)} stations named {name!r}; names must differ")
    return stations


def _stations(places: PlaceList) -> list[dict[str, object]]:
    columns = zip(places.names, places.latitude, places.longitude, places.height, strict=True)
    return [
        {"name": name or f"station-{k}", "lat": lat, "long": long, "elev": elev}
        for k, (name, lat, long, elev) in enumerate(columns)
    ]
