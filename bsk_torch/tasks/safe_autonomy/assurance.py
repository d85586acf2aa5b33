"""Run-time assurance: filters between a policy and the thrusters that keep a deputy close to a chief safe.

Safe are states in which every barrier h(x) of a task is at least zero; :data:`DOCKING` and :data:`INSPECTION` list those of the
published tasks. Two kinds of filters change the force wished by a policy:

- :class:`Barriers`, an active-set invariance filter: the nearest force u, within the limits of the thrusters, for which each
  barrier decreases slowly enough, ``dh/dx (f(x) + g(x) u) >= -alpha(h)``. This is a quadratic program. It assumes that the
  filter acts continuously, so forces held for a time exceed limits slightly.
- :class:`Backup`, a simplex filter: the wished force if every barrier is at least zero after it, otherwise that of a controller
  that stops the deputy. With a ``window``, the barriers must also stay at least zero while this controller would act.

Sources: K. Dunlap, M. Mote, K. Delsing and K. L. Hobbs, "Run time assured reinforcement learning for safe satellite docking",
Journal of Aerospace Information Systems 20(1), 2023; K. Dunlap, D. van Wijk and K. L. Hobbs, "Run time assurance for autonomous
spacecraft inspection", AAS/AIAA Astrodynamics Specialist Conference, 2023. Numbers are those of AFRL's run-time-assurance 1.18.6
(``zoo/cwh/docking_3d.py``, ``inspection_1v1.py`` and ``inspection_3d.py``), which filters the force of one deputy at a time. With
several deputies (:func:`crew_inspection`), each is filtered as if the others would not thrust.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import torch
from torch import Tensor

from bsk_torch._checks import number
from bsk_torch.astro.clohessy_wiltshire import propagate, pushed
from bsk_torch.tasks.safe_autonomy.dyn import LinearInspectorDynModel, LinearMotionDynModel

if TYPE_CHECKING:
    from bsk_torch.sats.bound import BoundSatellite

__all__ = [
    "DOCKING",
    "INSPECTION",
    "Assurance",
    "Backup",
    "Barrier",
    "Barriers",
    "Deputies",
    "crew_barriers",
    "crew_inspection",
    "nearest",
    "stopping_gain",
]

Assurance: TypeAlias = "Callable[[Deputies, Tensor, float], Tensor]"
"""A filter: function of deputies, wished forces [N, 3] N and their duration, s, that returns forces [N, 3] N."""

SOFT = 1e-5
"""Added to squared speeds and distances in the barrier of the safe speed, whose gradient is finite at rest."""

REPAIR, REPAIR_BIAS = 10.0, 0.01
"""Where a barrier is negative, alpha is multiplied by the first number and lowered by the second, so that it recovers."""

FREE_FLIGHT = 100
"""Seconds of flight without thrust that must not lead into the chief."""

MOST_SPEED = 1.0
"""Maximum of each component of the velocity in inspections, m/s."""

BLIND = math.radians(30.0)
"""Minimum angle between the line of sight to the chief and the Sun, rad."""

EDGE = 800.0
"""Maximum distance in inspections, m."""

ON_AXIS = 1e-9
"""Distance from the axis of the cone of blinding up to which a deputy counts as on it, m."""

CLEAR = 1e-9
"""Violation of an inequality with a ``weight`` of length 1 that counts as rounding, N."""


NO_OTHERS = torch.zeros(1, 0, 3, dtype=torch.float64, device="cpu")
"""Positions or velocities of no other deputies."""


class Deputies(NamedTuple):
    """What barriers read of N deputies.

    Attributes:
        r: Positions relative to the chief in its Hill frame, [N, 3] m.
        v: Velocities as seen in it, [N, 3] m/s.
        sun: Directions of the Sun in it, [N, 3]; zero where a task has no Sun.
        n: Mean motion of the chief, [N] rad/s.
        mass: Masses, [N] kg.
        limit: Safe speed: that near the chief, m/s, its slope over the mean motion, and the distance of the former, m, [N, 3].
        keep_out: Distance at which a deputy crashes, [N] m; zero where a task has none.
        most: Maximum of each component of the force, N.
        others_r: Positions of the K other deputies of the episode, in the order of the environment, [N, K, 3] m.
        others_v: Their velocities, [N, K, 3] m/s.
    """

    r: Tensor
    v: Tensor
    sun: Tensor
    n: Tensor
    mass: Tensor
    limit: Tensor
    keep_out: Tensor
    most: float
    others_r: Tensor = NO_OTHERS
    others_v: Tensor = NO_OTHERS

    @classmethod
    def of(cls, satellite: BoundSatellite, most: float) -> Deputies:
        """Return the current state of satellites with :class:`bsk_torch.tasks.safe_autonomy.LinearMotionDynModel`."""
        dynamics, simulator = satellite.dynamics, satellite.simulator
        r, v = dynamics.rho_H, dynamics.rho_dot_H
        inspects = isinstance(dynamics, LinearInspectorDynModel)

        def argument(name: str) -> Tensor:
            value: Tensor = simulator.argument(name)
            return value.expand(len(r))

        limit = torch.stack([argument(f"speedLimit{name}") for name in ("Near", "Slope", "Distance")], 1)
        return cls(
            r,
            v,
            dynamics.sun_hat_H if inspects else torch.zeros_like(r),
            argument("meanMotion"),
            argument("mass"),
            limit,
            argument("keepOutRadius") if inspects else torch.zeros_like(r[:, 0]),
            most,
            *others(satellite),
        )

    @property
    def braking(self) -> Tensor:
        """Acceleration that is available against relative motion everywhere, [N] m/s^2."""
        near, slope, _ = self.limit.unbind(1)
        fastest = torch.clamp(near + slope * self.n * EDGE, max=MOST_SPEED)
        return self.most / self.mass - 3.0 * self.n**2 * EDGE - 2.0 * self.n * fastest

    @property
    def drift(self) -> tuple[Tensor, Tensor, Tensor]:
        """Rates of position, velocity and direction of the Sun without thrust, [N, 3] each."""
        n, zero = self.n, torch.zeros_like(self.n)
        turn = torch.stack([n * self.sun[:, 1], -n * self.sun[:, 0], zero], 1)
        return self.v, drifting(n, self.r, self.v), turn

    def repeated(self, count: int) -> Deputies:
        """Return the deputies ``count`` times, one copy after the other."""
        r, v, sun, n, mass, limit, keep_out = (torch.cat([part] * count) for part in self[:7])
        others_r, others_v = (torch.cat([part] * count) for part in self[8:])
        return Deputies(r, v, sun, n, mass, limit, keep_out, self.most, others_r, others_v)

    def after(self, force: Tensor, time: float) -> Deputies:
        """Return the deputies after a constant force [N, 3] N for some seconds, with the Sun where it is."""
        seconds = torch.full_like(self.n, time)
        r, v = propagate(self.r, self.v, self.n, seconds)
        by_r, by_v = pushed(self.n, seconds)
        a = (force / self.mass.unsqueeze(1)).unsqueeze(-1)
        shape = self.others_r.shape
        each = (part.repeat_interleave(shape[1]) for part in (self.n, seconds))
        others_r, others_v = propagate(self.others_r.flatten(0, 1), self.others_v.flatten(0, 1), *each)
        return self._replace(
            r=r + (by_r @ a).squeeze(-1),
            v=v + (by_v @ a).squeeze(-1),
            others_r=others_r.view(shape),
            others_v=others_v.view(shape),
        )


def others(satellite: BoundSatellite) -> tuple[Tensor, Tensor]:
    """Return positions, m, and velocities, m/s, of the K other deputies of each satellite, [N, K, 3]."""
    fleet = satellite.fleet
    parts = [k for k, other in enumerate(fleet.satellites) if isinstance(other.dynamics, LinearMotionDynModel)]
    deputies = torch.cat([fleet.columns[k] for k in parts]).sort().values
    index = fleet.columns[satellite.type_index].unsqueeze(1)
    column = deputies.expand(len(index), -1)[deputies != index].view(len(index), -1)

    def read(name: str) -> Tensor:
        return fleet.each(attrgetter(f"dynamics.{name}"))[:, column].flatten(0, 1)

    return read("rho_H"), read("rho_dot_H")


def drifting(n: Tensor, r: Tensor, v: Tensor) -> Tensor:
    """Return the accelerations of deputies at ``r`` m with ``v`` m/s [..., 3] without thrust, [..., 3] m/s^2; ``n`` in rad/s."""
    (x, _, z), (u, w, _) = r.unbind(-1), v.unbind(-1)
    return torch.stack([3.0 * n * n * x + 2.0 * n * w, -2.0 * n * u, -n * n * z], -1)


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Return the products of vectors [..., 3], [...]."""
    product = a * b
    return product[..., 0] + product[..., 1] + product[..., 2]


def length(vector: Tensor, soft: float = 0.0) -> Tensor:
    """Return the lengths of vectors [..., 3], [...]."""
    return torch.sqrt(dot(vector, vector) + soft)


def stopping_speed(braking: Tensor, gap: Tensor) -> Tensor:
    """Return the speed from which a deputy can stop within a gap, m/s; negative for a negative gap."""
    return gap.sign() * torch.sqrt(2.0 * braking * gap.abs().clamp(min=1e-12))


def safe_speed(x: Deputies) -> Tensor:
    """Return safe minus present speed, [N] m/s."""
    near, slope, distance = x.limit.unbind(1)
    return near + slope * x.n * (length(x.r, SOFT) - distance) - length(x.v, SOFT)


def apart(x: Deputies) -> Tensor:
    """Return how much faster the deputy may approach the chief's keep-out sphere, [N] m/s."""
    distance = length(x.r)
    return stopping_speed(x.braking, distance - x.keep_out) + dot(x.r, x.v) / distance


def within(x: Deputies) -> Tensor:
    """Return how much faster the deputy may fly away, [N] m/s."""
    distance = length(x.r)
    return stopping_speed(x.braking, EDGE - distance) - dot(x.r, x.v) / distance


def unblinded(x: Deputies) -> Tensor:
    """Return how much faster the deputy may approach the cone in which it looks at the Sun behind the chief, [N] m/s."""
    cone, sin, cos = -x.sun, math.sin(BLIND), math.cos(BLIND)
    along = dot(x.r, cone)
    across = x.r - along.unsqueeze(1) * cone
    # on the axis, every direction across it leads to the cone: take the orbit normal, since the Sun is in the orbit plane
    across = torch.where((dot(across, across) > ON_AXIS**2).unsqueeze(1), across, across.new_tensor([0.0, 0.0, ON_AXIS]))
    off_axis = length(across)
    slant = cos * (off_axis - math.tan(BLIND) * along)
    foot = x.r + (slant * sin).unsqueeze(1) * cone - (slant * cos / off_axis).unsqueeze(1) * across
    turning = torch.stack([x.n * foot[:, 1], -x.n * foot[:, 0], torch.zeros_like(x.n)], 1)
    distance = length(x.r)
    gap = distance * torch.sin(torch.acos((along / distance).clamp(-1.0 + 1e-12, 1.0 - 1e-12)) - BLIND)
    return stopping_speed(x.braking, gap) + dot(x.r - foot, x.v - turning) / gap


def passive(x: Deputies) -> Tensor:
    """Return the smallest distance from the keep-out sphere in flight without thrust, [N] m."""
    times = torch.arange(1, FREE_FLIGHT + 1, dtype=x.r.dtype, device=x.r.device).unsqueeze(1)
    angle = x.n * times
    s, c = torch.sin(angle), torch.cos(angle)
    (rx, ry, rz), (vx, vy, vz) = x.r.unbind(1), x.v.unbind(1)
    ahead = (
        (4.0 - 3.0 * c) * rx + (s * vx + 2.0 * (1.0 - c) * vy) / x.n,
        6.0 * (s - angle) * rx + ry + (-2.0 * (1.0 - c) * vx + (4.0 * s - 3.0 * angle) * vy) / x.n,
        c * rz + s / x.n * vz,
    )
    return torch.sqrt(ahead[0] ** 2 + ahead[1] ** 2 + ahead[2] ** 2).amin(0) - x.keep_out


def slow_along(axis: int) -> Callable[[Deputies], Tensor]:
    """Return a barrier: the square of the maximum velocity along an axis, minus that of the present one, (m/s)^2."""
    return lambda x: MOST_SPEED**2 - x.v[:, axis] ** 2


def of_pair(x: Deputies, other: int) -> Deputies:
    """Return deputies with position and velocity relative to one of the others; ValueError without it."""
    if other >= x.others_r.shape[1]:
        raise ValueError(f"a barrier needs the other deputy {other}, counted from 0; there are {x.others_r.shape[1]} others")
    return x._replace(r=x.r - x.others_r[:, other], v=x.v - x.others_v[:, other])


def apart_from(other: int) -> Callable[[Deputies], Tensor]:
    """Return a barrier: how much faster a deputy may approach another one, if both brake, [N] m/s."""

    def value(x: Deputies) -> Tensor:
        pair = of_pair(x, other)
        distance = length(pair.r)
        return stopping_speed(2.0 * x.braking, distance - x.keep_out) + dot(pair.r, pair.v) / distance

    return value


def unblinded_by(other: int) -> Callable[[Deputies], Tensor]:
    """Return a barrier: how much faster two deputies may approach the line to the Sun through one of them, [N] m/s.

    It keeps whichever looks toward the Sun from being blinded when it looks at the other one.
    """

    def value(x: Deputies) -> Tensor:
        pair = of_pair(x, other)
        sign = (1.0 - 2.0 * (dot(pair.r, x.sun) > 0.0).to(x.r.dtype)).unsqueeze(1)
        return unblinded(pair._replace(r=sign * pair.r, v=sign * pair.v))

    return value


def passive_to(other: int) -> Callable[[Deputies], Tensor]:
    """Return a barrier: the smallest distance beyond the keep-out distance if neither deputy thrusts, [N] m."""
    return lambda x: passive(of_pair(x, other))


@dataclass(frozen=True)
class Barrier:
    """A quantity that must not be negative, and how fast it may decrease: ``alpha(h) = linear h + cubic h^3``.

    Attributes:
        value: Function from deputies to the quantity, [N].
        linear: First coefficient, 1/s.
        cubic: Second coefficient.
        bias: Added to the quantity.
    """

    value: Callable[[Deputies], Tensor]
    linear: float
    cubic: float
    bias: float = 0.0

    def __call__(self, x: Deputies) -> Tensor:
        """Return the quantity with its bias, [N]."""
        return self.value(x) + self.bias

    def alpha(self, h: Tensor) -> Tensor:
        """Return the fastest decrease, [N]; negative where ``h`` [N] must recover."""
        allowed = self.linear * h + self.cubic * h**3
        return torch.where(h < 0.0, REPAIR * allowed - REPAIR_BIAS, allowed)


DOCKING = (Barrier(safe_speed, 0.05, 0.005, -1e-4),)
"""Barriers of docking."""

INSPECTION = (
    Barrier(safe_speed, 0.05, 0.005, -1e-3),
    Barrier(unblinded, 0.001, 0.0001, -1e-3),
    Barrier(within, 0.01, 0.001, -1e-3),
    Barrier(passive, 0.01, 0.001),
    *(Barrier(slow_along(axis), 0.1, 0.01, -1e-3) for axis in range(3)),
    Barrier(apart, 0.01, 0.001),
)
"""Barriers of inspection."""


def crew_inspection(count: int) -> tuple[Barrier, ...]:
    """Return the barriers of each of ``count`` deputies that inspect together: their own, and three for each other deputy."""
    barriers = (Barrier(safe_speed, 0.0, 0.1, -2e-3), INSPECTION[1], Barrier(within, 0.01, 0.001), *INSPECTION[3:])
    pairs = (
        (
            Barrier(apart_from(k), 0.01, 0.001),
            Barrier(unblinded_by(k), 0.0, 0.1, -1e-3),
            Barrier(passive_to(k), 0.01, 0.001),
        )
        for k in range(count - 1)
    )
    return (*barriers, *itertools.chain(*pairs))


def nearest(wish: Tensor, weight: Tensor, bound: Tensor) -> Tensor:
    """Return the vectors u nearest to wishes that obey inequalities ``weight u >= bound``, [n, 3].

    Where no vector obeys them, that is the wish; where an inequality is not finite, it is NaN.

    The solution is the projection of the wish onto the inequalities that hold with equality, of which there are at most three:
    among the projections onto all such sets that obey all inequalities, the nearest one.

    Args:
        wish: Wishes, [n, 3].
        weight: Left sides of M inequalities, [n, M, 3].
        bound: Right sides, [n, M].
    """
    size = length(weight).clamp(min=1e-12)
    weight, bound = weight / size.unsqueeze(-1), bound / size
    short = bound - dot(weight, wish.unsqueeze(1))
    candidates = [wish.unsqueeze(1), wish.unsqueeze(1) + short.unsqueeze(-1) * weight]
    i, j = torch.tensor(list(itertools.combinations(range(bound.shape[1]), 2)), device=wish.device).unbind(1)
    a, b = weight[:, i], weight[:, j]
    cosine = dot(a, b)
    sine = 1.0 - cosine**2
    first, second = (short[:, i] - cosine * short[:, j]) / sine, (short[:, j] - cosine * short[:, i]) / sine
    candidates.append(wish.unsqueeze(1) + first.unsqueeze(-1) * a + second.unsqueeze(-1) * b)
    i, j, k = torch.tensor(list(itertools.combinations(range(bound.shape[1]), 3)), device=wish.device).unbind(1)
    a, b, c = weight[:, i], weight[:, j], weight[:, k]
    crosses = torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)
    corner = sum(bound[:, m].unsqueeze(-1) * cross for m, cross in zip((i, j, k), crosses, strict=True))
    candidates.append(corner / dot(a, crosses[0]).unsqueeze(-1))
    points = torch.cat(candidates, 1)
    worst = torch.zeros_like(points[..., 0])
    for row, least in zip(weight.unbind(1), bound.unbind(1), strict=True):  # all at once would need M times the memory
        worst = torch.maximum(worst, least.unsqueeze(1) - dot(points, row.unsqueeze(1)))
    gap = dot(points - wish.unsqueeze(1), points - wish.unsqueeze(1))
    gap = torch.where(worst <= CLEAR, gap, math.inf)  # NaN of parallel inequalities is not smaller
    best = gap.argmin(1)
    solution = points.gather(1, best.view(-1, 1, 1).expand(-1, 1, 3)).squeeze(1)
    solution = torch.where(torch.isfinite(gap.amin(1)).unsqueeze(1), solution, wish)
    return solution.masked_fill(~finite(weight, bound).unsqueeze(1), math.nan)


def finite(weight: Tensor, bound: Tensor) -> Tensor:
    """Return whether all inequalities ``weight`` [n, M, 3] and ``bound`` [n, M] are finite, [n] bool."""
    return torch.isfinite(bound).all(1) & torch.isfinite(weight).flatten(1).all(1)


@dataclass(frozen=True)
class Barriers:
    """Changes a force as little as the barriers of a task require; see the module. Where no force obeys them, the wish stays.

    ValueError if there are no barriers.
    """

    barriers: Sequence[Barrier] = DOCKING

    def __post_init__(self) -> None:
        check_barriers(self.barriers)

    def __call__(self, x: Deputies, wish: Tensor, time: float) -> Tensor:
        """Return the forces [N, 3] N for wishes [N, 3] that last ``time`` seconds.

        Raises:
            FloatingPointError: If a barrier, or its derivative, is not finite, such as those of distances if thrusters are weaker
                than the accelerations of the orbit.
        """
        weight, bound = inequalities(self.barriers, x)
        # >= sorts out NaN. Where 5 % of 1,024 deputies need a program, solving all takes 3 (inspection) to 7 times (docking) as
        # long, with equal forces
        rows = torch.nonzero(~(dot(weight, wish.unsqueeze(1)) >= bound).all(1)).squeeze(-1)
        if not len(rows):
            return wish
        bad = rows[~finite(weight[rows], bound[rows])]
        if len(bad):
            raise FloatingPointError(self._not_finite(x, int(bad[0])))
        one = torch.eye(3, dtype=wish.dtype, device=wish.device).expand(len(rows), 3, 3)
        box = torch.full((len(rows), 6), -x.most, dtype=wish.dtype, device=wish.device)
        weight, bound = torch.cat([one, -one, weight[rows]], 1), torch.cat([box, bound[rows]], 1)
        return wish.index_copy(0, rows, nearest(wish[rows], weight, bound))

    def _not_finite(self, x: Deputies, row: int) -> str:
        values = {k: float(barrier(x)[row]) for k, barrier in enumerate(self.barriers)}
        return (
            f"a barrier of run-time assurance, or its derivative, is not finite for deputy {row} at {x.r[row].tolist()} m with "
            f"{x.v[row].tolist()} m/s and forces of up to {x.most:g} N; barriers by number: {values}"
        )


def check_barriers(barriers: Sequence[Barrier]) -> None:
    """Raise ValueError if there are no barriers."""
    if not barriers:
        raise ValueError("barriers is empty; list at least one act.assurance.Barrier")


def inequalities(barriers: Sequence[Barrier], x: Deputies) -> tuple[Tensor, Tensor]:
    """Return ``weight`` [N, M, 3] and ``bound`` [N, M] of the forces u that keep barriers: ``weight u >= bound``."""
    x = x._replace(others_r=x.others_r.expand(len(x.r), -1, -1), others_v=x.others_v.expand(len(x.r), -1, -1))  # of NO_OTHERS
    # the derivatives along the drift and along a force on each axis, side by side in one call
    four = x.repeated(4)
    push = torch.eye(3, dtype=x.r.dtype, device=x.r.device).unsqueeze(1) / x.mass.view(1, -1, 1)
    drift, zero = x.drift, torch.zeros_like(x.r)
    still = [torch.zeros_like(x.others_r)] * 3  # the others drift
    directions = (
        torch.cat([drift[0], *[zero] * 3]),
        torch.cat([drift[1], *push]),
        torch.cat([drift[2], *[zero] * 3]),
        torch.cat([x.others_v, *still]),
        torch.cat([drifting(x.n.unsqueeze(1), x.others_r, x.others_v), *still]),
    )

    def values(r: Tensor, v: Tensor, sun: Tensor, others_r: Tensor, others_v: Tensor) -> Tensor:
        now = four._replace(r=r, v=v, sun=sun, others_r=others_r, others_v=others_v)
        return torch.stack([barrier(now) for barrier in barriers], 1)

    h, slope = torch.func.jvp(values, (four.r, four.v, four.sun, four.others_r, four.others_v), directions)[:2]
    along, *by_axis = slope.unflatten(0, (4, -1)).unbind(0)
    alpha = torch.stack([barrier.alpha(h[: len(x.r), k]) for k, barrier in enumerate(barriers)], 1)
    return torch.stack(by_axis, -1), -along - alpha


def crew_barriers(x: Deputies, wish: Tensor, time: float) -> Tensor:
    """Return the forces [N, 3] N of :class:`Barriers` with :func:`crew_inspection` for all deputies of an episode."""
    return Barriers(crew_inspection(1 + x.others_r.shape[1]))(x, wish, time)


@dataclass(frozen=True)
class Backup:
    """Replaces a force by that of a controller that stops the deputy, where a barrier would become negative.

    The controller is the linear-quadratic regulator of the velocity, with weights 0.05 for states and 1000 for forces.

    Attributes:
        barriers: Barriers of the task.
        window: Seconds for which the controller must also keep the barriers.

    ValueError if there are no barriers, or for a window that is negative or infinite.
    """

    barriers: Sequence[Barrier] = DOCKING
    window: float = 0.0

    def __post_init__(self) -> None:
        check_barriers(self.barriers)
        number("window", self.window, 0.0, unit="s")

    def __call__(self, x: Deputies, wish: Tensor, time: float) -> Tensor:
        """Return the forces [N, 3] N for wishes [N, 3] that last ``time`` seconds; a barrier that is NaN counts as negative."""
        gain = stopping_gain(x)

        def stop(now: Deputies) -> Tensor:
            return -(gain @ now.v.unsqueeze(-1)).squeeze(-1).clamp(-x.most, x.most)

        ahead = x.after(wish, time)
        safe = self._holds(ahead)
        for _ in range(int(self.window / time)):  # one step after the other
            ahead = ahead.after(stop(ahead), time)
            safe = safe & self._holds(ahead)
        return torch.where(safe.unsqueeze(1), wish, stop(x))

    def _holds(self, x: Deputies) -> Tensor:
        return torch.stack([barrier(x) >= 0.0 for barrier in self.barriers], 1).all(1)


def stopping_gain(x: Deputies) -> Tensor:
    """Return the gain of the velocity of the linear-quadratic regulator of a deputy, [N, 3, 3] N s/m.

    The stable subspace of the Hamiltonian matrix gives the solution P of the algebraic Riccati equation, and ``B^T P / R`` the
    gain (B. D. O. Anderson and J. B. Moore, Optimal Control, 1990).
    """
    states, forces = 0.05, 1000.0
    n, count = x.n, len(x.n)
    a = torch.zeros(count, 6, 6, dtype=x.r.dtype, device=x.r.device)
    a[:, 0, 3] = a[:, 1, 4] = a[:, 2, 5] = 1.0
    a[:, 3, 0], a[:, 3, 4], a[:, 4, 3], a[:, 5, 2] = 3.0 * n * n, 2.0 * n, -2.0 * n, -n * n
    b = torch.zeros(count, 6, 3, dtype=x.r.dtype, device=x.r.device)
    b[:, 3, 0] = b[:, 4, 1] = b[:, 5, 2] = 1.0 / x.mass
    q = states * torch.eye(6, dtype=x.r.dtype, device=x.r.device).expand(count, 6, 6)
    hamiltonian = torch.cat([torch.cat([a, -b @ b.mT / forces], 2), torch.cat([-q, -a.mT], 2)], 1)
    values, vectors = torch.linalg.eig(hamiltonian)
    stable = values.real.argsort(1)[:, :6].unsqueeze(1).expand(-1, 12, -1)
    top, bottom = vectors.gather(2, stable).split(6, 1)
    riccati = torch.linalg.solve(top, bottom, left=False).real
    gain: Tensor = (b.mT @ riccati / forces)[:, :, 3:]
    return gain
