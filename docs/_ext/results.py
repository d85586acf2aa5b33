"""Tables of ``benchmarks/results/*.json``, each with the command that writes the file and with the machine."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from docs._ext.markdown import block, code, command, digits, short, table, whole

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results"

SCRIPTS = {
    "teams_prompt": "teams",
    "crews_three": "crews",
    "crews_walker": "crews",
    "services_leo": "services",
    "services_trained": "services",
    "aeos_real": "aeos_bench",
    "aeos_random": "aeos_bench",
    "aeos_generated": "aeos_bench",
    "vs_basilisk_imaging": "vs_basilisk",
    "constellation_intervals": "constellation",
    "constellation_tasks": "constellation",
    "inspection_rso": "inspection_rules",
    "inspection_crew": "inspection_rules",
    "clouds_moving": "clouds",
    "faults_planners": "faults_headroom",
    "safe_docking": "safe_autonomy",
    "safe_inspection": "safe_autonomy",
    "safe_docking_trained": "safe_autonomy",
    "safe_inspection_trained": "safe_autonomy",
    "risk_scan": "risk",
    "risk_large": "risk",
    "computation_aeos": "return_vs_computation",
    "computation_power": "return_vs_computation",
    "computation_clouds": "return_vs_computation",
    "computation_scan": "return_vs_computation",
    "computation_inspection": "return_vs_computation",
    "adversary_wide": "adversary",
    "adversary_alone": "adversary",
    "adversary_trained": "adversary",
}
"""Scripts by result, where the names differ."""

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


@cache
def load(name: str) -> dict[str, Any]:
    """Return a result."""
    content: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text())
    return content


def made(name: str) -> str:
    """Return the command that writes a result, and what it ran on."""
    result = load(name)
    where = result["machine"]
    place = f"One thread on a virtual machine with {where['cores']} cores ({where['processor']}, {where['capability']})"
    versions = f"torch {where['torch']}, TorchRL {where['torchrl']}, Python {where['python']}"
    made_by = command(invocation(SCRIPTS.get(name, name), name, result["options"]))
    return f"{made_by}\n\n{place}, {versions}, commit `{where['commit']}`.\n"


def invocation(script: str, name: str, options: dict[str, Any]) -> list[str]:
    """Return the words of the command that writes a result, an option with its first value each."""
    words = [f"python benchmarks/{script}.py"]
    for option, value in (options | {"out": f"benchmarks/results/{name}.json"}).items():
        if value in (None, "", []):
            continue
        shown = "PYTHON" if option == "basilisk" else value
        first, *more = [quoted(str(v)) for v in shown] if isinstance(shown, list) else [quoted(str(shown))]
        words += [f"--{option.replace('_', '-')} {first}", *more]
    return words


def quoted(word: str) -> str:
    """Return a word of a command line."""
    return f"'{word}'" if " " in word else word


def with_command(name: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table with its command below it."""
    return f"{table(head, rows)}\n\n{made(name)}"


# -- speed ---------------------------------------------------------------------------------------------------------------------


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


# -- policies and flights ------------------------------------------------------------------------------------------------------


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


def pretrained() -> str:
    """Return how the policies of the package were made, and what they reach."""
    makings = json.loads((ROOT / "bsk_torch" / "rl" / "policies" / "policies.json").read_text())
    rows = []
    for preset, made_by in makings.items():
        score = made_by["score"]
        minutes, seconds = divmod(round(made_by["seconds"]), 60)
        reached = f"{score['return']:.3f} ±\u00a0{score['half_width']:.3f}"
        time = f"{minutes} min {seconds} s"
        rows.append([code(preset), code(made_by["command"]), whole(made_by["frames"]), time, reached, f"{score['survival']:.1%}"])
    machines = sorted({entry["machine"] for entry in makings.values()})
    episodes = {entry["score"]["episodes"] for entry in makings.values()}
    note = f"Returns of {', '.join(map(str, episodes))} unseen episodes. Trained on: {'; '.join(machines)}."
    return f"{table(['preset', 'command', 'decisions', 'wall time', 'return', 'survival'], rows)}\n\n{note}\n"


def pretrained_short() -> str:
    """Return what the policies of the package reach, and how long their training took."""
    makings = json.loads((ROOT / "bsk_torch" / "rl" / "policies" / "policies.json").read_text())
    rows = []
    for preset, made_by in makings.items():
        score = made_by["score"]
        reached = f"{score['return']:.2f} ± {score['half_width']:.2f}"
        cells = [whole(made_by["frames"]), f"{made_by['seconds'] / 60.0:.0f} min", reached, f"{score['survival']:.1%}"]
        rows.append([f"[{preset}](../api/presets.md)", *cells])
    return f"{table(['preset', 'decisions in training', 'time', 'return', 'survival'], rows)}\n"


def inspections(*names: str) -> str:
    """Return the results of rules and trained policies in the presets of inspection, a table for each preset."""
    head = ["policy, actions", "complete", "hours", "fuel, m/s", "inspected", "lit", "inspectors died", "collisions"]
    parts = []
    for name in names:
        rows, [preset] = [], {row["preset"] for row in load(name)["rows"]}
        for row in load(name)["rows"]:
            share, low, high = (100.0 * value for value in (row["complete"], *row["complete_interval"]))
            rows.append(
                [
                    f"{player(row)}, {row['actions']}",
                    f"{share:.1f} % ({low:.1f} to {high:.1f})",
                    f"{row['hours']:.2f}" if share else "-",
                    f"{row['fuel']:.2f}",
                    f"{row['inspected']:.1f}",
                    f"{row['lit']:.1f}",
                    f"{100.0 * row['died']:.1f} %",
                    str(row["collisions"]),
                    f"{row['value']:.3f} ±\u00a0{row['half']:.3f}",
                    f"{row['gain']:+.3f} ±\u00a0{row['gain_half']:.3f}" if "gain" in row else "-",
                ]
            )
        parts += [f"### {preset}", table([*head, "return", "gain over survey"], rows), made(name)]
    return "\n\n".join(parts)


def player(row: Mapping[str, Any]) -> str:
    """Return the name of a rule, or that of a training with its length."""
    if "frames" not in row:
        return Path(row["policy"]).name
    minutes, seconds = divmod(round(row["seconds"]), 60)
    return f"trained ({Path(row['policy']).name}, {whole(row['frames'])} steps, {minutes} min {seconds} s)"


def safe_autonomy(*names: str) -> str:
    """Return the results of rules with and without run-time assurance in the presets of linear motion, and the speeds."""
    rows, rates = [], []
    for name in names:
        for row in load(name)["rows"]:
            rows.append(
                [
                    row["preset"],
                    f"{row['policy']}, {'no filter' if row['filter'] == 'none' else row['filter']}",
                    f"{100.0 * row['success']:.1f} %",
                    f"{100.0 * row['inspected']:.2f} %" if "inspected" in row else "-",
                    f"{100.0 * row['crashed']:.1f} %",
                    f"{row['speeding']:.2f}",
                    f"{row['blinded']:.1f}" if "blinded" in row else "-",
                    f"{row['interventions']:.1f}" if "interventions" in row else "-",
                    f"{row['value']:.3f} ±\u00a0{row['half']:.3f}",
                ]
            )
        for row in load(name)["rates"]:
            spread = " to ".join(whole(row[key]) for key in ("rate_low", "rate_high"))
            rates.append([row["preset"], row["side"], whole(row["batch"]), f"{whole(row['rate'])} ({spread})"])
    head = [
        "preset",
        "policy",
        "success",
        "inspected, IQM",
        "crashed",
        "above the safe speed",
        "blinded",
        "interventions",
        "return",
    ]
    parts = [table(head, rows)]
    if rates:
        parts.append(table(["preset", "program", "episodes at once", "decisions per core-s"], rates))
    return "\n\n".join([*parts, *(made(name) for name in names)])


def planners(name: str) -> str:
    """Return what planners gain and cost."""
    head = ["preset", "policy", "return", "gain over the rule", "decisions", "simulated s per decision", "wall s per episode"]
    rows = []
    for row in load(name)["rows"]:
        gain = f"{row['gain']:+.3f} ± {row['gain_half']:.3f} ({row['relative']:+.1%})" if "gain" in row else "-"
        simulated = whole(row["simulated"]) if "simulated" in row else "-"
        value = f"{row['value']:.3f} ± {row['half']:.3f}"
        rows.append([code(row["preset"]), row["policy"], value, gain, whole(row["decisions"]), simulated, digits(row["wall"])])
    return with_command(name, head, rows)


def computation(name: str) -> str:
    """Return what methods gain in a task, with the CPU time of a decision."""
    rows = []
    for row in load(name)["rows"]:
        of_rule = f"{row['relative']:+.1%} ± {row['relative_half']:.1%}" if row["policy"] != "rule" else "-"
        value = f"{row['value']:.3g} ± {row['half']:.2g}"
        seconds = milliseconds(row["seconds"]), milliseconds(row["longest"])
        rows.append([row["policy"], row["size"] or "-", value, of_rule, whole(row["episodes"]), *seconds])
    head = ["policy", "size", "return", "gain over the rule", "episodes", "ms per decision", "longest"]
    return with_command(name, head, rows)


def milliseconds(seconds: float) -> str:
    """Return seconds as milliseconds, in the digits that matter."""
    return digits(1e3 * seconds)


def distillations() -> str:
    """Return what networks keep of a planner's gain."""
    rows = []
    for row in load("distillation")["rows"]:
        gain = f"{row['gain']:+.3f} ± {row['gain_half']:.3f}" if row["policy"] != "network" else "-"
        kept = f"{row['share']:.0%} ± {row['share_half']:.0%}" if "training" in row else "-"
        spent = [digits(row[key]) if key in row else "-" for key in ("collecting", "training")]
        learned = whole(row["decisions"]) if "decisions" in row else "-"
        rows.append([code(row["task"]), row["policy"], f"{row['value']:.3f} ± {row['half']:.3f}", gain, kept, learned, *spent])
    head = [
        "task",
        "policy",
        "return",
        "gain over the network",
        "share of the planner's",
        "decisions",
        "collection, core-s",
        "training, core-s",
    ]
    return with_command("distillation", head, rows)


PARAMETERS = {
    "battery": "capacity of the battery, of the preset's",
    "charge": "initial charge, of the capacity",
    "storage": "initial data, of the capacity",
    "spin": "bound of initial wheel speeds, of the largest",
    "fastest": "largest wheel speed, of the preset's",
    "torque": "disturbance, of the preset's",
    "baud": "baud rate of the transmitter, of the preset's",
    "panel": "area of the panel, of the preset's",
    "inclination": "inclination, degrees",
}
"""What the parameters of adversarial scenarios are."""


def adversarial_family(name: str, box: str) -> str:
    """Return the family that a search has found in a box."""
    content = load(name)
    whole_box, found = content["boxes"][box], content["families"][box]["family"]
    rows = [
        [title, *(" to ".join(f"{end:.3g}" for end in ends[key]) for ends in (whole_box, found))]
        for key, title in PARAMETERS.items()
    ]
    return table(["parameter", "searched", "family"], rows) + "\n"


def adversaries(name: str) -> str:
    """Return what policies reach in a family and in the preset, with the rule in the same episodes."""
    rows = [
        [
            row["policy"],
            row["condition"],
            f"{row['value']:.3f} ± {row['half']:.3f}",
            f"{row['gain']:+.3f} ± {row['gain_half']:.3f}",
            f"{row['survival']:.1%}",
            f"{row['rule_survival']:.1%}",
            whole(row["episodes"]),
        ]
        for row in load(name)["rows"]
    ]
    head = ["policy", "episodes from", "return", "over the rule", "survival", "the rule's", "episodes"]
    return with_command(name, head, rows)


def adversarial_flights(name: str, box: str) -> str:
    """Return the certificates of a family on Basilisk."""
    rows = [
        [
            f"`{policy}`" if policy == "rule" else "of the package",
            *(", ".join(f"{value:.4f}" for value in flown[key]) for key in ("returns", "returns_basilisk")),
            *(", ".join("yes" if value else "no" for value in flown[key]) for key in ("survived", "survived_basilisk")),
            certificate({"episodes": len(flown["returns"])} | flown),
        ]
        for policy, flown in load(name)["families"][box]["basilisk"].items()
    ]
    head = ["policy", "returns", "on Basilisk", "survived", "on Basilisk", "same decisions; largest difference"]
    return table(head, rows) + "\n"


def spread(values: Sequence[float], form: str) -> str:
    """Return a mean, with the least and the largest of several values."""
    mean, low, high = (form.format(x) for x in (sum(values) / len(values), min(values), max(values)))
    return mean if len(values) == 1 else f"{mean} ({low} to {high})"


def by_condition(name: str, what: str) -> str:
    """Return survival or return (``what``) of rules and of trainings with several seeds, by condition."""
    found = load(name)["found"]
    form = "{:.1%}" if what == "survival" else "{:.3f}"
    conditions = list(next(iter(found.values()))[0])
    rows = [
        [training, *(spread([result[condition][what] for result in results], form) for condition in conditions)]
        for training, results in found.items()
    ]
    return f"{table(['policy', *conditions], rows)}\n"


def headroom(name: str) -> str:
    """Return what policies and planners gain over a rule in the same episodes."""
    rows = [
        [
            row["policy"],
            whole(row["episodes"]),
            f"{row['return']:.3f} ±\u00a0{row['half']:.3f}",
            f"{row['gain']:+.3f} ±\u00a0{row['gain_half']:.3f}" if row["gain_half"] else "-",
            f"{row['survival']:.1%} ({row['survival_low']:.1%} to {row['survival_high']:.1%})",
        ]
        for row in load(name)["rows"]
    ]
    return with_command(name, ["policy", "episodes", "return", "gain over cautious", "survival"], rows)


def candidates() -> str:
    """Return how far policies and planners are ahead of the best rule, by candidate for a task of the suite v2."""
    head = [
        "candidate",
        "random",
        "best rule",
        "best policy or planner",
        "episodes",
        "gain",
        "share of head-room",
        "in the suite",
    ]
    rows = [
        [
            f"`{row['candidate']}` ({row['preset']})",
            f"{row['random']:.3f}",
            f"{entrant(row['rule'])}: {with_half(row['rule_return'], row['rule_half'])}",
            f"{entrant(row['best'])}: {with_half(row['best_return'], row['best_half'])}",
            whole(row["episodes"]),
            f"{row['gain']:+.3f} ±\u00a0{row['gain_half']:.3f}",
            f"{row['share']:.2f} ({row['share_low']:.2f} to {row['share_high']:.2f})",
            "yes" if row["task"] else "no",
        ]
        for row in sorted(load("headroom")["rows"], key=lambda row: -row["share"])
    ]
    return table(head, rows) + "\n"


def risks(*names: str) -> str:
    """Return probabilities by subset simulation, next to the shares of independent episodes, of the questions in some results."""
    rows = []
    for found in [found for name in names for found in load(name)["questions"].values()]:
        asked, plain, (mean, low, high) = found["question"], found.get("plain"), found["probability"].values()
        limit = asked["options"].get("time_limit")
        rows.append(
            [
                asked["preset"] + ("" if limit is None else f", first {limit:,.0f} s"),
                asked["policy"],
                f"`{asked['event']}`",
                f"{mean:.1e} ({low:.1e} to {high:.1e})" if mean else f"at most {high:.1e}",
                whole(found["episodes"]),
                f"{plain['mean']:.1e} ({plain['low']:.1e} to {plain['high']:.1e})" if plain else "-",
                whole(plain["episodes"]) if plain else "-",
                digits(found["saved"]) if found["saved"] else "-",
                whole(found["cpu"]),
            ]
        )
    head = [
        "task",
        "policy",
        "event",
        "subset simulation",
        "episodes",
        "independent episodes",
        "their number",
        "factor",
        "core-s",
    ]
    return f"{table(head, rows)}\n\n" + "\n".join(made(name) for name in names)


def known_risks() -> str:
    """Return estimates of known probabilities."""
    rows = [
        [
            f"{case['probability']:.0e}",
            f"{case['mean']:.2e} ± {case['standard_error']:.1e}",
            f"{case['relative_error_of_one_repetition']:.0%}",
            f"{case['intervals_with_the_truth']} of {case['runs']}",
            whole(case["episodes"]),
            digits(case["saved"]),
        ]
        for case in load("risk")["textbook"]
    ]
    head = ["probability", "mean estimate, standard error", "error of a repetition", "intervals with it", "episodes", "factor"]
    return f"{table(head, rows)}\n"


def own_environments() -> str:
    """Return what trainings without settings reach, and random and constant actions."""
    head = [
        "environment",
        "time limit, s",
        "at the limit",
        "random actions",
        "best constant action",
        "trained, each seed",
        "decisions",
    ]
    rows = []
    for row in load("own_environments")["rows"]:
        results = zip(row["trained"], row["half_widths"], strict=True)
        trained = ", ".join(f"{value:.3g} ± {half:.2g}" for value, half in results)
        decisions = whole(max(row["curves"][0]["frames"]))
        rows.append([row["name"], whole(row["limit"]), row["ends"], f"{row['random']:.3g}", row["best"], trained, decisions])
    return with_command("own_environments", head, rows)


def of_runs(runs: Sequence[Mapping[str, float]], key: str, form: str) -> str:
    """Return the mean of a figure over runs, with the smallest and the largest; a dash if a run has none."""
    if not all(key in run for run in runs):
        return "-"
    values = [run[key] for run in runs]
    mean, low, high = (form.format(value) for value in (sum(values) / len(values), min(values), max(values)))
    return f"{mean} ({low} to {high})"


def off_policy(preset: str) -> str:
    """Return the errors of estimators of a policy's value in a preset, by the behavior whose episodes they have."""
    rows = []
    for row in load("off_policy")["rows"]:
        if row["preset"] == preset:
            forms = {"behavior_return": "{:.2f}", "fitted": "{:+.2f}", "traced": "{:+.2f}", "importance": "{:+.2f}"}
            cells = [of_runs(row["seeds"], key, form) for key, form in (forms | {"effective": "{:.1f}"}).items()]
            rows.append([code(row["behavior"]), *cells])
    head = ["behavior", "its return", "fitted Q", "fitted Q with traces", "importance sampling", "effective episodes"]
    return table(head, rows) + "\n"


def expert_iteration() -> str:
    """Return what training on audited decisions gains, with the command."""
    rows = [
        [
            row["policy"],
            f"{row['return']:.2f} ±\u00a0{row['half']:.2f}",
            f"{row['gain']:+.2f} ±\u00a0{row['gain_half']:.2f}" if row["gain_half"] else "-",
            f"{row['regret']:.3f}" if "regret" in row else "-",
            whole(row["decisions"]) if "decisions" in row else "-",
            whole(row["cpu"]) if row["cpu"] else "-",
            whole(row["episodes"]),
        ]
        for row in load("expert_iteration")["rows"]
    ]
    head = ["policy", "return", "gain", "regret of a decision", "decisions", "core-seconds", "unseen episodes"]
    return with_command("expert_iteration", head, rows)


def action_scores() -> str:
    """Return the scores of estimated action values against the returns of all actions."""
    forms = {"rmse": "{:.2f}", "concordance": "{:.0%}", "regret": "{:.3f}"}
    rows = []
    for row in load("off_policy")["rows"]:
        for label, words in (("fitted", "fitted Q"), ("traced", "with traces")):
            cells = [of_runs(row["seeds"], f"{label}_{key}", form) for key, form in forms.items()]
            rows.append([row["preset"], code(row["behavior"]), words, *cells])
    return table(["preset", "behavior", "estimator", "error of values", "pairs in order", "loss of one decision"], rows) + "\n"


def dataset_sizes() -> str:
    """Return the sizes of datasets and the time to write them, with the command."""
    found: dict[str, list[dict[str, float]]] = {}
    for one in load("off_policy")["sizes"]:
        found.setdefault(one["preset"], []).append(one)
    forms = {"decisions": "{:,.0f}", "sampled": "{:,.0f}", "returns": "{:,.0f}", "megabytes": "{:.1f}", "bytes": "{:,.0f}"}
    rows = []
    for preset, runs in found.items():
        means = {key: sum(run[key] for run in runs) / len(runs) for key in (*forms, "cpu")}
        rows.append([preset, *(form.format(means[key]) for key, form in forms.items()), of_runs(runs, "cpu", "{:.0f}")])
    head = ["preset", "decisions", "sampled", "returns of actions", "MB", "bytes per decision", "core-seconds"]
    return with_command("off_policy", head, rows)


def clouds(name: str) -> str:
    """Return what policies reach under clouds, by what they see of them."""
    rows = []
    for world, policies in load(name)["found"].items():
        for policy, results in policies.items():
            gains = ", ".join(f"{row['gain']:+.2f} ± {row['gain_half']:.2f}" for row in results)
            decisions = whole(results[0]["frames"]) if results[0]["frames"] else "-"
            rows.append([world, policy, decisions, spread([row["return"] for row in results], "{:.2f}"), gains])
    head = ["forecasts", "policy", "decisions in training", "return", "gain over hasty, each seed"]
    return with_command(name, head, rows)


def envelope() -> str:
    """Return least times between images, with the transitions that they were fitted to."""
    fitted = json.loads((ROOT / "bsk_torch" / "plan" / "bounds" / "agile.json").read_text())
    rows = []
    for row in load("envelope")["rows"]:
        k = round(row["low"] / fitted["width"])
        times = [fitted["direct"][k] * fitted["step"], fitted["any"][k] * fitted["step"], row["median"]]
        rows.append([f"{row['low']:.1f} to {row['high']:.1f}", whole(row["count"]), *(f"{seconds:.1f}" for seconds in times)])
    head = ["angle, rad", "transitions", "least in one step, s", "least, s", "median in one step, s"]
    return with_command("envelope", head, rows)


def sustained() -> str:
    """Return times between images that satellites cannot beat for long, with the least and the median ones."""
    fitted = json.loads((ROOT / "bsk_torch" / "plan" / "bounds" / "agile_sustained.json").read_text())
    rows = []
    for row in load("sustained")["rows"]:
        k = round(row["low"] / fitted["width"])
        times = [fitted["direct"][k] * fitted["step"], row["least"], row["median"]]
        rows.append([f"{row['low']:.1f} to {row['high']:.1f}", whole(row["count"]), *(f"{seconds:.1f}" for seconds in times)])
    return table(["angle, rad", "transitions", "sustained, s", "least in one step, s", "median, s"], rows) + "\n"


def largest_leads() -> str:
    """Return how far ahead of the sustained times flights get that the fit has not seen."""
    rows = []
    found = load("sustained")
    names = ["times of the program, seen", "times of the program", "lowered times, seen", "lowered times"]
    planned = [row | {"policy": f"{row['policy']}, {name}"} for row, name in zip(found["planned"], names, strict=True)]
    for row in found["leads"] + planned[1:]:
        rows.append([code(row["task"]), row["policy"], whole(row["images"]), f"{row['largest']:.1f}", whole(row["beyond"])])
    return with_command("sustained", ["task", "policy", "images", "largest lead, s", "beyond the reserve"], rows)


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
        rows.append([whole(row["targets"]), row["times"], *values, whole(row["knapsack"]), short(row["seconds"])])
    head = [
        "targets",
        "times between images",
        "in view",
        "bound",
        "schedule",
        "planner",
        "quickest transitions, s",
        "s for each bound",
    ]
    return with_command("relaxation", head, rows)


def communications() -> str:
    """Return what communication is worth to rules."""
    rows = []
    for row in load("communication")["rows"]:
        gain = "-" if row["communication"] == "none" else f"{row['gain']:+.2f} ± {row['gain_half']:.2f}"
        names = code(row["preset"]), row["rule"], row["communication"]
        rows.append([*names, f"{row['value']:.2f} ± {row['half']:.2f}", gain, f"{row['in_view']:.2f}"])
    head = ["preset", "rule", "communication after every step", "return", "gain over none", "all targets in view"]
    return with_command("communication", head, rows)


def resources() -> str:
    """Return how much energy and storage there is for images."""
    rows = [[row["name"], *(quantity(row[name]) for name in ("least", "mean", "largest"))] for row in load("resources")["rows"]]
    return with_command("resources", ["quantity of an episode", "least", "mean", "largest"], rows)


def quantity(value: float) -> str:
    """Return a number in the digits that its size asks for."""
    return short(value) if value < 1.0 else whole(value) if value >= 100.0 else f"{value:.1f}"


def suites(name: str) -> str:
    """Return what policies reach in a suite, in a table for each preset."""
    content = load(name)
    most = max(row["episodes"] for row in content["rows"])
    if any("measures" in row for row in content["rows"]):
        return suite_measures(content["rows"])
    presets: dict[str, list[list[str]]] = {}
    for row in content["rows"]:
        marked = entrant(row["policy"]) + ("" if row["episodes"] == most else f" ({row['episodes']} episodes)")
        behind = with_half(row["behind"], row["behind_half"]) if row["behind"] else "-"
        score, value = with_half(row["score"], row["score_half"]), with_half(row["value"], row["half"])
        spent = digits_of(row["milliseconds"]), "-" if row["simulated"] is None else whole(row["simulated"])
        cells = [marked, score, value, behind, f"{row['survival']:.1%}", *spent, certificate(row["basilisk"])]
        presets.setdefault(row["preset"], []).append(cells)
    head = ["policy", "score", "return", "behind the best", "survival", "ms", "simulated s", "on Basilisk"]
    tables = [f"### {preset}\n\n{table(head, rows)}" for preset, rows in presets.items()]
    versions = f"bsk_torch {content['bsk_torch']}, torch {content['torch']}"
    made_by = f"{versions}, {most:,} episodes of each task unless said otherwise, one thread."
    return "\n\n".join([*tables, made_by]) + "\n"


def suite_measures(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the measures of policies in the tasks of a suite, in a table for each task."""
    shares, others = ("CR", "WCR", "PCR", "WPCR"), (("TAT", 0), ("PC", 0), ("CS", 2))
    head = ["policy", *(f"{name}, %" for name in shares), "TAT, s", "PC, W s", "CS", "behind the best, %", "on Basilisk"]
    tasks: dict[str, list[list[str]]] = {}
    for row in rows:
        measures = row["measures"]
        cells = [f"{100.0 * measures[name]['mean']:.1f} ±\u00a0{100.0 * measures[name]['half_width']:.1f}" for name in shares]
        cells += [f"{measures[name]['mean']:,.{n}f} ±\u00a0{measures[name]['half_width']:,.{n}f}" for name, n in others]
        behind = f"{100.0 * row['behind']:.1f} ±\u00a0{100.0 * row['behind_half']:.1f}" if row["behind"] else "-"
        line = [entrant(row["policy"]), *cells, behind, certificate(row["basilisk"])]
        tasks.setdefault(f"`{row['preset']}`, {row['episodes']} scenarios", []).append(line)
    return "\n\n".join(f"{title}:\n\n{table(head, lines)}" for title, lines in tasks.items()) + "\n"


def entrant(policy: str) -> str:
    """Return the name of a policy, with the options of a planner after it."""
    name, *options = policy.split(",")
    return code(name) + "".join(f" {option}" for option in options)


def with_half(value: float | None, half: float) -> str:
    """Return a value with half of its interval, in the digits that matter; a dash for none."""
    if value is None:
        return "-"
    count = 3 if abs(value) < 10.0 else 1
    return f"{value:.{count}f} ±\u00a0{half:.{count}f}"


def services(name: str) -> str:
    """Return what rules and policies return in the episodes of Services-v1."""
    loaded = load(name)
    rows = [
        [
            row["policy"] if row["policy"].startswith("trained") else f"`{row['policy']}`",
            f"{row['return']:.1f} ±\u00a0{row['half']:.1f}",
            f"{row['gain']:+.1f} ±\u00a0{row['gain_half']:.1f}" if row["gain_half"] else "-",
            whole(row["captured"]),
            whole(row["delivered"]),
            whole(row["decisions"]),
            f"{row['survival']:.0%}",
            f"{row['cpu']:.2f}",
        ]
        for row in loaded["rows"]
    ]
    best = loaded["options"].get("best", "rate")
    titles = ["policy", "return", f"gain over `{best}`", "images", "downlinked", "decisions", "survival", "core-s per episode"]
    return with_command(name, titles, rows)


def aeos_bench(name: str) -> str:
    """Return what rules and policies reach in cases of AEOS-Bench, with the bound."""
    rows = [
        [
            f"`{row['policy']}`" if row["policy"].endswith("_task") else row["policy"],
            f"{row['CR']:.1f} ±\u00a0{row['half']:.1f}",
            f"{row['gain']:+.1f} ±\u00a0{row['gain_half']:.1f}" if row["gain_half"] else "-",
            f"{row['over']:+.2f} ±\u00a0{row['over_half']:.2f}" if row["policy"].startswith("trained") else "-",
            *(measured(row[key], digit) for key, digit in (("PCR", 1), ("WCR", 1), ("TAT", 0), ("PC", 0), ("CS", 2))),
            f"{row['cpu']:.1f}",
        ]
        for row in load(name)["rows"]
    ]
    titles = [
        "policy",
        "CR, %",
        "over `nearest_task`",
        "over `soonest_task`",
        "PCR, %",
        "WCR, %",
        "TAT, s",
        "PC, W s",
        "CS",
        "core-s per case",
    ]
    return with_command(name, titles, rows)


BENCH_MEASURES = {
    "CR": ("CR, %", 100.0, 1),
    "WCR": ("WCR, %", 100.0, 1),
    "PCR": ("PCR, %", 100.0, 1),
    "WPCR": ("WPCR, %", 100.0, 1),
    "TAT": ("TAT, s", 1.0, 0),
    "PC": ("PC, W s", 1.0, 0),
    "CS": ("CS", 1.0, 2),
}
"""Title, factor and decimals of the measures of AEOS-Bench."""


def greedy_flights(name: str) -> str:
    """Return the measures of the greedy rule here and on Basilisk, and how far flights differ."""
    result = load(name)

    def cells(found: Mapping[str, Mapping[str, float]], sign: str, more: int) -> list[str]:
        shown = []
        for key, (_, factor, decimals) in BENCH_MEASURES.items():
            value, half = (factor * found[key][part] for part in ("mean", "half_width"))
            form = f",.{decimals + more}f"
            shown.append("-" if math.isnan(value) else f"{value:{sign}{form}} ±\u00a0{half:{form}}")
        return shown

    titles = [title for title, _, _ in BENCH_MEASURES.values()]
    means = [[kind, *cells(found, "", 0)] for kind, found in result["means"].items()]
    pairs = [[pair, *cells(found, "+", 1)] for pair, found in result["differences"].items()]
    tables = [
        table([head, *titles], [row for row in rows if set(row[1:]) != {"-"}])  # not those of flights that no case has
        for head, rows in (("flight", means), ("difference", pairs))
    ]
    words = [f"python scripts/validation/greedy_on_basilisk.py cases/{result['folder']}", f"--cases {len(result['names'])}"]
    words += [f"--out benchmarks/results/{name}.json"]
    return "\n\n".join([*tables, command(words)]) + "\n"


def measured(value: float, digit: int) -> str:
    """Return a measure with so many digits; a dash for NaN."""
    return "-" if value != value else f"{value:,.{digit}f}"


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


def teams(name: str) -> str:
    """Return what rules of teams reach, with the published means below."""
    counted = ("acquisitions", "services", "reward", "captured_share", "delivered_share", "duplicate_attempts", "wasted_share")
    rows: list[list[str]] = []
    for row in load(name)["rows"]:
        mixture = "low orbits" if row["mixture"] == "LEO" else "mixed orbits"
        title = f"`{row['preset']}`, {mixture}, `{row['rule']}`, `{row['information']}`"
        rows.append([title, *(f"{row[count][0]:.1f} ±\u00a0{row[count][1]:.1f}" for count in counted)])
        if row["published"] is not None:
            rows.append(["published", *(f"{value:.1f}" for value in row["published"])])
    titles = ["task, rule, information", "captures paid", "deliveries paid", "reward", "captured, %", "delivered, %"]
    return with_command(name, [*titles, "duplicate attempts", "wasted, %"], rows)


def crews(name: str) -> str:
    """Return what policies of teams return next to rules, with gains over these in the same episodes."""
    loaded = load(name)
    rules = loaded["options"]["rules"]
    rows = [
        [
            row["policy"] if row["policy"].startswith("trained") else f"`{row['policy']}`",
            f"{row['return'][0]:.1f} ±\u00a0{row['return'][1]:.1f}",
            *(f"{gain[0]:+.1f} ±\u00a0{gain[1]:.1f}" if gain[1] else "-" for gain in (row["over"][rule] for rule in rules)),
            *(f"{row[count]:.1f}" for count in ("acquisitions", "services", "duplicate_attempts")),
            whole(row["decisions"]),
        ]
        for row in loaded["rows"]
    ]
    gains = [f"over `{rule}`" for rule in rules]
    titles = ["policy", "return", *gains, "captures paid", "deliveries paid", "duplicate attempts", "decisions"]
    return with_command(name, titles, rows)


def digits_of(value: float) -> str:
    """Return milliseconds in three digits."""
    return f"{value:.3f}" if value < 1.0 else f"{value:.1f}" if value < 100.0 else whole(value)


def certificate(flown: Mapping[str, Any] | None) -> str:
    """Return how many episodes are the same on Basilisk, and the largest difference of a return."""
    if flown is None:
        return "-"
    how = ", replayed" if flown["decided"] == "in bsk_torch" else ""
    return f"{flown['same']} of {flown['episodes']}{how}; {short(flown['largest_difference'])}".replace("e-", "e\u2011")


TABLES = {
    "by_condition": by_condition,
    "headroom": headroom,
    "candidates": candidates,
    "risks": risks,
    "known_risks": known_risks,
    "own_environments": own_environments,
    "off_policy": off_policy,
    "expert_iteration": expert_iteration,
    "action_scores": action_scores,
    "dataset_sizes": dataset_sizes,
    "clouds": clouds,
    "envelope": envelope,
    "sustained": sustained,
    "largest_leads": largest_leads,
    "bounds": bounds,
    "bounds_made": bounds_made,
    "schedules": schedules,
    "relaxations": relaxations,
    "resources": resources,
    "communications": communications,
    "made": made,
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
    "flights": flights,
    "releases": releases,
    "release_differences": release_differences,
    "drift_made": drift_made,
    "failures": failures,
    "pretrained": pretrained,
    "pretrained_short": pretrained_short,
    "inspections": inspections,
    "planners": planners,
    "computation": computation,
    "distillations": distillations,
    "adversarial_family": adversarial_family,
    "adversaries": adversaries,
    "adversarial_flights": adversarial_flights,
    "safe_autonomy": safe_autonomy,
    "services": services,
    "aeos_bench": aeos_bench,
    "aeos_speed": aeos_speed,
    "greedy_flights": greedy_flights,
    "teams": teams,
    "crews": crews,
    "suites": suites,
}
