"""Where the CPU time of a training goes, by phase.

Usage:
    python benchmarks/training_profile.py [--cases NadirScan-v1:mlp AEOS-v1:attention] [--seconds 20] [--out FILE.json]

Each case is a preset and a network, trained by its recipe in one process and one thread; see bsk_torch/rl/training/profile.py.
"bsk-torch profile PRESET" does the same for other presets and settings.
"""

from __future__ import annotations

from typing import Any

import harness
import torch

from bsk_torch.rl.marl.runs import configure, training_of
from bsk_torch.rl.training.profile import measure

COLUMNS = {"case": "{case}", "phase": "{phase}", "us per decision": "{us:,.2f}", "%": "{percent:.1f}"}


def profile(case: str, seconds: float, num_envs: int) -> list[dict[str, Any]]:
    """Rows of a case: every phase, and their sum."""
    preset, _, network = case.partition(":")
    changes = {"num_envs": num_envs} if num_envs else {}
    found = measure(configure(preset, network or None, **changes), seconds, training_of)
    return [
        {"case": case, "phase": phase, "us": us, "percent": 100.0 * us / found.total}
        for phase, us in [*found.spent.items(), ("all", found.total)]
    ]


def main() -> None:
    """Measure and print a table."""
    cases = ["NadirScan-v1:mlp", "AEOS-v1:attention"]
    parsed = harness.parser(__doc__, cases=cases, seconds=20.0, num_envs=0)
    options, described = harness.begin(parsed)
    torch.manual_seed(0)
    rows = harness.Rows(
        options, described, (row for case in options.cases for row in profile(case, options.seconds, options.num_envs))
    )
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
