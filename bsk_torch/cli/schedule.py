"""``bsk-torch schedule``: the order of a tick, all slots, or the components that run for the satellites of a preset."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from bsk_torch.cli.shared import made
from bsk_torch.cli.terminal import echo
from bsk_torch.sim.schedule import SCHEDULE, Schedule, Slot

if TYPE_CHECKING:
    from bsk_torch.sim.component import Component
    from bsk_torch.sim.tick.loop import Tick


def show_schedule(
    preset: Annotated[
        str | None, typer.Argument(help="Environment, such as AEOS-v1; default: all slots.", show_default=False)
    ] = None,
) -> None:
    """Show the order of a tick: all slots, or the components that run in a preset.

    Examples:
        bsk-torch schedule
        bsk-torch schedule NadirScan-v1
    """
    if preset is None:
        echo("\n".join(slot_lines(SCHEDULE)))
        return
    env = made(preset, 1, {"backend": "eager"})
    for simulator in env.fleet.simulators:
        names = ", ".join(env.fleet.names[k] for k in simulator.columns)
        echo("\n".join([f"{names}:", *(f"  {line}" for line in tick_lines(simulator.tick, simulator.type.schedule))]))


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
    found, group = [], ""
    for slot in slots:
        if slot.group != group:
            group = slot.group
            found.append(f"{group}:")
        found.append(f"  {slot.name:<{width}}  {slot.doc} ({slot.basilisk})")
    return found


def tick_lines(tick: Tick, schedule: Schedule) -> list[str]:
    """Return one line for each component that runs in a tick."""
    return slot_lines([described(component, schedule) for component in tick.components if component.update is not None])
