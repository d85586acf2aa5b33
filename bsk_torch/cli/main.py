"""The commands of ``bsk-torch``."""

from __future__ import annotations

import logging
from importlib import import_module

import typer

from bsk_torch.cli.evaluate import evaluate_policy
from bsk_torch.cli.explain import explain_failures
from bsk_torch.cli.publish import publish
from bsk_torch.cli.report import report
from bsk_torch.cli.schedule import show_schedule
from bsk_torch.cli.shared import Preset, made
from bsk_torch.cli.train import train
from bsk_torch.presets import PRESETS

app = typer.Typer(help="Train and evaluate satellite-tasking policies.", no_args_is_help=True, add_completion=False)


@app.callback()
def setup() -> None:
    """Say what takes long, and nothing else."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    logging.getLogger("torchrl").setLevel(logging.WARNING)


@app.command("list")
def list_presets() -> None:
    """List the environments that can be trained in."""
    for name, preset in PRESETS.items():
        docs = (preset.__doc__ or "", import_module(preset.__module__).__doc__ or "")
        lines = [doc.partition("\n")[0] for doc in docs]
        about = lines[0] if lines[0].startswith(f"{name}:") else lines[1]
        typer.echo(f"{name}  {about.removeprefix(f'{name}:').strip()}")


@app.command("args")
def show_arguments(preset: Preset) -> None:
    """Print every argument of a preset's satellite and world with default, unit and meaning."""
    env = made(preset, 1, {"backend": "eager"})
    typer.echo(f"sat_args\n{env.default_sat_args()!r}\n\nworld_args\n{env.default_world_args()!r}")


app.command("eval")(evaluate_policy)
app.command("explain")(explain_failures)
app.command("publish")(publish)
app.command("report")(report)
app.command("schedule")(show_schedule)
app.command("train")(train)
