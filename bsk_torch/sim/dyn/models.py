"""Dynamics models: the components of a spacecraft, and its observables."""

from __future__ import annotations

import functools
import operator
import warnings
from typing import ClassVar

import torch
from torch import Tensor

from bsk_torch.astro.frames import angle_between
from bsk_torch.astro.gravity import DEGREE
from bsk_torch.astro.orbit import Elements
from bsk_torch.constants import RPM
from bsk_torch.sim import world
from bsk_torch.sim.component import Arg, Component, collect
from bsk_torch.sim.dyn import events, hub, navigation
from bsk_torch.sim.dyn.effectors import thrusters, torque_bars, wheels
from bsk_torch.sim.dyn.forces import drag, facets
from bsk_torch.sim.dyn.power import balance as power
from bsk_torch.sim.dyn.power import panels
from bsk_torch.sim.dyn.storage import partitions
from bsk_torch.sim.dyn.storage import store as storage
from bsk_torch.sim.faults.component import FAULTS, severities
from bsk_torch.sim.instruments import INSTRUMENTS, argument_now
from bsk_torch.sim.readout.model import Model, Simulation
from bsk_torch.sim.readout.observables import Now, observable, vital
from bsk_torch.sim.schedule import SCHEDULE, Schedule
from bsk_torch.vec3 import Mat3, Vec3


class DynamicsModel(Model):
    """A rigid spacecraft in orbit, without actuators.

    ``requires_world`` lists the required world models, in addition to those of the base classes. ``world_components`` are further
    components of the world, which replace those of world models in the same slots. ``orbit`` is the default computation of the
    orbit: ``"arc"`` (in advance) or ``"integrated"`` (in every tick). ``schedule`` is the order of a tick (``SCHEDULE``);
    see :mod:`bsk_torch.sim.schedule`. ``gravity_degree`` is the degree and order of the Earth's field, from 2 to 10, or 0 for a
    point mass, which orbits that are integrated can have.

    Frames: N is inertial (J2000 equator), B the body, P fixed to the Earth, H the Hill frame. Vectors ``r``, ``v`` and ``h`` in
    the formulas are ``r_BN_N``, ``v_BN_N`` and their cross product. Equations of two-body motion and of attitude are those of
    Schaub and Junkins, Analytical Mechanics of Space Systems, chapters 3 and 9.
    """

    components: ClassVar[tuple[Component, ...]] = (FAULTS, hub.HUB)
    world_components: ClassVar[tuple[Component, ...]] = ()
    requires_world: ClassVar[tuple[type[world.WorldModel], ...]] = (world.WorldModel,)
    orbit: ClassVar[str] = "arc"
    schedule: ClassVar[Schedule] = SCHEDULE
    gravity_degree: ClassVar[int] = DEGREE

    @classmethod
    def all_components(cls) -> tuple[Component, ...]:
        """Return the components of the class and its bases in the order of its schedule."""
        return collect(reversed(cls.__mro__), schedule=cls.schedule)

    @classmethod
    def all_required_worlds(cls) -> tuple[type[world.WorldModel], ...]:
        """Return the world models that the class and its bases require."""
        return tuple(dict.fromkeys(model for base in cls.__mro__ for model in vars(base).get("requires_world", ())))

    @observable
    def r_BN_N(now: Now) -> Vec3:
        """Position ``r_BN_N`` of the satellite relative to the Earth's center, [N, 3] m in N."""
        return now.r_BN_N

    @observable
    def v_BN_N(now: Now) -> Vec3:
        """Velocity ``v_BN_N = d(r_BN_N)/dt`` as seen from N, [N, 3] m/s in N."""
        return now.v_BN_N

    @observable
    def sigma_BN(now: Now) -> Vec3:
        """Attitude of B relative to N, ``sigma_BN = tan(phi / 4) e`` (MRP, dimensionless), [N, 3].

        ``phi`` is the principal angle, rad, and ``e`` the principal axis (Schaub and Junkins, section 3.5).
        """
        return now.sigma_BN

    @observable
    def omega_BN_B(now: Now) -> Vec3:
        """Angular velocity ``omega_BN_B`` of B relative to N, [N, 3] rad/s in B."""
        return now.omega_BN_B

    @observable
    def BN(now: Now) -> Mat3:
        """DCM from N to B, ``v_B = [BN] v_N``, [N, 3, 3]; see :func:`bsk_torch.astro.attitude.mrp_to_dcm`."""
        return now.BN

    @observable
    def HN(now: Now) -> Mat3:
        """DCM from N to the Hill frame H, [N, 3, 3].

        Its rows are the axes of H in N: ``r / |r|``, ``h x r / |h x r|`` and ``h / |h|`` with ``h = r_BN_N x v_BN_N``.
        """
        return now.HN

    @property
    def BP(self) -> Tensor:
        """DCM from the Earth-fixed frame P to B, ``[BP] = [BN] [PN]^T``, [N, 3, 3]."""
        return self.BN @ self.simulator.observer.now.PN.stack().mT

    @observable
    def r_BN_P(now: Now) -> Vec3:
        """Position ``r_BN_P = [PN] r_BN_N`` in the Earth-fixed frame P, [N, 3] m."""
        return now.PN @ now.r_BN_N

    @observable
    def v_BN_P(now: Now) -> Vec3:
        """Velocity as seen from the Earth-fixed frame P, ``v_BN_P = [PN] (v_BN_N - omega_PN_N x r_BN_N)``, [N, 3] m/s in P."""
        return now.PN @ (now.v_BN_N - now.omega_PN_N.cross(now.r_BN_N))

    @observable
    def omega_BP_P(now: Now) -> Vec3:
        """Body rate relative to the Earth-fixed frame P, ``omega_BP_P = [PN] ([BN]^T omega_BN_B - omega_PN_N)``, [N, 3] rad/s."""
        return now.PN @ (now.BN.mT @ now.omega_BN_B - now.omega_PN_N)

    @observable
    def omega_BH_H(now: Now) -> Vec3:
        """Body rate relative to the Hill frame H, ``omega_BH_H = [HN] [BN]^T omega_BN_B - omega_HN_H``, [N, 3] rad/s.

        ``omega_HN_H = (0, 0, |r x v| / |r|^2)`` with position ``r``, m, and velocity ``v``, m/s (Keplerian motion).
        """
        return now.HN @ (now.BN.mT @ now.omega_BN_B) - now.omega_HN_H

    @property
    def elements(self) -> Elements:
        """Osculating elements a (m), e, i, Omega, omega and f (rad) of the current position and velocity, [N] each.

        See :func:`bsk_torch.astro.orbit.rv_to_elements` for the equations, and for circular and equatorial orbits.
        """
        return self.simulator.observer.now.elements

    @observable
    def semi_major_axis(now: Now) -> Tensor:
        """Semi-major axis ``a = 1 / (2 / |r| - |v|^2 / mu)``, [N] m, with ``mu`` in m^3/s^2."""
        return now.elements.a

    @observable
    def eccentricity(now: Now) -> Tensor:
        """Eccentricity ``e = |v x h / mu - r / |r||`` with ``h = r x v``, [N]."""
        return now.elements.e

    @observable
    def inclination(now: Now) -> Tensor:
        """Inclination ``i = acos(h_z / |h|)`` with ``h = r x v`` in N, [N] rad in [0, pi]."""
        return now.elements.i

    @observable
    def ascending_node(now: Now) -> Tensor:
        """Right ascension ``Omega`` of the ascending node: angle from N's first axis to the node in N's equator, [N] rad."""
        return now.elements.Omega

    @observable
    def argument_of_periapsis(now: Now) -> Tensor:
        """Argument of periapsis ``omega``: angle from the ascending node to the eccentricity vector, [N] rad."""
        return now.elements.omega

    @observable
    def true_anomaly(now: Now) -> Tensor:
        """True anomaly ``f``: angle from the eccentricity vector to the position in the orbit plane, [N] rad."""
        return now.elements.f

    @observable
    def beta_angle(now: Now) -> Tensor:
        """Angle between orbit normal and Sun, ``beta = acos(h . s)``, [N] rad in [0, pi].

        ``h`` is the unit vector along ``r x v``, ``s`` that from the Earth to the Sun; texts often define ``pi / 2 - beta``.
        """
        return torch.acos(torch.clamp(now.HN.z.dot(now.r_SN_N.unit()), -1.0, 1.0))

    @property
    def fault_severity(self) -> Tensor:
        """Share of the change of each fault that acts now, from 0 to 1, [N, F], in the order of the argument ``faults``.

        Raises:
            ValueError: For satellites without faults.
        """
        state = self.simulator.state
        declared = state.argument("faults")
        if not declared:
            raise ValueError("fault_severity needs faults, such as sat_args={'faults': [faults.wheel_torque(0, at=600.0)]}")
        return severities(declared, state.all_arguments, state.ticks, state.h_ns)

    @vital
    def altitude_valid(now: Now) -> Tensor:
        """Whether ``|r_BN_N| > min_orbital_radius`` (m), [N]."""
        return now.r_BN_N.norm() > now.args.min_orbital_radius


class EclipseDynModel(DynamicsModel):
    """Adds the eclipse."""

    requires_world: ClassVar[tuple[type[world.WorldModel], ...]] = (world.EclipseWorldModel,)

    @observable
    def illumination(now: Now) -> Tensor:
        """Visible fraction of the solar disc, 0 in the umbra to 1 in sunlight, [N]; that of the previous tick.

        Basilisk's ``eclipse`` runs once a tick; see :mod:`bsk_torch.astro.eclipse` for its equations.
        """
        return now.illumination


class DisturbanceTorqueDynModel(DynamicsModel):
    """Adds a constant torque in body axes."""

    components: ClassVar[tuple[Component, ...]] = (drag.DISTURBANCE,)


class GravityGradientDynModel(DynamicsModel):
    """Adds the torque of the gravity gradient; composed with other models."""

    components: ClassVar[tuple[Component, ...]] = (drag.GRAVITY_GRADIENT,)


class SolarPressureDynModel(EclipseDynModel):
    """Adds the pressure of sunlight on ``facets``; composed with other models.

    Where the orbit is solved in advance, sunlight turns the body but does not push its orbit.
    """

    components: ClassVar[tuple[Component, ...]] = (facets.SUNLIGHT_PRESSURE,)


class TorqueBarsDynModel(DynamicsModel):
    """Adds magnetic torque bars, and the Earth's magnetic field; composed with other models.

    Flight software, such as :class:`bsk_torch.sim.fsw.MagneticUnloadingFSWModel`, writes dipoles to the state ``bar_command``.
    """

    components: ClassVar[tuple[Component, ...]] = (torque_bars.TORQUE_BARS,)
    requires_world: ClassVar[tuple[type[world.WorldModel], ...]] = (world.MagneticFieldWorldModel,)

    @observable
    def magnetic_field_B(now: Now) -> Vec3:
        """Magnetic field in B, [N, 3] T, at the position of the previous tick."""
        return now.BN @ now.magnetic_field_N

    @observable
    def bar_dipoles(now: Now) -> tuple[Tensor, ...]:
        """Commanded dipoles of the torque bars, [N, T] A m^2."""
        return now.bar_command


class NavigationErrorsDynModel(DynamicsModel):
    """Adds errors of the navigation; composed with other models.

    Guidance laws read position, velocity, attitude and rate with errors; observations and all else remain true. What is known of
    other satellites is true, too.
    """

    components: ClassVar[tuple[Component, ...]] = (navigation.NAVIGATION_ERRORS,)

    @observable
    def navigation_errors(now: Now) -> tuple[Tensor, ...]:
        """Errors of position (m), velocity (m/s), attitude (MRP) and rate (rad/s), three each, and six unused ones, [N, 18].

        Constant errors are not included.
        """
        return now.nav_errors


class AtmosphericDragDynModel(DynamicsModel):
    """Adds drag by an exponential atmosphere for integrated orbits; see :mod:`bsk_torch.sim.dyn.forces.drag`."""

    components: ClassVar[tuple[Component, ...]] = (drag.DRAG,)
    requires_world: ClassVar[tuple[type[world.WorldModel], ...]] = (world.AtmosphereWorldModel,)


class BasicDynamicsModel(EclipseDynModel, DisturbanceTorqueDynModel, AtmosphericDragDynModel):
    """Adds wheels, thrusters, solar panel, battery and power sinks."""

    components: ClassVar[tuple[Component, ...]] = (
        wheels.WHEELS,
        wheels.WHEEL_POWER,
        thrusters.THRUSTERS,
        panels.PANEL,
        power.BASE_POWER,
        power.THRUSTER_POWER,
        power.BATTERY,
    )

    @observable
    def battery_charge(now: Now) -> Tensor:
        """Charge of the battery, [N] W s = J (Basilisk's ``simpleBattery``)."""
        return now.charge

    @observable
    def battery_charge_fraction(now: Now) -> Tensor:
        """Charge over capacity, ``charge / batteryStorageCapacity``, [N] in [0, 1]."""
        return now.charge / now.args.batteryStorageCapacity

    @observable
    def wheel_speeds(now: Now) -> Vec3 | tuple[Tensor, ...]:
        """Speeds ``Omega`` of the wheels relative to B about their spin axes, [N, 3] rad/s; [N, W] of other ``wheels``."""
        return now.Omega_WB_B

    @observable
    def wheel_speeds_fraction(now: Now) -> Vec3 | tuple[Tensor, ...]:
        """Wheel speeds ``Omega / Omega_max``, [N, 3] or [N, W], where ``Omega_max`` is ``maxWheelSpeed`` (rpm) in rad/s."""
        limit = now.args.maxWheelSpeed * RPM
        return now.Omega_WB_B / limit if isinstance(now.Omega_WB_B, Vec3) else tuple(speed / limit for speed in now.Omega_WB_B)

    @observable
    def solar_pointing_error(now: Now) -> Tensor:
        """Angle between ``nHat_B``, the normal of the panel, and the direction of the Sun, [N] rad.

        Of several ``panels``, ``nHat_B`` is the axis that the mode ``"charge"`` points at the Sun.
        """
        return angle_between(now.BN.mT @ now.args.nHat_B, now.r_SN_N - now.r_BN_N)

    @observable
    def panel_angles(now: Now) -> tuple[Tensor, ...]:
        """Angles of the ``panels`` that turn, about their axes, [N, T] rad."""
        return now.panel_angle

    @vital
    def rw_speeds_valid(now: Now) -> Tensor:
        """Whether ``|Omega_k| < Omega_max`` for each wheel, [N], with ``Omega_max`` from ``maxWheelSpeed`` (rpm)."""
        limit = now.args.maxWheelSpeed * RPM
        speeds = getattr(now, "Omega_WB_B", (torch.zeros_like(limit),))  # none without wheels
        return functools.reduce(operator.and_, [torch.abs(speed) < limit for speed in speeds])

    @vital
    def battery_valid(now: Now) -> Tensor:
        """Whether ``charge > 0``, [N]."""
        return now.charge > 0.0


class ImagingDynModel(BasicDynamicsModel):
    """Adds one or several instruments that take each image in one tick, a partitioned data buffer, and a transmitter.

    A step may end with the image of its task.
    """

    components: ClassVar[tuple[Component, ...]] = (
        INSTRUMENTS,
        partitions.IMAGER,
        storage.INSTRUMENT_POWER,
        partitions.TRANSMITTER,
        storage.TRANSMITTER_POWER,
        partitions.PARTITIONED_STORE,
        events.IMAGE_EVENT,
    )

    @observable
    def storage_level(now: Now) -> Tensor:
        """Data in all partitions of the buffer, [N] bit (Basilisk's ``partitionedStorageUnit``)."""
        return now.storage

    @observable
    def storage_level_fraction(now: Now) -> Tensor:
        """Data as a fraction of the capacity, ``level / dataStorageCapacity``, [N]; 0 for a capacity of zero."""
        return now.storage / torch.clamp(now.args.dataStorageCapacity, min=1.0)

    @observable
    def partition_levels(now: Now) -> tuple[Tensor, ...]:
        """Data in every partition of the buffer, [N, P] bit."""
        return now.partitions

    @observable
    def instrument_index(now: Now) -> Tensor:
        """Number of the instrument chosen last, [N], of several ``instruments``."""
        return now.instrument_index

    @property
    def instrument_baud(self) -> Tensor:
        """Data of one image, [N] bit, by the instrument chosen last; for a continuous instrument, its data rate, bit/s."""
        return argument_now(self.simulator.state, "instrumentBaudRate")

    @vital
    def data_storage_valid(now: Now) -> Tensor:
        """Whether the buffer is not full, [N]: ``level < C`` or ``|level - C| > 1e-8 + 1e-5 |C|``; True without the check.

        ``C`` is ``dataStorageCapacity``, bit; ``storageUnitValidCheck`` switches the check on.
        """
        level, capacity = now.storage, now.args.dataStorageCapacity
        full = torch.abs(level - capacity) > 1e-8 + 1e-5 * torch.abs(capacity)  # as close as numpy's isclose
        return (level < capacity) | ~full if now.args.storageUnitValidCheck else torch.ones_like(level) > 0.0


class ContinuousImagingDynModel(ImagingDynModel):
    """Adds one or several instruments that record continuously while they point down, into a data buffer without partitions."""

    components: ClassVar[tuple[Component, ...]] = (
        storage.INSTRUMENT,
        storage.TRANSMITTER,
        storage.STORAGE,
        events.NO_IMAGE_EVENT,
    )

    @observable
    def partition_levels(now: Now) -> tuple[Tensor, ...]:
        """Data in the buffer as a single partition, [N, 1] bit."""
        return (now.storage,)


class StripImagingDynModel(ImagingDynModel):
    """Adds an instrument that records continuously, at a data rate ``instrumentBaudRate``, into a partitioned data buffer.

    For strips, see :class:`bsk_torch.sim.fsw.StripImagingFSWModel`. No step ends with an image.
    """

    components: ClassVar[tuple[Component, ...]] = (storage.INSTRUMENT, events.NO_IMAGE_EVENT)


class GroundStationDynModel(ImagingDynModel):
    """Adds ground stations, which the transmitter needs to send data."""

    requires_world: ClassVar[tuple[type[world.WorldModel], ...]] = (world.GroundStationWorldModel,)


class LOSCommDynModel(DynamicsModel):
    """Adds lines of sight between satellites; see :class:`~bsk_torch.comm.LOSCommunication`."""

    components: ClassVar[tuple[Component, ...]] = (
        Component(
            "los_comms",
            args=(Arg("losMaximumRange", -1.0, "m", "longest range of sight; no limit where not positive", endless=True),),
        ),
    )


class FullFeaturedDynModel(GroundStationDynModel, LOSCommDynModel):
    """Ground stations and lines of sight; deprecated in favor of a tuple of both models in ``dyn_type``."""

    def __init__(self, simulator: Simulation) -> None:
        """Warn of the deprecation, and bind the model to a simulation."""
        warnings.warn(
            "dyn.FullFeaturedDynModel is deprecated; write dyn_type = (dyn.GroundStationDynModel, dyn.LOSCommDynModel)",
            DeprecationWarning,
            stacklevel=2,
        )
        super().__init__(simulator)
