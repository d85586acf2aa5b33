"""The spacecraft of AEOS-Bench: wheels with their own power, a panel, a battery and a sensor, in the benchmark's order of a tick.

AEOS-Bench (NeurIPS 2025, arXiv 2510.26297) drives Basilisk's modules in another order than BSK-RL, in one task with a period of
1 s: what the flight software commands at the end of a tick is latched by the wheels in the same tick, positions of targets and
eclipses are those of the present, and the battery takes the power of the wheels one tick late, since their modules run after it.
The Earth is a point mass.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.sim.component import Arg, Bus, Component, Field, vec
from bsk_torch.sim.dyn.effectors.wheel_set import described_wheels, wheel_form, wheel_set
from bsk_torch.sim.dyn.effectors.wheel_types import TRIAD
from bsk_torch.sim.dyn.effectors.wheels import WHEELS, draw_power_of_wheels, wheel_power
from bsk_torch.sim.dyn.hub import HUB
from bsk_torch.sim.dyn.models import BasicDynamicsModel, EclipseDynModel
from bsk_torch.sim.dyn.power import balance as power
from bsk_torch.sim.dyn.power import panels
from bsk_torch.sim.readout.observables import Now, observable
from bsk_torch.sim.schedule import SCHEDULE, Schedule
from bsk_torch.vec3 import Mat3, Vec3


def started(component: Component) -> Component:
    """Return a component that takes part in the tick at time zero."""
    fit = component.fit
    fitted = None if fit is None else lambda arguments: dataclasses.replace(fit(arguments), at_start=True)
    return dataclasses.replace(component, at_start=True, fit=fitted)


def balance_of_wheels(bus: Bus) -> None:
    """Write the power of the wheels, W, which the battery takes in the next tick; see :func:`draw_power_of_wheels`."""
    bus.power = torch.zeros_like(bus.wheel_power)
    draw_power_of_wheels(bus)
    bus.wheel_power = bus.power


def charge_battery(bus: Bus) -> None:
    """Integrate the power of the end of the tick, and that of the wheels one tick ago; see :func:`power.charge_battery`."""
    charge = torch.clamp(bus.charge + (bus.power + bus.wheel_power) * bus.h, min=0.0)
    bus.charge = torch.minimum(charge, bus.battery_capacity)


def _fitted_wheels(arguments: Mapping[str, object]) -> Component:
    wheels = described_wheels(arguments) or TRIAD
    return started(wheel_set(wheel_form(arguments, wheels), wheels))


def _with_balance(component: Component) -> Component:
    """Return the component of the power of wheels with the balance of :func:`balance_of_wheels`."""
    return dataclasses.replace(
        component,
        update=balance_of_wheels,
        fit=lambda arguments: _with_balance(wheel_power(len(described_wheels(arguments) or TRIAD))),
        state=(Field("wheel_power", 1, "W", "power of the wheels, negative, which the battery takes in the next tick"),),
        at_start=True,
    )


SENSOR_POWER = dataclasses.replace(
    power.sink("instrument_draw", power.power_arg("sensorPower", -5.0, "power while the sensor is on, negative"), "sensor_on"),
    idle_flags=(),
)

FIELD_OF_VIEW = Component(
    slot="field_of_view",
    after="instrument_draw",
    args=(Arg("sensorFieldOfView", 0.005, "rad", "half of the sensor's field of view", low=1e-9, high=1.5),),
)
"""The sensor's cone; its axis is +z of B."""


def look(bus: Bus) -> None:
    """Write where the satellite is, and where its sensor looks, in P; in the same operations as the observables."""
    x, y, z = bus.EN
    PN = Mat3(x * bus.cos_earth + y * bus.sin_earth, y * bus.cos_earth - x * bus.sin_earth, z)
    bus.r_sensor_P, bus.axis_sensor_P = PN @ bus.r_BN_N, PN @ mrp_to_dcm(bus.sigma_BN).z


VIEWS = ("r_sensor_P", "axis_sensor_P")
"""Recorded fields of a model with :data:`SENSOR_VIEW`."""

SENSOR_VIEW = Component(
    slot="sensor_view",
    after="instrument_draw",
    update=look,
    state=(
        vec("r_sensor_P", "m", "position of the satellite, Earth-fixed", exact=True),
        vec("axis_sensor_P", "-", "axis of the sensor, Earth-fixed", exact=True),
    ),
    overwrites=tuple((name, "it follows from orbit and attitude") for name in VIEWS),
    records=VIEWS,
)


class AEOSBenchDynModel(EclipseDynModel):
    """The spacecraft of AEOS-Bench; see :mod:`bsk_torch.tasks.aeos_bench.dyn`. No state ends an episode."""

    components: ClassVar[tuple[Component, ...]] = (
        HUB,
        dataclasses.replace(WHEELS, fit=_fitted_wheels),
        _with_balance(wheel_power(len(TRIAD))),
        panels.PANEL,
        SENSOR_POWER,
        FIELD_OF_VIEW,
        dataclasses.replace(power.BATTERY, update=charge_battery),
    )
    schedule: ClassVar[Schedule] = (
        SCHEDULE.moved("location_target", after="ephemeris")
        .moved("eclipse", after="hub")
        .moved("wheels", after="control")
        .moved("wheel_power", after="wheels")
    )
    orbit: ClassVar[str] = "integrated"
    gravity_degree: ClassVar[int] = 0

    battery_charge = BasicDynamicsModel.battery_charge
    battery_charge_fraction = BasicDynamicsModel.battery_charge_fraction
    wheel_speeds = BasicDynamicsModel.wheel_speeds

    @observable
    def boresight_P(now: Now) -> Vec3:
        """Axis of the sensor, +z of B, in the Earth-fixed frame P, [N, 3]."""
        return now.PN @ now.BN.z

    @observable
    def sensor_cone(now: Now) -> Tensor:
        """Tangent of half of the sensor's field of view, [N]."""
        return torch.tan(now.args.sensorFieldOfView)


class AEOSBenchTracedDynModel(AEOSBenchDynModel):
    """A spacecraft of AEOS-Bench that records at every tick where its sensor looks, for choices that last longer than a tick."""

    components: ClassVar[tuple[Component, ...]] = (SENSOR_VIEW,)
