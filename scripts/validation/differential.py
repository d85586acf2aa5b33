"""Fly random problems in bsk_rl on Basilisk and in bsk_torch, and compare them step by step.

Usage::

    python scripts/validation/differential.py --seeds 0:100 --steps 30
    python scripts/validation/differential.py --seeds 7 --steps 40 --backend eager --verbose
    python scripts/validation/differential.py --library bsk_torch.bsk_rl --seeds 0:100 --out programs.jsonl
    python scripts/validation/differential.py --summarize core.jsonl programs.jsonl --out benchmarks/results/differential.json

Each seed draws one problem: satellites, world, scenario, rewards, options and actions; ``--steps`` bounds the number of actions.
``bsk_torch``, with ``compat="bsk_rl"``, gets the values that bsk_rl gets. For ``bsk_torch.bsk_rl`` the problem is a program that
leaves draws to the library, in one to three episodes: the same seeds must give the same episodes.

Basilisk also flies a twin, which starts 1e-12 away: where the twin parts from its original, the comparison ends ("chaos"). Where
a difference remains, another twin starts 1e-10 away, about the accuracy of orbits and of the Earth's orientation. "error" is the
same exception on both sides before the first step, "explained" a difference in docs/migration_reference.md.
Ends with status 1 if a case is "different". Needs the extra ``basilisk``; see ``scripts/recorders/recording.py``.
"""

from __future__ import annotations

import argparse
import collections
import json
import sys
import time
import traceback
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from differential_compare import Verdict, judge
from differential_draw import FAMILIES, Case, draw_case
from differential_flight import CORE, DROP_IN, FARTHER, NUDGE, REFERENCE, Library, fly
from differential_program import as_program

from bsk_torch.lab.basilisk.certificate import names_kept, quiet
from bsk_torch.lab.basilisk.flight import absent_data, lacking


def arguments(given: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", default="0:20", help="seeds, as in 0:100 or 7 (default: %(default)s)")
    parser.add_argument("--steps", type=int, default=30, help="largest number of actions (default: %(default)s)")
    parser.add_argument("--families", nargs="+", choices=sorted(FAMILIES), help="only problems of these kinds")
    parser.add_argument(
        "--library", default=CORE, choices=(CORE, DROP_IN), help="what is compared with bsk_rl (default: %(default)s)"
    )
    parser.add_argument("--backend", default="compiled", choices=("compiled", "eager"), help="(default: %(default)s)")
    parser.add_argument("--out", type=Path, help="file to which results are added, JSON lines; of a summary, JSON")
    parser.add_argument("--summarize", type=Path, nargs="+", help="fly nothing; summarize results, the last of each seed")
    parser.add_argument("--verbose", action="store_true", help="print descriptions, and traces of exceptions")
    return parser.parse_args(given)


def seeds_of(text: str) -> range:
    """Read seeds: "3" or "0:100"."""
    first, _, last = text.partition(":")
    return range(int(first), int(last)) if last else range(int(first), int(first) + 1)


def problem(seed: int, steps: int, library: str) -> Case:
    """Return the problem of a seed for a library."""
    case = draw_case(seed, steps)
    return as_program(case) if library == DROP_IN else case


def compare(case: Case, here: Library, there: Library, backend: str, verbose: bool = False) -> Verdict:
    """Fly a case on both sides, and its twin; where they differ, a twin that starts farther away."""
    reference, twin = fly(there, case), fly(there, case, NUDGE)
    mine = fly(here, case, backend=backend)
    if verbose:
        for flight in (reference, mine):
            if flight.error is not None:
                traceback.print_exception(flight.error)
    verdict = judge(case, mine, reference, twin)
    if verdict.word != "different":
        return verdict
    farther = judge(case, mine, reference, fly(there, case, FARTHER))
    return farther if farther.word == "chaos" else verdict


def summarize(files: Sequence[Path]) -> dict[str, Any]:
    """Return counts of results by library and family, and the cases that are explained or different."""
    cases = {(case["library"], case["seed"]): case for file in files for case in map(json.loads, file.read_text().splitlines())}
    summary: dict[str, Any] = {}
    for (library, _), case in sorted(cases.items()):
        part = summary.setdefault(library, {"cases": 0, "steps": 0, "results": {}, "families": {}, "differences": []})
        part["cases"] += 1
        part["steps"] += case["steps"]
        for counts in (part["results"], part["families"].setdefault(case["family"], {})):
            counts[case["result"]] = counts.get(case["result"], 0) + 1
        if case["finding"] is not None:
            part["differences"].append({name: case[name] for name in ("seed", "family", "view", "result")} | case["finding"])
    return summary


def libraries(name: str) -> tuple[Library, Library]:
    """Import the library under test, and bsk_rl."""
    here = Library(name)
    with names_kept():
        return here, Library(REFERENCE)


def main(given: list[str] | None = None) -> None:
    """Compare, and print a table."""
    options = arguments(given)
    if options.summarize:
        text = json.dumps(summarize(options.summarize), indent=1)
        options.out.write_text(text + "\n") if options.out else print(text)
        return
    if missing := lacking():
        sys.exit(missing)
    if absent := absent_data(None):
        print(absent, file=sys.stderr)
    torch.set_num_threads(1)
    here, there = libraries(options.library)
    counts: collections.Counter[str] = collections.Counter()
    print(f"{'seed':>6} {'family':9} {'view':7} {'result':10} {'steps':>5} {'s':>6}  first difference (here, bsk_rl)")
    for seed in seeds_of(options.seeds):
        case = problem(seed, options.steps, options.library)
        if options.families and case.family not in options.families:
            continue
        if options.verbose:
            print(case)
        begin = time.perf_counter()
        with quiet():
            verdict = compare(case, here, there, options.backend, options.verbose)
        counts[verdict.word] += 1
        found = verdict.finding
        seconds = time.perf_counter() - begin
        words = f"step {found.step}, {found.quantity}: {found.here} | {found.there}" if found else verdict.parted
        print(
            f"{seed:6d} {case.family:9} {case.view:7} {verdict.word:10} {verdict.steps:5d} {seconds:6.1f}  {words}"
            f"{f' [{found.reason}]' if found and found.reason else ''}",
            flush=True,
        )
        if options.out:
            with options.out.open("a") as file:
                case_of = {"library": options.library, "seed": seed, "family": case.family, "view": case.view}
                file.write(json.dumps(case_of | {"result": verdict.word} | asdict(verdict)) + "\n")
    print(", ".join(f"{count} {word}" for word, count in sorted(counts.items())))
    sys.exit(1 if counts["different"] else 0)


if __name__ == "__main__":
    main()
