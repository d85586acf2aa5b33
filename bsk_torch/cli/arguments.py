"""``bsk-torch args``: the arguments of a preset's satellites and world."""

from __future__ import annotations

from collections.abc import Mapping

from bsk_torch.cli.shared import made
from bsk_torch.sim.arguments.table import ArgumentTable, short
from bsk_torch.tables import print_table

COLUMNS = ("argument", "in this preset", "default", "meaning")


def show_arguments(preset: str) -> None:
    """Print every argument of a preset's first satellite and world: its value there, default, unit and meaning."""
    env = made(preset, 1, {"backend": "eager"})
    first = env.builder.satellites[0]
    for title, defaults, given in (
        ("sat_args", env.default_sat_args(), first.sat_args_generator),
        ("world_args", env.default_world_args(), env.world_args_generator),
    ):
        print_table(rows(defaults, given), title, left=COLUMNS, whole=COLUMNS[:1])


def rows(defaults: ArgumentTable, given: Mapping[str, object]) -> list[dict[str, str]]:
    """Return a row for each argument, those first that the preset sets; the default is empty where it is the preset's value."""
    found = []
    for arg in sorted(defaults.rows.values(), key=lambda arg: arg.name not in given):
        default = short(defaults[arg.name])
        here = short(given[arg.name]) if arg.name in given else default
        meaning = f"{arg.doc} ({arg.unit})" if arg.unit not in ("", "-") else arg.doc
        found.append(dict(zip(COLUMNS, (arg.name, here, default if default != here else "", meaning), strict=True)))
    return found
