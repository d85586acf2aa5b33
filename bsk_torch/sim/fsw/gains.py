"""Gains proposed for a body with reaction wheels, from its inertia and from what the wheels can do in a tick."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from bsk_torch._checks import no_gradient, number, parts
from bsk_torch.constants import RPM
from bsk_torch.sim.component import Values
from bsk_torch.sim.dyn.effectors.thrusters import Thruster, forces_and_arms
from bsk_torch.sim.dyn.effectors.wheel_set import check_inertia, free_tensor_moments, wheel_defaults
from bsk_torch.sim.dyn.effectors.wheel_types import Wheel
from bsk_torch.sim.dyn.hub import body_inertia, check_tensor
from bsk_torch.sim.fsw.allocation import check_axes, wheel_map
from bsk_torch.sim.fsw.stability import NULL_SHARE, attitude_rate, gains_at, rate_gain
from bsk_torch.sim.names import nearest

LAWS = {"feedback": ("K", "P"), "steering": ("K1", "K3", "servo_P")}
"""Control laws, and their gains of :func:`bsk_torch.sim.fsw.stability.gains_at`, without those of the integral."""

MOMENTUM_SHARE = 0.5  # part of the wheels' momentum that a slew uses; the rest is for what they have stored
NULL_TORQUE_SHARE = 0.25  # part of a wheel's torque that null motion uses at its top speed
PULSE_TORQUE_SHARE = 0.5  # part of the wheels' torque that takes up the pulses of the thrusters, on average
LEAST_WAIT = 4  # least proposed ticks between pulses, the default


def propose_gains(
    inertia: object,
    wheels: Sequence[Wheel],
    h: float = 1.0,
    law: str = "feedback",
    slew: float = math.pi,
    thrusters: Sequence[Thruster] = (),
) -> dict[str, float | bool]:
    """Return gains, as ``sat_args``, with which a body points and turns by its wheels without oscillating.

    Symbols: J and J' are the largest and the smallest principal moment of inertia, kg m^2, J' without the spin of the wheels; L
    and H are the torque, N m, and the momentum, N m s, that the wheels have in every direction: with the map [W] of body torques
    to wheels, ``L = min_i u_max_i / |W_i|`` and ``H = min_i J_i Omega_max_i / |W_i|``.

    Rate gain (``P``, ``servo_P``): ``P = 0.36 J' / h``. A command acts one tick late, so that the rate loop of an axis has the
    roots ``z^2 - z + P h / J``: it is unstable from 1 on and rings above 0.4.

    Rate a, 1/s, at which attitude errors decay: the smallest of

    - ``P / (5.76 J)``: the rate loop is faster, with a damping of ``P / sqrt(K J) = 1.2`` for the largest moment;
    - ``sqrt(L / (J slew))``: a turn by ``slew`` brakes at ``a^2 slew``, which the wheels can exert;
    - with feedback, ``0.5 H / (4 J tan(slew / 4))``: the rate of the turn, ``4 a tan(slew / 4)``, takes half of the momentum.
      Steering has ``omega_max`` for this.

    Attitude gains: ``K = 4 a P``; ``K1 = 4 a`` and ``K3 = K1 / 3``.

    Fastest rate of steering: ``omega_max = min(L / P, L / (J a), 0.5 H / J)``: the wheels can exert the torque of the servo at
    the start of a turn, brake from this rate, and store its momentum.

    Integral (``Ki``, ``servo_Ki``, ``integralLimit``): only of wheels with friction, whose constant torque would turn the body
    by ``friction / (a P)`` rad. It acts about as fast as a, and is limited to twice the friction of all wheels at half their top
    speed, so that it does not wind up in turns.

    ``compensateWheels``: True with feedback, since momentum h stored in the wheels else deflects the pointing at references that
    turn, by ``|omega_RN| h / (a P)`` rad. In turns, feedback does not compensate it, and they take up to ``1 + (h / P)^2`` times
    as long; steering does.

    ``nullSpaceGain``, of more than three wheels: ``min(0.2 J_i / h, 0.25 u_max_i / Omega_max_i)``: smooth, and at most a quarter
    of the torque of a wheel at its top speed.

    ``maxCounterValue``, with ``thrusters``: at least 4, and so many ticks between pulses that the wheels take up the momentum of
    one, at most ``dH = max_k sum_j max(0, l_j . l_k / |l_k|) h / 6`` with the torques l_j of the thrusters about the origin of B,
    with half of L. (Basilisk's integrator feels a sixth of a pulse.)

    Not considered are flexible parts, the smallest torque of wheels, and torques of the environment.

    Args:
        inertia: Inertia about the center of mass, wheels included: 9 numbers or 3 x 3, kg m^2 in B.
        wheels: Reaction wheels.
        h: Length of a tick, s: ``sim_rate`` of the environment.
        law: ``"feedback"`` for ``fsw.BasicFSWModel``, ``"steering"`` for ``fsw.SteeringFSWModel``.
        slew: Largest turn to be flown without saturated wheels, rad.
        thrusters: Thrusters for desaturation.

    Returns:
        Numbers by argument; copy them into ``sat_args``.

    Raises:
        ValueError: For an impossible inertia, wheels that do not span space or have no limits of torque and speed, an unknown
            law, or numbers out of range.
    """
    h = number("propose_gains: h", h, 0.0, 1e6, unit="s", above=True)
    slew = number("propose_gains: slew", slew, 0.0, math.pi, unit="rad", above=True)
    if law not in LAWS:
        raise ValueError(f"propose_gains: law={law!r} is unknown; {nearest(str(law), LAWS)}")
    args = _described(inertia, wheels)
    L, H = _weakest(args)
    smallest, largest = float(free_tensor_moments(args).min()), float(body_inertia(args).max())
    P = rate_gain(smallest, h)
    limits = [attitude_rate(P, largest), math.sqrt(L / (largest * slew))]
    if law == "feedback":
        limits.append(MOMENTUM_SHARE * H / (4.0 * largest * math.tan(slew / 4.0)))
    rate = min(limits)
    gains = gains_at(rate, P)
    proposed: dict[str, float | bool] = {name: gains[name] for name in LAWS[law]}
    if law == "steering":
        proposed["omega_max"] = min(L / P, L / (largest * rate), MOMENTUM_SHARE * H / largest)
    else:
        proposed["compensateWheels"] = True
    proposed |= _integral(args, gains, law)
    if len(wheels) > 3:
        smooth = NULL_SHARE * args["rwJs"] / h
        weak = NULL_TORQUE_SHARE * args["u_max"] / (args["rwOmegaMax"] * RPM)
        proposed["nullSpaceGain"] = float(torch.minimum(smooth, weak).min())
    if thrusters:
        proposed["maxCounterValue"] = _wait(thrusters, L, h)
    return proposed


def _described(inertia: object, wheels: Sequence[Wheel]) -> Values:
    parts("propose_gains: wheels", wheels, Wheel, "a list of dyn.Wheel, such as dyn.Wheel('BCT_RWP015', [1, 0, 0])")
    try:
        tensor = torch.as_tensor(no_gradient("propose_gains: inertia", inertia), dtype=torch.float64)
    except (TypeError, ValueError, RuntimeError):
        tensor = torch.empty(0, dtype=torch.float64)
    if tensor.shape not in ((9,), (3, 3)) or not bool(torch.isfinite(tensor).all()):
        raise ValueError(f"propose_gains: inertia={inertia!r} must be 9 numbers, or 3 x 3, kg m^2")
    numbers = {name: torch.tensor([values], dtype=torch.float64) for name, values in wheel_defaults(wheels).items()}
    args = {**numbers, "inertia": tensor.reshape(1, 9)}
    args |= {"checkInertia": torch.ones_like(tensor.view(-1)[:1]), "underactuated": torch.zeros_like(tensor.view(-1)[:1])}
    for name in ("u_max", "rwOmegaMax"):
        endless = (args[name] <= 0.0) | torch.isinf(args[name])
        if bool(endless.any()):
            k = int(torch.nonzero(endless)[0, 1])
            raise ValueError(f"propose_gains: wheel {k} has {name}={args[name][0, k].item():g}: not a limit; give one")
    check_tensor(args)
    check_axes(args)
    check_inertia(args)
    return args


def _weakest(args: Values) -> tuple[float, float]:
    """Return the torque, N m, and momentum, N m s, that wheels have in every direction; power limits count at half speed."""
    shares, fastest = wheel_map(args).norm(dim=-1), args["rwOmegaMax"] * RPM
    powered = args["rwPMax"] / (0.5 * fastest)
    torque = torch.where(args["rwPMax"] > 0.0, torch.minimum(args["u_max"], powered), args["u_max"])
    return float((torque / shares).min()), float((args["rwJs"] * fastest / shares).min())


def _integral(args: Values, gains: dict[str, float], law: str) -> dict[str, float]:
    each: Tensor = args["rwFCoulomb"] + args["rwCViscous"] * (0.5 * RPM) * args["rwOmegaMax"]
    axes = args["rwAxes_B"].abs()
    friction = float((axes * each.unsqueeze(-1)).sum(-2).max())
    gain = "Ki" if law == "feedback" else "servo_Ki"
    if friction <= 0.0:
        return {gain: -1.0}
    return {gain: gains[gain], "integralLimit": 2.0 * friction / (gains[gain] * (gains["P"] if law == "feedback" else 1.0))}


def _wait(thrusters: Sequence[Thruster], L: float, h: float) -> float:
    """Return the ticks between pulses of thrusters after which wheels with the torque L, N m, have taken up their momentum."""
    parts("propose_gains: thrusters", thrusters, Thruster, "a list of dyn.Thruster")
    places, directions = (
        torch.tensor([[getattr(part, name) for part in thrusters]], dtype=torch.float64) for name in ("position", "direction")
    )
    thrusts = torch.tensor([[part.thrust for part in thrusters]], dtype=torch.float64)
    values = {"thrusterPositions_B": places, "thrusterDirections_B": directions, "thrusterMaxThrust": thrusts}
    torques = forces_and_arms(values)[1][0]
    along = torques @ (torques / torques.norm(dim=-1, keepdim=True).clamp(min=1e-30)).mT
    kick = float(along.clamp(min=0.0).sum(0).max()) * h / 6.0
    return float(max(LEAST_WAIT, math.ceil(kick / (PULSE_TORQUE_SHARE * L * h)) - 1))
