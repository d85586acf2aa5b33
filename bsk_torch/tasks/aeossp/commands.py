"""``bsk-torch aeossp plan`` and ``aeossp check``: plans for cases of aeossp_standard, and what its rules say about them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bsk_torch.cli.declaration import flag
from bsk_torch.cli.shared import check_writable
from bsk_torch.cli.terminal import echo, fail, refusing, working
from bsk_torch.sim.names import nearest
from bsk_torch.tables import print_table

if TYPE_CHECKING:
    from bsk_torch.tasks.aeossp.files import Case, Observations
    from bsk_torch.tasks.aeossp.rules import Report

CaseFolder = Annotated[
    Path,
    typer.Argument(metavar="CASE", help="Folder of the case: mission.yaml, satellites.yaml, tasks.yaml.", show_default=False),
]

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
    solution: Annotated[Path, typer.Argument(metavar="FILE", help="JSON file of the solution.", show_default=False)],
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
