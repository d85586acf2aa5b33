"""The rigid hub with its wheels: initial state, equations of motion, and the Runge-Kutta step over one tick."""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_rate, mrp_switch, mrp_to_dcm
from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE
from bsk_torch.astro.frames import rotate_z
from bsk_torch.astro.gravity import third_body
from bsk_torch.astro.integrate import State, rk4_step
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.constants import MU_EARTH
from bsk_torch.rand import Uniform, random_orbit
from bsk_torch.sim.component import Arg, Bus, Component, Field, Values, vec
from bsk_torch.sim.dyn.drag import drag
from bsk_torch.sim.dyn.field import called_field, full_field
from bsk_torch.sim.dyn.thrusters import pulse_torque
from bsk_torch.sim.dyn.wheels import SPIN_INERTIA
from bsk_torch.vec3 import Vec3


def box_inertia(mass: Tensor, width: Tensor, depth: Tensor, height: Tensor) -> Tensor:
    """Principal inertia [n, 3], kg m^2, of a uniform box of the given mass, kg, and sides, m."""
    sides = width**2 + depth**2, depth**2 + height**2, width**2 + height**2
    return torch.stack(torch.broadcast_tensors(*(mass / 12.0 * side for side in sides)), -1)


def initial_orbit(args: Values) -> tuple[Tensor, Tensor]:
    """Initial position, m, and velocity, m/s, [n or 1, 3] each, from ``oe`` or from ``rN`` and ``vN``."""
    if args["oe"] is None:
        return args["rN"], args["vN"]
    r, v = elements_to_rv(Elements(*args["oe"].unbind(-1)), args["mu"])
    return r.stack(), v.stack()


def _check(args: Values) -> None:
    given = [name for name in ("oe", "rN", "vN") if args[name] is not None]
    if given not in (["oe"], ["rN", "vN"]):
        raise KeyError(f"give the orbit as 'oe', or as both 'rN' and 'vN' with oe=None; given are {given or 'none'}")
    if args["oe"] is not None:
        _check_elements(args["oe"])


def _check_elements(oe: Tensor) -> None:
    bad = (oe[:, 1] < 0.0) | (oe[:, 1] >= 1.0) | (oe[:, 0] <= 0.0) | ~torch.isfinite(oe).all(-1)
    if bool(bad.any()):
        a, e = oe[bad][0, :2].tolist()
        raise ValueError(f"oe has a={a:g} m and e={e:g}; an orbit around the Earth needs a > 0 and 0 <= e < 1")


def _initial(args: Values) -> dict[str, Tensor]:
    r, v = initial_orbit(args)
    sigma = mrp_switch(Vec3.of(args["sigma_init"]))  # Basilisk's tick at t = 0 already switches
    return {"r": r, "v": v, "sigma": sigma.stack(), "omega": args["omega_init"]}


def _prepare(args: Values) -> dict[str, Tensor]:
    return {"inertia": box_inertia(args["mass"], args["width"], args["depth"], args["height"]), "mass": args["mass"]}


def _attitude_rates(bus: Bus, torque: Vec3, sigma: Vec3, omega: Vec3, wheels: tuple[Vec3, ...]) -> State:
    """Rates of the MRP, the body rate and, where there are wheels, their speeds.

    ``(I - Js) omega' = L - omega x (I omega) - u - Js omega x Omega`` and ``Omega' = u / Js - omega'`` for three balanced
    wheels on the body axes (Schaub and Junkins, section 4.5).
    """
    total = torque - omega.cross(bus.inertia.scale(omega))
    if not wheels:
        return mrp_rate(sigma, omega), total.map(torch.div, bus.inertia)
    total = total - bus.motor_torque - omega.cross(wheels[0]) * SPIN_INERTIA
    omega_dot = total.map(lambda x, i: x * (1.0 / (i - SPIN_INERTIA)), bus.inertia)
    return mrp_rate(sigma, omega), omega_dot, bus.motor_torque * (1.0 / SPIN_INERTIA) - omega_dot


def _torque(bus: Bus, stage: int) -> Vec3:
    """Torque, N m, that does not depend on the orbit; thrusters act in the first stage only, as Basilisk's do."""
    torque = bus.disturbance_torque if bus.has("disturbance_torque") else Vec3.zeros_like(bus.sigma.x)
    return torque + pulse_torque(bus.pulse) if stage == 0 and bus.has("pulse") else torque


def _wheel_speeds(bus: Bus) -> tuple[Vec3, ...]:
    return (bus.Omega,) if bus.has("Omega") else ()


def _finish(bus: Bus, sigma: Vec3, omega: Vec3, wheels: tuple[Vec3, ...]) -> None:
    bus.sigma, bus.omega = mrp_switch(sigma), omega
    if wheels:
        (bus.Omega,) = wheels


def rotate(bus: Bus) -> None:
    """Advance attitude and wheels by one tick; the orbit is known in advance."""

    def rates(stage: int, offset: float, y: State) -> State:
        return _attitude_rates(bus, _torque(bus, stage), y[0], y[1], y[2:])

    sigma, omega, *wheels = rk4_step(rates, (bus.sigma, bus.omega, *_wheel_speeds(bus)), bus.h)
    _finish(bus, sigma, omega, tuple(wheels))


def gravity(bus: Bus, r: Vec3, offset: float) -> Vec3:
    """Acceleration, m/s^2, ``offset`` seconds after the start of the tick.

    Basilisk evaluates the field with the Earth's orientation of the end of the tick, extrapolated linearly and not
    orthonormalised, and with the Sun extrapolated linearly too.
    """
    dt = offset - bus.h
    turn = EARTH_ROTATION_RATE * dt
    p = rotate_z(bus.pole @ r, bus.cos_earth, bus.sin_earth)
    earth_field = called_field if bus.opaque_field else full_field
    f = earth_field(Vec3(p.x + turn * p.y, p.y - turn * p.x, p.z))
    f = Vec3(f.x - turn * f.y, f.y + turn * f.x, f.z)
    return bus.pole.mT @ rotate_z(f, bus.cos_earth, -bus.sin_earth) + third_body(r, bus.r_sun + bus.v_sun * dt)


def translate_and_rotate(bus: Bus) -> None:
    """Advance orbit, attitude and wheels together by one tick, as Basilisk does."""

    def rates(stage: int, offset: float, y: State) -> State:
        r, v, sigma, omega, *wheels = y
        acceleration, torque = gravity(bus, r, offset), _torque(bus, stage)
        if bus.has("density"):
            BN = mrp_to_dcm(sigma)
            force, drag_torque = drag(bus, BN @ v)
            acceleration, torque = acceleration + BN.mT @ force / bus.mass, torque + drag_torque.to(bus.dtype)
        return (v, acceleration, *_attitude_rates(bus, torque, sigma, omega, tuple(wheels)))

    start = (bus.r, bus.v, bus.sigma, bus.omega, *_wheel_speeds(bus))
    bus.r, bus.v, sigma, omega, *wheels = rk4_step(rates, start, bus.h)
    _finish(bus, sigma, omega, tuple(wheels))


HUB = Component(
    slot="hub",
    order=200,
    args=(
        Arg("mass", 330.0, "kg", "hub mass", low=1e-6),
        Arg("width", 1.38, "m", "side of the hub", low=1e-6),
        Arg("depth", 1.04, "m", "side of the hub", low=1e-6),
        Arg("height", 1.58, "m", "side of the hub", low=1e-6),
        Arg("sigma_init", Uniform(0.0, 1.0, 3), "-", "initial attitude, MRP of B relative to N", kind="vector"),
        Arg("omega_init", Uniform(-1e-4, 1e-4, 3), "rad/s", "initial body rate in B", kind="vector"),
        Arg("oe", random_orbit(), "m, -, rad", "initial orbit as elements a, e, i, Omega, omega, f", kind="orbit"),
        Arg("rN", None, "m", "initial position, instead of oe", kind="vector"),
        Arg("vN", None, "m/s", "initial velocity, instead of oe", kind="vector"),
        Arg("mu", MU_EARTH, "m^3/s^2", "gravitational parameter that converts oe", low=1.0),
        Arg("min_orbital_radius", 6578136.6, "m", "a spacecraft at or below this radius dies", low=0.0),
    ),
    state=(vec("r", "m", exact=True), vec("v", "m/s", exact=True), vec("sigma", "-"), vec("omega", "rad/s")),
    params=(vec("inertia", "kg m^2"), Field("mass", 1, "kg")),
    initial=_initial,
    prepare=_prepare,
    check=_check,
)
