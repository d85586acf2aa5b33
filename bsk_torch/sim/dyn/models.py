"""Dynamics models: which components a spacecraft has, and what can be read off it. Names are bsk_rl's."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.astro.orbit import Elements, hill_frame, hill_rate, rv_to_elements
from bsk_torch.constants import RPM
from bsk_torch.sim import world
from bsk_torch.sim.component import Component
from bsk_torch.sim.dyn import drag, hub, power, storage, thrusters, wheels
from bsk_torch.sim.model import Model, aliveness_checker
from bsk_torch.vec3 import Vec3


def rotate(dcm: Tensor, vectors: Tensor) -> Tensor:
    """Matrices [N, 3, 3] times vectors [N, 3]."""
    return (dcm @ vectors.unsqueeze(-1)).squeeze(-1)


class DynamicsModel(Model):
    """A rigid spacecraft in orbit, without actuators.

    ``world_components`` are the parts of the world that it needs; ``orbit`` is how its orbit is found unless the user says
    otherwise: ``"arc"`` in advance, or ``"integrated"`` in every tick.
    """

    components: ClassVar[tuple[Component, ...]] = (hub.HUB,)
    world_components: ClassVar[tuple[Component, ...]] = (world.EARTH_POLE, world.EPHEMERIS)
    orbit: ClassVar[str] = "arc"

    @property
    def r_BN_N(self) -> Tensor:
        """Position in N, [N, 3] m."""
        return self.state("r")

    @property
    def v_BN_N(self) -> Tensor:
        """Velocity in N, [N, 3] m/s."""
        return self.state("v")

    @property
    def sigma_BN(self) -> Tensor:
        """Attitude relative to N, [N, 3] MRP."""
        return self.state("sigma")

    @property
    def omega_BN_B(self) -> Tensor:
        """Body rate in B, [N, 3] rad/s."""
        return self.state("omega")

    @property
    def BN(self) -> Tensor:
        """DCM from N to B, [N, 3, 3]."""
        return mrp_to_dcm(Vec3.of(self.sigma_BN)).stack()

    @property
    def HN(self) -> Tensor:
        """DCM from N to the Hill frame, [N, 3, 3]."""
        return hill_frame(Vec3.of(self.r_BN_N), Vec3.of(self.v_BN_N)).stack()

    @property
    def BP(self) -> Tensor:
        """DCM from the Earth-fixed frame to B, [N, 3, 3]."""
        return self.BN @ self.world.PN.mT

    @property
    def r_BN_P(self) -> Tensor:
        """Position in the Earth-fixed frame, [N, 3] m."""
        return rotate(self.world.PN, self.r_BN_N)

    @property
    def v_BN_P(self) -> Tensor:
        """Velocity relative to the Earth-fixed frame, [N, 3] m/s."""
        return rotate(self.world.PN, self.v_BN_N) - torch.linalg.cross(rotate(self.world.PN, self.world.omega_PN_N), self.r_BN_P)

    @property
    def omega_BP_P(self) -> Tensor:
        """Body rate relative to the Earth, in the Earth-fixed frame, [N, 3] rad/s."""
        return rotate(self.world.PN, rotate(self.BN.mT, self.omega_BN_B) - self.world.omega_PN_N)

    @property
    def omega_BH_H(self) -> Tensor:
        """Body rate relative to the Hill frame, in the Hill frame, [N, 3] rad/s."""
        rate = hill_rate(Vec3.of(self.r_BN_N), Vec3.of(self.v_BN_N))
        omega_HN_H = torch.stack([torch.zeros_like(rate), torch.zeros_like(rate), rate], -1)
        return rotate(self.HN @ self.BN.mT, self.omega_BN_B) - omega_HN_H

    @property
    def elements(self) -> Elements:
        """Osculating elements, [N] each: a in m, angles in rad."""
        mu = self.satellite.sat_args["mu"]
        return rv_to_elements(Vec3.of(self.r_BN_N), Vec3.of(self.v_BN_N), mu)

    @property
    def semi_major_axis(self) -> Tensor:
        """Semi-major axis, [N] m."""
        return self.elements.a

    @property
    def eccentricity(self) -> Tensor:
        """Eccentricity, [N]."""
        return self.elements.e

    @property
    def inclination(self) -> Tensor:
        """Inclination, [N] rad."""
        return self.elements.i

    @property
    def ascending_node(self) -> Tensor:
        """Right ascension of the ascending node, [N] rad."""
        return self.elements.Omega

    @property
    def argument_of_periapsis(self) -> Tensor:
        """Argument of periapsis, [N] rad."""
        return self.elements.omega

    @property
    def true_anomaly(self) -> Tensor:
        """True anomaly, [N] rad."""
        return self.elements.f

    @property
    def beta_angle(self) -> Tensor:
        """Angle between the orbit normal and the Sun, [N] rad in [0, pi], as bsk_rl defines it."""
        h_hat = self.HN[:, 2]
        return torch.acos((h_hat * self.world.sun_direction_N).sum(-1).clamp(-1.0, 1.0))

    @aliveness_checker
    def altitude_valid(self) -> Tensor:
        """Whether the orbit is still above ``min_orbital_radius``, [N]."""
        return self.r_BN_N.norm(dim=-1) > self.satellite.sat_args["min_orbital_radius"]


class EclipseDynModel(DynamicsModel):
    """Adds the eclipse."""

    world_components: ClassVar[tuple[Component, ...]] = (world.ECLIPSE,)

    @property
    def illumination(self) -> Tensor:
        """Visible fraction of the solar disc, [N], one tick ago."""
        return self.state("illumination")


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

    @property
    def battery_charge(self) -> Tensor:
        """Charge of the battery, [N] W s."""
        return self.state("charge")

    @property
    def battery_charge_fraction(self) -> Tensor:
        """Charge over capacity, [N]."""
        return self.battery_charge / self.satellite.sat_args["batteryStorageCapacity"]

    @property
    def wheel_speeds(self) -> Tensor:
        """Wheel speeds, [N, 3] rad/s."""
        return self.state("Omega")

    @property
    def wheel_speeds_fraction(self) -> Tensor:
        """Wheel speeds over ``maxWheelSpeed``, [N, 3]."""
        return self.wheel_speeds / (self.satellite.sat_args["maxWheelSpeed"] * RPM).unsqueeze(-1)

    @aliveness_checker
    def rw_speeds_valid(self) -> Tensor:
        """Whether every wheel is slower than ``maxWheelSpeed``, [N]."""
        return (self.wheel_speeds.abs() < (self.satellite.sat_args["maxWheelSpeed"] * RPM).unsqueeze(-1)).all(-1)

    @aliveness_checker
    def battery_valid(self) -> Tensor:
        """Whether any charge is left, [N]."""
        return self.battery_charge > 0.0


class ImagingDynModel(BasicDynamicsModel):
    """Base of the models with an instrument, a transmitter and a store; :class:`ContinuousImagingDynModel` completes it."""

    components: ClassVar[tuple[Component, ...]] = (
        storage.INSTRUMENT,
        storage.INSTRUMENT_POWER,
        storage.TRANSMITTER,
        storage.TRANSMITTER_POWER,
        storage.STORAGE,
    )

    @property
    def storage_level(self) -> Tensor:
        """Data in the store, [N] bit."""
        return self.state("storage")

    @property
    def storage_level_fraction(self) -> Tensor:
        """Data over capacity, [N]."""
        return self.storage_level / self.satellite.sat_args["dataStorageCapacity"]

    @property
    def instrument_baud(self) -> Tensor:
        """Data rate of the instrument, [N] bit/s."""
        return self.satellite.sat_args["instrumentBaudRate"]

    @aliveness_checker
    def data_storage_valid(self) -> Tensor:
        """Whether the store has room left, [N]; always so unless ``storageUnitValidCheck`` is set."""
        level, capacity = self.storage_level, self.satellite.sat_args["dataStorageCapacity"]
        if not self.satellite.sat_args["storageUnitValidCheck"]:
            return torch.ones_like(level, dtype=torch.bool)
        return (level < capacity) | torch.isclose(level, capacity)


class ContinuousImagingDynModel(ImagingDynModel):
    """An instrument that records as long as it points down: data accumulate at a rate."""


class GroundStationDynModel(ImagingDynModel):
    """Adds ground stations, without which the transmitter has no one to send to."""

    world_components: ClassVar[tuple[Component, ...]] = (world.GROUND_STATIONS,)
