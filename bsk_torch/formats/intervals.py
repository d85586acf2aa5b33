"""Access windows and schedules as CSV and JSON: a row for each interval, with times in UTC and in seconds."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping
from typing import Literal

from bsk_torch.astro.ephemeris import date_in_words

__all__ = ["interval_row", "write_rows"]

Cell = str | float | int | None


def interval_row(et: float, start: float, end: float) -> dict[str, Cell]:
    """Return the cells of an interval from ``start`` to ``end`` s after ET: UTC to the millisecond, and seconds."""
    return {
        "start_utc": date_in_words(et + start),
        "end_utc": date_in_words(et + end),
        "start_s": round(start, 3),
        "end_s": round(end, 3),
    }


def write_rows(rows: Iterable[Mapping[str, Cell]], form: Literal["csv", "json"]) -> str:
    """Return rows of equal columns as the text of a CSV file with a header, or a JSON list of objects; None is an empty cell."""
    table = list(rows)
    if form == "json":
        return json.dumps(table, ensure_ascii=False, allow_nan=False, indent=1) + "\n"
    text = io.StringIO()
    if table:
        writer = csv.DictWriter(text, fieldnames=list(table[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)
    return text.getvalue()
