"""Errors of the navigation: what guidance laws know of position, velocity, attitude and rate. Basilisk's simpleNav.

Observations, access, power and aliveness are those of the true state. The errors are random walks: with 18 standard normal
numbers n of a tick, each error x of them becomes ``A x + P n``, cut off at its bound. Nothing pulls them back to zero, and P does
not depend on the length of a tick.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from dataclasses import replace
from numbers import Real
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_add
from bsk_torch.rand import Distribution, Uniform, first_key
from bsk_torch.sim.component import Arg, Bus, Component, Field, UserArguments, Values
from bsk_torch.sim.dyn.generators import combined_normals, combined_start, minstd_start, polar_normals
from bsk_torch.sim.dyn.hub import given_numbers
from bsk_torch.sim.faults.declared import may_change
from bsk_torch.vec3 import Vec3

ERRORS = 18
"""Errors of position, velocity, attitude and rate, three each, then of the Sun's direction and of velocity changes."""

Planes = tuple[Tensor, ...]


class Navigated(NamedTuple):
    """What the flight software knows of the motion of B relative to N; units and frames as those of the state."""

    r_BN_N: Vec3
    v_BN_N: Vec3
    sigma_BN: Vec3
    omega_BN_B: Vec3


def navigated(bus: Bus) -> Navigated:
    """Return what guidance laws know of the motion: the true state, unless there are errors of navigation."""
    if bus.has("navigated"):
        estimate: Navigated = bus.navigated
        return estimate
    return Navigated(bus.r_BN_N, bus.v_BN_N, bus.sigma_BN, bus.omega_BN_B)


def navigation_numbers(
    position: float | Sequence[float] = 0.0,
    velocity: float | Sequence[float] = 0.0,
    attitude: float | Sequence[float] = 0.0,
    rate: float | Sequence[float] = 0.0,
) -> list[float]:
    """Return 18 numbers for ``PMatrix``, ``walkBounds`` or ``navigationBias``, in their order; the last six are zero.

    Args:
        position: Of the position, m in N; one number, or three.
        velocity: Of the velocity, m/s in N, likewise.
        attitude: Of the attitude, MRP, likewise.
        rate: Of the rate, rad/s in B, likewise.

    Raises:
        ValueError: For neither one number nor three.
    """
    numbers: list[float] = []
    for name, value in (("position", position), ("velocity", velocity), ("attitude", attitude), ("rate", rate)):
        three = [value] * 3 if isinstance(value, Real) else list(value)  # type: ignore[arg-type]
        if len(three) != 3:
            raise ValueError(f"navigation_numbers: {name}={value!r} must be one number, or three")
        numbers += [float(number) for number in three]
    return [*numbers, *[0.0] * (ERRORS - len(numbers))]


class WalkForm(NamedTuple):
    """What decides the operations of a tick."""

    matrix: bool = False  # whether `PMatrix` is given as a matrix, otherwise as its diagonal
    full: bool = False  # whether numbers off its diagonal act
    position: bool = False  # whether errors of velocity are added to those of position
    attitude: bool = False  # whether errors of rate are added to those of attitude
    seeded: bool = False  # whether the random numbers are Basilisk's
    biased: bool = False  # whether there are constant errors
    scaled: bool = False  # whether P is multiplied by a factor


def _steps(bus: Bus, form: WalkForm, normals: Sequence[Tensor]) -> list[Tensor]:
    if form.full:
        rows = [bus.nav_P[k : k + ERRORS] for k in range(0, ERRORS * ERRORS, ERRORS)]
        steps = [functools.reduce(operator.add, (p * n for p, n in zip(row, normals, strict=True))) for row in rows]
    else:
        steps = [p * n for p, n in zip(bus.nav_P, normals, strict=True)]
    return [bus.nav_scale * step for step in steps] if form.scaled else steps


def _walked(bus: Bus, form: WalkForm, normals: Sequence[Tensor]) -> Planes:
    x = list(bus.nav_errors)
    moved = list(x)
    for to, source, on in ((0, 3, form.position), (6, 9, form.attitude)):
        for k in range(3 if on else 0):
            moved[to + k] = x[to + k] + bus.h * x[source + k]
    errors = []
    for error, step, bound in zip(moved, _steps(bus, form, normals), bus.nav_bounds, strict=True):
        free = error + step
        errors.append(torch.where(bound > 0.0, torch.minimum(torch.maximum(free, -bound), bound), free))
    return tuple(errors)


@functools.cache
def walk(form: WalkForm) -> Callable[[Bus], None]:
    """Return the update of the errors."""

    def err(bus: Bus) -> None:
        """Draw the errors of this tick, and write what guidance laws know: ``r + x_r``, ``v + x_v``, ``omega + x_omega``.

        The attitude is the true one followed by the rotation x_sigma.
        """
        pairs = ERRORS // 2
        if form.seeded:
            normals, x = polar_normals(bus.nav_generator[0], pairs)
            bus.nav_generator = (x,)
        else:
            normals, bus.nav_generator = combined_normals(bus.nav_generator, pairs)
        bus.nav_errors = _walked(bus, form, normals)
        total = bus.nav_errors
        if form.biased:
            total = tuple(x + bias for x, bias in zip(total, bus.nav_bias, strict=True))
        r, v, sigma, omega = (Vec3(*total[k : k + 3]) for k in (0, 3, 6, 9))
        bus.navigated = Navigated(
            bus.r_BN_N + r,
            bus.v_BN_N + v,
            mrp_add(bus.sigma_BN, sigma.to(bus.dtype)),
            bus.omega_BN_B + omega.to(bus.dtype),
        )

    return err


ZEROS = (0.0,) * ERRORS

ARGS = (
    Arg("PMatrix", ZEROS, "m, m/s, -, rad/s", "standard deviations of the steps of the errors, or a matrix", shape=(ERRORS,)),
    Arg("walkBounds", ZEROS, "m, m/s, -, rad/s", "largest errors; no limit where not positive", shape=(ERRORS,)),
    Arg("crossTrans", False, "-", "whether position errors grow with those of velocity", "constant", choices=(True, False)),
    Arg("crossAtt", False, "-", "whether attitude errors grow with those of rate", "constant", choices=(True, False)),
    Arg("RNGSeed", None, "-", "seed of Basilisk's random numbers; None: drawn", low=0, high=2**32 - 1, whole=True),
    Arg("navigationBias", None, "m, m/s, -, rad/s", "constant errors of navigation; None: none", shape=(ERRORS,)),
    Arg("navigationNoise", None, "-", "factor of PMatrix; None: one", low=0.0, high=1e9),
)
"""Arguments of the errors; ``navigationBias`` and ``navigationNoise`` are what faults change."""

START = Arg(
    "navigationStart", Uniform(0.0, 1.0, 6), "-", "where the random numbers of an episode start", low=0.0, high=1.0, shape=(6,)
)
"""Six numbers, drawn for each episode, where ``RNGSeed`` is None."""


def _matrix_form(matrix_argument: object) -> tuple[bool, bool]:
    """Return whether ``PMatrix`` is a matrix, and whether numbers off its diagonal may act.

    What functions return is not known before they are called, and anything but a vector takes a matrix.
    """
    P = given_numbers(matrix_argument)
    if P is not None:
        matrix = P.ndim == 2
        return matrix, matrix and (P.shape != (ERRORS, ERRORS) or bool((P - torch.diag(P.diagonal())).any()))
    matrix = (
        np.ndim(matrix_argument.draw(first_key(1))) == 3
        if isinstance(matrix_argument, Distribution)
        else callable(matrix_argument)
    )
    return matrix, matrix


def walk_form(arguments: UserArguments) -> WalkForm:
    """Return what decides the operations of a tick, from the arguments as given."""
    matrix, full = (False, False) if may_change(arguments, "PMatrix") else _matrix_form(arguments["PMatrix"])
    return WalkForm(
        matrix=matrix,
        full=full,
        position=arguments["crossTrans"] is True,
        attitude=arguments["crossAtt"] is True,
        seeded=arguments["RNGSeed"] is not None,
        biased=arguments["navigationBias"] is not None,
        scaled=arguments["navigationNoise"] is not None,
    )


def _initial(form: WalkForm, args: Values) -> dict[str, Tensor]:
    generator = minstd_start(args["RNGSeed"]).unsqueeze(-1) if form.seeded else combined_start(args["navigationStart"])
    return {"nav_errors": torch.zeros(1, ERRORS, dtype=torch.float64), "nav_generator": generator}


def _prepare(form: WalkForm, args: Values) -> dict[str, Tensor]:
    P = args["PMatrix"]
    P = P.flatten(-2) if form.full else P.diagonal(dim1=-2, dim2=-1) if form.matrix else P
    parameters = {"nav_P": P, "nav_bounds": args["walkBounds"]}
    parameters |= {"nav_bias": args["navigationBias"]} if form.biased else {}
    return parameters | ({"nav_scale": args["navigationNoise"]} if form.scaled else {})


def _check(form: WalkForm, args: Values) -> None:
    P = args["PMatrix"]
    if form.matrix and not form.full and bool((P - torch.diag_embed(P.diagonal(dim1=-2, dim2=-1))).any()):
        raise ValueError(
            "PMatrix has numbers off the diagonal, but that of the first satellite of the type has none, which decides what is "
            "built; give it a small number there, too"
        )


@functools.cache
def navigation_errors(form: WalkForm) -> Component:
    """Return the component of errors of a form."""
    P, bounds, position, attitude, seed, bias, noise = ARGS
    P = replace(P, shape=(ERRORS, ERRORS), diagonal=True) if form.matrix else P
    bias = replace(bias, default=ZEROS) if form.biased else bias
    noise = replace(noise, default=1.0) if form.scaled else noise
    params = [Field("nav_P", ERRORS * (ERRORS if form.full else 1), many=True, exact=True)]
    params += [Field("nav_bounds", ERRORS, many=True, exact=True)]
    params += [Field("nav_bias", ERRORS, many=True, exact=True)] if form.biased else []
    params += [Field("nav_scale", 1, "-", exact=True)] if form.scaled else []
    return Component(
        slot="navigation_errors",
        before="navigation",
        at_start=True,
        update=walk(form),
        args=(P, bounds, position, attitude, seed, bias, noise, *(() if form.seeded else (START,))),
        state=(
            Field("nav_errors", ERRORS, "m, m/s, -, rad/s", "errors of navigation", many=True, exact=True),
            Field("nav_generator", 1 if form.seeded else 6, "-", "state of the random numbers", many=True, exact=True),
        ),
        params=tuple(params),
        initial=functools.partial(_initial, form),
        prepare=functools.partial(_prepare, form),
        check=functools.partial(_check, form),
        fit=lambda arguments: navigation_errors(walk_form(arguments)),
    )


NAVIGATION_ERRORS = navigation_errors(WalkForm())  # errors of navigation; what acts follows from the arguments
