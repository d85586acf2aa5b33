"""``bsk-torch args`` and ``bsk-torch schedule``: the arguments of a preset, and the order of a tick."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from bsk_torch.cli.declaration import Preset
from bsk_torch.cli.shared import made
from bsk_torch.cli.terminal import echo
from bsk_torch.sim.schedule import SCHEDULE, Schedule, Slot
from bsk_torch.tables import print_table

if TYPE_CHECKING:
    from bsk_torch.sim.component import Component
    from bsk_torch.sim.tick.loop import Tick


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


def show_schedule(
    preset: Annotated[
        str | None, typer.Argument(help="Environment, such as AEOS-v1; default: all slots.", show_default=False)
    ] = None,
) -> None:
    """Show the order of a tick: all slots, or the components of a preset, and what computes the phases of a step.

    Examples:
        bsk-torch schedule
        bsk-torch schedule NadirScan-v1
    """
    if preset is None:
        echo("\n".join(slot_lines(SCHEDULE)))
        return
    from bsk_torch.env.native import only_images, reason_for_tensors

    env = made(preset, 1, {"backend": "eager"})
    for simulator in env.fleet.simulators:
        names = ", ".join(env.fleet.names[k] for k in simulator.columns)
        echo("\n".join([f"{names}:", *(f"  {line}" for line in tick_lines(simulator.tick, simulator.type.schedule))]))
    reason = reason_for_tensors(env)
    images = ", but images begin and end by kernels of rows" if all(map(only_images, env.satellites)) else ""
    echo(f"Phases of a step: {'kernels of rows' if reason is None else f'on tensors, because of {reason}{images}'}")


def described(component: Component, schedule: Schedule = SCHEDULE) -> Slot:
    """Return the slot of a component; the first line of its update's docstring describes one that is not in the schedule."""
    number, side = schedule.place(component)
    if component.slot in schedule.numbers:
        return schedule[schedule.numbers[component.slot]]
    doc = (getattr(component.update, "__doc__", None) or "").strip().partition("\n")[0]
    relation = f"{'after' if side > 0 else 'before'} {schedule[number].name}"
    return Slot(component.slot, doc or relation, f"none, runs {relation}", schedule[number].group)


def slot_lines(slots: Sequence[Slot]) -> list[str]:
    """Return one line for each slot, under the names of the groups."""
    width = max(len(slot.name) for slot in slots)
    lines, group = [], ""
    for slot in slots:
        if slot.group != group:
            group = slot.group
            lines.append(f"{group}:")
        lines.append(f"  {slot.name:<{width}}  {slot.doc} ({slot.basilisk})")
    return lines


def tick_lines(tick: Tick, schedule: Schedule) -> list[str]:
    """Return one line for each component that runs in a tick."""
    return slot_lines([described(component, schedule) for component in tick.components if component.update is not None])
