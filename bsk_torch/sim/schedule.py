"""The order of a tick: one list of slots, in which components run one after another.

The order is that of Basilisk's processes, tasks and modules under bsk_rl, and results depend on it: a component reads the
messages that earlier ones wrote in this tick, and those of the tick before of all others. So the world, which runs first, sees
the spacecraft where it was one tick ago, and what the flight software, which runs last, commands at t is latched by wheels and
thrusters at t + h and acts from there on. Within the environment, ``location_target`` and ``ground_stations`` precede
``ephemeris``, since they use the orientation of the Earth of the tick before.

A component runs at the place of its slot. A component of the user's own either takes a slot of this list, and so replaces what a
base class has there, or says ``after`` or ``before`` which of these slots it runs. Several after (before) the same slot run in
the order in which the models list them.

``python -m bsk_torch schedule`` prints the list, ``python -m bsk_torch schedule AEOS-v1`` what a preset runs.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Protocol, TypeVar

from bsk_torch.sim.names import nearest


class Slot(NamedTuple):
    """A place in the tick: its name, what runs there, the Basilisk modules that it stands for, and its group."""

    name: str
    doc: str
    basilisk: str
    group: str


def _group(group: str, *slots: tuple[str, str, str]) -> tuple[Slot, ...]:
    return tuple(Slot(*slot, group) for slot in slots)


SCHEDULE: tuple[Slot, ...] = (
    *_group(
        "environment",
        ("earth_pole", "axes of the Earth's equator, for all that follow", "spiceInterface"),
        ("location_target", "target that the instrument is pointed at, and its access, one tick ago", "groundLocation"),
        ("ground_stations", "access of the ground stations, one tick ago", "groundLocation"),
        ("ephemeris", "the Sun and the Earth's orientation at the end of the tick", "spiceInterface, ephemerisConverter"),
        ("atmosphere", "density at the position of one tick ago", "exponentialAtmosphere"),
        ("eclipse", "illumination at the position of one tick ago", "eclipse"),
    ),
    *_group(
        "orbit",
        ("manoeuvre", "the change of velocity that was commanded at the end of the last tick", "spacecraft"),
        ("orbit", "position and velocity from an arc solved in advance", "spacecraft"),
    ),
    *_group(
        "dynamics",
        ("disturbance", "constant torque", "extForceTorque"),
        ("hub", "attitude and wheels, and the orbit where it is integrated, over the tick", "spacecraft"),
        ("imposed_attitude", "attitude of the last reference, where there are no actuators", "spacecraft"),
        ("drag", "latch the density for the next tick", "facetDragDynamicEffector"),
        ("wheels", "latch the motor torque for the next tick", "reactionWheelStateEffector"),
        ("thrusters", "latch the pulses for the next tick", "thrusterDynamicEffector"),
        ("panel", "power of the solar panel, the first of the balance", "simpleSolarPanel"),
        ("wheel_power", "power of the wheels", "ReactionWheelPower"),
        ("base_power", "power that is always drawn", "simplePowerSink"),
        ("thruster_draw", "power while desaturating", "simplePowerSink"),
        ("instrument_draw", "power of the instrument", "simplePowerSink"),
        ("transmitter_draw", "power of the transmitter", "simplePowerSink"),
        ("instrument", "data rate of the instrument", "simpleInstrument"),
        ("battery", "charge, by the power of the end of the tick", "simpleBattery"),
        ("transmitter", "data rate of the transmitter, by the store of one tick ago", "spaceToGroundTransmitter"),
        ("storage", "data in the store", "simpleStorageUnit, partitionedStorageUnit"),
        ("image_event", "event that ends a step with its image", "an event of bsk_rl"),
        ("los_comms", "range of sight between satellites", "spacecraftLocation"),
        ("conjunction", "distance at which satellites collide", "an event of bsk_rl"),
        ("max_range", "distance at which a satellite loses its chief", "an event of bsk_rl"),
    ),
    *_group(
        "flight software",
        ("navigation", "attitude, which is the true one, and the error without guidance", "simpleNav, attTrackingError"),
        ("sun_pointing", "guidance: panel to the Sun", "locationPointing"),
        ("nadir_pointing", "guidance: along the Hill frame", "hillPoint"),
        ("desaturation", "thruster pulses", "thrMomentumManagement, thrForceMapping, thrMomentumDumping"),
        ("location_pointing", "guidance: instrument to its target", "locationPointing"),
        ("instrument_controller", "command to the instrument", "scanningInstrumentController, simpleInstrumentController"),
        (
            "control",
            "motor torque command",
            "mrpFeedback or mrpSteering with rateServoFullNonlinear, rwMotorTorque",
        ),
    ),
)
"""All slots in the order of a tick."""

INDEX = {slot.name: k for k, slot in enumerate(SCHEDULE)}
"""Number of each slot in :data:`SCHEDULE`."""


class Placed(Protocol):
    """Anything that has a place in the tick: a :class:`~bsk_torch.sim.component.Component`."""

    @property
    def slot(self) -> str:
        """Name of its slot."""

    @property
    def after(self) -> str | None:
        """Slot that it runs after."""

    @property
    def before(self) -> str | None:
        """Slot that it runs before."""


P = TypeVar("P", bound=Placed)


def place(component: Placed) -> tuple[int, int]:
    """Return the place of a component in the tick, as a key to sort by: number of a slot; -1, 0 or 1 for before, in, after it.

    Raises:
        ValueError: For a component that has neither a slot of :data:`SCHEDULE` nor one to run after or before.
    """
    if component.after is not None and component.before is not None:
        raise ValueError(
            f"slot={component.slot!r} has after={component.after!r} and before={component.before!r}; give one of them"
        )
    anchor, side = component.slot, 0
    if component.after is not None:
        anchor, side = component.after, 1
    elif component.before is not None:
        anchor, side = component.before, -1
    if anchor in INDEX:
        return INDEX[anchor], side
    if side:
        word = "after" if side > 0 else "before"
        raise ValueError(f"slot={component.slot!r} has {word}={anchor!r}, which is no slot of a tick; {nearest(anchor, INDEX)}")
    raise ValueError(
        f"slot={anchor!r} is not in the schedule of a tick: give after= or before= one of its slots, such as after='battery', "
        f"or replace one of them; {nearest(anchor, INDEX)} See python -m bsk_torch schedule"
    )


def ordered(components: Iterable[P]) -> tuple[P, ...]:
    """Return components in the order of a tick; those with the same place stay in the given order.

    Raises:
        ValueError: See :func:`place`.
    """
    return tuple(sorted(components, key=place))
