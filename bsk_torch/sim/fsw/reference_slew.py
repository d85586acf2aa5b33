"""Reference slew: guidance that turns the instrument to a place along a planned motion, which the control law feeds forward.

The target frame T of a place has its first axis u along the line of sight and its second axis in the plane of u and the orbit
normal. B is wanted at rest in T, with the instrument's axis p along u: the tracking frame R_0. At the start of a slew, R_0 is the
frame to which the body comes the shortest way, so that the slew does not roll about p.

The reference R is turned from R_0 by the rotation vector theta, ``[R R_0] = exp(-[theta x])``. At the start it has the attitude
and the rate of the body, whatever these are, such as those of tracking another place. Along the start's rotation vector and
across it, theta accelerates, coasts and brakes, with shares ``a cos(b)`` and ``a sin(b)`` of the acceleration such that both end
at the same time, as early as possible: from there on R is R_0, and moves with the place. So the slew starts from and ends in
motion, and never waits at rest.

Sources: rotation vectors and their rates as in Shuster, "A survey of attitude representations", Journal of the Astronautical
Sciences 41(4), 1993, sections on the rotation vector; time-optimal motion of a double integrator with bounded rate as in Bryson
and Ho, "Applied Optimal Control", 1975, section 3.9.
"""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.attitude import dcm_to_mrp
from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE
from bsk_torch.astro.frames import rotate_z
from bsk_torch.constants import MU_EARTH
from bsk_torch.sim.component import Arg, Bus, Component, Field, Values, vec
from bsk_torch.sim.dyn.axes import check_axis, unit_rows
from bsk_torch.sim.dyn.hub import body_inertia
from bsk_torch.sim.dyn.navigation import navigated
from bsk_torch.sim.fsw.allocation import wheel_map
from bsk_torch.sim.fsw.guidance import LOCATION_POINTING, Error
from bsk_torch.sim.fsw.models import SteeringImagerFSWModel
from bsk_torch.sim.fsw.stability import LOOP, has_wheels
from bsk_torch.sim.readout.observables import Now, observable
from bsk_torch.vec3 import Mat3, Vec3, only

TINY = 1e-30  # keeps quotients finite whose numerator is zero, too
HALVINGS = 12  # bisections of the share b, to 4e-4 rad


class Sight(NamedTuple):
    """Target frame T of a place: its axes in N, and its rate omega_TN, rad/s in N."""

    axes: Mat3
    rate: Vec3


class Motion(NamedTuple):
    """Positions, m, velocities, m/s, and accelerations, m/s^2, of a satellite relative to a place, in N, and the orbit normal."""

    r: Vec3
    v: Vec3
    a: Vec3
    normal: Vec3


def relative_motion(bus: Bus) -> Motion:
    """Return the motion of the satellite relative to the place r_LP_P at this tick; the Earth is a point mass for a moment."""
    r, v, _, _ = navigated(bus)
    r_L = bus.EN.mT @ rotate_z(bus.r_LP_P, bus.cos_earth, -bus.sin_earth)
    spin = bus.EN.z * EARTH_ROTATION_RATE
    v_L = spin.cross(r_L)
    radius = r.norm()
    return Motion(r - r_L, v - v_L, r * (-MU_EARTH / (radius * radius * radius)) - spin.cross(v_L), r.cross(v).unit())


def coasted(bus: Bus, motion: Motion, dt: Tensor) -> Motion:
    """Return the motion ``dt`` s later on a circular orbit, which is good enough for limits of rates.

    With the mean motion n, ``r cos(n dt) + v / n sin(n dt)``; the place turns with the Earth.
    """
    r, v, _, _ = navigated(bus)
    n = torch.sqrt(v.dot(v) / r.dot(r))
    cos, sin = torch.cos(n * dt), torch.sin(n * dt)
    r_L, v_L = r - motion.r, v - motion.v
    turn = EARTH_ROTATION_RATE * dt
    r_L, v_L = (x + bus.EN.z.cross(x) * torch.sin(turn) for x in (r_L, v_L))
    r, v = r * cos + v * (sin / n), v * cos - r * (n * sin)
    return Motion(r - r_L, v - v_L, motion.a, motion.normal)


def sight(motion: Motion, dt: float) -> Sight:
    """Return the target frame ``dt`` s after the tick, by ``r + v dt + a dt^2 / 2``.

    With ``d`` from the satellite to the place, the orbit normal n and ``m = n - (n . u) u``::

        u = d / |d|,  u' = (d' - u (u . d')) / |d|,  y = m / |m|,  z = u x y
        omega = u x u' - u (n . u) (z . u') / |m|
    """
    d = -(motion.r + motion.v * dt + motion.a * (0.5 * dt * dt))
    rate = -(motion.v + motion.a * dt)
    distance = d.norm()
    u = d / distance
    du = (rate - u * u.dot(rate)) / distance
    aside = motion.normal.dot(u)
    m = motion.normal - u * aside
    width = m.norm()
    y = m / width
    z = u.cross(y)
    return Sight(Mat3(u, y, z), u.cross(du) - u * (aside * z.dot(du) / width))


class Leg(NamedTuple):
    """Motion along an axis to rest at zero: sign, first speed, top speed, times of acceleration, coasting and braking."""

    start: Tensor
    sign: Tensor
    speed: Tensor
    top: Tensor
    times: tuple[Tensor, Tensor, Tensor]
    acceleration: Tensor

    @property
    def duration(self) -> Tensor:
        """Time until rest, s."""
        return self.times[0] + self.times[1] + self.times[2]

    def at(self, time: Tensor) -> tuple[Tensor, Tensor]:
        """Return place and rate at a time, s; before zero the first rate holds."""
        before = torch.clamp(time, max=0.0)
        gains = torch.minimum(torch.clamp(time, min=0.0), self.times[0])
        coasts = torch.minimum(torch.clamp(time - self.times[0], min=0.0), self.times[1])
        brakes = torch.minimum(torch.clamp(time - self.times[0] - self.times[1], min=0.0), self.times[2])
        way = self.speed * (gains + before) + self.top * (coasts + brakes)
        way = way + 0.5 * self.acceleration * (gains * gains - brakes * brakes)
        rate = self.speed + self.acceleration * (gains - brakes)
        return self.start - self.sign * way, -self.sign * rate


def leg(start: Tensor, rate: Tensor, acceleration: Tensor, limit: Tensor) -> Leg:
    """Return the fastest motion from ``start``, rad, and ``rate``, rad/s, to rest at zero, for bounded acceleration and rate.

    Toward zero, or first away from where it would come to rest too late, with the way Y and the speed U in that direction::

        top = min(sqrt(a Y + U^2 / 2), max(limit, |U|)),  times (top - U) / a, (Y - (top^2 - U^2 / 2) / a) / top, top / a
    """
    speed = -rate
    one = torch.ones_like(start)
    sign = torch.where(start - speed * speed.abs() / (2.0 * acceleration) < 0.0, -one, one)
    way, speed = sign * start, sign * speed
    square = torch.clamp(acceleration * way + 0.5 * speed * speed, min=0.0)
    top = torch.maximum(torch.minimum(torch.sqrt(square), torch.maximum(limit, speed.abs())), speed)
    coast = torch.clamp(way - (top * top - 0.5 * speed * speed) / acceleration, min=0.0) / torch.clamp(top, min=TINY)
    return Leg(start, sign, speed, top, ((top - speed) / acceleration, coast, top / acceleration), acceleration)


class Plan(NamedTuple):
    """A slew: unit vectors along and across the first rotation vector, in B, and the motion along both."""

    along: Vec3
    across: Vec3
    legs: tuple[Leg, Leg]

    @property
    def duration(self) -> Tensor:
        """Time until the reference is the tracking frame, s."""
        return torch.maximum(self.legs[0].duration, self.legs[1].duration)

    def at(self, time: Tensor) -> tuple[Vec3, Vec3]:
        """Return the rotation vector theta, rad, and its rate, rad/s, at a time, s."""
        (x, dx), (y, dy) = (part.at(time) for part in self.legs)
        return self.along * x + self.across * y, self.along * dx + self.across * dy


def plan(theta: Vec3, rate: Vec3, share: Tensor, acceleration: Tensor, limit: Tensor) -> Plan:
    """Return the slew from theta, rad, and its rate, rad/s, with the share b, rad, of the acceleration, rad/s^2."""
    angle = theta.norm()
    along = theta / torch.clamp(angle, min=TINY)
    first = along.dot(rate)
    aside = rate - along * first
    second = aside.norm()
    across = aside / torch.clamp(second, min=TINY)
    legs = (
        leg(angle, first, acceleration * torch.cos(share), limit),
        leg(torch.zeros_like(angle), second, acceleration * torch.sin(share), limit),
    )
    return Plan(along, across, legs)


def fitting_share(theta: Vec3, rate: Vec3, acceleration: Tensor, limit: Tensor) -> Tensor:
    """Return the share b, rad, with which both parts of a slew take equally long, but for the bisection the one across less."""
    low, high = torch.zeros_like(acceleration), torch.full_like(acceleration, 0.5 * math.pi)
    for _ in range(HALVINGS):
        share = 0.5 * (low + high)
        along, across = plan(theta, rate, share, acceleration, limit).legs
        more = across.duration > along.duration
        low, high = torch.where(more, share, low), torch.where(more, high, share)
    return high


def _terms(theta: Vec3) -> tuple[Tensor, Tensor, Tensor]:
    """Return ``sin(x) / x``, ``(1 - cos(x)) / x^2`` and ``(x - sin(x)) / x^3`` of the length x of theta; series below 0.01."""
    x2 = theta.dot(theta)
    small = x2 < 1e-4
    x = torch.sqrt(torch.where(small, torch.ones_like(x2), x2))
    sine, half = torch.sin(x), torch.sin(0.5 * x)
    exact = sine / x, 2.0 * half * half / (x * x), (x - sine) / (x * x * x)
    series = 1.0 - x2 / 6.0 * (1.0 - x2 / 20.0), 0.5 - x2 / 24.0 * (1.0 - x2 / 30.0), (1.0 - x2 / 20.0 * (1.0 - x2 / 42.0)) / 6.0
    first, second, third = (torch.where(small, near, far) for near, far in zip(series, exact, strict=True))
    return first, second, third


def turned_back(theta: Vec3, v: Vec3) -> Vec3:
    """Return ``exp(-[theta x]) v``: components in R of a vector with components v in R_0."""
    s, c, _ = _terms(theta)
    once = theta.cross(v)
    return v - once * s + theta.cross(once) * c


def vector_rate(theta: Vec3, omega: Vec3) -> Vec3:
    """Return the rate of the rotation vector for the angular rate of R relative to R_0, rad/s in R.

    ``theta' = omega + theta x omega / 2 + (1 - (x / 2) cot(x / 2)) / x^2 theta x (theta x omega)`` with ``x = |theta|``.
    """
    x2 = theta.dot(theta)
    small = x2 < 1e-4
    half = 0.5 * torch.sqrt(torch.where(small, torch.ones_like(x2), x2))
    exact = (1.0 - half * torch.cos(half) / torch.sin(half)) / (4.0 * half * half)
    factor = torch.where(small, (1.0 + x2 / 60.0) / 12.0, exact)
    once = theta.cross(omega)
    return omega + once * 0.5 + theta.cross(once) * factor


def angular_rate(theta: Vec3, rate: Vec3) -> Vec3:
    """Return the angular rate of R relative to R_0, rad/s in R: ``theta' - (1 - cos x) / x^2 theta x theta' + ...``."""
    _, c, d = _terms(theta)
    once = theta.cross(rate)
    return rate - once * c + theta.cross(once) * d


def shortest(axis_B: Vec3, u_B: Vec3) -> Vec3:
    """Return the rotation vector from the tracking frame to B, whose axis p should point along u: ``phi (u x p) / |u x p|``.

    As :func:`bsk_torch.sim.fsw.guidance.point_at`, with ``phi = 4 atan(|u x p| / (c + sqrt(c^2 + |u x p|^2)))``,
    ``c = 1 + u . p``.
    """
    turn, half = u_B.cross(axis_B), 1.0 + u_B.dot(axis_B)
    sine = turn.norm()
    quarter = sine / torch.clamp(half + torch.sqrt(half * half + sine * sine), min=TINY)
    return turn * (4.0 * torch.atan(quarter) / torch.clamp(sine, min=TINY))


def tracking_axes(axis_B: Vec3, side_B: Vec3, at: Mat3) -> Mat3:
    """Return [R_0 N]: the axes of T in N are p, the side and ``p x side`` in B."""
    return Mat3.outer(axis_B, at.x) + Mat3.outer(side_B, at.y) + Mat3.outer(axis_B.cross(side_B), at.z)


class Start(NamedTuple):
    """What a slew remembers of its start."""

    theta: Vec3
    rate: Vec3
    side_B: Vec3
    share: Tensor
    limit: Tensor

    def plan(self, acceleration: Tensor) -> Plan:
        """Return the slew."""
        return plan(self.theta, self.rate, self.share, acceleration, self.limit)


def start_of(bus: Bus, motion: Motion) -> Start:
    """Return the start of a slew from the motion of the body; it begins a tick later, when the first command acts.

    The rate relative to the tracking frame is limited so that the rate relative to N is at most ``slewRate``: by
    ``w_a + sqrt(slewRate^2 - w_c^2)`` with the parts w_a and w_c of the frame's rate along and across the first rotation vector,
    at the start and at the end, but at least by a tenth of ``slewRate``.
    """
    known, axis_B, at = navigated(bus), bus.instrument_axis_B, sight(motion, 0.0)
    u_B = bus.BN @ at.axes.x.to(bus.dtype)
    theta = shortest(axis_B, u_B)
    rate = vector_rate(theta, known.omega_BN_B - bus.BN @ at.rate.to(bus.dtype))
    side_B = turned_back(-theta, bus.BN @ at.axes.y.to(bus.dtype))
    theta = theta + rate * bus.h
    along = theta / torch.clamp(theta.norm(), min=TINY)

    def allowed(at: Sight) -> Tensor:
        turning = tracking_axes(axis_B, side_B, at.axes.to(bus.dtype)) @ at.rate.to(bus.dtype)
        helping = along.dot(turning)
        rest = bus.slew_rate * bus.slew_rate - turning.dot(turning) + helping * helping
        return torch.maximum(helping + torch.sqrt(torch.clamp(rest, min=0.0)), 0.1 * bus.slew_rate)

    def limited(limit: Tensor) -> Start:
        return Start(theta, rate, side_B, fitting_share(theta, rate, bus.slew_acceleration, limit), limit)

    now = allowed(at)
    duration = limited(now).plan(bus.slew_acceleration).duration
    end = allowed(sight(coasted(bus, motion, duration.double()), 0.0))
    return limited(torch.minimum(now, end))


def follow_slew(bus: Bus) -> None:
    """Write the error relative to the reference of a slew, and ``look_error``, the error relative to the tracking frame.

    The command of a tick acts in the one after the next, so that the acceleration that is fed forward is the mean one there::

        omega_RN' = (omega_RN(t + 2 h) - omega_RN(t + h)) / h
    """
    on, fresh = bus.location_on > 0.0, bus.location_fresh > 0.0
    memory = Start(bus.slew_theta, bus.slew_theta_rate, bus.slew_side_B, bus.slew_share, bus.slew_limit)
    zero = Vec3.zeros_like(bus.sigma_BN.x)
    nothing = Error(zero, zero, zero, zero)

    def law() -> tuple[Start, Tensor, Tensor, Error, Error]:
        known, motion, axis_B = navigated(bus), relative_motion(bus), bus.instrument_axis_B
        now = sight(motion, 0.0)
        start: Start = Start(*only(on & fresh, lambda: start_of(bus, motion), memory))
        clock = torch.where(fresh, torch.zeros_like(bus.slew_clock), bus.slew_clock + bus.h)
        slew = start.plan(bus.slew_acceleration)

        def reference(dt: float, at: Sight) -> tuple[Mat3, Vec3]:
            """Return [RN], and omega_RN in N."""
            theta, rate = slew.at(clock + (dt - bus.h))
            axes, side_B = at.axes.to(bus.dtype), start.side_B
            parts = [turned_back(theta, v) for v in (axis_B, side_B, axis_B.cross(side_B))]
            RN = Mat3.outer(parts[0], axes.x) + Mat3.outer(parts[1], axes.y) + Mat3.outer(parts[2], axes.z)
            return RN, at.rate.to(bus.dtype) + RN.mT @ angular_rate(theta, rate)

        RN, omega_N = reference(0.0, now)
        acceleration_N = zero
        if bus.h_ns:
            (_, soon), (_, later) = (reference(k * bus.h, sight(motion, k * bus.h)) for k in (1, 2))
            acceleration_N = (later - soon) / bus.h
        omega_RN_B = bus.BN @ omega_N
        error = Error(_relative(bus.BN, RN), known.omega_BN_B - omega_RN_B, omega_RN_B, bus.BN @ acceleration_N)
        turning = bus.BN @ now.rate.to(bus.dtype)
        tracking = tracking_axes(axis_B, start.side_B, now.axes.to(bus.dtype))
        look = Error(_relative(bus.BN, tracking), known.omega_BN_B - turning, turning, zero)
        left = torch.clamp(slew.duration + bus.h - clock, min=0.0)
        return start, clock, left, error, look

    before = memory, bus.slew_clock, torch.zeros_like(bus.slew_left), bus.error, nothing
    start, bus.slew_clock, bus.slew_left, bus.error, bus.look_error = only(on, law, before)
    bus.slew_theta, bus.slew_theta_rate, bus.slew_side_B, bus.slew_share, bus.slew_limit = start
    bus.location_sigma_BR = bus.look_error.sigma_BR
    bus.location_fresh = torch.where(on, torch.zeros_like(bus.location_fresh), bus.location_fresh)


def _relative(BN: Mat3, RN: Mat3) -> Vec3:
    """Return sigma_BR of ``[BR] = [BN] [RN]^T``."""
    return dcm_to_mrp(Mat3(*(Vec3(row.dot(RN.x), row.dot(RN.y), row.dot(RN.z)) for row in BN)))


MARGIN = 1.1
"""Least share by which the torque of the wheels must exceed that of the slew: the rest turns with the line of sight."""


def check_slew(args: Values) -> None:
    """Raise ValueError for an acceleration for which the wheels are too weak in some direction."""
    check_axis("inst_pHat_B")(args)
    if not has_wheels(args):
        return
    u_max = args["u_max"].reshape(len(args["u_max"]), -1)
    each = torch.where(u_max > 0.0, u_max, torch.inf)
    torque = (each / wheel_map(args).norm(dim=-1) if args.get("rwAxes_B") is not None else each).amin(-1)
    J, wanted = body_inertia(args).amax(-1), args["slewAcceleration"]
    most, wanted, J = torch.broadcast_tensors(torque / (MARGIN * J), wanted, J)
    if bool((wanted > most).any()):
        k = int((wanted > most).nonzero()[0])
        raise ValueError(
            f"slewAcceleration={wanted[k].item():g} rad/s^2 is too fast: the wheels turn a body of {J[k].item():.3g} kg m^2 by "
            f"{most[k].item():.3g} rad/s^2; craft.from_slew_limits() returns wheels for an acceleration"
        )


REFERENCE_SLEW = dataclasses.replace(
    LOCATION_POINTING,
    update=follow_slew,
    args=(
        *LOCATION_POINTING.args,
        Arg("slewRate", 0.01, "rad/s", "largest rate of a slew", low=1e-6, high=10.0),
        Arg("slewAcceleration", 0.001, "rad/s^2", "its largest acceleration", low=1e-8, high=10.0),
    ),
    reads=LOOP,
    state=(
        *LOCATION_POINTING.state,
        vec("slew_theta", "rad", "rotation vector of the reference at the start of the slew"),
        vec("slew_theta_rate", "rad/s", "its rate"),
        vec("slew_side_B", "-", "second axis of the target frame in the tracking frame"),
        Field("slew_share", 1, "rad", "share of the acceleration across the rotation vector"),
        Field("slew_limit", 1, "rad/s", "largest rate relative to the tracking frame"),
        Field("slew_clock", 1, "s", "time since the start of the slew"),
        Field("slew_left", 1, "s", "time until the reference is the tracking frame"),
    ),
    params=(*LOCATION_POINTING.params, Field("slew_rate", 1, "rad/s"), Field("slew_acceleration", 1, "rad/s^2")),
    prepare=lambda args: {
        "instrument_axis_B": unit_rows(args["inst_pHat_B"]),
        "slew_rate": args["slewRate"],
        "slew_acceleration": args["slewAcceleration"],
    },
    check=check_slew,
)


class ReferenceSlewFSWModel(SteeringImagerFSWModel):
    """Imaging of places with reference slews: a planned motion from the present one to tracking, fed forward to the control law.

    The mode ``"image"`` slews within ``slewRate`` and ``slewAcceleration``; :func:`bsk_torch.craft.from_slew_limits` returns
    wheels and gains for them. Before its end, an image is taken only if the instrument points within its tolerances.
    """

    components: ClassVar[tuple[Component, ...]] = (REFERENCE_SLEW,)

    @observable
    def slew_time_left(now: Now) -> Tensor:
        """Time until the reference tracks the target, [N] s; zero while it does, and in other modes."""
        return now.slew_left
