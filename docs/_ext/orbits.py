"""Tables of ``benchmarks/results/real_orbits.json``: real orbits against Skyfield, ERFA and brahe."""

from __future__ import annotations

from docs._ext.markdown import block, table
from docs._ext.results import load


def orbit_positions() -> str:
    """Return the distances of flown orbits from SGP4's over time, km."""
    result = load("real_orbits")
    head = ["orbit", *(f"{hours:g} h" if hours else "start" for hours in result["hours"])]
    rows = []
    for name, distances in zip(result["orbits"], result["positions"], strict=True):
        rows.append([name, *(f"{meters:.2f} m" if k == 0 else f"{meters / 1e3:.1f} km" for k, meters in enumerate(distances))])
    return table(head, rows)


def orbit_windows() -> str:
    """Return the differences of opening and closing times by orbit, s."""
    result = load("real_orbits")
    rows = [
        [name, str(found["count"]), f"{found['rms']:.2f} s", f"{found['worst']:.2f} s"]
        for name, found in zip(result["orbits"], result["windows"], strict=True)
        if found["count"]
    ]
    return table(["orbit", "times compared", "rms", "worst"], rows)


def orbit_samples() -> str:
    """Return the differences of the sample satellites' positions and windows, and those of all of them."""
    found = load("real_orbits")["samples"]
    rows = [
        [
            name,
            f"{away['rms']:,.0f} m",
            f"{away['worst']:,.0f} m",
            str(edges["count"]),
            f"{edges['rms']:.2f} s",
            f"{edges['worst']:.2f} s",
        ]
        for name, away, edges in zip(found["names"], found["positions"], found["windows"], strict=True)
    ]
    everywhere, worst = found["all"], max(away["worst"] for away in found["positions"])
    times = [f"{everywhere['count']:,}", f"{everywhere['rms']:.2f} s", f"{everywhere['worst']:.2f} s"]
    rows.append(["all", "-", f"{worst:,.0f} m", *times])
    return table(["catalog number", "position, rms", "worst", "times compared", "rms", "worst"], rows)


def orbit_others() -> str:
    """Return the other quantities, and how they were made."""
    result = load("real_orbits")
    names = (
        ("eclipses", "begin and end of the umbra, s, under SGP4's positions and ERFA's Sun", "s"),
        ("sun_arcseconds", "direction of the Sun against ERFA", '"'),
        ("brahe", "SGP4 in GCRF with constants of WGS84, against brahe", "m"),
    )
    rows = [
        [title, str(result[name]["count"]), f"{result[name]['rms']:.3f} {unit}", f"{result[name]['worst']:.3f} {unit}"]
        for name, title, unit in names
        if result[name]
    ]
    versions = ", ".join(f"{name} {version}" for name, version in result["versions"].items())
    command = block("python scripts/validation/real_orbits.py --out benchmarks/results/real_orbits.json")
    return f"{table(['quantity', 'compared', 'rms', 'worst'], rows)}\n\n{command}\n\nMade with {versions}.\n"


TABLES = {
    "orbit_positions": orbit_positions,
    "orbit_windows": orbit_windows,
    "orbit_samples": orbit_samples,
    "orbit_others": orbit_others,
}
