"""Tables of ``benchmarks/results/truth.json``: largest differences from Basilisk, alongside the bounds of the tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from docs._ext.markdown import block, code, short, table
from docs._ext.results import load

QUANTITIES = {
    "time": ("end of steps", "s"),
    "r": ("position", "m"),
    "v": ("velocity", "m/s"),
    "sigma": ("attitude (MRP)", "1"),
    "omega": ("body rate", "rad/s"),
    "wheel_speed": ("wheel speed", "rad/s"),
    "battery": ("battery", "J"),
    "storage": ("data buffer", "bit"),
    "illumination": ("illumination", "1"),
    "observation": ("observations", "their units"),
    "window": ("access windows", "s"),
    "reward": ("reward", "1"),
    "paid": ("reward of each satellite", "1"),
    "duration": ("length of steps", "s"),
}
"""Names and units of what is compared, in the order of the tables."""


def rows_of(group: str) -> list[dict[str, Any]]:
    """Return the replays of a group."""
    return [row for row in load("truth")["rows"] if row["group"] == group]


def truth(*groups: str) -> str:
    """Return the largest difference of each quantity over the recordings of each group, and the loosest bound of a test."""
    each = {group: rows_of(group) for group in groups}
    names = [name for name in QUANTITIES if any(name in row["largest"] for rows in each.values() for row in rows)]
    lines = []
    for name in names:
        cells = [*QUANTITIES[name]]
        for rows in each.values():
            cells += [extreme(rows, "largest", name), extreme(rows, "bounds", name)]
        lines.append(cells)
    head = ["quantity", "unit"]
    for group in groups:
        head += [
            "largest difference" if len(groups) == 1 else f"{group}: largest",
            "bound" if len(groups) == 1 else f"{group}: bound",
        ]
    return f"{table(head, lines)}\n"


def extreme(rows: Sequence[Mapping[str, Any]], kind: str, name: str) -> str:
    """Return the largest value of a quantity among some replays, or a dash."""
    values = [row[kind][name] for row in rows if name in row[kind]]
    return short(max(values)) if values else "-"


def by_recording(group: str) -> str:
    """Return the differences of each recording of a group."""
    rows = rows_of(group)
    names = [name for name in QUANTITIES if any(row["largest"].get(name) for row in rows)]
    head = ["recording", *(f"{QUANTITIES[name][0]}, {QUANTITIES[name][1]}" for name in names)]
    return table(head, [[code(row["recording"]), *(extreme([row], "largest", name) for name in names)] for row in rows]) + "\n"


def equal(group: str) -> str:
    """Return what is equal in every replay of a group."""
    rows = rows_of(group)
    names = list(dict.fromkeys(name for row in rows for name in row["exact"]))
    same = [name for name in names if all(row["exact"].get(name, True) for row in rows)]
    count = f"{len(rows)} recordings" if len(rows) > 1 else "the recording"
    return f"Equal in every step of {count}: {', '.join(same)}.\n"


def truth_made() -> str:
    """Return the command, and the versions of both sides."""
    result = load("truth")
    ours, theirs = (
        ", ".join(f"{name} {version}" for name, version in result[key].items()) for key in ("versions", "recorded with")
    )
    command = block("python scripts/validation/truth.py --out benchmarks/results/truth.json")
    return f"{command}\n\nReplayed with {ours}. Recorded with {theirs}.\n"


def random_problems() -> str:
    """Return how random problems compare with bsk_rl on Basilisk, by package."""
    words = ("same", "chaos", "error", "explained", "different")
    rows = [
        [code(library), str(part["cases"]), str(part["steps"]), *(str(part["results"].get(word, 0)) for word in words)]
        for library, part in load("differential").items()
    ]
    return table(["package", "problems", "steps", *words], rows)


TABLES = {
    "random_problems": random_problems,
    "truth": truth,
    "by_recording": by_recording,
    "equal": equal,
    "truth_made": truth_made,
}
