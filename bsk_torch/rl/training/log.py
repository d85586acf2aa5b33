"""Numbers of a training as they come: rows of CSV files, and TensorBoard or Weights & Biases where these are asked for."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, cast

from bsk_torch._deprecated import deprecated_names

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
"""Of a row for each evaluation on fresh episodes, with the half width of the 95 % interval of the return."""

LOG, EVALUATIONS = "log.csv", "evaluations.csv"
"""Files of a run's folder."""


class CsvLog:
    """Writes rows as they come, so that a run can be watched and survives an interruption."""

    def __init__(self, path: Path, columns: Iterable[str], keep: float = 0) -> None:
        """Start the file at ``path``, or go on after its rows with up to ``keep`` frames."""
        self.columns = tuple(columns)
        rows = [row for row in _rows(path) if float(row["frames"]) <= keep] if path.exists() else []
        self._file = path.open("w", newline="")
        self._writer = csv.DictWriter(self._file, self.columns)
        self._writer.writeheader()
        self._writer.writerows(rows)

    def write(self, row: Mapping[str, float]) -> None:
        """Add a row with exactly the columns."""
        self._writer.writerow({name: f"{row[name]:.6g}" if name != "frames" else int(row[name]) for name in self.columns})
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def check_loggers(names: Iterable[str]) -> None:
    """ModuleNotFoundError, naming the command that installs it, for a logger that is not installed."""
    for name in names:
        if name != "csv" and find_spec(name) is None:
            raise ModuleNotFoundError(f"loggers={name!r} needs {name}; pip install 'bsk_torch[{name}]'", name=name)


class RunLog:
    """All logs of a run: ``log.csv`` and ``evaluations.csv`` in its folder, and the services that the configuration names."""

    def __init__(self, out: Path, names: Iterable[str], keep: float = 0) -> None:
        """Log into folder ``out``; go on after ``keep`` frames."""
        self.training = CsvLog(out / LOG, COLUMNS, keep)
        self.evaluation = CsvLog(out / EVALUATIONS, EVALUATED, keep)
        self.services = [_service(name, out) for name in names if name != "csv"]

    def __enter__(self) -> RunLog:
        """Nothing more to open."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close the files, and end what the services hold open."""
        for service in self.services:
            (getattr(service.experiment, "finish", None) or service.experiment.close)()
        self.training.close()
        self.evaluation.close()

    def iteration(self, row: Mapping[str, float]) -> None:
        """Note an iteration."""
        self.training.write(row)
        self._tell("training", row)

    def evaluated(self, row: Mapping[str, float]) -> None:
        """Note an evaluation."""
        self.evaluation.write(row)
        self._tell("evaluation", row)

    def _tell(self, kind: str, row: Mapping[str, float]) -> None:
        for service in self.services:
            for name, value in row.items():
                service.log_scalar(f"{kind}/{name}", value, step=int(row["frames"]))


def _service(name: str, out: Path) -> Any:
    """TorchRL's logger of that name."""
    from torchrl.record.loggers import get_logger

    return get_logger(cast(Any, name), logger_name=str(out), experiment_name=out.name if name == "wandb" else name)


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def read_log(path: Path) -> dict[str, list[float]]:
    """Columns of a log by name."""
    rows = _rows(path)
    return {name: [float(row[name]) for row in rows] for name in (rows[0] if rows else ())}


if not TYPE_CHECKING:
    __getattr__ = deprecated_names(__name__)
