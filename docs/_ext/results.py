"""Results of ``benchmarks/results/*.json``: how they are read, the commands that write them, and how numbers are written."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from docs._ext.markdown import command, short, table, whole

ROOT = Path(__file__).parents[2]

RESULTS = ROOT / "benchmarks" / "results"

SCRIPTS = {
    "learners_suite_v3": "learners",
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
    "thruster_docking": "thruster_rules",
    "thruster_inspection": "thruster_rules",
    "risk_scan": "risk",
    "risk_large": "risk",
    "risk_screen": "risk",
    "risk_screen_known": "risk",
    "risk_screen_loss": "risk",
    "computation_aeos": "return_vs_computation",
    "computation_power": "return_vs_computation",
    "computation_clouds": "return_vs_computation",
    "computation_scan": "return_vs_computation",
    "computation_inspection": "return_vs_computation",
    "computation_minute_aeos": "return_vs_computation",
    "computation_minute_power": "return_vs_computation",
    "computation_minute_clouds": "return_vs_computation",
    "computation_minute_scan": "return_vs_computation",
    "computation_minute_inspection": "return_vs_computation",
    "distillation_aeos": "distillation",
    "sustained_checked": "sustained",
    "sustained_searched": "sustained",
    "adversary_wide": "adversary",
    "adversary_alone": "adversary",
    "adversary_trained": "adversary",
    "aeossp_margins": "aeossp",
}
"""Scripts by result, where the names differ."""


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
    """Return the words of the command that writes a result, an option with its first value each.

    Raises:
        FileNotFoundError: If there is no such script.
    """
    if not (ROOT / "benchmarks" / f"{script}.py").exists():
        raise FileNotFoundError(f"benchmarks/{script}.py does not exist; SCRIPTS has the script that writes {name}.json")
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


def spread(values: Sequence[float], form: str) -> str:
    """Return a mean, with the least and the largest of several values."""
    mean, low, high = (form.format(x) for x in (sum(values) / len(values), min(values), max(values)))
    return mean if len(values) == 1 else f"{mean} ({low} to {high})"


def quantity(value: float) -> str:
    """Return a number in the digits that its size asks for."""
    return short(value) if value < 1.0 else whole(value) if value >= 100.0 else f"{value:.1f}"


def measured(value: float, digit: int) -> str:
    """Return a measure with so many digits; a dash for NaN."""
    return "-" if value != value else f"{value:,.{digit}f}"


def certificate(flown: Mapping[str, Any] | None) -> str:
    """Return how many episodes are the same on Basilisk, and the largest difference of a return."""
    if flown is None:
        return "-"
    how = ", replayed" if flown["decided"] == "in bsk_torch" else ""
    return f"{flown['same']} of {flown['episodes']}{how}; {short(flown['largest_difference'])}".replace("e-", "e\u2011")


TABLES: dict[str, Callable[..., str]] = {
    "made": made,
}
"""Tables by name."""
