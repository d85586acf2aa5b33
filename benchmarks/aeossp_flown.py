"""What plans of aeossp_standard promise, and what satellites with body, wheels and battery deliver of them.

Usage:
    python benchmarks/aeossp_flown.py [--folder cases] [--cases test/case_0001 ...] [--plans solution.json ...]
        [--slacks 2 5 10] [--out FILE.json]

``--folder`` holds cases, and in the folder of each case the ``--plans``. Slacks are those of gaps by which plans are thinned.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import harness

from bsk_torch.tasks.aeossp import Case, Observations, fitting_factor, fly, read_case, read_solution, thinned
from bsk_torch.tasks.aeossp.flight import REASONS
from bsk_torch.tasks.aeossp.margins import completed_weight, delivered

COLUMNS = {
    "case": "{case}",
    "plan": "{plan}",
    "slack, s": "{slack:g}",
    "promised": "{promised}",
    "delivered": "{delivered}",
    "WCR promised": "{WCR_promised:.4f}",
    "WCR": "{WCR:.4f}",
    **{reason: f"{{{reason}}}" for reason in REASONS},
    "factor": "{factor}",
    "CPU s": "{cpu:.1f}",
}


def flown(case: Case, plan: Observations) -> dict[str, Any]:
    """Return what a flight of a plan delivers."""
    begin = time.process_time()
    flight = fly(case, plan)
    cpu = time.process_time() - begin
    found = {
        "promised": len(plan),
        "delivered": int(flight.delivered.sum()),
        "WCR_promised": completed_weight(case, plan),
        "WCR": completed_weight(case, delivered(plan, flight)),
    }
    return found | {reason: int((flight.missed == k).sum()) for k, reason in enumerate(REASONS)} | {"cpu": cpu}


def main() -> None:
    """Fly and print a table."""
    arguments = harness.parser(
        __doc__, folder="cases", cases=["test/case_0001"], plans=["solution.json"], slacks=[2.0, 5.0, 10.0]
    )
    options, described = harness.begin(arguments)
    rows: list[dict[str, Any]] = []
    for name in options.cases:
        case = read_case(Path(options.folder, name))
        for file in options.plans:
            plan = read_solution(Path(options.folder, name, file), case)
            shared = {"case": name, "plan": Path(file).stem.removeprefix("solution_")}
            rows.append(shared | {"slack": 0.0, "factor": round(fitting_factor(case, plan), 3)} | flown(case, plan))
            for slack in options.slacks:
                rows.append(shared | {"slack": slack, "factor": None} | flown(case, thinned(case, plan, slack)))
            harness.write(options, described, rows=rows)
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    main()
