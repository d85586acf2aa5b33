"""A library of spacecraft: functions that return ``sat_args`` of a body with wheels, thrusters, power and stable gains.

The arguments are those of ``dyn.BasicDynamicsModel`` and of all models that build on it, with ``fsw.BasicFSWModel``
(``law="feedback"``) or ``fsw.SteeringFSWModel`` (``law="steering"``); the tick length h is the environment's ``sim_rate``. Change
and add entries as in any dictionary. Where each number comes from: ``docs/how_to/spacecraft.md``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.rand import Distribution, Key, Uniform
from bsk_torch.sim.dyn import Thruster, Wheel, pyramid
from bsk_torch.sim.dyn.axes import unit_rows
from bsk_torch.sim.fsw import propose_gains
from bsk_torch.sim.fsw.stability import RATE_SHARE, attitude_rate

__all__ = ["aeos_bench", "agile_imager", "cubesat", "from_slew_limits", "imager", "octet"]

PYRAMID = pyramid(0.8)
"""Axes of the four wheels of the first three spacecraft."""

DOWN = [-1.0, 0.0, 0.0]
"""Axis of their instruments in B, which looks at nadir while ``act.NadirPoint`` aligns B with the Hill frame."""


def octet(near: float, far: float, high: float, thrust: float | str) -> list[Thruster]:
    """Return eight thrusters in the arrangement of the default ones: opposite pairs, which exert torques and no force.

    One thruster of each pair sits at ``(+-near, -far, +-high)``, m, and pushes along ``(-+1, 1, 0)``, the other one opposite.
    With the center of mass at the origin of B, all eight together exert no torque.

    Args:
        near: Distance from the origin along the first axis of B, m.
        far: The same along the second axis.
        high: The same along the third axis.
        thrust: Thrust of each, N, or a name in ``dyn.THRUSTER_TYPES``.
    """
    halves = [((x, -far, z), (-math.copysign(1.0, x), 1.0, 0.0)) for x in (near, -near) for z in (high, -high)]
    return [
        Thruster([sign * a for a in place], [sign * b for b in push], thrust) for sign in (1.0, -1.0) for place, push in halves
    ]


def cubesat(h: float = 1.0, law: str = "steering") -> dict[str, object]:
    """Return a 6U CubeSat of 12 kg: four NanoAvionics RW0 wheels with friction, 40 Wh, deployed panels, thrusters of 1 mN.

    Null motion keeps the wheels off zero speed, two in each direction, since friction disturbs most where speeds change sign.
    The smallest torque of these wheels is off (``useMinTorque``): with it and ticks of 1 s, pointing wanders by up to 0.2 rad.

    Args:
        h: Length of a tick, s.
        law: ``"feedback"`` or ``"steering"``.
    """
    wheels = [Wheel("NanoAvionics_RW0", axis, useRWfriction=True) for axis in PYRAMID]
    inertia = [[0.09, 0.002, 0.0], [0.002, 0.13, 0.001], [0.0, 0.001, 0.16]]
    return _spacecraft(
        inertia,
        wheels,
        octet(0.03, 0.1, 0.17, 0.001),
        40.0,
        h,
        law,
        mass=12.0,
        width=0.2,
        depth=0.1,
        height=0.34,
        panelArea=0.12,
        basePowerDraw=-5.0,
        rwBasePower=0.15,
        wheelSpeeds=Uniform([1500.0, -2500.0, 1500.0, -2500.0], [2500.0, -1500.0, 2500.0, -1500.0]),
        nullSpaceSpeeds=[2000.0, -2000.0, 2000.0, -2000.0],
        maxWheelSpeed=6500.0,
    )


def imager(h: float = 1.0, law: str = "feedback") -> dict[str, Any]:
    """Return an imaging satellite of 180 kg: four Honeywell HR14 wheels of 25 N m s, 400 Wh, a panel of 0.8 m^2.

    For the arguments, see :func:`cubesat`.
    """
    wheels = [Wheel("Honeywell_HR14", axis, 25.0) for axis in PYRAMID]
    inertia = [[22.0, 0.3, -0.2], [0.3, 28.0, 0.4], [-0.2, 0.4, 30.0]]
    return _spacecraft(
        inertia,
        wheels,
        octet(0.1, 0.45, 0.5, "MOOG_Monarc_1"),
        400.0,
        h,
        law,
        mass=180.0,
        width=0.9,
        depth=0.8,
        height=1.1,
        panelArea=0.8,
        basePowerDraw=-60.0,
        rwBasePower=2.0,
        wheelSpeeds=Uniform(-1000.0, 1000.0, 4),
        maxWheelSpeed=6000.0,
    )


def agile_imager(h: float = 1.0, law: str = "steering") -> dict[str, object]:
    """Return an agile imaging satellite of 1,000 kg: four wheels of 250 N m s and 15 N m, as strong as control moment gyros.

    For the arguments, see :func:`cubesat`.
    """
    wheels = [Wheel("custom", axis, 250.0, Omega_max=6000.0, u_max=15.0) for axis in PYRAMID]
    inertia = [[500.0, 5.0, -3.0], [5.0, 600.0, 8.0], [-3.0, 8.0, 720.0]]
    return _spacecraft(
        inertia,
        wheels,
        octet(0.1, 1.0, 0.9, "MOOG_Monarc_5"),
        2000.0,
        h,
        law,
        mass=1000.0,
        width=1.6,
        depth=1.5,
        height=2.2,
        panelArea=4.0,
        basePowerDraw=-300.0,
        rwBasePower=10.0,
        wheelSpeeds=Uniform(-500.0, 500.0, 4),
        maxWheelSpeed=6000.0,
    )


BODY_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
TOP_SPEED = 6000.0  # of wheels for slew limits, rpm


def from_slew_limits(
    max_rate_deg_s: float,
    max_acceleration_deg_s2: float,
    settling_time: float = 2.0,
    inertia: Sequence[float] = (82.0, 98.0, 121.0),
    h: float = 0.1,
    *,
    tracking_rate_deg_s: float = 1.0,
    margin: float = 1.25,
    axes: Sequence[Sequence[float]] = BODY_AXES,
) -> dict[str, Any]:
    """Return the arguments of a body with wheels that flies slews within limits of rate and acceleration.

    They are those of ``fsw.ReferenceSlewFSWModel``. Planners state what a satellite can do as the time of a turn by d from rest
    to rest, ``2 sqrt(d / a)`` for small turns, else ``d / v + v / a``, and a settling time. A satellite that flies it needs, with
    the largest principal moment of inertia J and the map [W] of body torques to wheels
    (:func:`bsk_torch.sim.fsw.allocation.wheel_map`), from each wheel i

    - the torque ``m J a |W_i|``, since ``J a`` may point anywhere. The margin m covers the
      acceleration of the line of sight, the gyroscopic torque, and the feedback of errors; 1.1 is the least;
    - the momentum ``m J (v + w) |W_i|``: while a target is tracked, the line of sight turns by up to w besides.

    Gains are those of :func:`bsk_torch.fsw.propose_gains` for the steering law, as stiff as ticks of h s allow: the torque of a
    slew is fed forward, and feedback only corrects what is left. Turns without a reference, such as to the Sun, are limited to
    the rate from which the wheels can brake, at most half of what they can store.

    The settling time bounds the tick: what is commanded at the end of a tick turns the body two ticks later.

    Args:
        max_rate_deg_s: Largest rate v of a slew, deg/s.
        max_acceleration_deg_s2: Largest acceleration a, deg/s^2.
        settling_time: Time after a slew in which errors may settle, s.
        inertia: Inertia: 3 principal moments, or 9 numbers, kg m^2 in B.
        h: Length of a tick, s.
        tracking_rate_deg_s: Largest rate w of the line of sight to a tracked target, deg/s: 1 for orbits above 450 km.
        margin: Margin m of torque and momentum.
        axes: Spin axes of the wheels in B; they start at rest.

    Raises:
        ValueError: For numbers out of range, and a settling time of less than two ticks.
    """
    title = "from_slew_limits"
    v = math.radians(number(f"{title}: max_rate_deg_s", max_rate_deg_s, 1e-4, 100.0, unit="deg/s"))
    a = math.radians(number(f"{title}: max_acceleration_deg_s2", max_acceleration_deg_s2, 1e-4, 100.0, unit="deg/s^2"))
    w = math.radians(number(f"{title}: tracking_rate_deg_s", tracking_rate_deg_s, 1e-4, 100.0, unit="deg/s"))
    h = number(f"{title}: h", h, 0.0, unit="s", above=True)
    number(f"{title}: settling_time", settling_time, 2.0 * h, unit="s")
    number(f"{title}: margin", margin, 1.1, 100.0)
    moments = torch.tensor(inertia, dtype=torch.float64)
    if moments.shape not in ((3,), (9,)):
        raise ValueError(f"{title}: inertia={inertia!r} must be 3 or 9 numbers, kg m^2")
    tensor = torch.diag(moments) if moments.shape == (3,) else moments.view(3, 3)
    J = float(torch.linalg.eigvalsh(tensor)[-1])
    shares = torch.linalg.pinv(unit_rows(torch.tensor(axes, dtype=torch.float64)).mT).norm(dim=-1).tolist()
    wheels = [
        Wheel("custom", axis, margin * J * (v + w) * share, Omega_max=TOP_SPEED, u_max=margin * J * a * share)
        for axis, share in zip(axes, shares, strict=True)
    ]
    unsaturated = margin * a / attitude_rate(RATE_SHARE / h, 1.0) ** 2
    gains = propose_gains(tensor, wheels, h, "steering", slew=min(unsaturated, math.pi))
    decay = float(gains["K1"]) / 4.0
    gains["omega_max"] = min(margin * a / decay, 0.5 * margin * (v + w))
    return {
        "inertia": tensor.flatten().tolist(),
        "wheels": wheels,
        "wheelSpeeds": [0.0] * len(wheels),
        "maxWheelSpeed": TOP_SPEED,
        "inst_pHat_B": DOWN,
        "slewRate": v,
        "slewAcceleration": a,
        **gains,
    }


BENCH_MOMENTA = {12.0: "HR12", 25.0: "HR14", 50.0: "HR16", 75.0: "HR16", 100.0: "HR16"}
"""Momenta of AEOS-Bench's wheels, N m s, with a type that has them; types of the same momentum differ in nothing else."""

BENCH_MOMENTS = (50.0, 200.0)
"""Range of the principal moments of inertia of AEOS-Bench's satellites, kg m^2."""

DRAWS = 16
"""Draws of three moments, of which 85 % are those of a body: all fail with a probability of 5e-14."""


def aeos_bench(h: float = 1.0, law: str = "feedback", max_momentum: float = 50.0) -> dict[str, object]:
    """Return a class of AEOS-Bench's satellites: random bodies of 50 to 200 kg with three wheels on the body axes.

    AEOS-Bench (arXiv 2510.26297) draws wheels of five momenta; mass, inertia, wheel speeds, panels and power are random. Its
    gains, drawn too, oscillate with Basilisk's extra tick of delay, so gains are proposed for the extreme bodies.

    Args:
        h: Length of a tick, s.
        law: ``"feedback"`` or ``"steering"``.
        max_momentum: Momentum of each wheel at 6000 rpm, N m s: 12, 25, 50, 75 or 100.
    """
    if max_momentum not in BENCH_MOMENTA:
        raise ValueError(f"aeos_bench: max_momentum={max_momentum!r} N m s must be one of {list(BENCH_MOMENTA)}")
    wheels = [
        Wheel(f"Honeywell_{BENCH_MOMENTA[max_momentum]}", [float(k == j) for j in range(3)], max_momentum) for k in range(3)
    ]
    low, high = BENCH_MOMENTS
    return {
        "inertia": BenchInertia(),
        "wheels": wheels,
        "mass": Uniform(50.0, 200.0),
        "panelArea": Uniform(0.1, 0.5),
        "panelEfficiency": Uniform(0.1, 0.5),
        "nHat_B": BenchPanel(),
        "inst_pHat_B": DOWN,
        "batteryStorageCapacity": 3e6,
        "storedCharge_Init": 3e6,
        "rwBasePower": Uniform(5.0, 7.0, 3),
        "rwMechToElecEfficiency": Uniform(0.5, 0.6, 3),
        "rwElecToMechEfficiency": 1.0,
        "wheelSpeeds": Uniform(400.0, 750.0, 3),
        "maxWheelSpeed": 6000.0,
        **propose_gains([low, 0, 0, 0, high, 0, 0, 0, high], wheels, h, law),
    }


@dataclass(frozen=True)
class BenchInertia(Distribution):
    """Inertia of AEOS-Bench's satellites, diagonal, [n, 9] kg m^2: uniform moments, drawn again until a body can have them."""

    @override
    def draw(self, key: Key) -> Tensor:
        low, high = BENCH_MOMENTS
        moments = low + (high - low) * key.uniform(3 * DRAWS).unflatten(-1, (DRAWS, 3))
        possible = moments.sum(-1) >= 2.0 * moments.amax(-1)
        first = possible.byte().argmax(-1, keepdim=True)
        return torch.diag_embed(moments.take_along_dim(first.unsqueeze(-1), 1).squeeze(1)).flatten(-2)


@dataclass(frozen=True)
class BenchPanel(Distribution):
    """Normal of AEOS-Bench's solar panels, [n, 3] in B: ``(cos t cos p, cos t sin p, sin t)``, t in +-pi/2, p in 0 to pi."""

    @override
    def draw(self, key: Key) -> Tensor:
        u = key.uniform(2)
        p, t = math.pi * u[:, 0], math.pi * (u[:, 1] - 0.5)
        return torch.stack([torch.cos(t) * torch.cos(p), torch.cos(t) * torch.sin(p), torch.sin(t)], -1)


def _spacecraft(
    inertia: list[list[float]],
    wheels: list[Wheel],
    thrusters: list[Thruster],
    battery: float,
    h: float,
    law: str,
    **further: object,
) -> dict[str, object]:
    """Return the arguments of a body with wheels, thrusters and a battery of so many Wh, with proposed gains."""
    capacity = battery * 3600.0
    return {
        "inertia": inertia,
        "wheels": wheels,
        "thrusters": thrusters,
        "batteryStorageCapacity": capacity,
        "storedCharge_Init": Uniform(0.5 * capacity, 0.9 * capacity),
        "panelEfficiency": 0.28,
        "inst_pHat_B": DOWN,
        **further,
        **propose_gains(inertia, wheels, h, law, thrusters=thrusters),
    }
