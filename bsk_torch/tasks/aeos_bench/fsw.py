"""The flight software of AEOS-Bench: from the first tick, it points the sensor at a place, or at the Earth's center.

Basilisk's locationPointing without damping about the line of sight, never reset, and its mrpFeedback with the momentum of wheels.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from bsk_torch.astro.frames import rotate_z
from bsk_torch.sim.component import Bus, Component, vec
from bsk_torch.sim.dyn.effectors.wheel_types import TRIAD
from bsk_torch.sim.dyn.models import DynamicsModel
from bsk_torch.sim.fsw import allocation, control, guidance, imposed
from bsk_torch.sim.fsw.models import IDLE, FSWModel
from bsk_torch.sim.fsw.modes import Mode
from bsk_torch.tasks.aeos_bench.dyn import AEOSBenchDynModel, started


def find_place(bus: Bus) -> None:
    """Write the place L in N, ``r_LN = [PN]^T r_LP``, m, with the Earth's orientation of this tick."""
    bus.r_LN_N = bus.EN.mT @ rotate_z(bus.r_LP_P, bus.cos_earth, -bus.sin_earth)


def point_sensor(bus: Bus) -> None:
    """Point +z of B at the place; after a change of the place, the first rate error is the jump of the attitude error over h."""
    guidance.point_at(bus, bus.instrument_axis_B, bus.r_LN_N, "location", damped=False)


TARGET = Component(
    slot="location_target",
    update=find_place,
    state=(vec("r_LP_P", "m", "place to point at, Earth-fixed; zero for the Earth's center", exact=True),),
)

POINTING = dataclasses.replace(guidance.LOCATION_POINTING, update=point_sensor, resets=())

_DEFAULTS = {"K": 8.0, "Ki": 0.005, "P": 24.0, "integralLimit": 0.01, "compensateWheels": True}
"""About the middle of the benchmark's distributions."""


def _of_benchmark(law: Component) -> Component:
    """Return a control law that runs at time zero, with other defaults; gains are not checked: some of the benchmark chatter."""
    args = tuple(dataclasses.replace(arg, default=_DEFAULTS.get(arg.name, arg.default)) for arg in law.args)
    return dataclasses.replace(
        law, args=args, check_tick=None, at_start=True, fit=lambda arguments: _of_benchmark(control.fitted_feedback(arguments))
    )


class AEOSBenchFSWModel(FSWModel):
    """The flight software of AEOS-Bench: points the sensor at the place in the state ``r_LP_P`` [m, Earth-fixed].

    Modes ``"sensor_off"`` and ``"sensor_on"`` switch the sensor; a zero ``r_LP_P`` is the Earth's center.
    """

    components: ClassVar[tuple[Component, ...]] = (
        imposed.ACTUATORS,
        Component(slot="nadir_pointing"),
        started(guidance.NAVIGATION),
        started(TARGET),
        started(POINTING),
        _of_benchmark(control.MRP_FEEDBACK),
        dataclasses.replace(
            allocation.BODY_AXIS_WHEELS,  # of the wheels of the dynamics model
            fit=lambda arguments: allocation.fitted_allocation(
                arguments if arguments["wheels"] is not None else {**arguments, "wheels": list(TRIAD)}
            ),
        ),
    )
    requires_dyn: ClassVar[tuple[type[DynamicsModel], ...]] = (AEOSBenchDynModel,)
    modes: ClassVar[dict[str, Mode | None]] = {
        IDLE: Mode(("control_on", "location_on")),
        "drift": None,
        "nadir_point": None,
        "sensor_off": Mode(("control_on", "location_on")),
        "sensor_on": Mode(("control_on", "location_on", "sensor_on")),
    }
