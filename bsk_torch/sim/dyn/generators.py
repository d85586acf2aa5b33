"""Random numbers within ticks: generators whose state is a few planes, and whose integers are exact in float64.

A generator belongs to a row: its numbers depend on where it started, never on other rows. All products are below 2**53.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.vec3 import only

Planes = tuple[Tensor, ...]

MINSTD, MINSTD_FACTOR = 2147483647.0, 48271.0  # modulus and factor of C++'s `minstd_rand`

MINSTD_RANGE = MINSTD - 1.0

ATTEMPTS = 48  # pairs that polar_normals draws at most for nine normal pairs: fewer suffice but for once in 1e20 ticks
MODULI = 4294967087.0, 4294944443.0  # moduli of both parts of MRG32k3a


def modulo(product: Tensor, modulus: float) -> Tensor:
    """Return a whole number modulo another one; a quotient that rounding has moved by one is corrected."""
    rest = product - torch.floor(product * (1.0 / modulus)) * modulus
    rest = torch.where(rest < 0.0, rest + modulus, rest)
    return torch.where(rest >= modulus, rest - modulus, rest)


def combined_start(share: Tensor) -> Tensor:
    """Return states [n, 6] of the generator for numbers in [0, 1), [n, 6]: from 1 to below the moduli."""
    moduli = torch.tensor(MODULI, dtype=torch.float64).repeat_interleave(3)
    return torch.floor(share * (moduli - 1.0)) + 1.0


def combined_uniform(state: Planes) -> tuple[Tensor, Planes]:
    """Return a uniform number in (0, 1) with 32 bits, and the next state, of six planes.

    L'Ecuyer's MRG32k3a, with a period of 2**191 (Operations Research 47(1), 1999): ``x_k = 1403580 x_(k-2) - 810728 x_(k-3)``
    modulo m1, ``y_k = 527612 y_(k-1) - 1370589 y_(k-3)`` modulo m2, and ``u = (x_k - y_k mod m1) / (m1 + 1)``, m1 / (m1 + 1)
    where the difference is zero.
    """
    x3, x2, x1, y3, y2, y1 = state
    x = modulo(1403580.0 * x2 - 810728.0 * x3, MODULI[0])
    y = modulo(527612.0 * y1 - 1370589.0 * y3, MODULI[1])
    difference = torch.where(x > y, x - y, x - y + MODULI[0])
    return difference / (MODULI[0] + 1.0), (x2, x1, x, y2, y1, y)


def combined_normals(state: Planes, pairs: int) -> tuple[list[Tensor], Planes]:
    """Return two standard normal numbers for each of ``pairs``, by the Box-Muller transform, and the next state."""
    normals: list[Tensor] = []
    for _ in range(pairs):
        first, state = combined_uniform(state)
        second, state = combined_uniform(state)
        radius, angle = torch.sqrt(-2.0 * torch.log(first)), 2.0 * math.pi * second
        normals += [radius * torch.cos(angle), radius * torch.sin(angle)]
    return normals, state


class Polar(NamedTuple):
    """Generator x, how many points in the unit circle it has found, and these points."""

    x: Tensor
    found: Tensor
    points: Planes


def minstd_start(seed: Tensor) -> Tensor:
    """Return the state of C++'s ``minstd_rand`` for seeds: modulo 2**31 - 1, and 1 in place of 0."""
    state = torch.remainder(seed, MINSTD)
    return torch.where(state == 0.0, torch.ones_like(state), state)


def _canonical(x: Tensor) -> tuple[Tensor, Tensor]:
    """Return a uniform number in [0, 1) of two numbers of ``minstd_rand``, as libstdc++ does, and the next state."""
    low = modulo(MINSTD_FACTOR * x, MINSTD)
    high = modulo(MINSTD_FACTOR * low, MINSTD)
    return ((low - 1.0) + (high - 1.0) * MINSTD_RANGE) / (MINSTD_RANGE * MINSTD_RANGE), high


def _attempt(polar: Polar) -> Polar:
    """Return what is found after another point of the square, which counts in the unit circle."""
    first, x = _canonical(polar.x)
    second, x = _canonical(x)
    X, Y = 2.0 * first - 1.0, 2.0 * second - 1.0
    square = X * X + Y * Y
    inside = (square <= 1.0) & (square > 0.0)
    points = list(polar.points)
    for k in range(len(points) // 2):
        here = inside & (polar.found == float(k))
        points[2 * k], points[2 * k + 1] = torch.where(here, X, points[2 * k]), torch.where(here, Y, points[2 * k + 1])
    return Polar(x, polar.found + inside.to(x.dtype), tuple(points))


def polar_normals(x: Tensor, pairs: int) -> tuple[list[Tensor], Tensor]:
    """Return the standard normal numbers of libstdc++ with ``minstd_rand``, two for each of ``pairs``, and the next state.

    Marsaglia's polar method: points (X, Y) are drawn until q = X^2 + Y^2 is at most one; Y m, then X m with ``m = sqrt(-2 ln q /
    q)`` are normal.
    """
    half = torch.full_like(x, 0.5)
    polar = Polar(x, torch.zeros_like(x), (half,) * (2 * pairs))
    for _ in range(pairs):
        polar = _attempt(polar)
    for _ in range(ATTEMPTS - pairs):
        polar = only(polar.found < float(pairs), functools.partial(_attempt, polar), polar)
    normals: list[Tensor] = []
    for X, Y in zip(polar.points[::2], polar.points[1::2], strict=True):
        square = X * X + Y * Y
        scale = torch.sqrt(-2.0 * torch.log(square) / square)
        normals += [Y * scale, X * scale]
    return normals, polar.x
