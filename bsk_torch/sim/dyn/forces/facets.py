"""Flat facets: the surfaces of a spacecraft that drag and sunlight push.

Basilisk's facetDragDynamicEffector and facetSRPDynamicEffector, without articulation. Facets do not shade one another.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from bsk_torch._checks import number, vector
from bsk_torch.sim.component import Arg, Bus, Component, Effector, Field, UserArguments, Values
from bsk_torch.sim.dyn.axes import check_axis, described, of_each, unit_rows
from bsk_torch.vec3 import Mat3, Vec3

SUN_PRESSURE = 1368.0 / 299792458.0 * 149597870700.0**2
"""Pressure of sunlight times the square of the distance, N: 1368 W/m^2 at one astronomical unit, over the speed of light.

The flux is that of Basilisk's facetSRPDynamicEffector; its solar panels have 1361 W/m^2.
"""


@dataclass(frozen=True)
class Facet:
    """A flat surface of which one side is exposed; a thin plate has two facets.

    Raises:
        ValueError: For a negative area or coefficient, a normal of length zero, or more light reflected than comes in.

    Attributes:
        area: Area, m^2.
        normal: Outward normal in B, of any length.
        position: Center of pressure in B, m from its origin.
        dragCoeff: Drag coefficient.
        diffuseCoeff: Share of sunlight reflected in all directions.
        specularCoeff: Share of sunlight reflected as by a mirror. The rest is absorbed.
    """

    area: float
    normal: Sequence[float]
    position: Sequence[float]
    dragCoeff: float = 2.2
    diffuseCoeff: float = 0.0
    specularCoeff: float = 0.0

    def __post_init__(self) -> None:
        for name in ("area", "dragCoeff", "diffuseCoeff", "specularCoeff"):
            number(f"Facet: {name}", getattr(self, name), 0.0)
        if self.diffuseCoeff + self.specularCoeff > 1.0:
            raise ValueError(
                f"Facet: diffuseCoeff={self.diffuseCoeff:g} and specularCoeff={self.specularCoeff:g} are shares of the same "
                "light; their sum must be at most 1"
            )
        object.__setattr__(self, "normal", vector("Facet: normal", self.normal))
        object.__setattr__(self, "position", vector("Facet: position", self.position, zero=True))


def box_facets(size: Sequence[float], center: Sequence[float] = (0.0, 0.0, 0.0), **coefficients: float) -> list[Facet]:
    """Return the six facets of a box with sides along the axes of B.

    Args:
        size: Lengths of the sides along x, y and z, m.
        center: Center of the box in B, m.
        **coefficients: ``dragCoeff``, ``diffuseCoeff`` and ``specularCoeff`` of all facets.
    """
    if len(size) != 3 or len(center) != 3:
        raise ValueError(f"box_facets: size={size!r} and center={center!r} must be three numbers each, m in B")
    facets = []
    for k, sign in ((k, sign) for k in range(3) for sign in (1.0, -1.0)):
        normal = tuple(sign * float(k == j) for j in range(3))
        place = tuple(float(c) + 0.5 * float(s) * n for c, s, n in zip(center, size, normal, strict=True))
        facets.append(Facet(math.prod(size) / size[k], normal, place, **coefficients))
    return facets


FACETS_ARG = Arg("facets", None, "-", "surfaces that drag and sunlight push, a list of dyn.Facet; None: a box", "constant")

NUMBERS = (
    Arg("facetAreas", None, "m^2", "areas of the facets", low=0.0, high=1e6, shape=(None,)),
    Arg("facetNormals_B", None, "-", "their outward normals in B", low=-1e9, high=1e9, shape=(None, 3)),
    Arg("facetPositions_B", None, "m", "their centers of pressure in B", low=-1e4, high=1e4, shape=(None, 3)),
)
"""Numbers that replace those of ``facets``."""

LIGHT = (
    Arg("facetDiffuse", None, "-", "share of sunlight reflected in all directions", low=0.0, high=1.0, shape=(None,)),
    Arg("facetSpecular", None, "-", "share of sunlight reflected as by a mirror", low=0.0, high=1.0, shape=(None,)),
)

DRAG_COEFFICIENT = Arg("dragCoeff", 2.2, "-", "drag coefficient", low=0.0, high=1e3, flown=(-1e3, 1e3))

ATTRIBUTES = {
    "facetAreas": "area",
    "facetNormals_B": "normal",
    "facetPositions_B": "position",
    "dragCoeff": "dragCoeff",
    "facetDiffuse": "diffuseCoeff",
    "facetSpecular": "specularCoeff",
}
"""Attributes of facets that are the defaults of arguments."""


def described_facets(arguments: UserArguments) -> tuple[Facet, ...] | None:
    """Return the facets that arguments as given describe; None for the default box."""
    what = "a list of facets, such as [dyn.Facet(0.06, [1, 0, 0], [0.1, 0, 0])], or dyn.box_facets([0.2, 0.1, 0.34])"
    return described(arguments, "facets", NUMBERS, Facet, what)


def _of_facets(arg: Arg, listed: Sequence[Facet]) -> Arg:
    return of_each(arg, len(listed), tuple(getattr(facet, ATTRIBUTES[arg.name]) for facet in listed))


def _shape(args: Values) -> dict[str, Tensor]:
    return {
        "facet_area": args["facetAreas"],
        "facet_normals_B": unit_rows(args["facetNormals_B"]).flatten(-2),
        "facet_positions_B": args["facetPositions_B"].flatten(-2),
    }


def _shape_fields(count: int) -> tuple[Field, ...]:
    vectors = (Field(name, 3 * count, vectors=True) for name in ("facet_normals_B", "facet_positions_B"))
    return (Field("facet_area", count, "m^2", many=True), *vectors)


AT_REST = 1e-30  # square of a speed, m^2/s^2, below which there is no flow


def facet_drag(bus: Bus, v_BN_B: Vec3) -> tuple[Vec3, Vec3]:
    """Return the drag force, N, and its torque about B, N m, in B for the velocity v_BN_B, m/s.

    ``F = -1/2 rho v^2 Cd A (n . v^) v^`` at the location l of every facet whose normal n has ``n . v^ > 0``, and ``L = l x F``
    (Vallado, section 8.6.2; the atmosphere does not rotate).
    """
    speed2 = v_BN_B.dot(v_BN_B)
    flow = v_BN_B / torch.sqrt(torch.clamp(speed2, min=AT_REST))
    pressure = -0.5 * speed2 * bus.density
    total, arm = torch.zeros_like(speed2), Vec3.zeros_like(speed2)
    facets = zip(bus.facet_area, bus.facet_drag_coefficient, bus.facet_normals_B, bus.facet_positions_B, strict=True)
    for area, coefficient, normal, place in facets:
        faced = torch.clamp(normal.dot(flow), min=0.0) * (area * coefficient)
        total, arm = total + faced, arm + place * faced
    return flow * (pressure * total), arm.cross(flow) * pressure


@functools.cache
def drag_of_facets(box: Component, listed: tuple[Facet, ...]) -> Component:
    """Return the component of drag on facets, in place of that on the default ``box``."""
    count = len(listed)
    args = [_of_facets(arg, listed) if arg.name in ATTRIBUTES else arg for arg in box.args]
    return replace(
        box,
        args=tuple(args),
        params=(*_shape_fields(count), Field("facet_drag_coefficient", count, many=True)),
        prepare=lambda args: _shape(args) | {"facet_drag_coefficient": args["dragCoeff"]},
        check=check_axis("facetNormals_B"),
        effector=Effector(force=facet_drag),
    )


def sunlight_pressure(bus: Bus, BN: Mat3, r_BN_N: Vec3) -> tuple[Vec3, Vec3]:
    """Return the force of sunlight, N, and its torque about B, N m, in B.

    With the direction ``s = [BN] (r_SN - r_BN) / d`` of the Sun at the distance d, the illumination nu and the pressure
    ``p = 1368 W/m^2 / c (AU / d)^2``, every facet with ``n . s > 0`` feels, for its shares k_d and k_s of light that are
    reflected diffusely and specularly::

        F = -nu p A (n . s) ((1 - k_s) s + 2 (k_d / 3 + k_s (n . s)) n),    L = l x F

    (Schaub and Junkins, section 10.3, and Basilisk's facetSRPDynamicEffector.)
    """
    to_sun = bus.r_SN_N - r_BN_N
    distance2 = to_sun.dot(to_sun)
    s = BN @ (to_sun / torch.sqrt(distance2)).to(bus.dtype)
    pressure = (-SUN_PRESSURE / distance2).to(bus.dtype) * bus.illumination
    force = torque = Vec3.zeros_like(s.x)
    shares = zip(bus.facet_area, bus.facet_diffuse, bus.facet_specular, strict=True)
    for (area, diffuse, specular), normal, place in zip(shares, bus.facet_normals_B, bus.facet_positions_B, strict=True):
        cosine = torch.clamp(normal.dot(s), min=0.0)
        lit = area * cosine
        push = s * (lit * (1.0 - specular)) + normal * (2.0 * lit * (diffuse * (1.0 / 3.0) + specular * cosine))
        force, torque = force + push, torque + place.cross(push)
    return force * pressure, torque * pressure


@functools.cache
def sunlight_on_facets(listed: tuple[Facet, ...]) -> Component:
    """Return the component of the pressure of sunlight on facets."""
    count = len(listed)

    def check(args: Values) -> None:
        check_axis("facetNormals_B")(args)
        if bool((args["facetDiffuse"] + args["facetSpecular"] > 1.0).any()):
            raise ValueError("facetDiffuse and facetSpecular are shares of the same light; their sum must be at most 1")

    return Component(
        slot="sunlight_pressure",
        after="disturbance",
        args=(FACETS_ARG, *(_of_facets(arg, listed) for arg in (*NUMBERS, *LIGHT))),
        params=(*_shape_fields(count), *(Field(name, count, many=True) for name in ("facet_diffuse", "facet_specular"))),
        prepare=lambda args: _shape(args) | {"facet_diffuse": args["facetDiffuse"], "facet_specular": args["facetSpecular"]},
        check=check,
        effector=Effector(ambient=sunlight_pressure),
    )


def fitted_sunlight(arguments: UserArguments) -> Component:
    """Return the component for the facets that the arguments as given describe; ValueError without."""
    listed = described_facets(arguments)
    if listed is None:
        raise ValueError(
            "sat_args: facets=None, but sunlight pushes facets (dyn.SolarPressureDynModel); list them, such as "
            "facets=dyn.box_facets([0.2, 0.1, 0.34])"
        )
    return sunlight_on_facets(listed)


SUNLIGHT_PRESSURE = Component(
    slot="sunlight_pressure", after="disturbance", args=(FACETS_ARG, *NUMBERS, *LIGHT), fit=fitted_sunlight
)
"""The pressure of sunlight on ``facets``."""
