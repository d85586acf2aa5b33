"""The rigid hub: initial state, equations of motion, and the Runge-Kutta step over one tick.

What moves relative to the hub, or exerts forces and torques on it, are effectors of other components, such as reaction wheels
and thrusters: the hub sums them, and integrates their state together with its attitude; see
:class:`bsk_torch.sim.component.Effector`.
"""

from __future__ import annotations

import functools
import math
import operator
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_rate, mrp_switch, mrp_to_dcm
from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE
from bsk_torch.astro.frames import rotate_z
from bsk_torch.astro.gravity import third_body
from bsk_torch.astro.integrate import State, rk4_step
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.constants import MU_EARTH
from bsk_torch.rand import Distribution, Uniform, random_orbit
from bsk_torch.sim.component import Arg, Bus, Component, Field, UserArguments, Values, vec
from bsk_torch.sim.dyn.forces.field import called_field, full_field
from bsk_torch.vec3 import Mat3, Vec3, times

BODY = ("mass", "width", "depth", "height")
MOTION = ("inertia", *BODY, "omega_init")  # arguments that the inertia follows from
STABLE_TURN = 2.0 * math.sqrt(2.0)  # angle, rad, that a Runge-Kutta step of order four resolves


def box_inertia(mass: Tensor, width: Tensor, depth: Tensor, height: Tensor) -> Tensor:
    """Return the principal inertia [n, 3], kg m^2, about the center of a uniform box of the given mass, kg, and sides, m.

    ``I = m / 12 (w^2 + d^2, d^2 + h^2, w^2 + h^2)``, with width w, depth d and height h, in that order.
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
    check_tensor(args)
    names = [name for name in ("oe", "rN", "vN") if args[name] is not None]
    if names not in (["oe"], ["rN", "vN"]):
        raise KeyError(f"give the orbit as 'oe', or as both 'rN' and 'vN' with oe=None; given are {names or 'none'}")
    if args["oe"] is not None:
        _check_elements(args["oe"])


def inertia_tensor(args: Values) -> Tensor:
    """Return the inertia [n or 1, 3, 3], kg m^2, of the whole spacecraft about its center of mass."""
    if args["inertia"] is None:
        return torch.diag_embed(box_inertia(*(args[name] for name in BODY)))
    return args["inertia"].unflatten(-1, (3, 3))


def body_inertia(args: Values) -> Tensor:
    """Return the principal moments of inertia [n or 1, 3], kg m^2, of the whole spacecraft about its center of mass.

    Those of a box are about the body axes, see :func:`box_inertia`; those of ``inertia`` are sorted.
    """
    if args["inertia"] is None:
        return box_inertia(*(args[name] for name in BODY))
    return torch.linalg.eigvalsh(inertia_tensor(args))


def described_body(args: Values, row: int) -> str:
    """Return the arguments of the body of a row, for messages."""
    if args["inertia"] is not None:
        return f"inertia={shown_tensor(args['inertia'], row)}"
    return ", ".join(f"{name}={args[name][min(row, len(args[name]) - 1)].item():g}" for name in BODY)


def shown_tensor(values: Tensor, row: int) -> str:
    """Return the values of a row as text."""
    return str([float(f"{x:.5g}") for x in values[min(row, len(values) - 1)].tolist()])


INERTIA_SLACK = 1e-9
"""Part of the largest moment by which an inertia may break symmetry or the triangle inequality: rounding of given numbers."""


def check_tensor(args: Values) -> None:
    """Check that a given inertia is symmetric and positive, and the triangle inequality unless ``checkInertia`` is False."""
    if args["inertia"] is None:
        return
    tensor = inertia_tensor(args)
    skew = (tensor - tensor.mT).abs().amax((-2, -1)) > INERTIA_SLACK * tensor.abs().amax((-2, -1))
    moments = torch.linalg.eigvalsh(tensor)
    small, middle, large = moments.unbind(-1)
    broken = (small + middle < large * (1.0 - INERTIA_SLACK)) & (args["checkInertia"] > 0.5)
    impossible = "of which the largest exceeds the sum of the others: no body of mass has them"
    advice = "give an inertia about the center of mass, or checkInertia=False to fly it all the same"
    wrong = (
        (skew, "is not symmetric: entry [i][k] must equal [k][i]"),
        (small <= 0.0, "has principal moments {}; all must be positive"),
        (broken, f"has principal moments {{}}, {impossible}; {advice}"),
    )
    for mask, what in wrong:
        if bool(mask.any()):
            row = int(torch.nonzero(mask)[0])
            raise ValueError(f"inertia={shown_tensor(args['inertia'], row)} kg m^2 {what.format(shown_tensor(moments, row))}")


def check_turn(args: Values, H: Tensor, J: Tensor, h: float, cause: str) -> None:
    """Check that ticks of h s resolve the rates to which a momentum H, [n or 1, 3] N m s, can bring the body; else ValueError.

    A body turns about its momentum at up to ``|H| / J`` with its moments J, [n or 1, 3] kg m^2. The Runge-Kutta method of order
    four is stable up to ``2 sqrt(2)`` rad in a step (Hairer and Wanner, "Solving ordinary differential equations II", section
    IV.2), and numbers overflow beyond. ``cause`` names the arguments that turn the body, and the verb, for the message.
    """
    turn = h * H.norm(dim=-1) / J.min(-1).values
    row = int(turn.argmax())
    if bool(turn[row] > STABLE_TURN):
        raise ValueError(
            f"{cause} a body with {described_body(args, row)} by {turn[row].item():.3g} rad in a tick of sim_rate={h:g} s; ticks "
            f"resolve {STABLE_TURN:.3g} rad. Give smaller initial rates, a larger body, or a sim_rate of at most "
            f"{h * STABLE_TURN / turn[row].item():.2g} s"
        )


def body_momentum(args: Values) -> Tensor:
    """Return the initial momentum of the spacecraft without the spin of its wheels, [n or 1, 3] N m s in B."""
    if args["inertia"] is None:
        return body_inertia(args) * args["omega_init"]
    return (inertia_tensor(args) @ args["omega_init"].unsqueeze(-1)).squeeze(-1)


def _check_elements(oe: Tensor) -> None:
    bad = (oe[:, 1] < 0.0) | (oe[:, 1] >= 1.0) | (oe[:, 0] <= 0.0) | ~torch.isfinite(oe).all(-1)
    if bool(bad.any()):
        a, e = oe[bad][0, :2].tolist()
        raise ValueError(
            f"oe has a={a:g} m and e={e:g}; an orbit around the Earth needs a > 0 and 0 <= e < 1. oe are osculating elements "
            "(m, -, rad) in J2000 axes at utc_init; of a two-line set, give SGP4's state in GCRS as rN and vN"
        )


def _initial(args: Values) -> dict[str, Tensor]:
    r, v = initial_orbit(args)
    sigma = mrp_switch(Vec3.of(args["sigma_init"]))  # Basilisk's tick at t = 0 already switches
    return {"r_BN_N": r, "v_BN_N": v, "sigma_BN": sigma.stack(), "omega_BN_B": args["omega_init"]}


def _initial_of_origin(args: Values) -> dict[str, Tensor]:
    """Return the initial state where the given orbit is that of the center of mass, and B lies elsewhere."""
    state = _initial(args)
    sigma, omega, c = (Vec3.of(values) for values in (state["sigma_BN"], state["omega_BN_B"], args["r_CB_B"]))
    r, v = lever(sigma, omega, c)
    return state | {"r_BN_N": state["r_BN_N"] - r.stack(), "v_BN_N": state["v_BN_N"] - v.stack()}


def lever(sigma_BN: Vec3, omega_BN_B: Vec3, r_CB_B: Vec3) -> tuple[Vec3, Vec3]:
    """Return position, m, and velocity, m/s, of the center of mass C relative to B, in N: ``[BN]^T c, [BN]^T (omega x c)``."""
    NB = mrp_to_dcm(sigma_BN).mT
    return NB @ r_CB_B, NB @ omega_BN_B.cross(r_CB_B)


def _diagonal_inertia(args: Values) -> Tensor:
    tensor = inertia_tensor(args)
    diagonal = tensor.diagonal(dim1=-2, dim2=-1)
    if bool((tensor != torch.diag_embed(diagonal)).any()):
        raise ValueError(
            f"inertia={shown_tensor(args['inertia'], 0)}: the first satellite of the type has no products of inertia, so none "
            "may have; give the first one products, too"
        )
    return diagonal


EffectorStates = list[tuple[Any, ...]]  # state of each effector: a tuple of its fields on the bus


def _leaves(states: EffectorStates) -> State:
    return tuple(leaf for state in states for field in state for leaf in (field if _has_parts(field) else (field,)))


def _has_parts(field: object) -> bool:
    return isinstance(field, tuple) and not isinstance(field, Vec3)


def _regrouped(states: EffectorStates, leaves: State) -> EffectorStates:
    remaining = list(leaves)

    def taken(field: Any) -> Any:
        return tuple(remaining.pop(0) for _ in field) if _has_parts(field) else remaining.pop(0)

    return [tuple(taken(field) for field in state) for state in states]


def _effector_states(bus: Bus) -> EffectorStates:
    return [tuple(getattr(bus, name) for name in effector.state) for effector in bus.effectors]


def _attitude_rates(bus: Bus, L_B: Vec3, sigma_BN: Vec3, omega_BN_B: Vec3, states: EffectorStates) -> State:
    """Return the rates of the MRP sigma_BN, 1/s, of the body rate omega_BN, rad/s^2 in B, and of the states of effectors.

    With inertia I, kg m^2, of the whole spacecraft and external torque L, N m, both about the center of mass, and for each
    effector the inertia J that does not turn with the hub, and the torques l, N m, that the hub exerts on it (Schaub and
    Junkins, section 4.5)::

        sigma' = 1/4 B(sigma) omega
        (I - sum J) omega' = L - omega x (I omega) - sum l
    """
    total = L_B - omega_BN_B.cross(times(bus.inertia_B, omega_BN_B))
    for effector, y in zip(bus.effectors, states, strict=True):
        for load in effector.loads(bus, omega_BN_B, y) if effector.loads else ():
            total = total - load
    omega_dot = _accelerated(bus.inertia_B, [e.inertia(bus) for e in bus.effectors if e.inertia], total)
    rates = [mrp_rate(sigma_BN, omega_BN_B), omega_dot]
    effector_rates = [
        e.rates(bus, omega_BN_B, omega_dot, y) if e.rates else () for e, y in zip(bus.effectors, states, strict=True)
    ]
    return (*rates, *_leaves(effector_rates))


def _accelerated(inertia: Vec3 | Mat3, free: list[Vec3 | Mat3], torque: Vec3) -> Vec3:
    """Return the acceleration, rad/s^2, by a torque, N m, of a body without the inertia that is ``free`` to turn by itself."""
    if not free:
        return torque.map(torch.div, inertia) if isinstance(inertia, Vec3) else inertia.solve(torque)
    diagonals = [part for part in (inertia, *free) if isinstance(part, Vec3)]
    if len(diagonals) == 1 + len(free):  # 1 / J is the same in all stages
        return torque.map(lambda x, *parts: x * (1.0 / functools.reduce(operator.sub, parts)), *diagonals)
    matrices = [_matrix(part, torque.x) for part in (inertia, *free)]
    return functools.reduce(operator.sub, matrices).solve(torque)


def _matrix(inertia: Vec3 | Mat3, like: Tensor) -> Mat3:
    if isinstance(inertia, Mat3):
        return inertia
    zero = torch.zeros_like(like)
    return Mat3.diagonal(inertia.map(lambda x: zero + x))


def _torque(bus: Bus, stage: int) -> Vec3:
    """Return the external torque, N m in B, that does not depend on the orbit: the disturbance, and that of effectors."""
    torque = bus.disturbance_torque_B if bus.has("disturbance_torque_B") else Vec3.zeros_like(bus.sigma_BN.x)
    for effector in bus.effectors:
        effector_torque = effector.torque(bus, stage) if effector.torque else None
        torque = torque if effector_torque is None else torque + effector_torque
    return torque


def _finish(bus: Bus, sigma: Vec3, omega: Vec3, states: EffectorStates) -> None:
    bus.sigma_BN, bus.omega_BN_B = mrp_switch(sigma), omega
    for effector, values in zip(bus.effectors, states, strict=True):
        for name, value in zip(effector.state, values, strict=True):
            setattr(bus, name, value)


def _about_center(bus: Bus, force: Vec3 | None, torque: Vec3) -> Vec3:
    """Return the torque about the center of mass, N m, of a force in B, N, whose torque about B is given, ``L - c x F``."""
    if force is None or not bus.has("r_CB_B"):
        return torque.to(bus.dtype)
    return (torque - bus.r_CB_B.cross(force)).to(bus.dtype)


def rotate(bus: Bus) -> None:
    """Advance attitude and effectors by one tick, a Runge-Kutta step; the orbit is solved in advance.

    The MRP is switched to its shadow set after the whole step only, never between its stages, as in Basilisk.
    """
    if any(effector.thrust for effector in bus.effectors):
        raise TypeError(
            "thrusters without opposite partners push the orbit, but it was solved in advance, without them; pass "
            "orbit='integrated' to the environment, or write orbit = 'integrated' in the dynamics model"
        )
    states = _effector_states(bus)
    gradients, ambients = ([getattr(e, kind) for e in bus.effectors if getattr(e, kind)] for kind in ("gradient", "ambient"))

    def rates(stage: int, offset: float, y: State) -> State:
        torque = _torque(bus, stage)
        for gradient in gradients:  # the orbit is known at the end of the tick; its curvature within does not matter
            r_CN_B = mrp_to_dcm(y[0]) @ (bus.r_BN_N + bus.v_BN_N * (offset - bus.h))
            torque = torque + gradient(bus, r_CN_B).to(bus.dtype)
        for ambient in ambients:
            force, own = ambient(bus, mrp_to_dcm(y[0]), bus.r_BN_N + bus.v_BN_N * (offset - bus.h))
            torque = torque + _about_center(bus, force, own)
        return _attitude_rates(bus, torque, y[0], y[1], _regrouped(states, y[2:]))

    sigma, omega, *after = rk4_step(rates, (bus.sigma_BN, bus.omega_BN_B, *_leaves(states)), bus.h)
    _finish(bus, sigma, omega, _regrouped(states, tuple(after)))
    if bus.has("r_CB_B"):  # the orbit solved in advance is that of the center of mass
        r, v = lever(bus.sigma_BN, bus.omega_BN_B, bus.r_CB_B)
        bus.r_BN_N, bus.v_BN_N = bus.r_BN_N - r.to(bus.r_BN_N.x.dtype), bus.v_BN_N - v.to(bus.r_BN_N.x.dtype)


def gravity(bus: Bus, r: Vec3, offset: float, degree: int) -> Vec3:
    """Return the acceleration, m/s^2 in N, at r_BN_N, m, ``offset`` seconds after the start of the tick.

    ``a = C^T f(C r) + a_S(r, r_S + v_S dt)`` with the field f of a degree and order, in Earth-fixed axes, the Sun as a third
    body and ``dt = offset - h <= 0``. Basilisk takes the Earth's orientation ``R3(W) [EN]`` of the end of the tick and
    extrapolates it linearly, without making it orthonormal: ``C = (I + dt w R3'(0)) R3(W) [EN]``, where w is the Earth's rotation
    rate. Turned by dt, x and y become ``x + w dt y`` and ``y - w dt x``.
    """
    dt = offset - bus.h
    turn = EARTH_ROTATION_RATE * dt
    p = rotate_z(bus.EN @ r, bus.cos_earth, bus.sin_earth)
    earth_field = called_field if bus.opaque_field else full_field
    f = earth_field(Vec3(p.x + turn * p.y, p.y - turn * p.x, p.z), degree)
    f = Vec3(f.x - turn * f.y, f.y + turn * f.x, f.z)
    return bus.EN.mT @ rotate_z(f, bus.cos_earth, -bus.sin_earth) + third_body(r, bus.r_SN_N + bus.v_SN_N * dt)


def translate_and_rotate(bus: Bus, degree: int) -> None:
    """Advance orbit, attitude and effectors together by one tick, a Runge-Kutta step, as Basilisk does.

    ``r' = v`` and ``v' = a(r, t) + F_N / m + [BN]^T F_B / m`` with the forces F_B, N in B, of effectors, such as drag, and the
    message ``external_force_N``, F_N, N in N, that components may have written; it is constant over the tick and acts at the
    center of mass. The rest as in :func:`rotate`, with the torques of these effectors.

    Where the center of mass lies at c = r_CB_B from B, whose position is r, gravity acts there, forces have the torque
    ``-c x F_B`` in addition, and ``v' = a(r + [BN]^T c, t) + F_N / m + [BN]^T (F_B / m - omega x (omega x c) + c x omega')``.
    """
    constant = bus.external_force_N / bus.mass if bus.has("external_force_N") else None
    bus.force_is_felt = constant is not None
    states, c = _effector_states(bus), bus.r_CB_B if bus.has("r_CB_B") else None
    kinds = "force", "thrust", "gradient", "ambient"
    drags, pushes, gradients, ambients = ([getattr(e, kind) for e in bus.effectors if getattr(e, kind)] for kind in kinds)

    def rates(stage: int, offset: float, y: State) -> State:
        r, v, sigma, omega, *rest = y
        center = r if c is None else r + lever(sigma, omega, c)[0].to(r.x.dtype)
        acceleration, torque = gravity(bus, center, offset, degree), _torque(bus, stage)
        if constant is not None:
            acceleration = acceleration + constant
        for gradient in gradients:
            torque = torque + gradient(bus, mrp_to_dcm(sigma) @ center).to(bus.dtype)
        forces = [drag(bus, mrp_to_dcm(sigma) @ v) for drag in drags]
        forces += [force for push in pushes if (force := push(bus, stage)) is not None]
        forces += [ambient(bus, mrp_to_dcm(sigma), r) for ambient in ambients]
        for force, own in forces:
            if force is not None:
                acceleration = acceleration + mrp_to_dcm(sigma).mT @ force / bus.mass
            torque = torque + _about_center(bus, force, own)
        turned = _attitude_rates(bus, torque, sigma, omega, _regrouped(states, tuple(rest)))
        if c is not None:
            swing = c.cross(turned[1]) - omega.cross(omega.cross(c))
            acceleration = acceleration + (mrp_to_dcm(sigma).mT @ swing).to(r.x.dtype)
        return (v, acceleration, *turned)

    start = (bus.r_BN_N, bus.v_BN_N, bus.sigma_BN, bus.omega_BN_B, *_leaves(states))
    bus.r_BN_N, bus.v_BN_N, sigma, omega, *after = rk4_step(rates, start, bus.h)
    _finish(bus, sigma, omega, _regrouped(states, tuple(after)))


def move(bus: Bus) -> None:
    """Advance the spacecraft by one tick; its orbit, too, unless solved in advance."""
    if bus.gravity_degree is None:
        rotate(bus)
    else:
        translate_and_rotate(bus, bus.gravity_degree)


ARGS = (
    Arg("mass", 330.0, "kg", "hub mass", low=1e-6, high=1e9),
    Arg("width", 1.38, "m", "side of the hub", low=1e-6, high=1e4),
    Arg("depth", 1.04, "m", "side of the hub", low=1e-6, high=1e4),
    Arg("height", 1.58, "m", "side of the hub", low=1e-6, high=1e4),
    Arg(
        "inertia",
        None,
        "kg m^2",
        "inertia of the spacecraft about its center of mass, wheels included, in B (3 x 3); None: that of the box",
        "matrix",
        -1e12,
        1e12,
    ),
    Arg("checkInertia", True, "-", "whether inertia must obey the triangle inequality", "choice", choices=(False, True)),
    Arg("r_CB_B", (0.0, 0.0, 0.0), "m", "center of mass relative to the origin of B, in B", "vector", -1e3, 1e3),
    Arg("sigma_init", Uniform(0.0, 1.0, 3), "-", "initial attitude, MRP of B relative to N", "vector", -1e6, 1e6),
    Arg("omega_init", Uniform(-1e-4, 1e-4, 3), "rad/s", "initial body rate in B", "vector", -1e3, 1e3),
    Arg("oe", random_orbit(), "m, -, rad", "initial osculating elements a, e, i, Omega, omega, f; a TLE has others", "orbit"),
    Arg("rN", None, "m", "initial position, instead of oe", "vector", -1e12, 1e12),
    Arg("vN", None, "m/s", "initial velocity, instead of oe", "vector", -1e6, 1e6),
    Arg("mu", MU_EARTH, "m^3/s^2", "gravitational parameter that converts oe", low=1.0, high=1e20),
    Arg("min_orbital_radius", 6578136.6, "m", "a spacecraft at or below this radius dies", low=0.0),
)


def _check_no_lever(args: Values) -> None:
    _check(args)
    if bool((args["r_CB_B"] != 0.0).any()):
        row = int(args["r_CB_B"].norm(dim=-1).argmax())
        raise ValueError(
            f"r_CB_B={shown_tensor(args['r_CB_B'], row)} m: the first satellite of the type has its center "
            "of mass at the origin of B, so all must have; give the first one an offset, such as 1e-6 m, too"
        )


@functools.cache
def hub(inertia: str, lever: bool) -> Component:
    """Return the component of a hub, whose center of mass may lie off the origin of B where there is a ``lever``.

    ``inertia`` is ``"box"``, ``"diagonal"`` or ``"tensor"``: what it follows from, and its form.
    """
    field = Field("inertia_B", 9, "kg m^2", "inertia of the spacecraft, about its center of mass", matrix=True)
    diagonal = vec("inertia_B", "kg m^2", "principal inertia of the spacecraft, about the body axes")
    forms = {"box": body_inertia, "diagonal": _diagonal_inertia, "tensor": lambda args: args["inertia"]}

    def prepare(args: Values) -> dict[str, Tensor]:
        center = {"r_CB_B": args["r_CB_B"]} if lever else {}
        return {"inertia_B": forms[inertia](args), "mass": args["mass"]} | center

    return Component(
        slot="hub",
        update=move,
        args=ARGS,
        state=(
            vec("r_BN_N", "m", "position", exact=True),
            vec("v_BN_N", "m/s", "velocity", exact=True),
            vec("sigma_BN", "-", "attitude, MRP"),
            vec("omega_BN_B", "rad/s", "body rate"),
        ),
        params=(
            field if inertia == "tensor" else diagonal,
            Field("mass", 1, "kg"),
            *((vec("r_CB_B", "m", "center of mass"),) if lever else ()),
        ),
        initial=_initial_of_origin if lever else _initial,
        prepare=prepare,
        check=_check if lever else _check_no_lever,
        check_tick=lambda args, h: check_turn(args, body_momentum(args), body_inertia(args), h, "omega_init turns"),
        fit=fitted_hub,
    )


def fitted_hub(arguments: UserArguments) -> Component:
    """Return the hub for the arguments as given: of a tensor with zeros off its diagonal, in all rows, the diagonal is used."""
    inertia, place = given_numbers(arguments["inertia"]), given_numbers(arguments["r_CB_B"])
    diagonal = inertia is not None and inertia.numel() == 9 and not bool(inertia.flatten()[[1, 2, 3, 5, 6, 7]].any())
    form = "box" if arguments["inertia"] is None else "diagonal" if diagonal else "tensor"
    return hub(form, place is None or bool(place.any()))


def given_numbers(value: object) -> Tensor | None:
    """Return an argument as given, float64; None for one that is drawn, and for what is no number, which raises when drawn."""
    if value is None or isinstance(value, Distribution) or callable(value):
        return None
    try:
        return torch.as_tensor(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError):
        return None


HUB = hub("box", False)  # the hub of a box with its center of mass at the origin of B
