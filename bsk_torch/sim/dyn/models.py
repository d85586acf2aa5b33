"""Dynamics models: which components a spacecraft has, and what can be read off it. Names are bsk_rl's."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from bsk_torch.astro.orbit import Elements
from bsk_torch.constants import RPM
from bsk_torch.sim import world
from bsk_torch.sim.component import Arg, Component
from bsk_torch.sim.dyn import drag, events, hub, partitions, power, storage, thrusters, wheels
from bsk_torch.sim.model import Model
from bsk_torch.sim.observe import Now, observable, vital
from bsk_torch.vec3 import Vec3


class DynamicsModel(Model):
    """A rigid spacecraft in orbit, without actuators.

    ``world_components`` are the parts of the world that it needs; ``orbit`` is how its orbit is found unless the user says
    otherwise: ``"arc"`` in advance, or ``"integrated"`` in every tick.
    """

    components: ClassVar[tuple[Component, ...]] = (hub.HUB,)
    world_components: ClassVar[tuple[Component, ...]] = (world.EARTH_POLE, world.EPHEMERIS)
    orbit: ClassVar[str] = "arc"

    @observable
    def r_BN_N(now: Now) -> Vec3:
        """Position in N, [N, 3] m."""
        return now.r

    @observable
    def v_BN_N(now: Now) -> Vec3:
        """Velocity in N, [N, 3] m/s."""
        return now.v

    @observable
    def sigma_BN(now: Now) -> Vec3:
        """Attitude relative to N, [N, 3] MRP."""
        return now.sigma

    @observable
    def omega_BN_B(now: Now) -> Vec3:
        """Body rate in B, [N, 3] rad/s."""
        return now.omega

    @property
    def BN(self) -> Tensor:
        """DCM from N to B, [N, 3, 3]."""
        return self.simulator.observer.now.BN.stack()

    @property
    def HN(self) -> Tensor:
        """DCM from N to the Hill frame, [N, 3, 3]."""
        return self.simulator.observer.now.HN.stack()

    @property
    def BP(self) -> Tensor:
        """DCM from the Earth-fixed frame to B, [N, 3, 3]."""
        return self.BN @ self.simulator.observer.now.PN.stack().mT

    @observable
    def r_BN_P(now: Now) -> Vec3:
        """Position in the Earth-fixed frame, [N, 3] m."""
        return now.PN @ now.r

    @observable
    def v_BN_P(now: Now) -> Vec3:
        """Velocity relative to the Earth-fixed frame, [N, 3] m/s."""
        return now.PN @ (now.v - now.omega_PN_N.cross(now.r))

    @observable
    def omega_BP_P(now: Now) -> Vec3:
        """Body rate relative to the Earth, in the Earth-fixed frame, [N, 3] rad/s."""
        return now.PN @ (now.BN.mT @ now.omega - now.omega_PN_N)

    @observable
    def omega_BH_H(now: Now) -> Vec3:
        """Body rate relative to the Hill frame, in the Hill frame, [N, 3] rad/s."""
        return now.HN @ (now.BN.mT @ now.omega) - now.omega_HN_H

    @property
    def elements(self) -> Elements:
        """Osculating elements, [N] each: a in m, angles in rad."""
        return self.simulator.observer.now.elements

    @observable
    def semi_major_axis(now: Now) -> Tensor:
        """Semi-major axis, [N] m."""
        return now.elements.a

    @observable
    def eccentricity(now: Now) -> Tensor:
        """Eccentricity, [N]."""
        return now.elements.e

    @observable
    def inclination(now: Now) -> Tensor:
        """Inclination, [N] rad."""
        return now.elements.i

    @observable
    def ascending_node(now: Now) -> Tensor:
        """Right ascension of the ascending node, [N] rad."""
        return now.elements.Omega

    @observable
    def argument_of_periapsis(now: Now) -> Tensor:
        """Argument of periapsis, [N] rad."""
        return now.elements.omega

    @observable
    def true_anomaly(now: Now) -> Tensor:
        """True anomaly, [N] rad."""
        return now.elements.f

    @observable
    def beta_angle(now: Now) -> Tensor:
        """Angle between the orbit normal and the Sun, [N] rad in [0, pi], as bsk_rl defines it."""
        return torch.acos(torch.clamp(now.HN.z.dot(now.r_sun.unit()), -1.0, 1.0))

    @vital
    def altitude_valid(now: Now) -> Tensor:
        """Whether the orbit is still above ``min_orbital_radius``, [N]."""
        return now.r.norm() > now.args.min_orbital_radius


class EclipseDynModel(DynamicsModel):
    """Adds the eclipse."""

    world_components: ClassVar[tuple[Component, ...]] = (world.ECLIPSE,)

    @observable
    def illumination(now: Now) -> Tensor:
        """Visible fraction of the solar disc, [N], one tick ago."""
        return now.illumination


class DisturbanceTorqueDynModel(DynamicsModel):
    """Adds a constant torque in body axes."""

    components: ClassVar[tuple[Component, ...]] = (drag.DISTURBANCE,)


class AtmosphericDragDynModel(DynamicsModel):
    """Adds drag by an exponential atmosphere, felt where the orbit is integrated."""

    components: ClassVar[tuple[Component, ...]] = (drag.DRAG,)
    world_components: ClassVar[tuple[Component, ...]] = (world.ATMOSPHERE,)


class BasicDynamicsModel(EclipseDynModel, DisturbanceTorqueDynModel, AtmosphericDragDynModel):
    """Adds wheels, thrusters, solar panel, battery and power sinks."""

    components: ClassVar[tuple[Component, ...]] = (
        wheels.WHEELS,
        wheels.WHEEL_POWER,
        thrusters.THRUSTERS,
        power.PANEL,
        power.BASE_POWER,
        power.THRUSTER_POWER,
        power.BATTERY,
    )

    @observable
    def battery_charge(now: Now) -> Tensor:
        """Charge of the battery, [N] W s."""
        return now.charge

    @observable
    def battery_charge_fraction(now: Now) -> Tensor:
        """Charge over capacity, [N]."""
        return now.charge / now.args.batteryStorageCapacity

    @observable
    def wheel_speeds(now: Now) -> Vec3:
        """Wheel speeds, [N, 3] rad/s."""
        return now.Omega

    @observable
    def wheel_speeds_fraction(now: Now) -> Vec3:
        """Wheel speeds over ``maxWheelSpeed``, [N, 3]."""
        return now.Omega / (now.args.maxWheelSpeed * RPM)

    @vital
    def rw_speeds_valid(now: Now) -> Tensor:
        """Whether every wheel is slower than ``maxWheelSpeed``, [N]."""
        limit = now.args.maxWheelSpeed * RPM
        x, y, z = (torch.abs(speed) < limit for speed in now.Omega)
        return x & y & z

    @vital
    def battery_valid(now: Now) -> Tensor:
        """Whether any charge is left, [N]."""
        return now.charge > 0.0


class ImagingDynModel(BasicDynamicsModel):
    """Adds an instrument that takes images in a tick each, a store of partitions, and a transmitter.

    A step may end with the image that its task asks for.
    """

    components: ClassVar[tuple[Component, ...]] = (
        partitions.IMAGER,
        storage.INSTRUMENT_POWER,
        partitions.TRANSMITTER,
        storage.TRANSMITTER_POWER,
        partitions.PARTITIONED_STORE,
        events.IMAGE_EVENT,
    )

    @observable
    def storage_level(now: Now) -> Tensor:
        """Data in the store, [N] bit."""
        return now.storage

    @observable
    def storage_level_fraction(now: Now) -> Tensor:
        """Data over capacity, [N]."""
        return now.storage / now.args.dataStorageCapacity

    @observable
    def partition_levels(now: Now) -> tuple[Tensor, ...]:
        """Data in every partition of the store, [N, P] bit."""
        return now.partitions

    @property
    def instrument_baud(self) -> Tensor:
        """Data of one image, [N] bit; where data accumulate, the rate of the instrument, bit/s."""
        return self.satellite.sat_args["instrumentBaudRate"]

    @vital
    def data_storage_valid(now: Now) -> Tensor:
        """Whether the store has room left, [N]; always so unless ``storageUnitValidCheck`` is set."""
        level, capacity = now.storage, now.args.dataStorageCapacity
        full = torch.abs(level - capacity) > 1e-8 + 1e-5 * torch.abs(capacity)  # as close as numpy's isclose
        return (level < capacity) | ~full if now.args.storageUnitValidCheck else torch.ones_like(level) > 0.0


class ContinuousImagingDynModel(ImagingDynModel):
    """An instrument that records as long as it points down: data accumulate at a rate, in a store without partitions."""

    components: ClassVar[tuple[Component, ...]] = (
        storage.INSTRUMENT,
        storage.TRANSMITTER,
        storage.STORAGE,
        events.NO_IMAGE_EVENT,
    )

    @observable
    def partition_levels(now: Now) -> tuple[Tensor, ...]:
        """Data in the store as if it were its only partition, [N, 1] bit."""
        return (now.storage,)


class GroundStationDynModel(ImagingDynModel):
    """Adds ground stations, without which the transmitter has no one to send to."""

    world_components: ClassVar[tuple[Component, ...]] = (world.GROUND_STATIONS,)


class LOSCommDynModel(DynamicsModel):
    """Lets satellites see one another; see :class:`~bsk_torch.comm.LOSCommunication`."""

    components: ClassVar[tuple[Component, ...]] = (
        Component(
            slot="los_comms",
            order=230,
            args=(Arg("losMaximumRange", -1.0, "m", "longest range of sight to other satellites; no limit where not positive"),),
        ),
    )
