"""The rigid hub with its wheels: initial state, equations of motion, and the Runge-Kutta step over one tick."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_rate, mrp_switch, mrp_to_dcm
from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE
from bsk_torch.astro.frames import rotate_z
from bsk_torch.astro.gravity import third_body
from bsk_torch.astro.integrate import State, rk4_step
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.constants import MU_EARTH, RPM
from bsk_torch.rand import Uniform, random_orbit
from bsk_torch.sim.component import Arg, Bus, Component, Field, Values, vec
from bsk_torch.sim.dyn.drag import drag
from bsk_torch.sim.dyn.field import called_field, full_field
from bsk_torch.sim.dyn.thrusters import pulse_torque
from bsk_torch.sim.dyn.wheels import SPIN_INERTIA
from bsk_torch.vec3 import Vec3

BODY = ("mass", "width", "depth", "height")
"""Arguments that the inertia follows from."""

STABLE_TURN = 2.0 * math.sqrt(2.0)
"""Angle, rad, that a Runge-Kutta step of order four resolves."""


def box_inertia(mass: Tensor, width: Tensor, depth: Tensor, height: Tensor) -> Tensor:
    """Return the principal inertia [n, 3], kg m^2, about the centre of a uniform box of the given mass, kg, and sides, m.

    ``I = m / 12 (w^2 + d^2, d^2 + h^2, w^2 + h^2)``, with width w, depth d and height h, in the order in which bsk_rl sets it.
    """
    sides = width**2 + depth**2, depth**2 + height**2, width**2 + height**2
    return torch.stack(torch.broadcast_tensors(*(mass / 12.0 * side for side in sides)), -1)


def initial_orbit(args: Values) -> tuple[Tensor, Tensor]:
    """Return initial position, m, and velocity, m/s, in N, [n or 1, 3] each, from ``oe`` or from ``rN`` and ``vN``."""
    if args["oe"] is None:
        return args["rN"], args["vN"]
    r, v = elements_to_rv(Elements(*args["oe"].unbind(-1)), args["mu"])
    return r.stack(), v.stack()


def _check(args: Values) -> None:
    if "wheelSpeeds" in args:
        _check_inertia(args)
    given = [name for name in ("oe", "rN", "vN") if args[name] is not None]
    if given not in (["oe"], ["rN", "vN"]):
        raise KeyError(f"give the orbit as 'oe', or as both 'rN' and 'vN' with oe=None; given are {given or 'none'}")
    if args["oe"] is not None:
        _check_elements(args["oe"])


def _inertia(args: Values) -> Tensor:
    return box_inertia(*(args[name] for name in BODY))


def _in_words(args: Values, row: int) -> str:
    return ", ".join(f"{name}={args[name][min(row, len(args[name]) - 1)].item():g}" for name in BODY)


def _check_inertia(args: Values) -> None:
    """Check that the body is heavier than its wheels: the inertia of the box is that of hub and wheels together."""
    smallest = _inertia(args).min(-1).values
    if bool((smallest <= SPIN_INERTIA).any()):
        row = int(smallest.argmin())
        raise ValueError(
            f"{_in_words(args, row)}: a body whose smallest moment of inertia is {smallest[row].item():.3g} kg m^2 cannot hold "
            f"reaction wheels of {SPIN_INERTIA:.3g} kg m^2 each (Honeywell HR16, as in Basilisk): no gains K and P are stable. "
            "Give a larger body, or models without wheels, dyn.DynamicsModel and fsw.FSWModel"
        )


def _check_spin(args: Values, h: float) -> None:
    """Check that ticks of h s resolve the initial rates of body and wheels.

    The body turns about its momentum H at up to ``|H| / J``. The Runge-Kutta method of order four is stable up to ``2 sqrt(2)``
    rad in a step (Hairer and Wanner, "Solving ordinary differential equations II", section IV.2), and numbers overflow beyond.
    """
    inertia = _inertia(args)
    H, J, names = inertia * args["omega_init"], inertia, "omega_init turns"
    if "wheelSpeeds" in args:
        H = H + args["wheelSpeeds"] * (RPM * SPIN_INERTIA)
        J, names = J - SPIN_INERTIA, "wheelSpeeds and omega_init turn"
    turn = h * H.norm(dim=-1) / J.min(-1).values
    row = int(turn.argmax())
    if bool(turn[row] > STABLE_TURN):
        raise ValueError(
            f"{names} a body with {_in_words(args, row)} by {turn[row].item():.3g} rad in a tick of sim_rate={h:g} s; ticks "
            f"resolve {STABLE_TURN:.3g} rad. Give smaller initial rates, a larger body, or a sim_rate of at most "
            f"{h * STABLE_TURN / turn[row].item():.2g} s"
        )


def _check_elements(oe: Tensor) -> None:
    bad = (oe[:, 1] < 0.0) | (oe[:, 1] >= 1.0) | (oe[:, 0] <= 0.0) | ~torch.isfinite(oe).all(-1)
    if bool(bad.any()):
        a, e = oe[bad][0, :2].tolist()
        raise ValueError(f"oe has a={a:g} m and e={e:g}; an orbit around the Earth needs a > 0 and 0 <= e < 1")


def _initial(args: Values) -> dict[str, Tensor]:
    r, v = initial_orbit(args)
    sigma = mrp_switch(Vec3.of(args["sigma_init"]))  # Basilisk's tick at t = 0 already switches
    return {"r_BN_N": r, "v_BN_N": v, "sigma_BN": sigma.stack(), "omega_BN_B": args["omega_init"]}


def _prepare(args: Values) -> dict[str, Tensor]:
    return {"inertia_B": box_inertia(args["mass"], args["width"], args["depth"], args["height"]), "mass": args["mass"]}


def _attitude_rates(bus: Bus, L_B: Vec3, sigma_BN: Vec3, omega_BN_B: Vec3, wheels: tuple[Vec3, ...]) -> State:
    """Return the rates of the MRP sigma_BN, 1/s, the body rate omega_BN, rad/s^2 in B, and, with wheels, their speeds, rad/s^2.

    For three balanced wheels on the body axes, with the inertia Js about their own::

        sigma' = 1/4 B(sigma) omega
        (I - Js) omega' = L - omega x (I omega) - u - Js omega x Omega
        Omega' = u / Js - omega'

    where L is the external torque, N m, u the motor torque on the wheels, N m, and Omega their speed relative to the hub (Schaub
    and Junkins, section 4.5). Without wheels ``I omega' = L - omega x (I omega)``.
    """
    total = L_B - omega_BN_B.cross(bus.inertia_B.scale(omega_BN_B))
    if not wheels:
        return mrp_rate(sigma_BN, omega_BN_B), total.map(torch.div, bus.inertia_B)
    total = total - bus.motor_torque_B - omega_BN_B.cross(wheels[0]) * SPIN_INERTIA
    omega_dot = total.map(lambda x, i: x * (1.0 / (i - SPIN_INERTIA)), bus.inertia_B)
    return mrp_rate(sigma_BN, omega_BN_B), omega_dot, bus.motor_torque_B * (1.0 / SPIN_INERTIA) - omega_dot


def _torque(bus: Bus, stage: int) -> Vec3:
    """Return the external torque, N m in B, that does not depend on the orbit: the constant disturbance and the thrusters.

    Thrusters act in the first stage only, as Basilisk's do; see :mod:`bsk_torch.sim.dyn.thrusters`.
    """
    torque = bus.disturbance_torque_B if bus.has("disturbance_torque_B") else Vec3.zeros_like(bus.sigma_BN.x)
    return torque + pulse_torque(bus.pulse) if stage == 0 and bus.has("pulse") else torque


def _wheel_speeds(bus: Bus) -> tuple[Vec3, ...]:
    return (bus.Omega_WB_B,) if bus.has("Omega_WB_B") else ()


def _finish(bus: Bus, sigma: Vec3, omega: Vec3, wheels: tuple[Vec3, ...]) -> None:
    bus.sigma_BN, bus.omega_BN_B = mrp_switch(sigma), omega
    if wheels:
        (bus.Omega_WB_B,) = wheels


def rotate(bus: Bus) -> None:
    """Advance attitude and wheels by one tick, a Runge-Kutta step; the orbit is solved in advance.

    The MRP is switched to its shadow set after the whole step only, never between its stages, as in Basilisk.
    """

    def rates(stage: int, offset: float, y: State) -> State:
        return _attitude_rates(bus, _torque(bus, stage), y[0], y[1], y[2:])

    sigma, omega, *wheels = rk4_step(rates, (bus.sigma_BN, bus.omega_BN_B, *_wheel_speeds(bus)), bus.h)
    _finish(bus, sigma, omega, tuple(wheels))


def gravity(bus: Bus, r: Vec3, offset: float) -> Vec3:
    """Return the acceleration, m/s^2 in N, at r_BN_N, m, ``offset`` seconds after the start of the tick.

    ``a = C^T f(C r) + a_S(r, r_S + v_S dt)`` with the field f in Earth-fixed axes, the Sun as a third body and
    ``dt = offset - h <= 0``. Basilisk takes the Earth's orientation ``R3(W) [EN]`` of the end of the tick and extrapolates it
    linearly, without making it orthonormal: ``C = (I + dt w R3'(0)) R3(W) [EN]``, where w is the Earth's rotation rate. Turned
    by dt, x and y become ``x + w dt y`` and ``y - w dt x``.
    """
    dt = offset - bus.h
    turn = EARTH_ROTATION_RATE * dt
    p = rotate_z(bus.EN @ r, bus.cos_earth, bus.sin_earth)
    earth_field = called_field if bus.opaque_field else full_field
    f = earth_field(Vec3(p.x + turn * p.y, p.y - turn * p.x, p.z))
    f = Vec3(f.x - turn * f.y, f.y + turn * f.x, f.z)
    return bus.EN.mT @ rotate_z(f, bus.cos_earth, -bus.sin_earth) + third_body(r, bus.r_SN_N + bus.v_SN_N * dt)


def translate_and_rotate(bus: Bus) -> None:
    """Advance orbit, attitude and wheels together by one tick, a Runge-Kutta step, as Basilisk does.

    ``r' = v`` and ``v' = a(r, t) + F_N / m + [BN]^T F_B / m`` with the drag force F_B, N in B, and the message
    ``external_force_N``, F_N, N in N, that components may have written; it is constant over the tick. The rest as in
    :func:`rotate`, with the torque of the drag.
    """
    constant = bus.external_force_N / bus.mass if bus.has("external_force_N") else None
    bus.force_is_felt = constant is not None

    def rates(stage: int, offset: float, y: State) -> State:
        r, v, sigma, omega, *wheels = y
        acceleration, torque = gravity(bus, r, offset), _torque(bus, stage)
        if constant is not None:
            acceleration = acceleration + constant
        if bus.has("density"):
            BN = mrp_to_dcm(sigma)
            force, drag_torque = drag(bus, BN @ v)
            acceleration, torque = acceleration + BN.mT @ force / bus.mass, torque + drag_torque.to(bus.dtype)
        return (v, acceleration, *_attitude_rates(bus, torque, sigma, omega, tuple(wheels)))

    start = (bus.r_BN_N, bus.v_BN_N, bus.sigma_BN, bus.omega_BN_B, *_wheel_speeds(bus))
    bus.r_BN_N, bus.v_BN_N, sigma, omega, *wheels = rk4_step(rates, start, bus.h)
    _finish(bus, sigma, omega, tuple(wheels))


HUB = Component(
    slot="hub",
    args=(
        Arg("mass", 330.0, "kg", "hub mass", low=1e-6, high=1e9),
        Arg("width", 1.38, "m", "side of the hub", low=1e-6, high=1e4),
        Arg("depth", 1.04, "m", "side of the hub", low=1e-6, high=1e4),
        Arg("height", 1.58, "m", "side of the hub", low=1e-6, high=1e4),
        Arg("sigma_init", Uniform(0.0, 1.0, 3), "-", "initial attitude, MRP of B relative to N", "vector", -1e6, 1e6),
        Arg("omega_init", Uniform(-1e-4, 1e-4, 3), "rad/s", "initial body rate in B", "vector", -1e3, 1e3),
        Arg("oe", random_orbit(), "m, -, rad", "initial orbit as elements a, e, i, Omega, omega, f", kind="orbit"),
        Arg("rN", None, "m", "initial position, instead of oe", "vector", -1e9, 1e9),
        Arg("vN", None, "m/s", "initial velocity, instead of oe", "vector", -1e6, 1e6),
        Arg("mu", MU_EARTH, "m^3/s^2", "gravitational parameter that converts oe", low=1.0, high=1e20),
        Arg("min_orbital_radius", 6578136.6, "m", "a spacecraft at or below this radius dies", low=0.0),
    ),
    state=(
        vec("r_BN_N", "m", "position", exact=True),
        vec("v_BN_N", "m/s", "velocity", exact=True),
        vec("sigma_BN", "-", "attitude, MRP"),
        vec("omega_BN_B", "rad/s", "body rate"),
    ),
    params=(vec("inertia_B", "kg m^2", "principal inertia of hub and wheels, about the body axes"), Field("mass", 1, "kg")),
    initial=_initial,
    prepare=_prepare,
    check=_check,
    check_tick=_check_spin,
)
