"""Cases of aeossp_standard: real satellites observe tasks with windows for twelve hours; reading, checking, planning, solutions.

Attributes are imported when they are first read (PEP 562), so that the help of the commands does not wait for torch.
"""

from typing import TYPE_CHECKING

from bsk_torch.sim.names import lazy as _lazy

if TYPE_CHECKING:
    from bsk_torch.tasks.aeossp.env import case_env, drawn_case_env
    from bsk_torch.tasks.aeossp.files import (
        Case,
        CaseSatellite,
        Observations,
        Requests,
        read_case,
        read_solution,
        write_solution,
    )
    from bsk_torch.tasks.aeossp.flight import Flight, fly
    from bsk_torch.tasks.aeossp.margins import fitting_factor, thinned
    from bsk_torch.tasks.aeossp.planning import Plan, plan
    from bsk_torch.tasks.aeossp.rules import Power, Report, Slews, check
    from bsk_torch.tasks.aeossp.slews import Line, flyable, verifier

__all__ = [
    "Case",
    "CaseSatellite",
    "Flight",
    "Line",
    "Observations",
    "Plan",
    "Power",
    "Report",
    "Requests",
    "Slews",
    "case_env",
    "check",
    "drawn_case_env",
    "fitting_factor",
    "fly",
    "flyable",
    "plan",
    "read_case",
    "read_solution",
    "thinned",
    "verifier",
    "write_solution",
]

__getattr__ = _lazy(
    __name__,
    {
        "env": ["case_env", "drawn_case_env"],
        "files": ["Case", "CaseSatellite", "Observations", "Requests", "read_case", "read_solution", "write_solution"],
        "flight": ["Flight", "fly"],
        "margins": ["fitting_factor", "thinned"],
        "planning": ["Plan", "plan"],
        "rules": ["Power", "Report", "Slews", "check"],
        "slews": ["Line", "flyable", "verifier"],
    },
)
