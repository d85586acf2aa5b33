"""Numerical integration: the classical Runge-Kutta step, and Picard iteration on Chebyshev nodes."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.polynomial import chebyshev
from torch import Tensor

State = tuple[Any, ...]
"""Vectors, or single quantities."""


def _advance(y: State, rate: State, step: float | Tensor) -> State:
    return tuple(a + b * step for a, b in zip(y, rate, strict=True))


def rk4_step(rates: Callable[[int, Any, State], State], y: State, h: float | Tensor) -> State:
    """Return the state after one classical fourth-order Runge-Kutta step of length h, s.

    ``y(t + h) = y + h (k1 + 2 k2 + 2 k3 + k4) / 6`` with ``k1 = f(t, y)``, ``k2 = f(t + h/2, y + h k1 / 2)``,
    ``k3 = f(t + h/2, y + h k2 / 2)`` and ``k4 = f(t + h, y + h k3)`` (Hairer, Norsett and Wanner, "Solving Ordinary Differential
    Equations I", section II.1).

    Args:
        rates: ``rates(stage, offset, y)`` gives f for the stage 0 to 3 whose time lies ``offset`` seconds after the start.
        y: State at the start.
        h: Length of the step, which may be negative.
    """
    k1 = rates(0, 0.0, y)
    k2 = rates(1, 0.5 * h, _advance(y, k1, 0.5 * h))
    k3 = rates(2, 0.5 * h, _advance(y, k2, 0.5 * h))
    k4 = rates(3, h, _advance(y, k3, h))
    slopes = zip(k1, k2, k3, k4, strict=True)
    return _advance(y, tuple(a * (1 / 6) + b * (1 / 3) + c * (1 / 3) + d * (1 / 6) for a, b, c, d in slopes), h)


def nystroem_step(acceleration: Callable[[Tensor], Tensor], y: Tensor, rate: Tensor, h: float | Tensor) -> tuple[Tensor, Tensor]:
    """Return y and y' after one step of length h of ``y'' = f(y)`` by Nystroem's method of fourth order, three evaluations of f.

    ``y(t + h) = y + h y' + h^2 (k1 + 2 k2) / 6`` and ``y'(t + h) = y' + h (k1 + 4 k2 + k3) / 6`` with ``k1 = f(y)``,
    ``k2 = f(y + h y' / 2 + h^2 k1 / 8)`` and ``k3 = f(y + h y' + h^2 k2 / 2)`` (Hairer, Norsett and Wanner, "Solving Ordinary
    Differential Equations I", section II.14).
    """
    k1 = acceleration(y)
    k2 = acceleration(y + (rate + k1 * (0.25 * h)) * (0.5 * h))
    k3 = acceleration(y + (rate + k2 * (0.5 * h)) * h)
    return y + (rate + (k1 + 2.0 * k2) * (h / 6.0)) * h, rate + (k1 + 4.0 * k2 + k3) * (h / 6.0)


class Quadrature(NamedTuple):
    """Matrices of a Picard step on Chebyshev nodes, for an interval of length one.

    With accelerations a_j at the M ``nodes`` s_j [M] and their interpolating polynomial ``a(s) = sum_j a_j l_j(s)``, the
    matrices [K, M] give at the K output ``times`` t_k: ``value`` l_j(t_k), ``velocity`` the integral of l_j from 0 to t_k, and
    ``position`` the integral of (t_k - s) l_j(s) from 0 to t_k, which integrates twice.
    """

    nodes: Tensor
    times: Tensor
    value: Tensor
    velocity: Tensor
    position: Tensor


@functools.lru_cache
def quadrature(order: int, outputs: tuple[float, ...] | None = None, device: str = "cpu") -> Quadrature:
    """Return the quadrature of ``order + 1`` Chebyshev-Lobatto nodes, to ``outputs`` in [0, 1] (the nodes themselves if None).

    The nodes are ``(1 - cos(pi j / order)) / 2``, j = 0 to ``order``; the integrals of the interpolating polynomial are exact.
    Source: Bai and Junkins, "Modified Chebyshev-Picard Iteration Methods for Orbit Propagation" (2011).
    """
    x = -np.cos(np.pi * np.arange(order + 1) / order)
    x_out = x if outputs is None else 2.0 * np.asarray(outputs) - 1.0
    coefficients = np.linalg.inv(chebyshev.chebvander(x, order))
    once = chebyshev.chebint(coefficients, lbnd=-1, scl=0.5)
    twice = chebyshev.chebint(once, lbnd=-1, scl=0.5)
    arrays = [(x + 1.0) / 2.0, (x_out + 1.0) / 2.0, *(chebyshev.chebval(x_out, c).T for c in (coefficients, once, twice))]
    return Quadrature(*(torch.tensor(array, dtype=torch.float64, device=device) for array in arrays))
