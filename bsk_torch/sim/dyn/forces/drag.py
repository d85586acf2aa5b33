"""Drag on a box, gravity gradient, a constant disturbance torque, and forces of custom components.

Basilisk's facetDragDynamicEffector, GravityGradientEffector and extForceTorque.
"""

from __future__ import annotations

import dataclasses
import functools

import torch
from torch import Tensor

from bsk_torch.constants import MU_EARTH
from bsk_torch.sim.component import Arg, Bus, Component, Effector, Field, UserArguments, Values, vec
from bsk_torch.sim.dyn.forces.facets import AT_REST, DRAG_COEFFICIENT, FACETS_ARG, NUMBERS, described_facets, drag_of_facets
from bsk_torch.sim.dyn.power.panels import AREA, Panel, described_panels, of_panels
from bsk_torch.vec3 import Vec3, times


def _facet_areas(args: Values) -> dict[str, Tensor]:
    """Return areas A, m^2, and offsets l, m, of the default facets: six sides of the box and both faces of the panel.

    With width w, depth d, height h and the panel's area S: ``A = w d, h w, h d, S / 2`` and ``l = h / 2, d / 2, w / 2, h`` for
    the sides normal to x, y and z and the faces of the panel, which are normal to y.
    """
    w, d, h, panel = (args[name] for name in ("width", "depth", "height", "panelArea"))
    areas = torch.stack(torch.broadcast_tensors(w * d, h * w, h * d, panel / 2.0), -1)
    offsets = torch.stack(torch.broadcast_tensors(h / 2.0, d / 2.0, w / 2.0, h), -1)
    return {"facet_areas": areas, "facet_offsets": offsets, "drag_coefficient": args["dragCoeff"]}


def drag(bus: Bus, v_BN_B: Vec3) -> tuple[Vec3, Vec3]:
    """Return the drag force, N, and its torque, N m, in B for the velocity v_BN_B, m/s.

    ``F = -1/2 rho v^2 Cd A (n . v^) v^`` at the location l of every facet whose normal n has ``n . v^ > 0``, and ``L = l x F``
    (Vallado, section 8.6.2; the atmosphere does not rotate). Of two opposite facets one faces the flow, so ``A |v^_i|`` serves
    both, and the sign of v^_i tells on which side it sits. Both x facets sit at +height/2, as in recordings.
    """
    speed2 = v_BN_B.dot(v_BN_B)
    flow = v_BN_B / torch.sqrt(torch.clamp(speed2, min=AT_REST))
    x_side, y_side, z_side, panel = bus.facet_areas
    x_at, y_at, z_at, panel_at = bus.facet_offsets
    facing_x, facing_y, facing_z = torch.abs(flow.x), torch.abs(flow.y), torch.abs(flow.z)
    pressure = -0.5 * speed2 * bus.drag_coefficient * bus.density
    area = x_side * facing_x + (y_side + panel) * facing_y + z_side * facing_z
    sign_y, sign_z = torch.sign(flow.y), torch.sign(flow.z)
    arm = Vec3(
        x_side * facing_x * x_at,
        y_side * facing_y * y_at * sign_y + panel * facing_y * panel_at,
        z_side * facing_z * z_at * sign_z,
    )
    return flow * (pressure * area), arm.cross(flow) * pressure


def _latch_density(bus: Bus) -> None:
    bus.density = bus.density_message


def fitted_drag(arguments: UserArguments) -> Component:
    """Return the component of drag on the facets that the arguments as given describe, or on the default box."""
    listed, several = described_facets(arguments), described_panels(arguments)
    box = DRAG if several is None else drag_with_panels(several)
    return box if listed is None else drag_of_facets(box, listed)


@functools.cache
def drag_with_panels(several: tuple[Panel, ...]) -> Component:
    """Return the component of drag on the default box with a panel that has the area of ``several``."""

    def prepare(args: Values) -> dict[str, Tensor]:
        return _facet_areas({**args, "panelArea": args["panelArea"].sum(-1)})

    args = (of_panels(arg, several) if arg is AREA else arg for arg in DRAG.args)
    return dataclasses.replace(DRAG, args=tuple(args), prepare=prepare)


DRAG = Component(
    slot="drag",
    update=_latch_density,
    args=(DRAG_COEFFICIENT, AREA, FACETS_ARG, *NUMBERS),
    state=(Field("density", 1, "kg/m^3", "density that acts over the next tick"),),
    params=(Field("facet_areas", 4, "m^2"), Field("facet_offsets", 4, "m"), Field("drag_coefficient", 1, "-")),
    reads=("width", "depth", "height"),
    prepare=_facet_areas,
    integrated_only=True,
    at_start=True,
    fit=fitted_drag,
    effector=Effector(force=drag),
)
"""Drag on the default box with a panel, unless the arguments describe facets."""


def gravity_gradient(bus: Bus, r_CN_B: Vec3) -> Vec3:
    """Return the gravity-gradient torque, N m in B, ``L = 3 mu / |r|^3 x^ x (I x^)`` with ``x^ = r / |r|``.

    The inertia I is about the center of mass, at r from the Earth's center, m (Schaub and Junkins, section 4.6), as in Basilisk's
    GravityGradientEffector.
    """
    x = r_CN_B.unit()
    distance = r_CN_B.norm()
    return x.cross(times(bus.inertia_B, x.to(bus.dtype))) * (3.0 * MU_EARTH / (distance * distance * distance))


GRAVITY_GRADIENT = Component(slot="gravity_gradient", after="disturbance", effector=Effector(gradient=gravity_gradient))
"""The torque by which gravity turns a body toward the vertical."""

DISTURBANCE = Component(
    slot="disturbance",
    args=(Arg("disturbance_vector", None, "N m", "constant torque in B", "vector", -1.0, 1.0, missing=0.0, flown=(-1e9, 1e9)),),
    params=(vec("disturbance_torque_B", "N m"),),
    prepare=lambda args: {"disturbance_torque_B": args["disturbance_vector"]},
)


def add_force(bus: Bus, force_N: Vec3) -> None:
    """Add a force on the spacecraft, in newtons with components in N, constant over this tick.

    The hub integrates ``v' = a(r, t) + F_N / m`` with the sum ``external_force_N`` of all added forces. Components that add
    forces must run before it: ``before="hub"``, or in an earlier slot. The orbit must be integrated; if it is solved in advance,
    a component that adds a force raises a TypeError. Look-ahead (predicted windows and eclipses) does not include the force.
    """
    bus.external_force_N = bus.external_force_N + force_N if bus.has("external_force_N") else force_N


def check_force(bus: Bus, on_arc: bool) -> None:
    """Raise TypeError after a tick for a force that the hub has not felt."""
    if not bus.has("external_force_N"):
        return
    if on_arc:
        raise TypeError(
            "a component writes external_force_N, a force on the spacecraft, but the orbit was solved in advance, without it; "
            "pass orbit='integrated' to the environment, or write orbit = 'integrated' in the dynamics model"
        )
    if not (bus.has("force_is_felt") and bus.force_is_felt):
        raise TypeError(
            "a component writes external_force_N, a force on the spacecraft, after the hub, which would never feel it; give the "
            "component before='hub'"
        )
