"""What the planner of ``bsk_torch.tasks.aeossp`` reaches in cases of aeossp_standard, by model of slews and margin.

Usage:
    python benchmarks/aeossp.py [--folder cases] [--cases test/case_0001 ...] [--models verifier flyable]
        [--margins 0 2 5 10 20] [--seed 0] [--solutions FOLDER] [--out FILE.json]

``--folder`` holds cases, such as benchmarks/aeossp_standard/dataset/cases in github.com/Mtrya/astro-reason. Plans go to
the folder ``--solutions``, if any.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import harness

from bsk_torch.tasks.aeossp import check, plan, read_case, write_solution
from bsk_torch.tasks.aeossp.files import Case
from bsk_torch.tasks.aeossp.geometry import tracks
from bsk_torch.tasks.aeossp.slews import MODELS

COLUMNS = {
    "case": "{case}",
    "slews": "{model}",
    "margin, s": "{margin:g}",
    "WCR": "{WCR:.4f}",
    "bound": "{bound:.4f}",
    "CR": "{CR:.4f}",
    "TAT, s": "{TAT:.0f}",
    "PC, Wh": "{PC:.0f}",
    "least charge": "{charge:.1%}",
    "CPU s": "{cpu:.0f}",
}


def planned(case: Case, model: str, margin: float, seed: int, solution: Path | None) -> dict[str, Any]:
    """Return what a plan reaches, by the rules of the benchmark."""
    begin = time.process_time()
    result = plan(case, MODELS[model], margin, seed)
    cpu = time.process_time() - begin
    report = check(case, result.observations, tracks(case))
    if not report.valid:
        raise RuntimeError(f"the plan is invalid: {report.violations[0]}")
    if solution is not None:
        write_solution(solution, case, result.observations)
    charge = min(least / craft.capacity_wh for least, craft in zip(report.power.least_wh, case.satellites, strict=True))
    metrics = {"WCR": report.WCR, "CR": report.CR, "TAT": report.TAT, "PC": report.PC}
    return metrics | {"bound": result.bound, "charge": charge, "observations": len(result.observations), "cpu": cpu}


def main() -> None:
    """Plan and print a table."""
    arguments = harness.parser(
        __doc__, folder="cases", cases=["test/case_0001"], models=["verifier", "flyable"], margins=[0.0], seed=0, solutions=""
    )
    options, described = harness.begin(arguments)
    rows = []
    for name in options.cases:
        case = read_case(Path(options.folder, name))
        for model in options.models:
            for margin in options.margins:
                file = f"{name.replace('/', '_')}_{model}_{margin:g}.json"
                place = Path(options.solutions, file) if options.solutions else None
                rows.append({"case": name, "model": model, "margin": margin} | planned(case, model, margin, options.seed, place))
                harness.write(options, described, rows=rows)
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    main()
