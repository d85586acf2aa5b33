"""Flight modes as a table: what each one switches on, and what entering it resets.

Every command first switches all tasks and devices off and resets location pointing and the reference that is imposed; the rest
persists, as in Basilisk: torque, thruster and instrument commands, the transmitter's packet, the integral of the control law.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bsk_torch.sim.names import current_name

MODE_FLAGS = (
    "sun_on",
    "nadir_on",
    "location_on",
    "desat_on",
    "control_on",
    "controller_on",
    "instrument_linked",
    "instrument_power",
    "transmitter_on",
    "thruster_power",
)
"""Tasks, controllers and devices that a mode may switch on; each is 1 or 0 on the bus."""

ALWAYS_RESET = {"location_fresh": 1.0, "location_sigma_BR": 0.0, "sigma_RN": 0.0, "omega_RN_N": 0.0}
SUN_RESET = {"sun_fresh": 1.0, "sun_sigma_BR": 0.0}
IMAGE_RESET = {"image_taken": 0.0}
DUMP_RESET = {"dump_calls": 0.0, "dump_counter": 0.0, "dump_remaining": 0.0}


@dataclass(frozen=True)
class Mode:
    """A row of the mode table: ``on`` lists flags, ``resets`` gives state fields and the value they get on entry."""

    on: tuple[str, ...] = ("control_on",)
    resets: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse flags that do not exist, and take old names of fields for the present ones."""
        unknown = set(self.on) - set(MODE_FLAGS)
        if unknown:
            raise ValueError(f"on={self.on!r}: {sorted(unknown)} are no flags; known are {list(MODE_FLAGS)}")
        object.__setattr__(self, "resets", {current_name(name): value for name, value in self.resets.items()})


@dataclass(frozen=True)
class Command:
    """Command of an action to the flight software: a mode, or one of several ``modes`` by the index in argument ``choice``."""

    modes: tuple[str, ...]
    choice: str | None = None
