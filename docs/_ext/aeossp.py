"""Tables of the planner of aeossp_standard."""

from __future__ import annotations

from collections.abc import Callable

from docs._ext.results import load, with_command

SOLVER = {
    "test/case_0001": 0.7057,
    "test/case_0002": 0.7763,
    "test/case_0003": 0.7837,
    "test_easy/case_0001": 0.8746,
}
"""WCR of the benchmark's solver ``mwis_conflict_graph``, run with its default settings."""


def aeossp(name: str) -> str:
    """Return what plans reach, by case, slews and margin."""
    rows = [
        [
            row["case"],
            f"`{row['model']}`",
            f"{row['margin']:g}",
            f"{row['WCR']:.4f}",
            f"{row['bound']:.4f}",
            f"{SOLVER[row['case']]:.4f}" if row["case"] in SOLVER else "-",
            f"{row['CR']:.4f}",
            f"{row['TAT']:.0f}",
            f"{row['PC']:,.0f}",
            f"{row['cpu']:.0f}",
        ]
        for row in load(name)["rows"]
    ]
    titles = ["case", "slews", "margin, s", "WCR", "bound", "solver's WCR", "CR", "TAT, s", "PC, Wh", "CPU s"]
    return with_command(name, titles, rows)


def entrants(name: str) -> str:
    """Return what rules and a policy deliver in a case, next to flown plans."""
    found = load(name)
    case = found["options"]["case"]
    plans = [row for row in load("aeossp_flown")["rows"] if row["case"] == case and not row["slack"]]
    rows = [[f"plan of `{row['plan']}`, flown", f"{row['WCR']:.4f}", f"{row['delivered']:,}", "-"] for row in plans]
    rows += [
        [
            f"rule `{row['entrant']}`" if row["entrant"] != "policy" else "policy",
            f"{row['WCR']:.4f}",
            f"{row['looks']:,}",
            f"{row['cpu']:.0f}",
        ]
        for row in found["rows"]
    ]
    return with_command(name, [f"entrant of {case}", "WCR delivered", "looks", "CPU s"], rows)


TABLES: dict[str, Callable[..., str]] = {"aeossp": aeossp, "aeossp_entrants": entrants}
"""Tables by name."""
