"""A training log: one row of numbers for each iteration, in a CSV file."""

from __future__ import annotations

import csv
from pathlib import Path
from types import TracebackType

COLUMNS = (
    "iteration",
    "frames",
    "seconds",
    "simulated_days",
    "episodes",
    "return",
    "survival",
    "decisions",
    "entropy",
    "kl",
    "clip_fraction",
    "explained_variance",
    "loss_critic",
    "learning_rate",
    "entropy_coefficient",
    "collect_seconds",
    "update_seconds",
)
"""``seconds`` is training time without compilation; ``return``, ``survival`` (fraction) and ``decisions`` are means over the
episodes that ended last, ``episodes`` how many have ended in all."""


class CsvLog:
    """Writes rows as they come, so that a run can be watched and survives an interruption."""

    def __init__(self, path: Path) -> None:
        """Start the file at ``path`` anew."""
        self.path = path

    def __enter__(self) -> CsvLog:
        """Open the file and write the header."""
        self._file = self.path.open("w", newline="")
        self._writer = csv.DictWriter(self._file, COLUMNS)
        self._writer.writeheader()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close the file."""
        self._file.close()

    def write(self, row: dict[str, float]) -> None:
        """Add a row with exactly the columns :data:`COLUMNS`."""
        self._writer.writerow({name: f"{row[name]:.6g}" for name in COLUMNS})
        self._file.flush()


def read_log(path: Path) -> dict[str, list[float]]:
    """Columns of a log by name."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: [float(row[name]) for row in rows] for name in COLUMNS}
