"""``bsk-torch windows``: access windows of real satellites over places, without an environment."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from bsk_torch.cli.declaration import MACHINE, flag
from bsk_torch.cli.shared import check_file
from bsk_torch.cli.terminal import echo, fail, refusing, working
from bsk_torch.files import write_file

FORMS = (".csv", ".json")


def windows(
    tle: Annotated[Path, flag("FILE", "Element sets: two-line sets, or OMM in JSON, CSV or XML.", show_default=False)],
    targets: Annotated[Path, flag("FILE", "Places in degrees on WGS84: .csv, .geojson or .json.", show_default=False)],
    start: Annotated[str, flag("UTC", "Start of the search, such as 2026-04-14T00:00:00Z.", show_default=False)],
    hours: Annotated[float, flag("H", "Length of the search.", min=0.01, max=1000.0)] = 24.0,
    min_elevation: Annotated[float, flag("DEG", "Smallest elevation above the horizon.", min=-5.0, max=89.0)] = 10.0,
    out: Annotated[Path | None, flag("FILE", "File for the windows (.csv, .json); default: CSV on standard output.")] = None,
    gravity: Annotated[str, flag("NAME", "Constants of SGP4: 'wgs72' or 'wgs84'.")] = "wgs72",
    max_age: Annotated[float, flag("DAYS", "Largest age of elements.", min=0.0)] = 30.0,
    backend: Annotated[
        str, flag("NAME", "'compiled', or 'eager', which needs no compiler.", rich_help_panel=MACHINE)
    ] = "compiled",
) -> None:
    """List when satellites are above places on the ground, by SGP4 and the WGS84 ellipsoid.

    Examples:
        bsk-torch windows --tle my.tle --targets my.csv --start 2026-04-14
        bsk-torch windows --tle gp.json --targets my.geojson --start 2026-04-14
    """
    import torch

    from bsk_torch.astro.ephemeris import parse_utc
    from bsk_torch.astro.geodetic import geodetic_to_fixed
    from bsk_torch.formats.intervals import interval_table
    from bsk_torch.formats.orbits import ElementSet, read_orbits
    from bsk_torch.formats.places import read_csv, read_geojson
    from bsk_torch.sim.access.ground_windows import ground_windows

    if out is not None:
        check_file("--out", out, FORMS)
    if backend not in ("compiled", "eager"):
        fail(f"--backend {backend!r} must be 'compiled' or 'eager'")
    torch.set_num_threads(1)
    with refusing():
        satellites = read_orbits(tle, gravity=gravity, max_age_days=max_age)
        places = (read_geojson if targets.suffix in (".geojson", ".json") else read_csv)(targets)
        et = parse_utc(start)
        if not isinstance(satellites[0], ElementSet):
            fail(f"--tle {str(tle)!r} is an ephemeris; windows are those of element sets")
        columns = (places.latitude, places.longitude, places.height)
        latitude, longitude, height = (torch.tensor(column, dtype=torch.float64) for column in columns)
        r_LP_P = geodetic_to_fixed(latitude.deg2rad(), longitude.deg2rad(), height)
    names = [name or f"tgt-{k}" for k, name in enumerate(places.names)]
    cells: dict[str, list[str | None]] = {"satellite": [], "place": []}
    parts, count = [], 0
    with working("searching") as progress, refusing():
        search = ground_windows(satellites, r_LP_P, et, hours * 3600.0, math.radians(min_elevation), backend)
        for k, (satellite, (place, opens, closes)) in enumerate(zip(satellites, search, strict=True), 1):
            cells["satellite"] += [satellite.name] * len(place)
            cells["place"] += [names[i] for i in place.tolist()]
            parts.append(torch.stack([opens, closes]))
            count += len(place)
            progress(f"satellite {k} of {len(satellites)}: {count:,} windows")
    opens, closes = torch.cat(parts, -1)
    text = interval_table(cells, et, opens, closes, "csv" if out is None else out.suffix[1:])
    if out is None:
        echo(text.rstrip("\n"))
        return
    write_file(out, text)
    echo(f"{out}: {count:,} windows of {len(satellites)} satellites over {len(names)} places in {hours:g} h")
