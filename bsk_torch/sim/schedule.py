"""The order of a tick: a list of slots, in which components run one after another. It belongs to the dynamics model.

The order of :data:`SCHEDULE`, the default of all dynamics models, is that of Basilisk's processes, tasks and modules under
BSK-RL, and results depend on it: a component reads the messages that earlier ones wrote in this tick, and those of the tick
before of all others. So the world, which runs first, sees the spacecraft where it was one tick ago, and what the flight software,
which runs last, commands at t is latched by wheels and thrusters at t + h and acts from there on. Within the environment,
``location_target`` and ``ground_stations`` precede ``ephemeris``, since they use the orientation of the Earth of the tick before.

A component runs in its slot. A user's component either takes a slot of the schedule, and so replaces what a base
class has there, or says ``after`` or ``before`` which of these slots it runs. Several after (before) the same slot run in the
order in which the models list them. A dynamics model with another order sets ``schedule``, for example
``schedule = SCHEDULE.moved("wheels", before="hub")``.

``python -m bsk_torch schedule`` prints the default, ``python -m bsk_torch schedule AEOS-v1`` what a preset runs.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
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


class Schedule(tuple[Slot, ...]):
    """Slots in the order of a tick."""

    @cached_property
    def numbers(self) -> dict[str, int]:
        """Number of each slot by its name."""
        return {slot.name: k for k, slot in enumerate(self)}

    def place(self, component: Placed) -> tuple[int, int]:
        """Return the place of a component, as a key to sort by: number of a slot; -1, 0 or 1 for before, in, after it.

        ValueError for a component that has neither a slot of the schedule nor one to run after or before.
        """
        anchor, side = anchored(component)
        if anchor in self.numbers:
            return self.numbers[anchor], side
        if side:
            word = "after" if side > 0 else "before"
            raise ValueError(
                f"slot={component.slot!r} has {word}={anchor!r}, which is not a slot of a tick; {nearest(anchor, self.numbers)}"
            )
        raise ValueError(
            f"slot={anchor!r} is not in the schedule of a tick: give after= or before= one of its slots, such as "
            f"after='battery', or replace one of them; {nearest(anchor, self.numbers)} See python -m bsk_torch schedule"
        )

    def ordered(self, components: Iterable[P]) -> tuple[P, ...]:
        """Return components in the order of the schedule, :meth:`place`; those with the same place stay in the given order."""
        return tuple(sorted(components, key=self.place))

    def listed(self, components: Iterable[P]) -> tuple[P, ...]:
        """Return components in the order of the schedule, with those that have no place in it at the end."""

        def rank(component: Placed) -> tuple[int, int]:
            return self.place(component) if anchored(component)[0] in self.numbers else (len(self), 0)

        return tuple(sorted(components, key=rank))

    def moved(self, name: str, *, after: str | None = None, before: str | None = None) -> Schedule:
        """Return the schedule with one of its slots after, or before, another one.

        ValueError for a slot that is not in the schedule, or unless exactly one of ``after`` and ``before`` is given.
        """
        slot = self[self._number("name", name)]
        return Schedule(other for other in self if other is not slot).with_slot(slot, after=after, before=before)

    def with_slot(self, slot: Slot, *, after: str | None = None, before: str | None = None) -> Schedule:
        """Return the schedule with another slot after, or before, one of its slots.

        ValueError for a slot that is there already, a neighbor that is not, or unless one of ``after`` and ``before`` is given.
        """
        if slot.name in self.numbers:
            raise ValueError(f"slot {slot.name!r} is in the schedule already; Schedule.moved() changes its place")
        if (after is None) == (before is None):
            raise ValueError(f"slot {slot.name!r} has after={after!r} and before={before!r}; give one of them")
        k = self._number("before", before) if after is None else self._number("after", after) + 1
        return Schedule((*self[:k], slot, *self[k:]))

    def _number(self, title: str, name: str | None) -> int:
        if name not in self.numbers:
            raise ValueError(f"{title}={name!r} is no slot of the schedule; {nearest(str(name), self.numbers)}")
        return self.numbers[name]


def anchored(component: Placed) -> tuple[str, int]:
    """Return the slot by which a component is placed, and -1, 0 or 1 for before, in, or after it."""
    if component.after is not None and component.before is not None:
        raise ValueError(
            f"slot={component.slot!r} has after={component.after!r} and before={component.before!r}; give one of them"
        )
    if component.after is not None:
        return component.after, 1
    if component.before is not None:
        return component.before, -1
    return component.slot, 0


SCHEDULE = Schedule(
    (
        *_group(
            "faults",
            ("faults", "parameters changed by faults, which act after the tick of their time", "events, between two ticks"),
        ),
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
            ("manoeuvre", "the change of velocity commanded at the end of the last tick", "spacecraft"),
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
            ("image_event", "event that ends a step with its image", "an event"),
            ("los_comms", "range of sight between satellites", "spacecraftLocation"),
            ("conjunction", "distance at which satellites collide", "an event"),
            ("max_range", "distance at which a satellite loses its chief", "an event"),
        ),
        *_group(
            "flight software",
            ("navigation", "attitude, which is the true one, and the error without guidance", "simpleNav, attTrackingError"),
            ("sun_pointing", "guidance: panel to the Sun", "locationPointing"),
            ("nadir_pointing", "guidance: along the Hill frame", "hillPoint"),
            ("desaturation", "thruster pulses", "thrMomentumManagement, thrForceMapping, thrMomentumDumping"),
            ("location_pointing", "guidance: instrument to its target", "locationPointing"),
            ("instrument_controller", "command to the instrument", "scanningInstrumentController, simpleInstrumentController"),
            ("control", "motor torque command", "mrpFeedback or mrpSteering with rateServoFullNonlinear, rwMotorTorque"),
        ),
    )
)
"""The slots in the order of a tick, the default of dynamics models."""
