"""Dynamics of imagers of resident space objects (RSO): the gate before the instrument, and the end of a step with an image.

A target is an object of a catalog. It has neither attitude nor tick: the component of the gate finds its position from nodes of
its orbit, which the scenario supplies.

There are two kinds of exposure. By default the gate commands the instrument at the end of the hold. With ``exposure="first"`` the
controller of the flight software does in the first valid tick, as for places on the ground, and the hold is checked afterward,
while the image is in the store already: see :func:`expose` and :func:`check_hold`.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import torch
from torch import Tensor

from bsk_torch.astro.eclipse import illumination
from bsk_torch.astro.interpolate import BEFORE, COUNT, coefficients, position
from bsk_torch.astro.sight import line_clearance, stretch
from bsk_torch.constants import NANO
from bsk_torch.sim.component import Arg, Bus, Component, Field, Track, UserArguments, Values, vec
from bsk_torch.sim.dyn.models import ImagingDynModel
from bsk_torch.sim.dyn.storage import partitions
from bsk_torch.sim.dyn.storage import store as storage
from bsk_torch.sim.instruments import NO_INSTRUMENTS
from bsk_torch.sim.orbit.grid import NODE_SPACING
from bsk_torch.sim.readout.observables import Now, observable
from bsk_torch.vec3 import Vec3, only

RSO_TRACK = Track("rso_nodes", NODE_SPACING, (vec("r_TN_N", "m", exact=True),), COUNT, BEFORE)
"""Nodes of the orbit of the object that each satellite points at."""

HELD = 1e-9
"""Seconds by which a hold may be too short, for rounding of its sum."""

GATE_FIELDS = (
    Field("rso_armed", 1, "-", "1 from the command to image until the image or the deadline, else 0"),
    Field("rso_pointed", 1, "-", "1 where flight software has found the pointing error of this task within the requirements"),
    Field("rso_valid", 1, "-", "1 where all conditions held in the last tick of an armed gate"),
    Field("rso_light", 1, "-", "visible fraction of the Sun at the target in that tick"),
    Field("rso_held", 1, "s", "time for which all conditions have held", exact=True),
    Field("rso_lit", 1, "s", "integral of the visible fraction over that time", exact=True),
    Field("rso_taken", 1, "-", "1 after the image of the task, else 0"),
    Field("rso_fired", 1, "-", "1 where the controller has commanded an image for the next tick, else 0"),
)
"""Fields of the gate that every command sets to zero."""

TASK_FIELDS = (
    Field("rso_deadline", 1, "-", "tick from which on no image is taken", exact=True, limit=2.0**53),
    Field("rso_hold", 1, "s", "time for which all conditions must hold", exact=True),
    Field("rso_continuous", 1, "-", "1 where a break ends a hold, 0 where it interrupts it"),
    Field("rso_least_light", 1, "-", "least visible fraction of the Sun at the target; none where negative"),
    Field("rso_ends", 1, "-", "1 where the image ends the step, else 0"),
    Field("rso_first", 1, "-", "1 where the image is taken in the first valid tick, 0 where at the end of the hold"),
)
"""Requirements of the task."""

IMAGE_FIELDS = (
    Field("rso_images", 1, "-", "images taken since reset", exact=True),
    Field("rso_image_tick", 1, "-", "tick of the last image", exact=True, limit=2.0**53),
    Field(
        "rso_image_quality", 1, "-", "mean visible fraction of the Sun at the target over the hold of the last image", exact=True
    ),
    Field("rso_image_held", 1, "s", "hold of the last image", exact=True),
    Field("rso_stored_tick", 1, "-", "tick in which an image was stored last", exact=True, limit=2.0**53),
    Field("rso_open", 1, "-", "1 + target of an image that is stored, but whose hold is not complete; 0 for none", exact=True),
    Field("rso_left", 1, "-", "images since reset whose hold another command has ended", exact=True),
    Field("rso_left_target", 1, "-", "target of the last one of these", exact=True),
)
"""The last image, and images whose hold is not complete."""


def see_rso(bus: Bus) -> tuple[Vec3, Tensor, Tensor]:
    """Return the target T in N, m, whether it is in sight and within range, and the visible fraction of the Sun there.

    The line of sight passes the Earth, an ellipsoid (:mod:`bsk_torch.astro.sight`). Light is that of the position of one tick ago
    under the Sun of this one, as for satellites.
    """
    path, s = coefficients([node.r_TN_N for node in bus.rso_nodes]), bus.rso_nodes_tau * (1.0 / NODE_SPACING)
    r_TN_N, before = position(path, s), position(path, s - bus.h / NODE_SPACING)
    line, reach = r_TN_N - bus.r_BN_N, bus.target_range
    clear = line_clearance(stretch(r_TN_N, bus.EN.z), stretch(bus.r_BN_N, bus.EN.z)) > 0.0
    near = (line.dot(line) <= reach * reach) | (reach < 0.0)
    return r_TN_N, (clear & near).to(bus.dtype), illumination(before, bus.r_SN_N)


def hold(bus: Bus) -> None:
    """Command the instrument for one tick, the first in which all conditions hold and have held for long enough.

    The conditions of a tick at t are: pointing within the requirements, as flight software has found it at t - h, but not before
    the tick after the command; the target in sight and within range; light at the target. Intervals count whose two ends fulfill
    them::

        held += h,  lit += h (f + f(t - h)) / 2          valid now, and in the tick before
        held = lit = 0                                   not valid now, if the hold must be continuous
        image: valid now, held >= hold, room for it      quality = lit / held, or f where held = 0

    From the deadline on nothing is taken. What the controller has commanded, see :func:`check_hold`, the instrument does.
    """
    zero, on = torch.zeros_like(bus.rso_held), bus.location_on > 0.0
    none = Vec3.zeros_like(bus.r_BN_N.x)
    bus.r_TN_N, sees, light = only(on, lambda: see_rso(bus), (none, none.x, none.x))
    bus.rso_sees, bus.rso_sees_light, first = sees, light, bus.rso_first > 0.0
    late = (bus.ticks >= bus.rso_deadline) & ~first
    for field in GATE_FIELDS:
        if field.name != "rso_pointed":
            value = getattr(bus, field.name)
            setattr(bus, field.name, torch.where(late, torch.zeros_like(value), value))
    armed = (bus.rso_armed > 0.0) & ~first
    valid = armed & (bus.rso_pointed > 0.0) & (sees > 0.0) & (light >= bus.rso_least_light)
    counts, breaks = valid & (bus.rso_valid > 0.0), armed & ~valid & (bus.rso_continuous > 0.0)
    held = torch.where(counts, bus.rso_held + bus.h, torch.where(breaks, zero, bus.rso_held))
    lit = torch.where(counts, bus.rso_lit + (light + bus.rso_light) * (0.5 * bus.h), torch.where(breaks, zero, bus.rso_lit))
    room = bus.storage_capacity - bus.storage >= bus.instrument_baud - 1e-6
    takes = valid & (held + HELD >= bus.rso_hold) & room
    one = torch.ones_like(held)
    quality = torch.where(held > 0.0, lit / torch.where(held > 0.0, held, one), light)
    bus.rso_held, bus.rso_lit = held, lit
    bus.rso_valid = torch.where(armed, valid.to(bus.dtype), bus.rso_valid)
    bus.rso_light = torch.where(armed, light, bus.rso_light).to(bus.dtype)
    bus.instrument_command = torch.where(takes, one, zero)
    bus.rso_armed = torch.where(takes, torch.zeros_like(bus.rso_armed), bus.rso_armed)
    bus.rso_taken = torch.where(takes, torch.ones_like(bus.rso_taken), bus.rso_taken)
    bus.rso_images = bus.rso_images + bus.instrument_command
    bus.rso_image_tick = torch.where(takes, bus.ticks, bus.rso_image_tick)
    bus.rso_image_quality = torch.where(takes, quality, bus.rso_image_quality)
    bus.rso_image_held = torch.where(takes, held, bus.rso_image_held)
    bus.rso_stored_tick = torch.where(takes, bus.ticks, bus.rso_stored_tick)
    expose(bus)


def expose(bus: Bus) -> None:
    """Command the instrument where the controller did so in the last tick, and note whether the store has room for the image.

    The image is *open* until its hold is complete or the deadline has come. If another command comes first, it is *left*, and its
    data stay in the store.
    """
    open_ = bus.rso_open > 0.0
    gives_up = open_ & (bus.rso_taken <= 0.0)  # which a command has set to zero
    bus.rso_left = torch.where(gives_up, bus.rso_left + 1.0, bus.rso_left)
    bus.rso_left_target = torch.where(gives_up, bus.rso_open - 1.0, bus.rso_left_target)
    fires = bus.rso_fired > 0.0
    stored = fires & (bus.storage + bus.instrument_baud <= bus.storage_capacity)
    target = bus.data_partition if bus.has("data_partition") else torch.zeros_like(bus.rso_open)
    still = torch.where(gives_up, torch.zeros_like(bus.rso_open), bus.rso_open)
    bus.rso_open = torch.where(stored, target.to(still.dtype) + 1.0, still)
    bus.rso_stored_tick = torch.where(stored, bus.ticks, bus.rso_stored_tick)
    bus.instrument_command = torch.where(fires, torch.ones_like(bus.instrument_command), bus.instrument_command)
    bus.rso_fired = torch.zeros_like(bus.rso_fired)


def check_hold(bus: Bus) -> None:
    """Command the instrument in the first valid tick of a task with ``exposure="first"``, and check the hold of its image.

    A tick at t is valid where pointing, as flight software finds it at t, is within the requirements, and the target is in sight
    and within range. The instrument takes the image at t + h. Light does not matter, but is the quality::

        held += h,  lit += h f                           valid now
        held = lit = 0                                   not valid now, if the hold must be continuous
        success: image stored, held >= hold              time of the image: when it was stored,  quality = lit / held
        else at the deadline, image stored               time of the image: the deadline,        quality = f
    """
    zero, one = torch.zeros_like(bus.rso_held), torch.ones_like(bus.rso_held)
    armed = (bus.rso_first > 0.0) & (bus.rso_armed > 0.0) & (bus.location_on > 0.0)
    valid = armed & (bus.rso_pointed > 0.0) & (bus.rso_sees > 0.0)
    breaks = armed & ~valid & (bus.rso_continuous > 0.0)
    held = torch.where(valid, bus.rso_held + bus.h, torch.where(breaks, zero, bus.rso_held))
    lit = torch.where(valid, bus.rso_lit + bus.rso_sees_light * bus.h, torch.where(breaks, zero, bus.rso_lit))
    late = armed & (bus.ticks >= bus.rso_deadline)
    stored = armed & (bus.rso_open > 0.0)
    done = stored & (held + HELD >= bus.rso_hold)
    counts = done | (late & stored)
    fires = valid & (bus.rso_taken <= 0.0) & ~late
    quality = torch.where(done & (held > 0.0), lit / torch.where(held > 0.0, held, one), bus.rso_sees_light)
    bus.rso_held, bus.rso_lit = held, lit
    bus.rso_light = torch.where(armed, bus.rso_sees_light, bus.rso_light).to(bus.dtype)
    bus.rso_fired = torch.where(fires, torch.ones_like(bus.rso_fired), bus.rso_fired)
    bus.rso_taken = torch.where(fires, torch.ones_like(bus.rso_taken), bus.rso_taken)
    bus.rso_armed = torch.where(done | late, torch.zeros_like(bus.rso_armed), bus.rso_armed)
    bus.rso_open = torch.where(counts, torch.zeros_like(bus.rso_open), bus.rso_open)
    bus.rso_images = torch.where(counts, bus.rso_images + 1.0, bus.rso_images)
    bus.rso_image_tick = torch.where(counts, torch.where(done, bus.rso_stored_tick, bus.ticks), bus.rso_image_tick)
    bus.rso_image_quality = torch.where(counts, quality, bus.rso_image_quality)
    bus.rso_image_held = torch.where(counts, held, bus.rso_image_held)
    end_step(bus, done & (bus.rso_ends > 0.0))


def end_step(bus: Bus, ends: Tensor) -> None:
    """Count what ends the step, and stop."""
    bus.images = bus.images + ends.to(torch.float64)
    bus.stop = bus.stop | ends if bus.has("stop") else ends


def end_with_image(bus: Bus) -> None:
    """Count an image of the gate that ends the step, and stop."""
    end_step(bus, (bus.instrument_command > 0.0) & (bus.rso_ends > 0.0) & (bus.rso_first <= 0.0))


def _check_range(args: Values) -> None:
    if bool((args["imageTargetMaximumRange"] == 0.0).any()):
        raise ValueError("imageTargetMaximumRange=0 m must be positive, or negative for no limit")


GATE = Component(
    slot="rso_gate",
    before="instrument",
    update=hold,
    args=(Arg("imageTargetMaximumRange", -1.0, "m", "longest range to the target; no limit where negative", endless=True),),
    state=(*GATE_FIELDS, *TASK_FIELDS, *IMAGE_FIELDS),
    params=(Field("target_range", 1, "m", exact=True),),
    prepare=lambda args: {"target_range": args["imageTargetMaximumRange"]},
    check=_check_range,
    tracks=(RSO_TRACK,),
    resets=tuple((field.name, 0.0) for field in GATE_FIELDS),
)

RSO_IMAGE_EVENT = Component(
    slot="image_event",
    update=end_with_image,
    stops=True,
    state=(Field("images", 1, "-", "images since reset that ended a step", exact=True),),
)

RSO_IMAGER = dataclasses.replace(
    partitions.IMAGER,
    args=(Arg("instrumentBaudRate", 8e6, "bit", "data of one image", low=1.0, high=storage.MOST_BITS, whole=True),),
)


def _with_small_packets(transmitter: Component) -> Component:
    """Return a transmitter whose packets are one bit by default, so that an image continues after a gap between stations."""
    args = tuple(
        dataclasses.replace(arg, default=-1.0) if arg.name == "transmitterPacketSize" else arg for arg in transmitter.args
    )
    fit = partitions.TRANSMITTER.fit
    assert fit is not None

    def fitted(arguments: UserArguments) -> Component:
        return _with_small_packets(fit(arguments))

    return dataclasses.replace(transmitter, args=args, fit=fitted)


class SpaceToSpaceImagingDynModel(ImagingDynModel):
    """A satellite that images objects in orbit: instrument, a store with a partition for each target, and a transmitter.

    The targets come from :class:`bsk_torch.tasks.objects.RSOTargets`, as do the partitions of the store. Compose it with
    :class:`GroundStationDynModel` for downlinks.
    """

    components: ClassVar[tuple[Component, ...]] = (
        NO_INSTRUMENTS,
        GATE,
        RSO_IMAGER,
        _with_small_packets(partitions.TRANSMITTER),
        RSO_IMAGE_EVENT,
    )

    @observable
    def rso_images(now: Now) -> Tensor:
        """Number of images since reset, [N]."""
        return now.rso_images

    @observable
    def rso_left(now: Now) -> Tensor:
        """Images since reset whose hold another command has ended, [N]; see :class:`~bsk_torch.tasks.objects.ImageRSO`."""
        return now.rso_left

    @property
    def rso_image_time(self) -> Tensor:
        """Time of the last image, [N] s; zero without one."""
        state = self.simulator.state
        return state.read("rso_image_tick") * state.h_ns * NANO

    @observable
    def rso_image_quality(now: Now) -> Tensor:
        """Mean visible fraction of the Sun at the target over the hold of the last image, [N]."""
        return now.rso_image_quality

    @observable
    def rso_image_held(now: Now) -> Tensor:
        """Time for which all conditions had held before the last image, [N] s."""
        return now.rso_image_held
