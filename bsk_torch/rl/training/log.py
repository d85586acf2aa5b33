"""Numbers of a training as they come: rows of CSV files, and TensorBoard or Weights & Biases where these are asked for."""

from __future__ import annotations

import csv
import io
import logging
import os
from collections.abc import Iterable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any, cast

from bsk_torch.files import write_file

logger = logging.getLogger(__name__)

COLUMNS = (
    "iteration",
    "frames",
    "seconds",
    "simulated_days",
    "episodes",
    "return",
    "survival",
    "collected",
    "fill",
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
"""Of a row for each iteration. ``seconds`` is training time without compilation; ``return``, ``survival`` (fraction),
``collected`` (return without the penalty for dying), ``fill`` (of the data buffer at the end, where it is observed) and
``decisions`` are means over the episodes that ended last, ``episodes`` is how many have ended in all."""

EVALUATED = ("frames", "seconds", "return", "return_half_width", "survival", "collected", "fill")
"""Of a row for each evaluation on unseen episodes, with the half width of the 95 % interval of the return."""

LOG, EVALUATIONS = "log.csv", "evaluations.csv"
"""Files of a run's folder."""


class CsvLog:
    """Writes rows as they come, so that a run can be watched and survives an interruption.

    A log never stops a training: rows that cannot be written, such as on a full disk, are kept and tried again with the next one,
    and that is said once.
    """

    def __init__(self, path: Path, columns: Iterable[str], keep: float = 0) -> None:
        """Start the file at ``path``, or continue after its rows with up to ``keep`` frames."""
        self.path, self.columns = path, tuple(columns)
        self._file: io.RawIOBase | None = None
        self._warned = False
        self._waiting = _lines([self.columns, *self._earlier_rows(keep)])
        self._flush()

    def _earlier_rows(self, frames: float) -> list[Sequence[str]]:
        if not self.path.exists():
            return []
        try:
            header, rows = _read(self.path)
        except OSError as error:
            self._warn(error)
            return []
        if header != self.columns:
            logger.warning("%s has other columns than this training; it is started again", self.path)
            return []
        return [row for row in rows if float(row[header.index("frames")]) <= frames]

    def write(self, row: Mapping[str, float]) -> None:
        """Add a row with exactly the columns."""
        self._waiting += _lines([[f"{row[name]:.6g}" if name != "frames" else str(int(row[name])) for name in self.columns]])
        self._flush()

    def _flush(self) -> None:
        try:
            if self._file is None:
                write_file(self.path, self._waiting)
                self._waiting = b""
                flags = os.O_WRONLY | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0)
                self._file = io.FileIO(os.open(self.path, flags), "ab")
            while self._waiting:
                self._waiting = self._waiting[self._file.write(self._waiting) :]
        except OSError as error:
            self._warn(error)

    def _warn(self, error: OSError) -> None:
        if not self._warned:
            logger.warning("%s cannot be written (%s); training continues", self.path, error.strerror or error)
        self._warned = True

    def close(self) -> None:
        """Write what could not be written so far, if that is possible now, and close the file."""
        self._flush()
        if self._file is not None:
            self._file.close()


def _lines(rows: Iterable[Sequence[str]]) -> bytes:
    text = io.StringIO(newline="")
    csv.writer(text).writerows(rows)
    return text.getvalue().encode()


def check_loggers(names: Iterable[str]) -> None:
    """ModuleNotFoundError, naming the command that installs it, for a logger that is not installed."""
    for name in names:
        if name != "csv" and find_spec(name) is None:
            raise ModuleNotFoundError(f"loggers={name!r} needs {name}; pip install 'bsk_torch[{name}]'", name=name)


class RunLog:
    """All logs of a run: ``log.csv`` and ``evaluations.csv`` in its folder, and the services that the configuration names."""

    def __init__(self, out: Path, names: Iterable[str], keep: float = 0) -> None:
        """Log into folder ``out``; continue after ``keep`` frames."""
        self.training = CsvLog(out / LOG, COLUMNS, keep)
        self.evaluation = CsvLog(out / EVALUATIONS, EVALUATED, keep)
        self.services = {name: _service(name, out) for name in names if name != "csv"}

    def __enter__(self) -> RunLog:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.training.close()
        self.evaluation.close()
        for name, service in list(self.services.items()):
            try:
                (getattr(service.experiment, "finish", None) or service.experiment.close)()
            except Exception as problem:
                self._drop(name, problem)

    def iteration(self, row: Mapping[str, float]) -> None:
        """Note an iteration."""
        self.training.write(row)
        self._tell("training", row)

    def evaluated(self, row: Mapping[str, float]) -> None:
        """Note an evaluation."""
        self.evaluation.write(row)
        self._tell("evaluation", row)

    def _tell(self, kind: str, row: Mapping[str, float]) -> None:
        for name, service in list(self.services.items()):
            try:
                for column, value in row.items():
                    service.log_scalar(f"{kind}/{column}", value, step=int(row["frames"]))
            except Exception as problem:  # a full disk, or a network that is down; each service has its own errors
                self._drop(name, problem)

    def _drop(self, name: str, problem: Exception) -> None:
        logger.warning("the logger %s fails (%s) and is used no more; training continues", name, problem)
        self.services.pop(name, None)


def _service(name: str, out: Path) -> Any:
    from torchrl.record.loggers import get_logger

    return get_logger(cast(Any, name), logger_name=str(out), experiment_name=out.name if name == "wandb" else name)


def _read(path: Path) -> tuple[tuple[str, ...], list[list[str]]]:
    """Return the names of the columns and the rows of a log, without lines that are torn or hold no numbers."""
    lines = path.read_bytes().decode(errors="replace").splitlines(keepends=True)
    cells = [line.rstrip("\r\n").split(",") for line in lines if line.endswith("\n")]  # the last one may not have been finished
    header, rows = cells[:1], [row for row in cells[1:] if len(row) == len(cells[0]) and all(map(_is_number, row))]
    if header and len(header) + len(rows) < len(lines):
        logger.warning("%s: %d damaged lines are left out", path, len(lines) - len(rows) - 1)
    return tuple(*header), rows


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def read_log(path: Path) -> dict[str, list[float]]:
    """Columns of a log by name; none where it has no rows. ValueError for a file that is not a log."""
    header, rows = _read(path)
    if header and not {"frames", "seconds"} <= set(header):
        raise ValueError(f"{str(path)!r} is no log of a training: it has no columns 'frames' and 'seconds'")
    return {name: [float(row[k]) for row in rows] for k, name in enumerate(header)} if rows else {}
