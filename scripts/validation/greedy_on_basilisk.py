"""Fly cases of AEOS-Bench by its greedy rule here and on Basilisk, which both decide for themselves, and compare the measures.

    python scripts/validation/greedy_on_basilisk.py cases/test64 --out greedy.json

Attitudes are chaotic, so each case also flies from an attitude 1e-14 away, on both sides. The difference of the two flights of
one side is the spread that this side has against itself. Cases with a ``metrics.json`` were also flown by others. The extra
``basilisk`` is needed; see ``fly_on_basilisk.py``.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import warnings
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import torch

import bsk_torch
from bsk_torch import ConstellationTasking
from bsk_torch.files import write_file
from bsk_torch.lab.basilisk.aeos_certificate import NUDGE, flown_there
from bsk_torch.lab.basilisk.flight import lacking
from bsk_torch.rl.evaluation.statistics import Estimate, nan_confidence
from bsk_torch.rl.policies.shared_policy import rule
from bsk_torch.tables import print_table
from bsk_torch.tasks.aeos_bench import Cases, read_cases
from bsk_torch.tasks.aeos_bench.annotations import fly_cases
from bsk_torch.tasks.aeos_bench.writing import case_content

MEASURES = ("CR", "WCR", "PCR", "WPCR", "TAT", "PC", "CS")

HERE, HERE_AGAIN, THERE, THERE_AGAIN, OTHERS = "here", "here, 1e-14 away", "Basilisk", "Basilisk, 1e-14 away", "published"
"""Flights of a case."""

PAIRS = ((HERE, THERE), (HERE_AGAIN, HERE), (THERE_AGAIN, THERE), (HERE, OTHERS), (THERE, OTHERS))
"""Flights whose measures are compared."""

Row = dict[str, dict[str, float]]
"""Measures of the flights of a case."""


def nudged(cases: Cases) -> Cases:
    """Return the cases with attitudes that start :data:`NUDGE` away."""
    satellites = dict(cases.satellites)
    satellites["sigma_init"] = satellites["sigma_init"] + NUDGE
    return replace(cases, satellites=satellites)


def flown_here(cases: Cases, batch: int, seconds: int, backend: str) -> list[dict[str, float]]:
    """Return the measures of all cases here."""
    size, world = min(batch, len(cases)), {"time_limit": float(seconds), "backend": backend}
    env = bsk_torch.make("AEOSBench-v1", num_envs=size, env_ids=[0] * size, folder=cases, order="listed", sensor="on", **world)
    assert isinstance(env, ConstellationTasking)
    with torch.no_grad():
        return [dict(flight.measures) for flight in fly_cases(rule("nearest_task", env), env)]


def on_basilisk(cases: Cases, seconds: int) -> Iterator[dict[str, float]]:
    """Yield the measures of each case on Basilisk."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        from bsk_torch.lab.basilisk.aeos_reference import greedy_rule
    for k in range(len(cases)):
        content = case_content(cases, k)
        yield flown_there(content, greedy_rule(), seconds, always_on=True).measures(content["taskset"])


def published(folder: Path, name: str) -> Row:
    """Return the published measures of a case, if there are any."""
    path = folder / name / "metrics.json"
    return {OTHERS: json.loads(path.read_text())["metrics"]} if path.exists() else {}


def means(rows: list[Row]) -> dict[str, dict[str, Estimate]]:
    """Return the mean measures of each kind of flight, over the cases that have them."""
    kinds = (HERE, HERE_AGAIN, THERE, THERE_AGAIN, OTHERS)
    return {kind: estimates([row[kind] for row in rows if kind in row]) for kind in kinds}


def differences(rows: list[Row]) -> dict[str, dict[str, Estimate]]:
    """Return the mean differences between flights, paired by case, over the cases that have both."""
    found = {}
    for one, other in PAIRS:
        both = [(row[one], row[other]) for row in rows if one in row and other in row]
        found[f"{one} - {other}"] = estimates([{name: a[name] - b[name] for name in a if name in b} for a, b in both])
    return found


def estimates(found: list[dict[str, float]]) -> dict[str, Estimate]:
    """Return the mean of each measure over those that have it."""
    return {
        name: nan_confidence(torch.tensor([one[name] for one in found if name in one], dtype=torch.float64)) for name in MEASURES
    }


def cell(value: Estimate) -> str:
    """Return the cell of an estimate, empty for none."""
    return "" if math.isnan(value.mean) else f"{value.mean:.4g} ± {value.half_width:.2g}"


def table(title: str, estimates: dict[str, dict[str, Estimate]]) -> list[dict[str, str]]:
    """Return the cells of a table with a row for each estimate."""
    return [{title: name} | {key: cell(value) for key, value in row.items()} for name, row in estimates.items()]


def main() -> None:
    """Fly, and print two tables; the file is written after each case, so that a long run can be ended."""
    parser = argparse.ArgumentParser(description="Fly AEOS-Bench's greedy rule here and on Basilisk.")
    parser.add_argument("folder", type=Path, help="folder of cases")
    parser.add_argument("--cases", type=int, metavar="N", help="only the first N cases")
    parser.add_argument("--seconds", type=int, default=3600, help="length of flights (default 3600)")
    parser.add_argument("--batch", type=int, default=32, help="cases flown at once here (default 32)")
    parser.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    parser.add_argument("--out", type=Path, metavar="FILE", help="JSON file for the results")
    options = parser.parse_args()
    if missing := lacking():
        sys.exit(missing)
    torch.set_num_threads(1)
    try:
        cases = read_cases(options.folder)
    except (OSError, ValueError) as error:
        sys.exit(str(error))
    if options.cases is not None:
        cases = cases.take(torch.arange(min(options.cases, len(cases))))
    sides = (cases, nudged(cases))
    here = [flown_here(side, options.batch, options.seconds, options.backend) for side in sides]
    rows: list[Row] = []
    for k, (one, other) in enumerate(zip(*(on_basilisk(side, options.seconds) for side in sides), strict=True)):
        flights = {HERE: here[0][k], HERE_AGAIN: here[1][k], THERE: one, THERE_AGAIN: other}
        rows.append(flights | published(options.folder, cases.names[k]))
        print(f"{cases.names[k]}: CR " + ", ".join(f"{flight} {row['CR']:.4f}" for flight, row in rows[-1].items()), flush=True)
        if options.out is not None:
            flown = {"folder": options.folder.name, "seconds": options.seconds, "names": cases.names[: k + 1], "rows": rows}
            content = flown | {"means": means(rows), "differences": differences(rows)}
            write_file(options.out, json.dumps(content, default=asdict, indent=1) + "\n")
    print_table(table("flight", means(rows)), f"{len(rows)} cases of {options.folder}")
    print_table(table("difference", differences(rows)), "differences, paired by case")


if __name__ == "__main__":
    main()
