"""Tables of flights on Basilisk."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from docs._ext.markdown import block, code, command, short, table, whole
from docs._ext.results import load, quantity


def flights(*names: str) -> str:
    """Return what policies did here and on Basilisk."""
    rows = []
    for name in names:
        flight = load(name)
        summary, episodes = flight["summary"], flight["episodes"]
        here, there, count = summary["bsk_torch"], summary["basilisk"], len(episodes["seed"])
        rows.append(
            [
                flown(flight),
                f"{episodes['seed'][0]} to {episodes['seed'][-1]}",
                f"{summary['same_actions']} of {count}",
                whole(sum(episodes["decisions"])),
                f"{here['return'][0]:.4f} / {there['return'][0]:.4f}",
                f"{here['survival'][0]:.0%} / {there['survival'][0]:.0%}",
                short(max(episodes["observation_difference"])),
            ]
        )
    head = ["policy", "seeds", "all actions equal", "decisions", "return here / on Basilisk", "survival here / there"]
    versions = load(names[0])["versions"]
    used = ", ".join(f"{package} {number}" for package, number in versions.items())
    commands = [flight_command(name) for name in names]
    filled = table([*head, "largest difference of an observation"], rows)
    return f"{filled}\n\n{block(chr(10).join(commands))}\n\nVersions: {used}.\n"


def releases(name: str) -> str:
    """Return since which release of Basilisk results differ, by preset."""
    rows = load(name)["rows"]
    presets = list(load(name)["flights"])
    found = {(row["release"], row["preset"]): verdict(row) for row in rows}
    numbers = dict.fromkeys(row["release"] for row in rows)
    cells = [[number, *(found[number, preset] for preset in presets)] for number in numbers]
    return f"{table(['release', *map(code, presets)], cells)}\n\n{drift_made(name)}"


def verdict(row: Mapping[str, Any]) -> str:
    """Return how a release differs from the one before it."""
    if "error" in row:
        return code(row["error"])
    if "previous" not in row:
        return "first"
    if not any(row["previous"].values()):
        return "identical"
    parts = [f"{key} {quantity(row['previous'][key])} ({quantity(row['twin'][key])})" for key in row["changed"]]
    return f"changed: {'; '.join(parts)}" if parts else "rounding"


def release_differences(name: str, preset: str) -> str:
    """Return the largest difference of each quantity from the last release and from bsk_torch, identical releases in a column."""
    groups: list[list[dict[str, Any]]] = []
    for row in load(name)["rows"]:
        if row["preset"] != preset or "error" in row:
            continue
        if groups and not any(row["previous"].values()):
            groups[-1].append(row)
        else:
            groups.append([row])
    sides = {"latest": f"from {groups[-1][-1]['release']}", "here": "from bsk_torch", "twin": "from the twin"}
    if len(groups) == 1:  # which is the last one
        del sides["latest"]
    cells = [
        [key, *(" / ".join(quantity(group[0][side][key]) for side in sides) for group in groups)] for key in groups[0][0]["here"]
    ]
    labels = [" to ".join(dict.fromkeys([group[0]["release"], group[-1]["release"]])) for group in groups]
    flight = load(name)["flights"][preset]
    decisions, seconds = whole(sum(flight["decisions"])), whole(sum(flight["seconds"]))
    about = f"Largest difference {' / '.join(sides.values())}, over {decisions} decisions in {seconds} simulated s."
    return f"{about}\n\n{table(['quantity', *labels], cells)}\n"


def drift_made(name: str) -> str:
    """Return the command that compares releases, and the versions."""
    result = load(name)
    words = ["python scripts/validation/drift.py", f"--presets {' '.join(result['flights'])}"]
    words += [f"--seeds {':'.join(map(str, result['seeds']))}"]
    if result["time_limit"] is not None:
        words += [f"--time-limit {result['time_limit']:g}"]
    if result["give"]:
        words += [f"--releases {' '.join(dict.fromkeys(row['release'] for row in result['rows']))}"]
        words += [f"--give {' '.join(f'{key}={value!r}' for key, value in result['give'].items())}"]
    words += [f"--out benchmarks/results/{name}.json"]
    used = ", ".join(f"{package} {number}" for package, number in result["versions"].items())
    return f"{command(words)}\n\nVersions: {used}.\n"


PAPERS = "NadirScan-v1"
"""Default preset of flights."""


def flight_command(name: str) -> str:
    """Return the command that writes a flight."""
    flight = load(name)
    seeds = flight["episodes"]["seed"]
    out, script = f"--out benchmarks/results/{name}.json", flight.get("script", "fly_on_basilisk.py")
    preset = "" if "script" in flight or flight["preset"] == PAPERS else f" --preset {flight['preset']}"
    return f"python scripts/validation/{script} {flown(flight)}{preset} --seeds {seeds[0]}:{seeds[-1] + 1} {out}"


def flown(flight: Mapping[str, Any]) -> str:
    """Return the name of a policy that has flown."""
    if flight["policy"] == f"{flight['preset']}.pt":
        return "pretrained"
    return " ".join([flight["policy"], *(f"--plan {option}" for option in flight.get("plan", []))])


def failures() -> str:
    """Return what the search among the deaths of the pretrained policy found."""
    found = load("failures_nadir_scan")
    chance, starts = found["last_chances"], found["starts"]
    deaths = ", ".join(f"{count} {cause.removesuffix('_valid')}" for cause, count in found["causes"].items())
    rows = [
        ["episodes", whole(found["episodes"])],
        ["deaths", deaths],
        ["deaths with a sequence of actions that would have survived", str(found["saved"])],
        ["deaths without one, proven", str(found["lost"])],
        ["undecided", str(found["open"])],
        [
            "charge at the last decision that could have changed it",
            " to ".join(f"{100 * chance['charge'][k]:.1f} %" for k in (0, -1)),
        ],
        ["starts tried with a fixed sequence of actions", whole(starts["seeds"][1] - starts["seeds"][0])],
        ["starts that it survived", whole(starts["survived"])],
    ]
    seeds = f"--seeds {found['seeds'][0]}:{found['seeds'][1]}"
    words = ["bsk-torch explain pretrained", "--preset NadirScan-v1", seeds, "--out benchmarks/results/failures_nadir_scan.json"]
    return f"{table(['quantity', 'value'], rows)}\n\n{command(words)}\n"


TABLES: dict[str, Callable[..., str]] = {
    "flights": flights,
    "releases": releases,
    "release_differences": release_differences,
    "drift_made": drift_made,
    "failures": failures,
}
"""Tables by name."""
