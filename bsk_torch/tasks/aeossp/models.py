"""The satellite that flies a plan of aeossp_standard: rigid body, wheels, reference slews, and the battery of the case."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from bsk_torch.sim.component import Arg, Bus, Component, Field, vec
from bsk_torch.sim.dyn.effectors import wheels
from bsk_torch.sim.dyn.models import BasicDynamicsModel, EclipseDynModel
from bsk_torch.sim.dyn.navigation import navigated
from bsk_torch.sim.dyn.power import balance as power
from bsk_torch.sim.fsw import allocation, imposed, steering
from bsk_torch.sim.fsw.models import FSWModel
from bsk_torch.sim.fsw.modes import Mode
from bsk_torch.sim.fsw.reference_slew import REFERENCE_SLEW, relative_motion
from bsk_torch.sim.fsw.setpoint import ATTITUDE_SETPOINT

LOADS = ("idle", "imaging", "slew")


def balance_power(bus: Bus) -> None:
    """Write the power of the battery; a look lasts from its first to its last tick."""
    write_power(bus, (bus.ticks > bus.look_first) & (bus.ticks <= bus.look_last))


def write_power(bus: Bus, looks: Tensor) -> None:
    """Write the power of the battery, W: panels at any attitude, less the loads.

    The slew's load lasts while the reference slews, that of imaging where the satellite ``looks``.
    """
    zero = torch.zeros_like(bus.idle_power)
    load = bus.idle_power + torch.where(looks, bus.imaging_power, zero) + torch.where(bus.slew_left > 0.0, bus.slew_power, zero)
    bus.power = bus.charge_power * bus.illumination - load


CASE_POWER = Component(
    slot="panel",
    update=balance_power,
    args=(
        *(Arg(f"{name}Power", 0.0, "W", f"load: {name}", low=0.0, high=power.MOST_POWER) for name in LOADS),
        Arg("chargePower", 0.0, "W", "power of the panels in sunlight", low=0.0, high=power.MOST_POWER),
    ),
    params=tuple(Field(f"{name}_power", 1, "W") for name in (*LOADS, "charge")),
    prepare=lambda args: {f"{name}_power": args[f"{name}Power"] for name in (*LOADS, "charge")},
)


class FlownDynModel(EclipseDynModel):
    """A rigid body with wheels and the battery and powers of a case."""

    components: ClassVar[tuple[Component, ...]] = (wheels.WHEELS, CASE_POWER, power.BATTERY)

    battery_charge = BasicDynamicsModel.battery_charge
    wheel_speeds = BasicDynamicsModel.wheel_speeds


class WheelPowerDynModel(FlownDynModel):
    """The same with the power of the wheels."""

    components: ClassVar[tuple[Component, ...]] = (wheels.WHEEL_POWER,)


def judge_look(bus: Bus) -> None:
    """Keep the largest errors of a look, and the least charge since the command.

    At ticks from ``look_first`` to ``look_last``: the angle and the rate between the body and the tracking frame, and the angle
    at the satellite between the Earth's center and the place, rad and rad/s.
    """
    looks = (bus.ticks >= bus.look_first) & (bus.ticks <= bus.look_last)
    error, motion, down = bus.look_error, relative_motion(bus), -navigated(bus).r_BN_N
    angle, rate = 4.0 * torch.atan(error.sigma_BR.norm()), error.omega_BR_B.norm()
    off_nadir = torch.atan2(down.cross(motion.r).norm(), -down.dot(motion.r))
    for name, value in (("angle", angle), ("rate", rate), ("off_nadir", off_nadir.to(bus.dtype))):
        worst = getattr(bus, f"look_{name}")
        setattr(bus, f"look_{name}", torch.where(looks, torch.maximum(worst, value), worst))
    bus.fastest = torch.maximum(bus.fastest, navigated(bus).omega_BN_B.norm())
    bus.least_charge = torch.minimum(bus.least_charge, bus.charge)


LOOK = Component(
    slot="look",
    after="location_pointing",
    update=judge_look,
    state=(
        Field("look_first", 1, "-", "first tick of the look", exact=True),
        Field("look_last", 1, "-", "its last tick", exact=True),
        Field("look_angle", 1, "rad", "largest pointing error during the look"),
        Field("look_rate", 1, "rad/s", "largest rate error during the look"),
        Field("look_off_nadir", 1, "rad", "largest off-nadir angle during the look"),
        Field("fastest", 1, "rad/s", "largest rate of the body since the command"),
        Field("least_charge", 1, "W s", "least charge since the command", exact=True),
    ),
    resets=(("look_angle", 0.0), ("look_rate", 0.0), ("look_off_nadir", 0.0), ("fastest", 0.0), ("least_charge", 1e15)),
)

PLACE = Component(
    slot="location_target", state=(vec("r_LP_P", "m", "place to look at, Earth-fixed", exact=True),)
)  # its motion is computed by the slew

LOOK_MODE, HOLD_MODE = "look", "hold"


class FlownFSWModel(FSWModel):
    """Reference slews to places and tracking of them, by MRP steering and wheels.

    The mode ``"look"`` points at ``r_LP_P``, or with zero at the Earth's center; ``"hold"`` keeps the attitude ``sigma_RN``.
    """

    components: ClassVar[tuple[Component, ...]] = (
        imposed.ACTUATORS,
        Component(slot="nadir_pointing"),
        PLACE,
        ATTITUDE_SETPOINT,
        REFERENCE_SLEW,
        LOOK,
        steering.MRP_STEERING,
        allocation.BODY_AXIS_WHEELS,
    )
    requires_dyn = (FlownDynModel,)
    modes: ClassVar[dict[str, Mode | None]] = {
        "nadir_point": None,
        LOOK_MODE: Mode(("control_on", "location_on")),
        HOLD_MODE: Mode(("control_on",)),
    }
