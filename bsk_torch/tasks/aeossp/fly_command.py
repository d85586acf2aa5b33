"""``bsk-torch aeossp fly``: what a plan of aeossp_standard promises, and what satellites with body and wheels deliver."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bsk_torch.cli.declaration import JsonFile, flag
from bsk_torch.cli.shared import check_writable
from bsk_torch.cli.terminal import activity, refusing, working
from bsk_torch.tasks.aeossp.commands import CaseFolder

if TYPE_CHECKING:
    from bsk_torch.tasks.aeossp.files import Case, Observations
    from bsk_torch.tasks.aeossp.flight import Flight


def fly_solution(
    case: CaseFolder,
    solution: Annotated[Path, typer.Argument(metavar="FILE", help="JSON file of the solution.", show_default=False)],
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
    from bsk_torch.tables import print_table
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

    return [
        {
            "satellite_id": case.satellites[satellite].name,
            "task_id": case.requests.names[task],
            "start_time": iso(case, start),
            "missed": REASONS[missed] if missed >= 0 else None,
            "pointing_error_rad": angle,
            "rate_error_rad_per_s": rate,
        }
        for satellite, task, start, missed, angle, rate in zip(
            *(
                column.tolist()
                for column in (
                    observations.satellite,
                    observations.task,
                    observations.start_s,
                    flight.missed,
                    flight.angle,
                    flight.rate,
                )
            ),
            strict=True,
        )
    ]
