"""Motion of deputies close to a chief, which is linear in their position and velocity, to several moments at once.

:func:`about_orbit` holds about a chief on any orbit of two bodies, :func:`about_circle` about one on a circular orbit of which
only the mean motion is known. Both leave out terms of second order in distance over radius: 100 m over 7000 km leave a few
centimeters in a third of an orbit. Forces other than the Earth's attraction as a point, which nearly are the same on both, are
left out, too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.clohessy_wiltshire import transition
from bsk_torch.astro.integrate import nystroem_step
from bsk_torch.astro.orbit import hill_frame, hill_rate
from bsk_torch.constants import MU_EARTH
from bsk_torch.vec3 import Mat3, Vec3


class LinearMotion(NamedTuple):
    """Motion in the Hill frames of N chiefs to S moments of each of K durations: ``rho(t) = rr rho + rv rho'``.

    The position rho and the velocity rho', as seen in the rotating frame, are those at the start, in the Hill frame of the start;
    the result is in the Hill frame of its moment. Rows stand last, so that operations run along them.
    """

    rr: Mat3  # components of shape [S, K, N]
    rv: Mat3  # the same, s
    time: Tensor  # moments, [S, K] s

    def mapped(self, function: Callable[[Tensor], Tensor]) -> tuple[Mat3, Mat3]:
        """Return both matrices with ``function`` applied to each component."""
        rr, rv = (Mat3(*(row.map(function) for row in matrix)) for matrix in (self.rr, self.rv))
        return rr, rv

    def at(self, moment: int, rho: Vec3, velocity: Vec3) -> Vec3:
        """Return positions at a moment, [..., K, N] m, from positions, m, and velocities, m/s, of shapes that broadcast."""
        rr, rv = self.mapped(lambda x: x[moment])
        return rr @ rho + rv @ velocity

    def until(self, samples: int) -> LinearMotion:
        """Return the motion up to the last of the first moments."""
        return LinearMotion(*self.mapped(lambda x: x[:samples]), self.time[:samples])

    def some(self, rows: Tensor | slice) -> LinearMotion:
        """Return the motion of some rows, by their numbers."""
        return LinearMotion(*self.mapped(lambda x: x[..., rows]), self.time)

    def repeated(self, count: int) -> LinearMotion:
        """Return the motion of ``count`` deputies of each chief, side by side."""
        return LinearMotion(*self.mapped(lambda x: x.repeat_interleave(count, -1)), self.time)


def moments(durations: Tensor, samples: int) -> Tensor:
    """Return evenly spaced moments up to the end of durations [K], [samples, K] s."""
    return durations * (torch.arange(1, samples + 1, dtype=durations.dtype, device=durations.device) / samples).unsqueeze(1)


def about_circle(n: Tensor, durations: Tensor, samples: int) -> LinearMotion:
    """Return the motion about chiefs on circular orbits: the equations of Clohessy and Wiltshire.

    Args:
        n: Mean motions, [N] rad/s.
        durations: Durations, [K] s.
        samples: Number S of moments, evenly spaced up to the end of each duration.
    """
    time = moments(durations, samples)
    step = transition(n, time.unsqueeze(-1))
    return LinearMotion(Mat3.of(step.rr), Mat3.of(step.rv), time)


def about_orbit(r_CN_N: Tensor, v_CN_N: Tensor, durations: Tensor, samples: int, mu: float = MU_EARTH) -> LinearMotion:
    """Return the motion about chiefs on orbits of two bodies, of any eccentricity.

    The chief's orbit ``r'' = -mu r / |r|^3`` is integrated together with six deputies, displaced by a unit of position or
    velocity along each axis of the Hill frame, which obey ``x'' = mu / |r|^3 (3 r (r . x) / |r|^2 - x)`` in N. One step of
    Nystroem's method of fourth order leads from moment to moment: with moments 100 s apart, on a low orbit, its error over 2000 s
    is some 1e-5 of the distance.

    Args:
        r_CN_N: Positions of chiefs, [N, 3] m.
        v_CN_N: Their velocities, [N, 3] m/s.
        durations: Durations, [K] s.
        samples: Number S of moments, evenly spaced up to the end of each duration.
        mu: Gravitational parameter, m^3/s^2.
    """
    r, v = Vec3.of(r_CN_N), Vec3.of(v_CN_N)
    axes, rate = hill_frame(r, v), hill_rate(r, v)
    # velocities in N of deputies at rest in the frame: omega_HN x o_r = rate o_theta, omega_HN x o_theta = -rate o_r
    carried = axes.y * rate, axes.x * -rate, Vec3.zeros_like(rate)
    zero = Vec3.zeros_like(rate)
    x = torch.stack([torch.stack(tuple(column)) for column in (r, *axes, zero, zero, zero)], 1)  # components first
    w = torch.stack([torch.stack(tuple(column)) for column in (v, *carried, *axes)], 1)
    shape = *x.shape[:2], len(durations), x.shape[2]
    x, w = (each.unsqueeze(2).expand(shape).contiguous() for each in (x, w))
    # the factor of the term along the radius: the first column is the chief itself
    along = torch.tensor([0.0] + [3.0] * 6, dtype=x.dtype, device=x.device).view(-1, 1, 1)

    def fall(x: Tensor) -> Tensor:
        r = x[:, :1]
        square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
        share = (r[0] * x[0] + r[1] * x[1] + r[2] * x[2]) * (along / square)
        return (r * share - x) * (mu / (square * torch.sqrt(square)))

    time, h = moments(durations, samples), (durations / samples).unsqueeze(1)
    states = []
    for _ in range(samples):  # one moment after the other
        x, w = nystroem_step(fall, x, w, h)
        states.append((x, w[:, 0]))
    flown = torch.stack([state[0] for state in states], 2)
    HN = hill_frame(Vec3(*flown[:, 0]), Vec3(*torch.stack([state[1] for state in states], 1)))
    columns = [HN @ Vec3(*flown[:, k]) for k in range(1, 7)]
    return LinearMotion(Mat3(*columns[:3]).mT, Mat3(*columns[3:]).mT, time)
