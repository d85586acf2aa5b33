"""``bsk-torch args``: the arguments of a preset's satellites and world."""

from __future__ import annotations

from bsk_torch.cli.declaration import Preset
from bsk_torch.cli.shared import made
from bsk_torch.tables import print_table

NAMES = {"argument": "argument", "here": "in this preset", "default": "default", "meaning": "meaning"}
"""Headlines of the columns."""


def show_arguments(preset: Preset) -> None:
    """Show the arguments of a preset's satellites and world: value in the preset, default and meaning.

    Examples:
        bsk-torch args NadirScan-v1
    """
    env = made(preset, 1, {"backend": "eager"})
    for title, table in (("sat_args", env.default_sat_args()), ("world_args", env.default_world_args())):
        rows = [{NAMES[name]: cell for name, cell in with_unit(cells).items() if name in NAMES} for cells in table.cells()]
        print_table(rows, title, left=tuple(NAMES.values()), whole=("argument",))


def with_unit(cells: dict[str, str]) -> dict[str, str]:
    """Return the cells of an argument with its unit after its meaning."""
    unit = f" ({cells['unit']})" if cells["unit"] not in ("", "-") else ""
    return cells | {"meaning": cells["meaning"] + unit}
