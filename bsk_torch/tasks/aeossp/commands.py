"""``bsk-torch aeossp``: plans for cases of aeossp_standard, what its rules say about them, and what flown satellites deliver."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bsk_torch.cli.declaration import JsonFile, flag
from bsk_torch.cli.shared import check_writable
from bsk_torch.cli.terminal import activity, echo, fail, refusing, working
from bsk_torch.sim.names import nearest
from bsk_torch.tables import print_table

if TYPE_CHECKING:
    from bsk_torch.tasks.aeossp.files import Case, Observations
    from bsk_torch.tasks.aeossp.flight import Flight
    from bsk_torch.tasks.aeossp.rules import Report

CaseFolder = Annotated[
    Path,
    typer.Argument(metavar="CASE", help="Folder of the case: mission.yaml, satellites.yaml, tasks.yaml.", show_default=False),
]

SolutionFile = Annotated[Path, typer.Argument(metavar="FILE", help="JSON file of the solution.", show_default=False)]

SHOWN = 10
"""Violations that are printed."""


def plan_case(
    case: CaseFolder,
    out: Annotated[Path, flag("FILE", "JSON file for the solution.")],
    model: Annotated[
        str, flag("NAME", "Slews between observations: 'verifier', the benchmark's, or 'flyable', by a body under its limits.")
    ] = "verifier",
    margin: Annotated[float, flag("S", "Additional time in each gap between observations, in seconds.", min=0.0)] = 0.0,
    seed: Annotated[int, flag("N", "Seed of the planner.", min=0)] = 0,
) -> None:
    """Plan the observations of a case of aeossp_standard, and write a solution that its verifier accepts.

    Examples:
        bsk-torch aeossp plan test/case_0001 --out solution.json
        bsk-torch aeossp plan case --out s.json --model flyable --margin 5
    """
    from bsk_torch.tasks.aeossp.files import read_case, write_solution
    from bsk_torch.tasks.aeossp.geometry import tracks
    from bsk_torch.tasks.aeossp.planning import plan
    from bsk_torch.tasks.aeossp.rules import check
    from bsk_torch.tasks.aeossp.slews import MODELS

    if model not in MODELS:
        fail(f"--model {model!r} is no model of slews; {nearest(model, MODELS)}")
    check_writable(out)
    with working("reading the case") as tell, refusing():
        content = read_case(case)
        positions = tracks(content)
        result = plan(content, MODELS[model], margin, seed, positions, tell)
        report = check(content, result.observations, positions)
    write_solution(out, content, result.observations)
    print_report(content, result.observations, report)
    echo(f"No plan with these slews has a WCR above {result.bound:.4f}.")


def check_solution(
    case: CaseFolder,
    solution: SolutionFile,
) -> None:
    """Check a solution of a case of aeossp_standard by the benchmark's rules; the exit status is 1 for an invalid one.

    Examples:
        bsk-torch aeossp check test/case_0001 solution.json
    """
    from bsk_torch.tasks.aeossp.files import read_case, read_solution
    from bsk_torch.tasks.aeossp.rules import check

    with working("checking"), refusing():
        content = read_case(case)
        observations = read_solution(solution, content)
        report = check(content, observations)
    print_report(content, observations, report)
    for number, text in report.violations[:SHOWN]:
        echo(f"observation {number} {text}" if number >= 0 else text)
    if len(report.violations) > SHOWN:
        echo(f"and {len(report.violations) - SHOWN} more violations")
    if not report.valid:
        raise typer.Exit(1)


def print_report(case: Case, observations: Observations, report: Report) -> None:
    """Print the metrics of a plan."""
    margins = [power / craft.capacity_wh for power, craft in zip(report.power.least_wh, case.satellites, strict=True)]
    row = {
        "plan": "valid" if report.valid else "invalid",
        "observations": str(len(observations)),
        "WCR": f"{report.WCR:.4f}",
        "CR": f"{report.CR:.4f}",
        "TAT, s": "" if report.TAT is None else f"{report.TAT:.0f}",
        "PC, Wh": f"{report.PC:.0f}",
        "least charge, %": f"{100.0 * min(margins):.1f}",
    }
    print_table([row], f"{case.name}: {len(case.satellites)} satellites, {len(case.requests)} tasks", left=("plan",))


def fly_solution(
    case: CaseFolder,
    solution: SolutionFile,
    power: Annotated[str, flag("NAME", "Power of slews: 'case', as in the case, or 'wheels', as the wheels need.")] = "case",
    tick: Annotated[float, flag("S", "Length of a tick in seconds.")] = 0.1,
    margins: Annotated[
        str, flag("S,S,...", "Also fly the plan without observations whose gaps have less slack than S seconds.")
    ] = "",
    out: JsonFile = None,
    *,
    options: Annotated[dict[str, object], ("threads",)],
) -> None:
    """Fly a plan of aeossp_standard with rigid bodies, wheels and batteries, and show what it delivers.

    The row 'honest' has the slew limits of the case. The row 'as promised' multiplies them by the smallest factor with which
    everything is delivered; it is missing if no factor up to 4 suffices.

    Examples:
        bsk-torch aeossp fly test/case_0001 solution.json
        bsk-torch aeossp fly case solution.json --margins 1,2,5 --out flown.json
    """
    from bsk_torch._checks import number
    from bsk_torch.files import write_file
    from bsk_torch.tasks.aeossp.files import read_case, read_solution
    from bsk_torch.tasks.aeossp.flight import fly
    from bsk_torch.tasks.aeossp.margins import fitting_factor, thinned

    check_writable(out)
    with refusing():
        slacks = [number("margins", float(text), 0.0, unit="s") for text in margins.split(",") if text]
        task = read_case(case)
        plan = read_solution(solution, task)
    with working(f"flying {solution.name}"), refusing():
        flight = fly(task, plan, power=power, tick=tick)
        rows = [{"flown": "honest", "factor": "1", **cells(task, plan, flight)}]
        factor = fitting_factor(task, plan, power=power, tick=tick)
        if 1.0 < factor < math.inf:
            scaled = cells(task, plan, fly(task, plan, factor=factor, power=power, tick=tick))
            rows.append({"flown": "as promised", "factor": f"{factor:.2f}", **scaled})
        for slack in slacks:
            part = thinned(task, plan, slack)
            rows.append(
                {"flown": f"slack {slack:g} s", "factor": "1"} | cells(task, part, fly(task, part, power=power, tick=tick))
            )
    activity.report()
    print_table(rows, f"{task.name}, {solution.name}", left=("flown",), whole=("flown", "WCR"))
    if out is not None:
        write_file(out, json.dumps({"rows": rows, "observations": described(task, plan, flight)}, indent=1) + "\n")


def cells(case: Case, observations: Observations, flight: Flight) -> dict[str, str]:
    """Return a row of the table: delivered of promised observations and weight, and reasons of missed ones."""
    from bsk_torch.tasks.aeossp.flight import REASONS
    from bsk_torch.tasks.aeossp.margins import completed_weight, delivered

    missed = {reason: int((flight.missed == k).sum()) for k, reason in enumerate(REASONS)}
    weights = (completed_weight(case, part) for part in (delivered(observations, flight), observations))
    return {
        "delivered": f"{int(flight.delivered.sum())} of {len(observations)}",
        "WCR": "{:.4f} of {:.4f}".format(*weights),
        **{reason.replace("_", " "): str(count) for reason, count in missed.items() if count},
    }


def described(case: Case, observations: Observations, flight: Flight) -> list[dict[str, object]]:
    """Return what became of each observation."""
    from bsk_torch.tasks.aeossp.files import iso
    from bsk_torch.tasks.aeossp.flight import REASONS

    o = observations
    columns = o.satellite, o.task, o.start_s, flight.missed, flight.angle, flight.rate
    return [
        {
            "satellite_id": case.satellites[satellite].name,
            "task_id": case.requests.names[task],
            "start_time": iso(case, start),
            "missed": REASONS[missed] if missed >= 0 else None,
            "pointing_error_rad": angle,
            "rate_error_rad_per_s": rate,
        }
        for satellite, task, start, missed, angle, rate in zip(*(column.tolist() for column in columns), strict=True)
    ]
