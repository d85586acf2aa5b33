"""Table of flown plans of aeossp_standard."""

from __future__ import annotations

from collections.abc import Callable

from docs._ext.results import load, with_command


def flown(name: str) -> str:
    """Return what plans promise and deliver, by case, plan and slack of gaps."""
    rows = [
        [
            row["case"],
            f"`{row['plan']}`",
            f"{row['slack']:g}",
            f"{row['delivered']:,} of {row['promised']:,}",
            f"{row['WCR']:.4f} of {row['WCR_promised']:.4f}",
            f"{row['pointing']}",
            f"{row['rate']}",
            f"{row['off_nadir'] + row['battery']}",
            "-" if row["factor"] is None else f"{row['factor']:.2f}",
            f"{row['cpu']:.1f}",
        ]
        for row in load(name)["rows"]
    ]
    titles = ["case", "plan", "slack, s", "delivered", "WCR", "pointing", "rate", "other reasons", "factor", "CPU s"]
    return with_command(name, titles, rows)


TABLES: dict[str, Callable[..., str]] = {"aeossp_flown": flown}
"""Tables by name."""
