"""Flight modes as a table: what each one switches on, and what entering it resets.

What can be switched on are the ``flags`` that the components of a satellite's models declare. Every command first switches all of
them off and sets the fields that components list in ``resets``: those of location pointing, and of the imposed reference.
The rest persists, as in Basilisk: torque, thruster and instrument commands, the transmitter's packet, the integral of the control
law.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from bsk_torch._checks import number
from bsk_torch.sim.component import Component
from bsk_torch.sim.names import nearest


@dataclass(frozen=True)
class Mode:
    """A row of the mode table: ``on`` lists flags, and ``resets`` gives state fields with their values on entry.

    None instead of flags stands for the ``idle_flags`` of all components. A flag not declared by any component of the satellite
    raises ValueError when an environment is built.
    """

    on: tuple[str, ...] | None = ("control_on",)
    resets: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if isinstance(self.on, str):
            raise ValueError(f"on={self.on!r} must be a tuple of flags: write on=({self.on!r},)")
        for name, value in self.resets.items():
            number(f"resets[{name!r}]", value)


@dataclass(frozen=True)
class Command:
    """Command of an action to the flight software: a mode, or one of several ``modes`` by the index in argument ``choice``."""

    modes: tuple[str, ...]
    choice: str | None = None

    def __post_init__(self) -> None:
        if isinstance(self.modes, str) or not self.modes:
            raise ValueError(f"modes={self.modes!r} must be a tuple of names, such as modes=('safe',)")
        if self.choice is None and len(self.modes) > 1:
            raise ValueError(f"modes={self.modes!r} has several modes; name the argument that chooses one, choice='safeAttitude'")


def mode_table(modes: Mapping[str, Mode], components: Iterable[Component]) -> dict[str, Mode]:
    """Return the modes of satellites with all flags named, from rows of the mode table and the models' components.

    ValueError for a mode that switches on a flag, or resets a field, that no component declares.
    """
    declared = list(components)
    flags = dict.fromkeys(flag for part in declared for flag in part.flags)
    fields = dict.fromkeys(field.name for part in declared for field in part.state)
    idle = tuple(dict.fromkeys(flag for part in declared for flag in part.idle_flags))
    for title, mode in modes.items():
        for flag in mode.on or ():
            if flag not in flags:
                raise ValueError(
                    f"mode {title!r} switches on {flag!r}, which no component of the satellite declares; list it in flags= of "
                    f"the component that reads bus.{flag}; {nearest(flag, flags)}"
                )
        for name in mode.resets:
            if name not in fields:
                raise ValueError(f"mode {title!r} resets {name!r}, which is not a field of the state; {nearest(name, fields)}")
    return {title: replace(mode, on=idle) if mode.on is None else mode for title, mode in modes.items()}
