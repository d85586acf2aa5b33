"""A bound on the tasks of AEOS-Bench that any policy can complete: those that stay above some horizon long enough."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from bsk_torch._checks import number
from bsk_torch.env import ConstellationTasking
from bsk_torch.env.base import Tasking
from bsk_torch.tasks.aeos_bench.files import MU
from bsk_torch.tasks.aeos_bench.outlook import EARTH_SPIN, dot
from bsk_torch.tasks.aeos_bench.scene import AEOSBench

LONGEST = 15.0
"""Longest interval, s: the shortest tasks last as long, so that a pass between two looks completes none."""


def sight_bound(env: Tasking, *, interval: float = 10.0) -> Tensor:
    """Return an upper bound on the completion rate of the current episodes of AEOS-Bench, [N].

    A task can succeed only if satellites have it above their horizons, one after the other, for as long as it still lasts,
    between now or its release and its due time. Power, turns, and the narrow cones of sensors are left out: satellites are
    taken to look everywhere at once. Satellites fly Kepler orbits here, which are meters away after an hour, and are looked at
    once in an interval; a task counts as seen in an interval if it is at either end.

    Args:
        env: An environment with :class:`~bsk_torch.tasks.aeos_bench.AEOSBench` after ``reset``; what it returns afterwards does
        not change.
        interval: Time between looks, s, at most :data:`LONGEST`.

    Raises:
        ValueError: For another scenario or interval.
    """
    scenario = env.scenario if isinstance(env, ConstellationTasking) else None
    if not isinstance(scenario, AEOSBench):
        raise ValueError(f"sight_bound needs an environment with AEOSBench; this is {type(env.scenario).__name__}")
    number("interval", interval, 0.0, LONGEST, unit="s", above=True)
    now, place = scenario.task_time.unsqueeze(1), scenario.drawn("task_place")
    release, due, duration = (scenario.drawn(f"task_{name}") for name in ("release", "due", "duration"))
    r_P, v_P = scenario.motion()
    present = scenario.present_now.unsqueeze(2)
    spin = torch.tensor(EARTH_SPIN, dtype=r_P.dtype, device=r_P.device)
    v_P = v_P + torch.linalg.cross(spin.expand_as(r_P), r_P)  # of axes that do not turn with the Earth from now on
    seen = torch.where(scenario.task_succeeded, torch.inf, 0.0)
    run, was, elapsed = scenario.memory["task_progress"], _above(r_P, place, present), 0.0
    for _ in range(math.ceil((scenario.horizon - float(now.min())) / interval)):
        r_P, v_P = _coasted(r_P, v_P, interval)
        elapsed += interval
        angle = EARTH_SPIN[2] * elapsed
        above = _above(_turned(r_P, angle), place, present)
        end = torch.minimum(due, now + elapsed).clamp(max=scenario.horizon)
        counted = (end - torch.maximum(release, now + elapsed - interval)).clamp(min=0.0)
        run = torch.where(above | was, run + counted, 0.0)
        seen, was = torch.maximum(seen, run), above
    exists = scenario.task_exists
    return ((seen >= duration) & exists).sum(1) / exists.sum(1)


def _above(r_P: Tensor, place: Tensor, present: Tensor) -> Tensor:
    """Return which places [N, T, 3] are above the horizon of some present satellite at [N, S, 3], [N, T]."""
    return ((dot(r_P, place) > (place * place).sum(-1).unsqueeze(1)) & present).any(1)


def _turned(r: Tensor, angle: float) -> Tensor:
    """Return vectors [..., 3] in axes turned by ``angle``, rad, about z."""
    x, y, z = r.unbind(-1)
    cosine, sine = math.cos(angle), math.sin(angle)
    return torch.stack([cosine * x + sine * y, cosine * y - sine * x, z], -1)


def _coasted(r: Tensor, v: Tensor, seconds: float) -> tuple[Tensor, Tensor]:
    """Return positions and velocities after a step of the classical Runge-Kutta method around a point mass, as given."""

    def pull(x: Tensor) -> Tensor:
        return -MU * x / x.norm(dim=-1, keepdim=True) ** 3

    h = seconds
    a1 = pull(r)
    v2, a2 = v + 0.5 * h * a1, pull(r + 0.5 * h * v)
    v3, a3 = v + 0.5 * h * a2, pull(r + 0.5 * h * v2)
    v4, a4 = v + h * a3, pull(r + h * v3)
    return r + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4), v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
