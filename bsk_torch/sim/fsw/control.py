"""Attitude control by MRP feedback: the torque on the body, which an allocation distributes among actuators."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping

import torch
from torch import Tensor

from bsk_torch.sim.component import Arg, Bus, Component, Field, Values, vec
from bsk_torch.sim.dyn.hub import body_inertia
from bsk_torch.sim.fsw.allocation import commands_for, write_commands
from bsk_torch.sim.fsw.stability import LOOP, Law, check_gains, has_wheels, in_words
from bsk_torch.vec3 import Vec3, select, times


def feed_back(bus: Bus) -> None:
    """Command the torque L on the body, N m, of MRP feedback.

    The law is::

        -L = K sigma_BR + P omega_BR + P Ki z - (omega_RN + Ki z) x H + I (omega_BN x omega_RN - omega_RN') + L_k
        z = K int(sigma_BR dt) + I omega_BR   where Ki > 0, else 0
        H = I omega_BN

    All vectors are in B; I is the inertia, kg m^2, K, N m, and P, N m s, are gains, omega_RN' is the reference's acceleration.
    L_k, N m, is the known disturbance ``knownTorquePntB_B``, if given. Source: Schaub and Junkins, section 8.4, as in Basilisk's
    mrpFeedback.

    The integral is kept within +-0.2 / Ki, or +-integralLimit, for each component; its first call has dt = 0, and drifting lets
    the clock run. Where control is off the command holds.
    """
    _feed_back(bus, with_wheels=False)


def feed_back_with_wheels(bus: Bus) -> None:
    """Command the torque of :func:`feed_back` with the momentum of the wheels about their axes in H, which it compensates."""
    _feed_back(bus, with_wheels=True)


def body_and_wheels(bus: Bus, omega_BN_B: Vec3) -> Vec3:
    """Return the momentum of the spacecraft, ``H = I omega + sum h`` with h of each effector about its axes, N m s in B."""
    H = times(bus.inertia_B, omega_BN_B)
    for effector in bus.effectors:
        H = H + effector.momentum(bus, omega_BN_B) if effector.momentum else H
    return H


def _feed_back(bus: Bus, with_wheels: bool) -> None:
    sigma_BR, omega_BR_B, omega_RN_B, domega_RN_B = bus.error
    on, never = bus.control_on > 0.0, bus.control_idle < 0.0
    integrates = bus.Ki > 0.0
    Ki = torch.where(integrates, bus.Ki, torch.ones_like(bus.Ki))
    limit = bus.integral_limit if bus.has("integral_limit") else 0.2 / Ki
    dt = torch.where(never, torch.zeros_like(bus.control_idle), bus.control_idle + bus.h)
    integral = (bus.control_integral_B + sigma_BR * (bus.K * dt)).map(lambda x: torch.minimum(torch.maximum(x, -limit), limit))
    zero = Vec3.zeros_like(sigma_BR.x)
    Ki_z = select(integrates, (integral + times(bus.inertia_B, omega_BR_B)) * Ki, zero)
    omega_BN_B = omega_BR_B + omega_RN_B
    turning = omega_RN_B + Ki_z
    H = body_and_wheels(bus, omega_BN_B) if with_wheels else times(bus.inertia_B, omega_BN_B)
    gyroscopic = turning.cross(H)
    opposite = sigma_BR * bus.K + omega_BR_B * bus.P + Ki_z * bus.P - gyroscopic
    opposite = opposite + times(bus.inertia_B, omega_BN_B.cross(omega_RN_B) - domega_RN_B)
    if bus.has("known_torque_B"):
        opposite = opposite + bus.known_torque_B
    write_commands(bus, commands_for(bus, -opposite), on)
    bus.control_integral_B = select(on & integrates, integral, bus.control_integral_B)
    if bus.h_ns:  # Basilisk takes a call at time zero for none
        bus.control_idle = torch.where(on, torch.zeros_like(dt), torch.where(never, bus.control_idle, bus.control_idle + bus.h))


def check_control_axes(args: Values) -> None:
    """Raise ValueError for controlled axes that do not span space."""
    axes = torch.as_tensor(args["controlAxes_B"], dtype=torch.float64).reshape(-1, 3, 3)
    if bool((torch.linalg.det(axes).abs() < 1e-9).any()):
        raise ValueError(
            f"controlAxes_B={axes.tolist()} must be three independent axes (nine numbers): three wheels then control every "
            "axis, and the mapping to wheels and thrusters is the same for all such choices"
        )


def initial_control(args: Values) -> dict[str, Tensor]:
    """Return the state of a controller that has never been called."""
    return {"control_idle": -torch.ones(1, dtype=torch.float64)}


def feedback_law(args: Values, h: float) -> Law:
    """Return :func:`feed_back` near its reference, in ticks of h s."""
    K, P, Ki = (args[name].unsqueeze(-1) for name in ("K", "P", "Ki"))
    integral, none = torch.clamp(Ki, min=0.0), torch.zeros_like(K + P + Ki)
    inertia = body_inertia(args)
    return Law(K + none, P * integral * K * h, P * (1.0 + integral * inertia), none)


def check_feedback(args: Values, h: float) -> str | None:
    """Check that the gains are stable; see :func:`bsk_torch.sim.fsw.stability.check_gains`."""
    if not has_wheels(args):
        return None
    names = ("K", "P", "Ki") if bool((args["Ki"] > 0.0).any()) else ("K", "P")
    return check_gains(args, h, feedback_law(args, h), in_words(args, *names), "K={K}, P={P} and Ki=-1")


CONTROL_AXES = Arg("controlAxes_B", (1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0), "-", "controlled axes in B, one after another", "matrix")

CONTROL_STATE = (
    vec("control_integral_B", "", "integral of the control error"),
    Field("control_idle", 1, "s", "since the last call; negative: never called"),
)
"""State of every control law: its integral, and the time since it was called."""

LAW_ARGS = (
    Arg("integralLimit", None, "-", "bound of the integral of the law; None: 0.2 over its gain", low=0.0, high=1e12),
    Arg("knownTorquePntB_B", None, "N m", "known disturbance that the law compensates", "vector", -1e6, 1e6),
)
"""Arguments of every control law."""


def with_given_terms(law: Component, given: Mapping[str, object]) -> Component:
    """Return a control law with the terms that the arguments as given ask for."""
    return _with_terms(law, given["integralLimit"] is not None, given["knownTorquePntB_B"] is not None)


@functools.cache
def _with_terms(law: Component, limited: bool, known: bool) -> Component:
    if limited:
        law = law.extended(params=(Field("integral_limit"),), prepare=lambda args: {"integral_limit": args["integralLimit"]})
    if known:
        torque = vec("known_torque_B", "N m")
        law = law.extended(params=(torque,), prepare=lambda args: {"known_torque_B": args["knownTorquePntB_B"]})
    return law


def fitted_feedback(given: Mapping[str, object]) -> Component:
    """Return MRP feedback with the terms that the arguments as given ask for."""
    return with_given_terms(_FEEDBACK_WITH_WHEELS if given["compensateWheels"] else MRP_FEEDBACK, given)


MRP_FEEDBACK = Component(
    slot="control",
    update=feed_back,
    args=(
        Arg("K", 7.0, "N m", "attitude gain", low=0.0, high=1e6),
        Arg("Ki", -1.0, "-", "integral gain; no integral where not positive", high=1e6),
        Arg("P", 35.0, "N m s", "rate gain", low=0.0, high=1e6),
        CONTROL_AXES,
        Arg("compensateWheels", False, "-", "whether the wheels' momentum is compensated", "constant", choices=(False, True)),
        *LAW_ARGS,
    ),
    state=CONTROL_STATE,
    reads=LOOP,
    params=(Field("K"), Field("Ki"), Field("P")),
    initial=initial_control,
    prepare=lambda args: {name: args[name] for name in ("K", "Ki", "P")},
    check=check_control_axes,
    check_tick=check_feedback,
    fit=fitted_feedback,
    flags=("control_on",),
)

_FEEDBACK_WITH_WHEELS = dataclasses.replace(MRP_FEEDBACK, update=feed_back_with_wheels)
