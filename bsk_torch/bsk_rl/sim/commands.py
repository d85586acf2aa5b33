"""Commands that flight software of users defines: methods marked by ``@action`` that arrange what the package has.

While such a method runs, a :class:`Command` keeps which tasks and devices it switches; at its end the satellite enters the row
of the mode table with these flags. :func:`arrangements` adds rows for all combinations to the table.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np

from bsk_torch.bsk_rl.sim.messages import COMPONENT, MODULES, read_of
from bsk_torch.bsk_rl.sim.models import TASK_FLAGS
from bsk_torch.bsk_rl.sim.setup import NotSimulatedError
from bsk_torch.sim.dyn.models import DynamicsModel
from bsk_torch.sim.fsw.desaturation import DUMP_RESET
from bsk_torch.sim.fsw.guidance import SUN_RESET
from bsk_torch.sim.fsw.instrument import IMAGE_RESET
from bsk_torch.sim.fsw.models import FSWModel
from bsk_torch.sim.fsw.modes import Mode

OWN = "own:"
"""Beginning of the names of modes that commands of users enter."""

GUIDANCE = ("sun_on", "nadir_on", "location_on")
"""Flags of guidance laws, of which at most one is on."""

DEVICES = ("control_on", "desat_on", "controller_on", "instrument_linked", "instrument_power", "transmitter_on", "thruster_power")
"""Flags that may be on together."""

RESETS: dict[str, Mapping[str, float]] = {
    "sunPoint": SUN_RESET, "thrDesatControl": DUMP_RESET, "thrDump": DUMP_RESET,
    "hillPoint": {}, "trackingError": {}, "locPoint": {}, "insControl": {}, "imagingTarget": {},
}  # fmt: skip
"""Modules that a command may reset, and the fields of the state that they begin with; every command resets the others."""

SWITCHES = {
    ("insControl", "controllerStatus"): "controller_on",
    ("instrumentPowerSink", "powerStatus"): "instrument_power",
    ("thrusterPowerSink", "powerStatus"): "thruster_power",
    ("transmitter", "dataStatus"): "transmitter_on",
    ("transmitterPowerSink", "powerStatus"): "transmitter_power",
}
"""Settings of modules that are flags of the mode table; the transmitter and its power are one there."""


def is_command(member: object) -> bool:
    """Return whether a member of a model is a command of the user's."""
    return bool(getattr(member, "is_command", False))


def arranged(dyn_type: type[DynamicsModel], fsw_type: type[FSWModel]) -> type[FSWModel] | None:
    """Return a model with the modes that commands of users may enter; None for flight software without such commands."""
    if not any(is_command(getattr(fsw_type, name)) for name in dir(fsw_type)):
        return None
    flags = {flag for part in (*dyn_type.all_components(), *fsw_type.all_components()) for flag in part.flags}
    return _arranged(frozenset(flags))


@functools.cache
def _arranged(flags: frozenset[str]) -> type[FSWModel]:
    guidance = [(), *((flag,) for flag in GUIDANCE if flag in flags)]
    devices = [flag for flag in DEVICES if flag in flags]
    chosen = (some for count in range(len(devices) + 1) for some in itertools.combinations(devices, count))
    modes = {title({*some, *law}): Mode((*law, *some)) for some in chosen for law in guidance}
    return type("ArrangedFSWModel", (FSWModel,), {"modes": modes, "__module__": __name__})


def title(flags: Iterable[str]) -> str:
    """Return the name of the mode with some flags."""
    return OWN + "+".join(sorted(flags))


class Command:
    """What a command of a user's switches, from the call of its method on."""

    def __init__(self) -> None:
        """Begin as every command does: attitude is controlled, all else is off."""
        self.flags = {"control_on"}
        self.fields: dict[str, object] = {}

    def task(self, name: str, on: bool) -> None:
        """Switch a task of the package; NotSimulatedError for another one."""
        if name not in TASK_FLAGS:
            raise NotSimulatedError(f"task {name!r} is none of the package's, {sorted(TASK_FLAGS)}. {COMPONENT}")
        self.switch(TASK_FLAGS[name], on)

    def switch(self, flag: str, on: bool) -> None:
        """Switch a flag."""
        if flag:
            (self.flags.add if on else self.flags.discard)(flag)

    def enter(self, mode: Mode) -> None:
        """Switch what a mode of the package does."""
        self.flags |= set(mode.on or ())
        if "transmitter_on" in self.flags:
            self.flags.add("transmitter_power")
        self.fields |= mode.resets

    def mode(self) -> str:
        """Return the mode with the flags; NotSimulatedError for a combination that the package does not have."""
        laws = self.flags & set(GUIDANCE)
        if len(laws) > 1:
            raise NotSimulatedError(f"a command enables {sorted(laws)} together: one guidance law at a time is simulated")
        flags = set(self.flags)
        if ("transmitter_power" in flags) != ("transmitter_on" in flags):
            raise NotSimulatedError("a command must switch transmitter.dataStatus and transmitterPowerSink.powerStatus together")
        return title(flags - {"transmitter_power"})


class Commanded:
    """A module that commands reset and switch: attributes that can be read, and the settings of a command."""

    def __init__(self, name: str, command: Callable[[], Command | None], read: Callable[[str], object]) -> None:
        self.__dict__.update(_name=name, _command=command, _read=read)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return self.__dict__["_read"](name)

    def __setattr__(self, name: str, value: object) -> None:
        command, module = self._within(name), self._name
        if (module, name) in SWITCHES:
            command.switch(SWITCHES[module, name], bool(value))
        elif (module, name) == ("insControl", "imaged"):
            command.fields |= IMAGE_RESET
        elif (module, name) == ("imagingTarget", "r_LP_P_Init"):
            command.fields["r_LP_P"] = np.asarray(value, dtype=float).ravel()
        elif (module, name) != ("instrument", "nodeDataName"):
            raise NotSimulatedError(
                f"{module}.{name} of Basilisk's cannot be set by a command: give it in sat_args, or {COMPONENT}"
            )

    def _within(self, name: str) -> Command:
        command = self._command()
        if command is None:
            raise AttributeError(
                f"{name!r} of Basilisk's {self._name} cannot be set: give it in sat_args; methods of flight "
                f"software marked by @action switch tasks and devices. Otherwise, {COMPONENT}"
            )
        return command

    def Reset(self, nanoseconds: int = 0) -> None:
        """Let the module begin again."""
        self._within("Reset").fields.update(RESETS.get(self._name, {}))


def module_of(view: object, name: str, command: Callable[[], Command | None]) -> Commanded | None:
    """Return a module of Basilisk's that the dynamics model of a view stands for; None for another name, or another model."""
    module = MODULES.get(name)
    if module is None or not hasattr(type(view.__dict__["_whole"]), module.needs):
        return None
    return Commanded(name, command, partial(read_of, view, module.attributes))
