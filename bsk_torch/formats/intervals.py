"""Access windows and schedules as CSV and JSON: a row for each interval, with times in UTC and in seconds."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence

from torch import Tensor

from bsk_torch.astro.ephemeris import utc_in_words

__all__ = ["interval_table"]

Cell = str | float | int | None
NOTHING: Mapping[str, Sequence[Cell]] = {}


def interval_table(
    columns: Mapping[str, Sequence[Cell]],
    et: float,
    start: Tensor,
    end: Tensor,
    form: str,
    after: Mapping[str, Sequence[Cell]] = NOTHING,
) -> str:
    """Return intervals as the text of a CSV file with a header, or of a JSON list of objects.

    Args:
        columns: What the intervals are, n cells each.
        et: ET of time zero, s.
        start: Begins, [n] s; written in UTC to the millisecond, and in seconds.
        end: Ends, likewise.
        form: ``"csv"`` or ``"json"``.
        after: Columns behind the times; None is an empty cell.
    """
    seconds = {name: [round(time, 3) for time in times.tolist()] for name, times in (("start_s", start), ("end_s", end))}
    words = {"start_utc": utc_in_words(et + start), "end_utc": utc_in_words(et + end)}
    table: dict[str, Sequence[Cell]] = {**columns, **words, **seconds, **after}
    rows = zip(*table.values(), strict=True)
    if form == "json":
        return (
            json.dumps([dict(zip(table, row, strict=True)) for row in rows], ensure_ascii=False, allow_nan=False, indent=1) + "\n"
        )
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows(rows)
    return text.getvalue()
