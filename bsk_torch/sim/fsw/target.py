"""Targets of the instrument: a place on the ground that the agent chooses, or the Earth's center. Basilisk's groundLocation.

Targets are modules of the world, so the flight software reads their position and access of one tick ago.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from bsk_torch.astro.frames import rotate_z, sin_elevation
from bsk_torch.astro.geodetic import Vertical, axis_shift
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.component import Arg, Bus, Component, Computation, Field, UserArguments, Values, vec
from bsk_torch.sim.environment.ephemeris import sun_at, turned
from bsk_torch.sim.instruments import differs
from bsk_torch.vec3 import Vec3, only

Update = Callable[[Bus], None]

QUARTER = 0.5 * math.pi

FIRST_ALTITUDE = 1000.0  # height, m, of the place on the equator that is the target until the first task


@functools.cache
def aim_at_place(minimum: bool, maximum: bool, vertical: Vertical = "radius") -> Update:
    """Return the update of targets with a minimum, a maximum, both or no limit of the Sun's elevation, and a vertical."""

    def aim(bus: Bus) -> None:
        """Write the place L in N, m, and its access, 1 or 0, both of one tick ago.

        ``r_LN = [PN]^T r_LP`` with the Earth's orientation of one tick ago. It has access where the spacecraft is above the
        minimum elevation, ``sin(el) = v . d / (|v| |d|)`` with the vertical v, ``r_LN`` or the normal of the ellipsoid, and
        ``d = r_BN - r_LN``, and within the maximum range, ``|d| <= reach``, unless that is negative. That sine is positive, so
        squares are compared, without roots. Where location pointing is off, position and access are zero.

        The elevation of the Sun S, ``sin(el_S) = v . s / (|v| |s|)`` with ``s = r_SN - r_LN`` of one tick ago, must not be below
        a minimum, nor above a maximum.
        """
        cos, sin = turned(bus.ephemeris[0].earth_angle, bus.ephemeris_tau - bus.h)

        def seen() -> tuple[Vec3, Tensor]:
            p = bus.EN.mT @ rotate_z(bus.r_LP_P, cos, -sin)
            line, reach = bus.r_BN_N - p, bus.target_range
            v = p + bus.EN.z * axis_shift(bus.r_LP_P) if vertical == "wgs84" else p
            up, range2 = v.dot(line), line.dot(line)
            rises = (up > 0.0) & (up * up > bus.target_sin2_elevation * v.dot(v) * range2)
            sees = rises & ((range2 <= reach * reach) | (reach < 0.0))
            if minimum or maximum:
                sun = sin_elevation(sun_at(bus, bus.ephemeris_tau - bus.h)[0], p, v)
                sees = sees & (sun >= bus.target_least_sun) if minimum else sees
                sees = sees & (sun <= bus.target_most_sun) if maximum else sees
            return p, torch.where(sees, torch.ones_like(up), torch.zeros_like(up))

        none = Vec3.zeros_like(bus.r_BN_N.x)
        bus.r_LN_N, access = only(bus.location_on > 0.0, seen, (none, none.x))
        bus.target_access = access.to(bus.dtype)

    return aim


def aim_at_earth_centre(bus: Bus) -> None:
    """Write the target of a scan and its access: ``r_LN = 0.1 m`` along the Earth's axis, always above its horizon.

    It has access where ``|r_BN - r_LN| <= reach``, or where the maximum range is negative.
    """
    bus.r_LN_N = bus.EN.z * 0.1
    distance, longest = bus.r_BN_N - bus.r_LN_N, bus.target_range
    reaches = (distance.dot(distance) <= longest * longest) | (longest < 0.0)
    bus.target_access = torch.where(reaches, torch.ones_like(bus.r_BN_N.x), torch.zeros_like(bus.r_BN_N.x)).to(bus.dtype)


def _check_elevation(args: Values) -> None:
    elevation = args["imageTargetMinimumElevation"]
    bad = elevation[(elevation < 0.0) | (elevation >= 0.5 * math.pi)]
    if len(bad):
        value = bad[0].item()
        hint = f"; for {value:g} degrees write math.radians({value:g})" if 0.5 * math.pi < value <= 90.0 else ""
        raise ValueError(f"imageTargetMinimumElevation={value:g} rad must lie in [0, pi/2){hint}")


def first_place(args: Values) -> dict[str, Tensor]:
    """Return a place for guidance until an action chooses one."""
    height = args["groundLocationPlanetRadius"] + FIRST_ALTITUDE
    return {"r_LP_P": torch.stack([height, torch.zeros_like(height), torch.zeros_like(height)], -1)}


def _limits(args: Values) -> dict[str, Tensor]:
    elevation = args["imageTargetMinimumElevation"]
    return {"target_range": args["imageTargetMaximumRange"], "target_sin2_elevation": elevation.sin() ** 2}


MAXIMUM_RANGE = Arg("imageTargetMaximumRange", -1.0, "m", "longest range to the target; no limit where negative", endless=True)

SUN_LIMITS = (
    Arg("imageTargetMinimumSunElevation", None, "rad", "least elevation of the Sun at the target", low=-QUARTER, high=QUARTER),
    Arg("imageTargetMaximumSunElevation", None, "rad", "largest elevation of the Sun at the target", low=-QUARTER, high=QUARTER),
)
"""Light in which targets can be imaged; None: any."""

VERTICAL = "imageTargetVertical"

SUN_PARAMETERS = ("target_least_sun", "target_most_sun")  # parameters of the tick, the sines of SUN_LIMITS


def targets_that(wrap: Callable[[Update], Update], state: Sequence[Field], initial: Computation) -> Component:
    """Return the component of targets with more fields of the state, whose update is ``wrap`` of that of other targets.

    It fits the light that the arguments as given ask for, as :data:`IMAGE_TARGET` does.
    """

    @functools.cache
    def of_form(minimum: bool, maximum: bool, vertical: Vertical) -> Component:
        place = lit_target(minimum, maximum, vertical)
        update, fields = wrap(aim_at_place(minimum, maximum, vertical)), (*place.state, *state)
        fit = lambda arguments: of_form(*target_form(arguments))  # noqa: E731
        return dataclasses.replace(place, update=update, state=fields, initial=initial, fit=fit)

    return of_form(False, False, "radius")


def fitted_target(arguments: UserArguments) -> Component:
    """Return the component of targets in the light that the arguments as given ask for."""
    return lit_target(*target_form(arguments))


def target_form(arguments: UserArguments) -> tuple[bool, bool, Vertical]:
    """Return what decides the component of targets: a minimum, a maximum of the Sun's elevation, and the vertical."""
    minimum, maximum = (differs(arguments, arg.name) for arg in SUN_LIMITS)
    return minimum, maximum, "wgs84" if arguments[VERTICAL] == "wgs84" else "radius"


def _sine(args: Values, limit: Arg) -> Tensor:
    """Return the sine of a limit of the Sun's elevation; beyond all sines for an instrument that has none."""
    elevation = args[limit.name]
    return (
        torch.full((1,), -2.0 if limit is SUN_LIMITS[0] else 2.0, dtype=torch.float64) if elevation is None else elevation.sin()
    )


@functools.cache
def lit_target(minimum: bool, maximum: bool, vertical: Vertical) -> Component:
    """Return the component of targets with a minimum, a maximum, both or no limit of the Sun's elevation, and a vertical."""
    if not (minimum or maximum):
        plain = vertical == "radius"
        return IMAGE_TARGET if plain else dataclasses.replace(IMAGE_TARGET, update=aim_at_place(False, False, vertical))
    pairs = zip(SUN_PARAMETERS, SUN_LIMITS, (minimum, maximum), strict=True)
    limits = {parameter: arg for parameter, arg, has in pairs if has}

    def prepare(args: Values) -> dict[str, Tensor]:
        return _limits(args) | {parameter: _sine(args, arg) for parameter, arg in limits.items()}

    def check(args: Values) -> None:
        _check_elevation(args)
        bounds = [args[arg.name] for arg in SUN_LIMITS]
        if all(value is not None for value in bounds):
            low, high = torch.broadcast_tensors(*bounds)
            if bool((low >= high).any()):
                k = int((low >= high).nonzero()[0])
                raise ValueError(
                    f"imageTargetMinimumSunElevation={low[k].item():g} rad must be below "
                    f"imageTargetMaximumSunElevation={high[k].item():g} rad"
                )

    return dataclasses.replace(
        IMAGE_TARGET,
        update=aim_at_place(minimum, maximum, vertical),
        params=(*IMAGE_TARGET.params, *(Field(name, 1, "-", exact=True) for name in limits)),
        prepare=prepare,
        check=check,
    )


IMAGE_TARGET = Component(
    slot="location_target",
    update=aim_at_place(False, False),
    args=(
        Arg("imageTargetMinimumElevation", math.radians(45.0), "rad", "least elevation of the satellite above the target"),
        MAXIMUM_RANGE,
        Arg("groundLocationPlanetRadius", R_EARTH, "m", "radius of the sphere with the initial target", low=1e-9, high=1e9),
        *SUN_LIMITS,
        Arg(VERTICAL, "radius", "-", "vertical of elevations; the scenario sets it", "constant", choices=("radius", "wgs84")),
    ),
    state=(vec("r_LP_P", "m", "place that the agent has chosen, Earth-fixed", exact=True),),
    params=(Field("target_range", 1, "m", exact=True), Field("target_sin2_elevation", 1, "-", exact=True)),
    initial=first_place,
    prepare=_limits,
    check=_check_elevation,
    fit=fitted_target,
)

EARTH_CENTRE_TARGET = Component(
    slot="location_target",
    after="ground_stations",
    update=aim_at_earth_centre,
    args=(MAXIMUM_RANGE,),
    params=(Field("target_range", 1, "m", exact=True),),
    prepare=lambda args: {"target_range": args["imageTargetMaximumRange"]},
)
