"""The commands of ``bsk-torch``."""

from __future__ import annotations

import logging
import sys
from typing import Any

import typer
from typer.core import TyperGroup

from bsk_torch.cli.bench import bench
from bsk_torch.cli.evaluate import evaluate_policy
from bsk_torch.cli.explain import explain_failures
from bsk_torch.cli.kernels import build_kernels
from bsk_torch.cli.publish import publish
from bsk_torch.cli.report import report
from bsk_torch.cli.schedule import show_schedule
from bsk_torch.cli.shared import Preset, fail, made
from bsk_torch.cli.train import train
from bsk_torch.presets import PRESETS

logger = logging.getLogger(__name__)


class Commands(TyperGroup):
    """Ends the program with one error, not a traceback, where files, memory or a compiler fail in the middle of a command."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        try:
            return super().invoke(ctx)
        except (typer.Exit, typer.Abort, BrokenPipeError):
            raise
        except (OSError, RuntimeError, MemoryError) as error:
            logger.debug("the command failed", exc_info=error)
            fail(described(error))


def described(error: BaseException) -> str:
    """Return the message of an error; that of the system names the file first."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{str(error.filename)!r}: {error.strerror}"
    return str(error) or type(error).__name__


app = typer.Typer(cls=Commands, help="Train and evaluate satellite-tasking policies.", no_args_is_help=True, add_completion=False)


@app.callback()
def setup() -> None:
    """Say what takes long, and nothing else."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    logging.getLogger("torchrl").setLevel(logging.WARNING)


@app.command("list")
def list_presets() -> None:
    """List the environments that can be trained in."""
    for name, preset in PRESETS.items():
        docs = (preset.__doc__ or "", getattr(sys.modules.get(preset.__module__), "__doc__", None) or "")
        lines = [doc.partition("\n")[0] for doc in docs]
        about = lines[0] if lines[0].startswith(f"{name}:") else lines[1]
        typer.echo(f"{name}  {about.removeprefix(f'{name}:').strip()}")


@app.command("args")
def show_arguments(preset: Preset) -> None:
    """Print every argument of a preset's satellite and world with default, unit and meaning."""
    env = made(preset, 1, {"backend": "eager"})
    typer.echo(f"sat_args\n{env.default_sat_args()!r}\n\nworld_args\n{env.default_world_args()!r}")


app.command("bench")(bench)
app.command("build-kernels")(build_kernels)
app.command("eval")(evaluate_policy)
app.command("explain")(explain_failures)
app.command("publish")(publish)
app.command("report")(report)
app.command("schedule")(show_schedule)
app.command("train")(train)
