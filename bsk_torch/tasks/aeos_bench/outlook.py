"""What satellites of AEOS-Bench can expect of tasks: when they would see them, and until when; and who should take which.

Nothing here is part of the benchmark: rules and policies look ahead with it.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.tasks.aeos_bench.files import EARTH_RADIUS, MU

AIM = 0.5
"""Share of the field of view to which the error of pointing decays in a turn."""

PACE = 0.65
"""Share of the sum of both parts of a turn, see :func:`turn_time`, that flown turns take: the median of 2,236
turns in 16 of the benchmark's test cases."""

KEEP = 20.0
"""Time by which another task must end earlier to be preferred to the present one, s."""

LATE = 300.0
"""Time by which tasks that are not expected in time are preferred less than others, s."""

NEVER = 1e9
"""End of tasks that cannot be expected to succeed, s."""

ROUNDS = 12
"""Rounds of proposals after which satellites without a task remain so; few cases need more."""

EARTH_SPIN = 0.0, 0.0, 7.292115e-5
"""Rotation of the Earth, rad/s, Earth-fixed; see WGS 84."""


class TaskOutlook(NamedTuple):
    """What can be expected of tasks if satellites turn to them now, [N, S, T] each.

    Attributes:
        angle: Angle from the axis of the sensor to the task, rad.
        turn: Time until the task is in the cone of the sensor, s.
        start: Time until the task is seen, s: until the end of the turn, and until the task is above the horizon.
        end: Time until the task succeeds, s.
        last: Time until the task is below the horizon or overdue, s.
        feasible: Whether the task is offered, and succeeds until ``last`` after a turn that takes a share ``haste`` of ``turn``;
            see :class:`~bsk_torch.tasks.aeos_bench.AEOSBench`. False for absent satellites.
    """

    angle: Tensor
    turn: Tensor
    start: Tensor
    end: Tensor
    last: Tensor
    feasible: Tensor


class TaskCandidates(NamedTuple):
    """The first n tasks of each satellite, [N, S, n] each, in the order of their costs."""

    task: Tensor  # number of the task
    exists: Tensor  # whether it may succeed; the others pad
    # time until it succeeds, s, less KEEP for the current task, and plus LATE if that is not expected in time; NEVER for
    # padding
    cost: Tensor


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Return the products of vectors [N, S, 3] and [N, T, 3], [N, S, T].

    Sums of three products, since results of matrix products depend on the size of the batch in the last bits.
    """
    (ax, ay, az), (bx, by, bz) = (part.unbind(-1) for part in (a.unsqueeze(2), b.unsqueeze(1)))
    return ax * bx + ay * by + az * bz


def time_constant(inertia: Tensor, K: Tensor, P: Tensor, Ki: Tensor) -> Tensor:
    """Return the time constant of the slowest part of the feedback law for small angles, s, [...].

    An angle x follows ``I x'' + P (1 + Ki I) x' + K x / 4 = 0`` with an inertia I, kg m^2, and the gains K, N m, P, N m s, and
    Ki; a quarter, since the error is an MRP.
    """
    half = 0.5 * P * (1.0 + Ki * inertia) / inertia
    return 1.0 / (half - (half * half - 0.25 * K / inertia).clamp(min=0.0).sqrt())


def turn_time(angle: Tensor, cone: Tensor, time_constant: Tensor, acceleration: Tensor) -> Tensor:
    """Return how long a turn takes to an object at ``angle`` until it is well in the cone, s, [...].

    :data:`PACE` times the sum of the decay of a small angle to the share :data:`AIM` of the cone, and of a turn from rest to rest
    at the greatest acceleration; zero in the cone.

    Args:
        angle: Angle from the axis of the sensor, rad.
        cone: Half of the field of view, rad.
        time_constant: See :func:`time_constant`, s.
        acceleration: Torque of the wheels over the inertia, rad/s^2.
    """
    decay = time_constant * (angle / (AIM * cone)).clamp(min=1.0).log()
    return torch.where(angle > cone, PACE * (decay + 2.0 * (angle / acceleration).sqrt()), 0.0)


def sight_times(r_P: Tensor, v_P: Tensor, place: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return ``r . p`` over the squared radius of the Earth, and the times until tasks rise and set, s, [N, S, T] each.

    A satellite on a circle with the rate n has ``r(t) . p = r . p cos(n t) + v . p sin(n t) / n``, which the Earth's horizon
    limits to squares of the Earth's radius; with the velocity relative to the Earth, this holds for some minutes. Times are
    negative for what has passed; places that stay below the horizon set a turn before.

    Args:
        r_P: Positions of satellites, [N, S, 3] m, Earth-fixed.
        v_P: Their velocities relative to the Earth, [N, S, 3] m/s.
        place: Positions of tasks, [N, T, 3] m.
    """
    rate = (MU / r_P.norm(dim=-1) ** 3).sqrt().unsqueeze(2)
    height = dot(r_P, place) / EARTH_RADIUS**2
    climb = dot(v_P, place) / EARTH_RADIUS**2 / rate
    top = (height * height + climb * climb).sqrt()
    phase, width = torch.atan2(climb, height), torch.acos((1.0 / top).clamp(max=1.0))
    width = torch.where(top > 1.0, width, -torch.pi)
    return height, (phase - width) / rate, (phase + width) / rate


def find_candidates(outlook: TaskOutlook, held: Tensor, count: int) -> TaskCandidates:
    """Return the tasks that may succeed, first those that are expected to, in the order of their expected ends.

    Args:
        outlook: What can be expected of all tasks.
        held: Number of each satellite's present task, [N, S]; -1 for none.
        count: Number of candidates n of each satellite.
    """
    n_tasks = outlook.end.shape[2]
    current = held.unsqueeze(2) == torch.arange(n_tasks, device=held.device)
    expected = outlook.end + LATE * (outlook.end > outlook.last) - KEEP * current
    cost = torch.where(outlook.feasible, expected, NEVER)
    cost, task = cost.sort(stable=True, dim=2)
    if n_tasks < count:
        cost = torch.nn.functional.pad(cost, (0, count - n_tasks), value=NEVER)
        task = torch.nn.functional.pad(task, (0, count - n_tasks))
    return TaskCandidates(task[..., :count], cost[..., :count] < NEVER, cost[..., :count])


def match(candidates: TaskCandidates, n_tasks: int) -> Tensor:
    """Return for each satellite the place of the candidate that it should take, [N, S]; -1 for none.

    Every satellite proposes its first candidate. A task accepts the satellite that would complete it first, and the others
    propose their next candidates: the stable matching of Gale and Shapley (1962), after :data:`ROUNDS` rounds. Satellites that
    would complete a task at exactly the same time share it.

    Args:
        candidates: Candidates of all satellites.
        n_tasks: Number of tasks.
    """
    cost, (n, s, count) = candidates.cost, candidates.cost.shape
    place, lost = (torch.zeros(n, s, dtype=dtype, device=cost.device) for dtype in (torch.int64, torch.bool))
    for _ in range(ROUNDS):
        place = place + lost
        at = place.clamp(max=count - 1).unsqueeze(2)
        asks = (place < count) & candidates.exists.gather(2, at).squeeze(2)
        offer = torch.where(asks, cost.gather(2, at).squeeze(2), NEVER)
        task = torch.where(asks, candidates.task.gather(2, at).squeeze(2), n_tasks)
        best = torch.full((n, n_tasks + 1), NEVER, dtype=cost.dtype, device=cost.device).scatter_reduce(1, task, offer, "amin")
        lost = asks & (offer > best.gather(1, task))
    return torch.where(asks & ~lost, place, -1)
