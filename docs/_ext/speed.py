"""Tables of speed, memory and start."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from docs._ext.markdown import code, command, digits, short, table, whole
from docs._ext.results import invocation, load, made, measured, with_command

CASES = {
    "4096": "4096 satellites",
    "4096-float32": "4096 satellites, mixed precision",
    "4096-collector": "4096 satellites, TorchRL's `Collector` with a policy of 2 x 64",
    "4096-wheels": "4096 satellites, four wheels",
    "gymnasium": "one satellite through `gymnasium.make`",
    "gymnasium-own": "the same with two custom properties",
    "1": "one satellite",
    "imaging-1k-1024": "1024 satellites",
    "imaging-1k-64": "64 satellites",
    "imaging-1k-1": "one satellite",
}
"""Labels of the cases of ``vs_basilisk.py``; others are numbers of satellites."""

RECORDED: dict[str, Callable[[float], str]] = {"seconds": "{:.1f}".format, "core_seconds": "{:.1f}".format, "decisions": whole}
"""Columns of records, and how they are written."""

INSPECTIONS = {
    "1": "1,024 inspections, one inspector",
    "1-integrated": "the same, orbits integrated in every tick",
    "3": "1,024 inspections, three inspectors",
    "manoeuvres": "1,024 satellites that change their orbit in every step, and see the windows of the new one",
    "manoeuvres-as-bsk_rl": "the same, windows of the first orbit, as in bsk_rl",
}


def vs_basilisk(name: str) -> str:
    """Return rates here and on Basilisk."""
    rows, cases = [], INSPECTIONS if name == "inspection" else CASES
    for row in load(name)["rows"] if name == "inspection" else sorted(load(name)["rows"], key=by_size):
        words = cases.get(row["case"], f"{row['case']} satellites")
        decisions = [whole(row["decision_rate"])] if "decision_rate" in row else []
        low, high = digits(row["ratio_low"]), digits(row["ratio_high"])
        rows.append(
            [words, whole(row["rate"]), *decisions, whole(row["basilisk_rate"]), digits(row["ratio"]), f"{low} to {high}"]
        )
    decided = ["decisions per core-s"] if "decision_rate" in load(name)["rows"][0] else []
    head = ["case", "simulated s per core-s", *decided, "bsk_rl on Basilisk", "ratio", "range of the ratio"]
    return with_command(name, head, rows)


def rso_imaging(name: str) -> str:
    """Return rates of imaging in orbit, here and on Basilisk."""
    rows = []
    for row in load(name)["rows"]:
        spread = " to ".join(digits(row[key]) for key in ("ratio_low", "ratio_high"))
        counts = [whole(row["batch"]), str(row["imagers"]), str(row["targets"])]
        rates = [whole(row[key]) for key in ("rate", "decision_rate", "basilisk_rate")]
        rows.append([*counts, *rates, digits(row["ratio"]), spread])
    rates = ["simulated s per core-s", "decisions per core-s", "bsk_rl on Basilisk"]
    head = ["episodes", "imagers", "objects", *rates, "ratio", "range of the ratio"]
    return with_command(name, head, rows)


def rso_catalogs(name: str) -> str:
    """Return what catalogs cost."""
    rows = []
    for row in load(name)["catalogs"]:
        low, high = (whole(row[f"decision_us_{end}"]) for end in ("low", "high"))
        memory = [f"{row[key]:.1f}" for key in ("orbits_kb", "state_kb")]
        times = [whole(row["reset_us"]), f"{whole(row['decision_us'])} ({low} to {high})", whole(row["simulated"])]
        rows.append([str(row["targets"]), whole(row["batch"]), *memory, *times])
    memory = ["kB of orbits", "kB of all state"]
    head = ["objects", "environments", *memory, "reset, us", "decision, us (quartiles)", "simulated s in a decision"]
    return with_command(name, head, rows)


def by_size(row: Mapping[str, Any]) -> tuple[int, str]:
    """Return the number of satellites of a case of ``vs_basilisk.py``, and its name, by which cases are sorted."""
    counts = [int(word) for word in row["case"].split("-") if word.isdigit()]
    return (counts or [1])[0], row["case"]


def constellations(name: str) -> str:
    """Return rates of constellations."""
    rows = []
    for row in load(name)["rows"]:
        ratio = whole(row["ratio"]) if "ratio" in row else "not measured"
        rows.append([str(row["satellites"]), str(row["batch"]), whole(row["rate"]), f"{row['step']:.0f}", ratio])
    head = ["satellites", "episodes", "satellite-seconds per core-s", "seconds per step", "ratio to bsk_rl"]
    return with_command(name, head, rows)


def breakdown() -> str:
    """Return where the time of a step goes."""
    rows = [row for row in load("breakdown")["rows"] if "part" in row]
    cells = [[str(row["batch"]), row["part"], whole(row["us"]), f"{row['percent']:.1f}"] for row in rows]
    return with_command("breakdown", ["satellites", "part of a step", "us per step", "%"], cells)


def training_profile() -> str:
    """Return where the time of a training goes."""
    rows = load("training_profile")["rows"]
    cells = [[row["case"], row["phase"], f"{row['us']:.1f}", f"{row['percent']:.1f}"] for row in rows]
    return with_command("training_profile", ["training", "phase", "us per decision", "%"], cells)


def records() -> str:
    """Return the times of trainings until they reach thresholds, and the commands that measured them."""
    rows, commands = [], []
    for row in load("records")["rows"]:
        runs, where = row["runs"], row["machine"]
        times = {key: " / ".join(form(run[key]) if run["reached"] else "-" for run in runs) for key, form in RECORDED.items()}
        count = f"{sum(run['reached'] for run in runs)} of {len(runs)}"
        place = f"{where['cores']} cores, {row['processor']}, load {where['load']:.1f}"
        rows.append(
            [row["task"], row["threshold"], row["name"], count, *times.values(), place, code(where["commit"]), row["date"]]
        )
        commands += [command(invocation("speedrun", "records", row["options"]))]
    head = ["task", "threshold", "trained by", "reached", "wall, s", "core-seconds", "decisions", "machine", "commit", "date"]
    return "\n\n".join([table(head, rows), *commands]) + "\n"


def learner_limit() -> str:
    """Return the rates of trainings with many collecting processes, simulated and measured."""
    cells = []
    for row in load("learner_limit")["rows"]:
        processes = f"{row['workers']}{', ahead' if row['ahead'] else ''}" if row["workers"] else "none, the learner collects"
        measured = whole(row["measured"]) if "measured" in row else "-"
        cells.append([row["case"], processes, whole(row["simulated"]), f"{row['busy']:.0%}", measured])
    head = ["training", "collecting processes", "decisions per second, simulated", "learner busy", "measured"]
    return with_command("learner_limit", head, cells)


def viewer_frames() -> str:
    """Return the frames per second of the viewer's page."""
    rows = [
        [
            row["view"],
            f"{row['rate']:.1f}",
            f"{row['rate_least']:.1f} to {row['rate_most']:.1f}",
            f"{row['detail']:.2f}",
            f"{row['cpu']:.0f}",
        ]
        for row in load("viewer_frames")["rows"]
    ]
    head = ["view", "frames a second", "range of turns", "resolution", "CPU ms a frame"]
    made_by = command(invocation("viewer_frames", "viewer_frames", load("viewer_frames")["options"]))
    return f"{table(head, rows)}\n\n{made_by}\n"


def startup() -> str:
    """Return the time until the first step is done."""
    kept = {"nothing": "nothing compiled before", "everything": "everything compiled before"}
    rows = []
    for row in load("startup")["rows"]:
        times = [f"{row[name]:.2f}" for name in ("construction", "reset", "step")]
        rows.append([str(row["batch"]), row["dtype"], kept[row["cache"]], *times])
    return with_command("startup", ["satellites", "precision", "cache", "construction, s", "reset, s", "first step, s"], rows)


def recordings() -> str:
    """Return what recordings at tick resolution cost."""
    rows = []
    for row in load("recording")["rows"]:
        times = [f"{row[name]:.3g}" for name in ("without_ms", "with_ms", "ratio", "bytes")]
        rows.append([str(row["batch"]), str(row["rows"]), str(row["every"]), *times])
    head = ["environments", "recorded", "every", "a step without, ms", "with, ms", "ratio", "bytes a record"]
    return with_command("recording", head, rows)


def resets() -> str:
    """Return the cost of resetting rows of a batch."""
    rows = []
    for row in load("reset")["rows"]:
        times = [f"{row[name]:.1f}" for name in ("ready_ms", "used_ms", "all_used_ms", "whole_ms")]
        rows.append([whole(row["rows"]), *times])
    head = ["rows that end", "prepared, ms", "not prepared, ms", "none of the batch prepared, ms", "a batch of that size, ms"]
    shares = [
        [str(share["batch"]), f"{100 * share['share']:.0f}", f"{share['episode_ms']:.2f}"] for share in load("reset")["shares"]
    ]
    in_rollouts = table(["satellites", "share of resets in a random rollout, %", "a new episode, ms"], shares)
    return f"{table(head, rows)}\n\n{in_rollouts}\n\n{made('reset')}"


def memory() -> str:
    """Return bytes of an environment, and the memory of a long rollout."""
    result = load("memory")
    rows = [[code(row["what"]), whole(row["per_env"])] for row in result["rows"] if row["per_env"] >= 50]
    flat = [point["megabytes"] for point in result["flatness"]]
    steps = result["flatness"][-1]["steps"]
    line = f"Memory of the process along {whole(steps)} steps: {whole(min(flat))} to {whole(max(flat))} MB."
    return f"{table(['part', 'bytes per environment'], rows)}\n\n{line}\n\n{made('memory')}"


def soak() -> str:
    """Return the long runs: first, smallest to largest and last of ten points."""
    cases: dict[str, list[dict[str, Any]]] = {}
    for row in load("soak")["rows"]:
        cases.setdefault(row["case"], []).append(row)
    rows = []
    for case, points in cases.items():
        last = points[-1]
        sums = [whole(last["steps"]), whole(last["simulated"]), whole(last["ended"])]
        bad = str(sum(point["not_finite"] for point in points))
        rows.append([case, *sums, course(points, "megabytes", 0), course(points, "cpu", 1), bad, short(last["drift"])])
    head = ["case", "steps", "simulated s", "episodes ended", "memory, MB", "CPU ms per step", "not finite", "clock error, s"]
    return with_command("soak", head, rows)


def course(points: Sequence[Mapping[str, Any]], name: str, count: int) -> str:
    """Return the first of some points, their range, and the last."""
    values = [point[name] for point in points]
    first, low, high, last = (f"{value:,.{count}f}" for value in (values[0], min(values), max(values), values[-1]))
    return f"{first}, {low} to {high}, {last}"


def communications() -> str:
    """Return what communication is worth to rules."""
    rows = []
    for row in load("communication")["rows"]:
        gain = "-" if row["communication"] == "none" else f"{row['gain']:+.2f} ± {row['gain_half']:.2f}"
        names = code(row["preset"]), row["rule"], row["communication"]
        rows.append([*names, f"{row['value']:.2f} ± {row['half']:.2f}", gain, f"{row['in_view']:.2f}"])
    head = ["preset", "rule", "communication after every step", "return", "gain over none", "all targets in view"]
    return with_command("communication", head, rows)


def aeos_speed(name: str) -> str:
    """Return rates of AEOS-Bench, here and on Basilisk."""
    rows = [
        [
            str(row["satellites"]),
            str(row["tasks"]),
            str(row["batch"]),
            f"{row['step']:g}",
            whole(row["rate"]),
            measured(row["basilisk_rate"], 0),
            f"{measured(row['ratio'], 0)} ({measured(row['low'], 0)} to {measured(row['high'], 0)})",
        ]
        for row in load(name)["rows"]
    ]
    titles = ["satellites", "tasks", "episodes", "s per choice", "satellite-s per core-s", "on Basilisk", "ratio"]
    return with_command(name, titles, rows)


TABLES: dict[str, Callable[..., str]] = {
    "communications": communications,
    "vs_basilisk": vs_basilisk,
    "rso_imaging": rso_imaging,
    "rso_catalogs": rso_catalogs,
    "constellations": constellations,
    "breakdown": breakdown,
    "training_profile": training_profile,
    "learner_limit": learner_limit,
    "records": records,
    "startup": startup,
    "viewer_frames": viewer_frames,
    "recordings": recordings,
    "resets": resets,
    "memory": memory,
    "soak": soak,
    "aeos_speed": aeos_speed,
}
"""Tables by name."""
