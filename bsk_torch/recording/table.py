"""Recorded episodes as tables: NumPy columns and CSV files."""

from __future__ import annotations

import csv
import io
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from bsk_torch.files import write_file

__all__ = ["Columns", "Tabular", "Tasks", "number_columns", "satellite_columns"]

Columns = dict[str, np.ndarray]
"""Columns of a table by name, of equal length."""


class Tabular(ABC):
    """A recorded episode that can be exported as a table."""

    @abstractmethod
    def to_numpy(self) -> Columns:
        """Return the episode as a table: columns by name, all of one length."""

    def to_csv(self, path: Path | str) -> Path:
        """Write the table of :meth:`to_numpy` to a file with a header, and return its path."""
        table = self.to_numpy()
        text = io.StringIO()
        lines = csv.writer(text, lineterminator="\n")
        lines.writerow(table)
        lines.writerows(zip(*(column.tolist() for column in table.values()), strict=True))
        write_file(Path(path), text.getvalue())
        return Path(path)


def number_columns(quantities: Mapping[str, Tensor]) -> Columns:
    """Return quantities [T, width] as columns [T]; of several numbers, each has a column, such as ``wheel_speeds_fraction_0``."""
    table: Columns = {}
    for name, values in quantities.items():
        numbers = values.double().numpy()
        names = [name] if numbers.shape[1] == 1 else [f"{name}_{k}" for k in range(numbers.shape[1])]
        table |= dict(zip(names, numbers.T, strict=True))
    return table


@dataclass(frozen=True)
class Tasks:
    """M tasks of satellites.

    Attributes:
        satellite: Number of the satellite, [M] int64.
        spans: Begin and end, [M, 2] s since reset.
        kind: Number of the name, [M] int64.
        names: Names of all kinds.
    """

    satellite: Tensor
    spans: Tensor
    kind: Tensor
    names: Sequence[str]

    def columns(self, times: Tensor, ends: Tensor) -> Columns:
        """Return the columns ``action``, the task in progress from each of ``times`` [B] on, and ``decided``, if it began there.

        Satellites do nothing after their ``ends`` [S], s. Rows are those of :func:`satellite_columns`.
        """
        action = np.full((len(times), len(ends)), "", dtype=object)
        decided = np.zeros(action.shape, dtype=bool)
        for who, (begin, end), kind in zip(self.satellite.tolist(), self.spans.tolist(), self.kind.tolist(), strict=True):
            during = (begin <= times) & (times < min(end, float(ends[who])))
            action[during.numpy(), who] = self.names[kind]
            decided[(during & (times == begin)).numpy(), who] = True
        return {"action": action.flatten().astype(str), "decided": decided.flatten()}


def satellite_columns(
    names: Sequence[str], times: Tensor, deaths: Tensor, tasks: Tasks, numbers: Mapping[str, Tensor]
) -> Columns:
    """Return a table with a row for each of S satellites at each of B decision boundaries, in the order of time.

    Args:
        names: Names of the satellites.
        times: The boundaries, [B] s since reset.
        deaths: When each satellite died, infinite for survivors, [S] s.
        tasks: Their tasks.
        numbers: Other columns, [S, B] or [S, B, width]; [S, B - 1, ...] are of the decisions, and nan at the last boundary.
    """
    table: Columns = {
        "time": np.repeat(times.double().numpy(), len(names)),
        "satellite": np.tile(np.array(names), len(times)),
        "alive": (times.unsqueeze(1) < deaths).flatten().numpy(),
    }
    table |= tasks.columns(times, deaths.clamp(max=float(times[-1])))
    for name, values in numbers.items():
        wide = values if values.ndim == 3 else values.unsqueeze(-1)
        missing = wide.new_full((len(names), len(times) - wide.shape[1], wide.shape[2]), float("nan"))
        table |= number_columns({name: torch.cat([wide, missing], 1).transpose(0, 1).flatten(0, 1)})
    return table
