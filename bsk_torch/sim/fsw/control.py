"""Attitude control: MRP feedback through three reaction wheels on the body axes."""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.sim.component import Arg, Bus, Component, Field, Values, vec
from bsk_torch.vec3 import Vec3, select


def feed_back(bus: Bus) -> None:
    """Motor torque command ``u = K s + P w + P Ki z - (w_R + Ki z) x (I w_B) + I (w_B x w_R - w_R')``.

    Source: Schaub and Junkins, section 8.4, as in Basilisk's mrpFeedback without wheel momentum. The integral
    ``z = K int(s dt) + I w`` acts where Ki is positive; its first call has dt = 0, and drifting lets the clock run. With three
    wheels and three controlled axes the wheel torque is the opposite of the body torque. Where control is off the command holds.
    """
    s, w, w_R, dw_R = bus.error
    on, never = bus.control_on > 0.0, bus.control_idle < 0.0
    integrates = bus.Ki > 0.0
    Ki = torch.where(integrates, bus.Ki, torch.ones_like(bus.Ki))
    limit = 0.2 / Ki
    dt = torch.where(never, torch.zeros_like(bus.control_idle), bus.control_idle + bus.h)
    integral = (bus.control_integral + s * (bus.K * dt)).map(lambda x: torch.minimum(torch.maximum(x, -limit), limit))
    zero = Vec3.zeros_like(s.x)
    z = select(integrates, (integral + bus.inertia.scale(w)) * Ki, zero)
    omega = w + w_R
    gyroscopic = (w_R + z).cross(bus.inertia.scale(omega))
    command = s * bus.K + w * bus.P + z * bus.P - gyroscopic + bus.inertia.scale(omega.cross(w_R) - dw_R)
    bus.motor_torque_command = select(on, command, bus.motor_torque_command)
    bus.control_integral = select(on & integrates, integral, bus.control_integral)
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
    """A controller that has never been called."""
    return {"control_integral": torch.zeros(1, 3).double(), "control_idle": -torch.ones(1).double()}


CONTROL_AXES = Arg("controlAxes_B", (1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0), "-", "controlled axes in B, one after another", "matrix")

CONTROL_STATE = (vec("control_integral"), Field("control_idle", 1, "s", "since the last call; negative: never called"))
"""What every control law remembers: its integral, and when it was called."""

MRP_FEEDBACK = Component(
    slot="control",
    order=307,
    update=feed_back,
    args=(
        Arg("K", 7.0, "N m", "attitude gain", low=0.0),
        Arg("Ki", -1.0, "-", "integral gain; no integral where not positive"),
        Arg("P", 35.0, "N m s", "rate gain", low=0.0),
        CONTROL_AXES,
    ),
    state=CONTROL_STATE,
    params=(Field("K"), Field("Ki"), Field("P")),
    initial=initial_control,
    prepare=lambda args: {name: args[name] for name in ("K", "Ki", "P")},
    check=check_control_axes,
)
