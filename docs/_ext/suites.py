"""Tables of suites, and of tasks that others have published."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from docs._ext.markdown import code, command, table, whole
from docs._ext.results import certificate, load, measured, with_command


def suites(name: str) -> str:
    """Return what policies reach in a suite, in a table for each preset."""
    content = load(name)
    most = max(row["episodes"] for row in content["rows"])
    if any("CR" in row.get("measures", {}) for row in content["rows"]):
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


TABLES: dict[str, Callable[..., str]] = {
    "services": services,
    "aeos_bench": aeos_bench,
    "greedy_flights": greedy_flights,
    "teams": teams,
    "crews": crews,
    "suites": suites,
}
"""Tables by name."""
