"""``bsk-torch args``: the arguments of a preset's satellite and world."""

from __future__ import annotations

import typer

from bsk_torch.cli.shared import made


def show_arguments(preset: str) -> None:
    """Print every argument of a preset's satellite and world, with default, unit and meaning."""
    env = made(preset, 1, {"backend": "eager"})
    typer.echo(f"sat_args\n{env.default_sat_args()!r}\n\nworld_args\n{env.default_world_args()!r}")
