"""Solar panels, Basilisk's simpleSolarPanel: the default one, or any number, fixed or turning about an axis.

Panels neither shade one another nor are shaded by the body. Turning panels have no mass: nothing acts on the body.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from bsk_torch._checks import number, vector
from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.constants import AU, SOLAR_FLUX
from bsk_torch.sim.component import Arg, Bus, Component, Field, UserArguments, Values, vec
from bsk_torch.sim.dyn.axes import AXIS_BOUNDS, check_axis, described, of_each, unit_rows
from bsk_torch.sim.faults.declared import Fault
from bsk_torch.vec3 import Vec3

SQUARE = 1e-6  # largest cosine of the angle between the normal of a turning panel and its axis

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Panel:
    """A solar panel, fixed to the body or turning about an axis toward the Sun.

    Raises:
        ValueError: For a negative area, an efficiency outside of [0, 1], a vector of length zero, an axis that is not
            perpendicular to the normal or has no rate, and stops that do not include the angle.

    Attributes:
        normal: Normal of the side with cells in B, of any length; of a turning panel, at the angle zero.
        area: Area, m^2.
        efficiency: Share of sunlight turned into power.
        axis: Axis in B about which it turns, of any length; None for a fixed panel.
        rate: Largest rate about the axis, rad/s.
        stops: Smallest and largest angle about the axis, rad, at most a full turn apart; None if it turns on and on.
        angle: Angle about the axis at reset, rad.
    """

    normal: Sequence[float]
    area: float
    efficiency: float
    axis: Sequence[float] | None = None
    rate: float | None = None
    stops: Sequence[float] | None = None
    angle: float = 0.0

    def __post_init__(self) -> None:
        number("Panel: area", self.area, 0.0, 1e6, unit="m^2")
        number("Panel: efficiency", self.efficiency, 0.0, 1.0)
        number("Panel: angle", self.angle, unit="rad")
        object.__setattr__(self, "normal", vector("Panel: normal", self.normal))
        if self.axis is None:
            for name, default in (("rate", None), ("stops", None), ("angle", 0.0)):
                if getattr(self, name) != default:
                    raise ValueError(f"Panel: {name}={getattr(self, name)!r} is given without axis; give axis= to turn about")
            return
        object.__setattr__(self, "axis", vector("Panel: axis", self.axis))
        cosine = (
            sum(a * b for a, b in zip(self.axis, self.normal, strict=True)) / math.hypot(*self.axis) / math.hypot(*self.normal)
        )
        if abs(cosine) > SQUARE:
            raise ValueError(
                f"Panel: axis={self.axis} is {math.degrees(math.acos(max(-1.0, min(cosine, 1.0)))):.3g} degrees from "
                f"normal={self.normal}; it must be perpendicular"
            )
        if self.rate is None:
            raise ValueError("Panel: axis is given without rate; give the largest rate= about it, rad/s")
        number("Panel: rate", self.rate, 0.0, unit="rad/s")
        if self.stops is not None:
            self._check_stops(self.stops)

    def _check_stops(self, stops: Sequence[float]) -> None:
        pair = tuple(number("Panel: stops", stop, unit="rad") for stop in stops)
        if len(pair) != 2 or not 0.0 < pair[1] - pair[0] <= 2.0 * math.pi + 1e-12:
            raise ValueError(f"Panel: stops={stops!r} must be the smallest and the largest angle, rad, at most 2 pi apart")
        if not pair[0] <= self.angle <= pair[1]:
            raise ValueError(f"Panel: angle={self.angle:g} must lie within stops={pair}, rad")
        object.__setattr__(self, "stops", pair)

    @property
    def kind(self) -> Kind:
        """How it moves."""
        return "fixed" if self.axis is None else "free" if self.stops is None else "stopped"


Kind = Literal["fixed", "free", "stopped"]  # whether a panel is fixed, turns freely, or turns between stops


PANELS_ARG = Arg("panels", None, "-", "solar panels, a list of dyn.Panel; None: one of panelArea with normal nHat_B", "constant")

NUMBERS = (
    Arg("panelNormals_B", None, "-", "normals of the panels in B, at the angle zero", "scalar", *AXIS_BOUNDS, shape=(None, 3)),
    Arg("panelRates", None, "rad/s", "largest rates of turning panels", low=0.0, high=1e6, shape=(None,)),
    Arg("panelAngles", None, "rad", "angles of turning panels at reset", low=-1e6, high=1e6, shape=(None,)),
)
"""Numbers that replace those of ``panels``, together with panelArea and panelEfficiency."""

AREA = Arg("panelArea", 1.0, "m^2", "area of the solar panel", low=0.0, high=1e6)

EFFICIENCY = Arg("panelEfficiency", 0.2, "-", "share of sunlight turned into power", low=0.0, high=1.0, flown=(-1e6, 1e6))

SUN_AXIS = Arg("nHat_B", (0.0, 0.0, -1.0), "-", "panel normal in B", "vector", *AXIS_BOUNDS)


def described_panels(arguments: UserArguments) -> tuple[Panel, ...] | None:
    """Return the panels that arguments as given describe; None for the default one."""
    what = "a list of panels, such as [dyn.Panel([0, 0, -1], 0.12, 0.29)]"
    return described(arguments, "panels", NUMBERS, Panel, what)


def of_panels(arg: Arg, listed: Sequence[Panel]) -> Arg:
    """Return an argument of which there is one for each panel."""
    turns = all(part.axis is not None for part in listed)
    defaults: dict[str, tuple[object, ...]] = {
        "panelArea": tuple(float(part.area) for part in listed),
        "panelEfficiency": tuple(float(part.efficiency) for part in listed),
        "panelNormals_B": tuple(part.normal for part in listed),
        "panelRates": tuple(float(part.rate or 0.0) for part in listed),
        "panelAngles": tuple(float(part.angle) for part in listed),
    }
    each = of_each(arg, len(listed), defaults[arg.name])
    return each if turns or arg.name in ("panelArea", "panelEfficiency") else replace(each, spread=False)


STARTS, ASCENTS = 256, 200
"""Directions, evenly distributed, from which the best one is searched for, and largest number of steps from each."""


def best_direction(listed: Sequence[Panel]) -> Triple:
    """Return the direction of the Sun in B, of length one, in which panels give the most power, turned as far as they can.

    The power in a direction s, ``f(s) = sum_i A_i eta_i max_theta max(n_i(theta) . s, 0)``, is convex. So the direction of its
    gradient, ``g(s) = sum_i A_i eta_i n_i`` over the panels that are lit, has at least the same power::

        f(g / |g|) >= g . g / |g| >= g . s = f(s)

    Steps ``s <- g / |g|``, longer ones where they are better, therefore ascend, from directions all around. Of directions that
    are equally good, the first one found is taken, starting with that of ``sum_i A_i eta_i n_i``.
    """
    gain = torch.tensor([part.area * part.efficiency for part in listed], dtype=torch.float64)
    normals = unit_rows(torch.tensor([part.normal for part in listed], dtype=torch.float64))
    across = torch.linalg.cross(_axes(listed), normals)
    held = [(part.angle, part.angle) if not part.rate else part.stops or (-math.pi, math.pi) for part in listed]
    low, high = torch.tensor(held, dtype=torch.float64).unbind(-1)

    def gradient(s: Tensor) -> Tensor:
        """Gradient [S, 3] of the power in directions s [S, 3]."""
        middle = 0.5 * (low + high)
        wanted = torch.atan2(s @ across.mT, s @ normals.mT) - middle
        angle = (middle + wanted - _TURN * torch.round(wanted / _TURN)).clamp(min=low, max=high).unsqueeze(-1)
        facing = torch.cos(angle) * normals + torch.sin(angle) * across
        lit = (facing * s.unsqueeze(-2)).sum(-1) > 0.0
        return (facing * (gain * lit).unsqueeze(-1)).sum(-2)

    begin = torch.cos(_each(listed, "angle")) * normals + torch.sin(_each(listed, "angle")) * across
    total = (gain.unsqueeze(-1) * begin).sum(0, keepdim=True)
    s = torch.cat([*([unit_rows(total)] if total.norm() > 1e-9 * gain.sum() else []), begin, _around(STARTS)])
    reach = torch.zeros(len(s), 1, dtype=torch.float64)
    for _ in range(ASCENTS):
        slope = gradient(s)
        length = slope.norm(dim=-1, keepdim=True)
        near = torch.where(length > 0.0, slope / length.clamp(min=1e-300), s)
        far = unit_rows(near + reach * (near - s))
        better = (gradient(far) * far).sum(-1, keepdim=True) > (gradient(near) * near).sum(-1, keepdim=True)
        old, s = s, torch.where(better, far, near)
        reach = torch.where(better | (reach == 0.0), 2.0 * reach + 1.0, torch.zeros_like(reach)).clamp(max=1e3)
        if bool((s - old).abs().amax() < 1e-13):
            break
    power = (gradient(s) * s).sum(-1)
    best = s[int(torch.nonzero(power >= power.max() * (1.0 - 1e-9))[0])]
    return tuple(best.tolist())


_TURN = 2.0 * math.pi


def _around(count: int) -> Tensor:
    """Return directions spread evenly over all of them, on a spiral, [count, 3]."""
    k = torch.arange(count, dtype=torch.float64) + 0.5
    z, turn = 1.0 - 2.0 * k / count, k * (math.pi * (3.0 - math.sqrt(5.0)))
    radius = torch.sqrt(1.0 - z * z)
    return torch.stack([radius * torch.cos(turn), radius * torch.sin(turn), z], -1)


def _each(listed: Sequence[Panel], name: str) -> Tensor:
    return torch.tensor([getattr(part, name) for part in listed], dtype=torch.float64).unsqueeze(-1)


def _axes(listed: Sequence[Panel]) -> Tensor:
    """Return the axes of panels, [P, 3], of length one; those of fixed ones are zero."""
    axes = [(0.0, 0.0, 0.0) if part.axis is None else part.axis for part in listed]
    table = torch.tensor(axes, dtype=torch.float64)
    return table / table.norm(dim=-1, keepdim=True).clamp(min=1e-300)


def _sun_in_B(bus: Bus) -> tuple[Vec3, Tensor]:
    """Return the direction of the Sun in B, of length one, and the square of its distance, m^2."""
    to_sun = bus.r_SN_N - bus.r_BN_N
    distance2 = to_sun.dot(to_sun)
    s_hat_B = mrp_to_dcm(bus.sigma_BN) @ (to_sun / torch.sqrt(distance2)).to(bus.dtype)
    return s_hat_B, distance2


def collect_sunlight(bus: Bus) -> None:
    """Start the power balance, W, with the solar panel.

    ``P = 1361 W/m^2 (AU / d)^2 A eta nu max(n . s^, 0)`` with the area A, m^2, the efficiency eta, the illumination nu of
    :mod:`bsk_torch.astro.eclipse`, the panel's normal n in B and the direction ``s^ = [BN] (r_SN - r_BN) / d`` of the Sun, both
    positions at the end of the tick.
    """
    s_hat_B, distance2 = _sun_in_B(bus)
    cosine = torch.clamp(s_hat_B.dot(bus.panel_normal_B), min=0.0)
    bus.power = (SOLAR_FLUX * AU * AU / distance2).to(bus.dtype) * bus.panel_gain * bus.illumination * cosine


def turned(angle: Tensor, wanted: Tensor, most: Tensor, stops: tuple[Tensor, Tensor] | None) -> Tensor:
    """Return the angle of a panel, rad, after a tick in which it turned toward the ``wanted`` one by at most ``most``.

    Between ``stops``, it turns to the allowed angle nearest to the wanted one; otherwise the short way, and the angle is kept in
    [-pi, pi].
    """
    if stops is None:
        return _wrapped(angle + torch.minimum(torch.maximum(_wrapped(wanted - angle), -most), most))
    low, high = stops
    middle = 0.5 * (low + high)
    goal = torch.minimum(torch.maximum(middle + _wrapped(wanted - middle), low), high)
    return angle + torch.minimum(torch.maximum(goal - angle, -most), most)


def _wrapped(angle: Tensor) -> Tensor:
    return angle - _TURN * torch.round(angle * (1.0 / _TURN))


@functools.cache
def sunlight_on_panels(kinds: tuple[Kind, ...]) -> Callable[[Bus], None]:
    """Return the update of several panels."""

    def collect(bus: Bus) -> None:
        """Turn panels toward the Sun, and start the power balance, W, with the power of all panels.

        Each has the power of :func:`collect_sunlight`. The normal n of a panel with axis e turns by the angle theta from n_0, at
        most by its rate times the tick, toward the angle at which it faces the Sun best::

            n = cos(theta) n_0 + sin(theta) e x n_0,    theta* = atan2(s . (e x n_0), s . n_0)
        """
        s_hat_B, distance2 = _sun_in_B(bus)
        gains, angles, stopped = torch.zeros_like(s_hat_B.x), list[Tensor](), 0
        for kind, gain, normal in zip(kinds, bus.panel_gain, bus.panel_normals_B, strict=True):
            cosine = s_hat_B.dot(normal)
            if kind != "fixed":
                k, across = len(angles), s_hat_B.dot(bus.panel_across_B[len(angles)])
                stops = (bus.panel_lowest[stopped], bus.panel_highest[stopped]) if kind == "stopped" else None
                stopped += kind == "stopped"
                angles.append(turned(bus.panel_angle[k], torch.atan2(across, cosine), bus.panel_rate[k] * bus.h, stops))
                cosine = torch.cos(angles[k]) * cosine + torch.sin(angles[k]) * across
            gains = gains + gain * torch.clamp(cosine, min=0.0)
        if angles:
            bus.panel_angle = tuple(angles)
        bus.power = (SOLAR_FLUX * AU * AU / distance2).to(bus.dtype) * bus.illumination * gains

    return collect


def _check_faults(arguments: UserArguments, listed: Sequence[Panel]) -> None:
    """Raise ValueError for faults of panels that would not do what they say."""
    for fault in arguments.get("faults") or ():
        if not isinstance(fault, Fault):
            continue
        if "nHat_B" in fault.arguments and fault.slots == ("panel",):
            raise ValueError(
                f"fault {fault.name!r} changes nHat_B of the panel, but sat_args has a list of panels; name one of them: "
                "faults.stuck_panel(normal, panel=0)"
            )
        parts = range(len(listed)) if fault.index is None else [fault.index]
        if "panelNormals_B" in fault.arguments and any(listed[k].axis is not None for k in parts if k < len(listed)):
            raise ValueError(
                f"fault {fault.name!r} changes the normal of a panel that turns; faults.stuck_panel(panel=k) stops panel k where "
                "it is"
            )


@functools.cache
def panel_set(listed: tuple[Panel, ...]) -> Component:
    """Return the component of several panels; ``listed`` are the defaults of its arguments."""
    count, kinds = len(listed), tuple(part.kind for part in listed)
    turning = [k for k, kind in enumerate(kinds) if kind != "fixed"]
    stopped = [part for part in listed if part.kind == "stopped"]
    stops = torch.tensor([part.stops for part in stopped], dtype=torch.float64).reshape(len(stopped), 2)
    axes, n = _axes(listed)[turning], len(turning)
    state = (Field("panel_angle", n, "rad", "angles of turning panels", many=True),) if turning else ()
    params = [Field("panel_gain", count, "m^2", many=True), Field("panel_normals_B", 3 * count, vectors=True)]
    params += [Field("panel_across_B", 3 * n, vectors=True), Field("panel_rate", n, "rad/s", many=True)] if turning else []
    params += [Field(name, len(stopped), "rad", many=True) for name in ("panel_lowest", "panel_highest")] if stopped else []

    def prepare(args: Values) -> dict[str, Tensor]:
        normals = unit_rows(args["panelNormals_B"])
        return {
            "panel_gain": args["panelArea"] * args["panelEfficiency"],
            "panel_normals_B": normals.flatten(-2),
            "panel_across_B": torch.linalg.cross(axes.expand_as(normals[:, turning]), normals[:, turning]).flatten(-2),
            "panel_rate": args["panelRates"][:, turning],
            "panel_lowest": stops[:, 0].unsqueeze(0),
            "panel_highest": stops[:, 1].unsqueeze(0),
        }

    return Component(
        slot="panel",
        update=sunlight_on_panels(kinds),
        args=(
            PANELS_ARG,
            *(of_panels(arg, listed) for arg in (AREA, EFFICIENCY, *NUMBERS)),
            replace(SUN_AXIS, default=best_direction(listed), doc="direction in B to point at the Sun"),
        ),
        state=state,
        params=tuple(params),
        initial=lambda args: {"panel_angle": args["panelAngles"][:, turning]} if turning else {},
        prepare=prepare,
        check=functools.partial(_check, listed),
    )


def _check(listed: Sequence[Panel], args: Values) -> None:
    check_axis("nHat_B")(args)
    check_axis("panelNormals_B")(args)
    cosine = (unit_rows(args["panelNormals_B"]) * _axes(listed)).sum(-1).abs()
    if bool((cosine > SQUARE).any()):
        raise ValueError(
            f"panelNormals_B: the normal of panel {int(cosine.amax(0).argmax())} is not perpendicular to the axis about which it "
            "turns; draw panelAngles instead"
        )
    for k, part in enumerate(listed):
        angles, rates = args["panelAngles"][:, k], args["panelRates"][:, k]
        if part.axis is None and bool(((angles != 0.0) | (rates != 0.0)).any()):
            raise ValueError(f"panelAngles and panelRates must be 0 for panel {k}, which is fixed; give it an axis in panels")
        low, high = part.stops or (-math.inf, math.inf)
        if bool(((angles < low) | (angles > high)).any()):
            raise ValueError(f"panelAngles: panel {k} must start between its stops, {low:g} and {high:g} rad")


def fitted_panels(arguments: UserArguments) -> Component:
    """Return the component of the panels that the arguments as given describe."""
    listed = described_panels(arguments)
    if listed is None:
        return PANEL
    _check_faults(arguments, listed)
    return panel_set(listed)


PANEL = Component(
    slot="panel",
    update=collect_sunlight,
    args=(AREA, EFFICIENCY, SUN_AXIS, PANELS_ARG, *NUMBERS),
    params=(Field("panel_gain", 1, "m^2"), vec("panel_normal_B")),
    prepare=lambda args: {
        "panel_gain": args["panelArea"] * args["panelEfficiency"],
        "panel_normal_B": unit_rows(args["nHat_B"]),
    },
    check=check_axis("nHat_B"),
    fit=fitted_panels,
)
"""The default panel, unless the arguments describe others."""
