"""Tables of bounds and schedules."""

from __future__ import annotations

import json
from collections.abc import Callable

from docs._ext.markdown import code, short, table, whole
from docs._ext.results import ROOT, load, made, quantity, with_command


def envelope() -> str:
    """Return least times between images, with the transitions that they were fitted to."""
    fitted = json.loads((ROOT / "bsk_torch" / "lab" / "bounds" / "agile.json").read_text())
    rows = []
    for row in load("envelope")["rows"]:
        k = round(row["low"] / fitted["width"])
        times = [fitted["direct"][k] * fitted["step"], fitted["any"][k] * fitted["step"], row["median"]]
        rows.append([f"{row['low']:.1f} to {row['high']:.1f}", whole(row["count"]), *(f"{seconds:.1f}" for seconds in times)])
    head = ["angle, rad", "transitions", "least in one step, s", "least, s", "median in one step, s"]
    return with_command("envelope", head, rows)


def sustained() -> str:
    """Return times between images that satellites cannot beat for long, with those of recorded flights."""
    fitted = json.loads((ROOT / "bsk_torch" / "lab" / "bounds" / "agile_sustained.json").read_text())
    rows = []
    for row in load("sustained")["rows"]:
        k = min(round(row["low"] / fitted["width"]), len(fitted["direct"]) - 1)
        times = [f"{seconds:.1f}" for seconds in (fitted["direct"][k] * fitted["step"], row["tenth"], row["median"])]
        rows.append([f"{row['low']:.2f} to {row['high']:.2f}", whole(row["count"]), *times])
    return table(["angle, rad", "transitions", "sustained, s", "quickest tenth, s", "median, s"], rows) + "\n"


def largest_leads(name: str) -> str:
    """Return how far ahead of the sustained times flights get that the fit has not seen, and how late their images come."""
    rows = []
    for row in load(name)["leads"]:
        values = [f"{row['largest']:.1f}", f"{row['latest']:.1f}", f"{row['lateness']:.2f}", whole(row["beyond"])]
        rows.append([code(row["task"]), row["policy"], whole(row["images"]), *values])
    head = ["task", "policy", "images", "largest lead, s", "latest image, s", "lateness, s in 1,000 s", "flights beyond"]
    return with_command(name, head, rows)


def bounds(*tasks: str) -> str:
    """Return how near policies come to their bounds in some tasks."""
    rows = []
    for row in load("bounds")["rows"]:
        if row["policy"] == "random" or row["task"] not in tasks:
            continue
        values = [f"{row['value']:.2f} ± {row['half']:.2f}", f"{row['bound']:.2f}", f"{row['share']:.1%}", short(row["smallest"])]
        rows.append([code(row["task"]), row["policy"], *values, f"{row['seconds']:.2f}", code(row["commit"])])
    head = ["task", "policy", "return", "bound", "share", "smallest difference", "s for each bound", "commit"]
    return table(head, rows) + "\n"


def bounds_made() -> str:
    """Return the command that writes the bounds, and what all of its flights show together."""
    rows = load("bounds")["rows"]
    flights, least = sum(row["episodes"] for row in rows), min(row["smallest"] for row in rows)
    return f"{made('bounds')}\n{whole(flights)} flights, random actions included; the smallest difference is {short(least)}.\n"


def schedules() -> str:
    """Return what schedules reach alongside other policies and the bound."""
    rows = []
    for row in load("milp")["rows"]:
        value = f"{row['value']:.1f} ± {row['half']:.1f}"
        gain = "-" if row["policy"] == "hasty" else f"{row['gain']:+.2f} ± {row['gain_half']:.2f}"
        rows.append([whole(row["targets"]), row["policy"], value, gain, f"{row['share']:.1%}", short(row["seconds"])])
    head = ["targets", "policy", "return", "gain over *hasty*", "share of the bound", "s for each episode"]
    return with_command("milp", head, rows)


def relaxations() -> str:
    """Return what the relaxation allows with several times between images."""
    rows = []
    for row in load("relaxation")["rows"]:
        values = [f"{row[name]:.2f}" for name in ("in_view", "bound", "schedule", "planner")]
        made = [f"{row['cell']:.1f}", short(row["seconds"]), code(row["commit"])]
        rows.append([whole(row["targets"]), row["times"], *values, whole(row["knapsack"]), *made])
    head = [
        "targets",
        "times between images",
        "in view",
        "bound",
        "schedule",
        "planner",
        "quickest transitions, s",
        "cell, s",
        "s for each bound",
        "commit",
    ]
    return with_command("relaxation", head, rows)


def resources() -> str:
    """Return how much energy and storage there is for images."""
    rows = [[row["name"], *(quantity(row[name]) for name in ("least", "mean", "largest"))] for row in load("resources")["rows"]]
    return with_command("resources", ["quantity of an episode", "least", "mean", "largest"], rows)


TABLES: dict[str, Callable[..., str]] = {
    "envelope": envelope,
    "sustained": sustained,
    "largest_leads": largest_leads,
    "bounds": bounds,
    "bounds_made": bounds_made,
    "schedules": schedules,
    "relaxations": relaxations,
    "resources": resources,
}
"""Tables by name."""
