"""Schedules of images by mixed-integer programming with learned slew times, and their flight in closed loop.

As in works that plan agile satellites by such programs, the time between two images is a function of the angle between them,
learned from flights; the schedule is computed once, before the episode, and then executed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, NamedTuple, cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch._checks import number
from bsk_torch.act import image_target
from bsk_torch.astro.frames import angle_between
from bsk_torch.env import SatelliteTasking
from bsk_torch.lab.bounds.envelope import Envelope
from bsk_torch.lab.bounds.imaging import imaging_bound
from bsk_torch.lab.bounds.tasks import check_task, payment
from bsk_torch.lab.bounds.windows import Openings, openings, satellite_positions
from bsk_torch.sats import BoundImagingSatellite

GRACE = 120.0
"""Seconds after its time in the schedule until which the window of an image may open."""


class Schedule(NamedTuple):
    """Images in the order in which they are to be taken, of N episodes.

    Attributes:
        target: Targets, [N, K]; -1 behind the last.
        tick: Ticks at which they are expected, [N, K].
    """

    target: Tensor
    tick: Tensor


def relaxed_schedule(env: SatelliteTasking, *, envelope: Envelope | None = None, iterations: int = 60) -> Schedule:
    """Return the best schedule that multipliers find with typical times between images; arguments as :func:`imaging_bound`'s."""
    bound = imaging_bound(env, envelope=(envelope or Envelope.load()).expected, iterations=iterations)
    first_time = ~_repeated(bound.target)
    order = torch.argsort(torch.where(first_time & (bound.target >= 0), bound.tick, 1 << 60), dim=1, stable=True)
    valid = (first_time & (bound.target >= 0)).gather(1, order)
    return Schedule(*(torch.where(valid, table.gather(1, order), -1) for table in (bound.target, bound.tick)))


def _repeated(target: Tensor) -> Tensor:
    """Return which entries [N, K] have occurred before in their row."""
    order = torch.argsort(target, dim=1, stable=True)
    ordered = target.gather(1, order)
    repeats = torch.cat([torch.zeros_like(ordered[:, :1], dtype=torch.bool), ordered[:, 1:] == ordered[:, :-1]], 1)
    return torch.zeros_like(repeats).scatter(1, order, repeats)


def milp_schedule(env: SatelliteTasking, *, envelope: Envelope | None = None, seconds: float = 60.0) -> Schedule:
    """Return schedules by mixed-integer programs, one for each episode, which HiGHS solves or improves for some time.

    With windows w that open at a_w and close at b_w, priorities p, times t_w and choices y_w in {0, 1}, and for every pair of
    windows that may get in each other's way an order z_ij in {0, 1} and the typical time s_ij in the middle of what they share::

        maximize sum_w p_w y_w
        a_w <= t_w <= b_w,  sum of y_w over the windows of a target <= 1
        t_j >= t_i + s_ij - M (3 - y_i - y_j - z_ij),  t_i >= t_j + s_ji - M (2 - y_i - y_j + z_ij)

    Args:
        env: An environment after ``reset``.
        envelope: Typical times (default: those of the presets' agile satellite).
        seconds: Time limit of each program, s.

    Raises:
        ValueError: For a task that the bound of imaging does not cover either, for a time that is not positive.
    """
    envelope = (envelope or Envelope.load()).expected
    check_task(env, envelope)
    if not isinstance(env, SatelliteTasking):
        raise ValueError("schedules by mixed-integer programs are those of one satellite; the environment has several")
    number("seconds", seconds, 0.0, unit="s", above=True)
    windows, payments = openings(cast(BoundImagingSatellite, env.satellite), env.state.limit_ticks), payment(env)
    parts = [_program(env, windows, payments[row], row, envelope, seconds) for row in range(len(payments))]
    width = max(1, *(len(part[0]) for part in parts))
    padded = [[torch.nn.functional.pad(x, (0, width - len(x)), value=-1) for x in part] for part in parts]
    return Schedule(*(torch.stack(column) for column in zip(*padded, strict=True)))


def _program(
    env: SatelliteTasking, windows: Openings, payments: Tensor, row: int, envelope: Envelope, seconds: float
) -> tuple[Tensor, Tensor]:
    """Return targets and ticks of one episode's schedule, in order."""
    import numpy as np
    from scipy import sparse
    from scipy.optimize import Bounds, LinearConstraint, milp

    selection = (windows.row == row) & (payments[windows.target] > 0.0)
    target, first, last = windows.target[selection], windows.first[selection].double(), windows.last[selection].double()
    n = len(target)
    if not n:
        return target, target
    i, j, slew = _pairs(env, row, target, first, last, envelope)
    pairs, k = len(i), torch.arange(len(i))
    # columns: choices y [n], times t [n], orders z [pairs]
    big_forth, big_back = last[i] + slew - first[j], last[j] + slew - first[i]
    rows, ones = torch.cat([k, k, k, k, k]), torch.ones(pairs, dtype=torch.float64)

    def inequality(a: Tensor, b: Tensor, big: Tensor, sign: float) -> object:
        """Coefficients of ``t_b - t_a - M (y_a + y_b) - sign M z``."""
        columns = torch.cat([n + b, n + a, a, b, 2 * n + k])
        values = torch.cat([ones, -ones, -big, -big, -sign * big])
        return sparse.csr_matrix((values.numpy(), (rows.numpy(), columns.numpy())), shape=(pairs, 2 * n + pairs))

    once = sparse.csr_matrix((np.ones(n), (target.numpy(), np.arange(n))), shape=(int(target.max()) + 1, 2 * n + pairs))
    constraints = [LinearConstraint(once, -np.inf, 1.0)]
    if pairs:
        constraints.append(LinearConstraint(inequality(i, j, big_forth, 1.0), (slew - 3.0 * big_forth).numpy(), np.inf))
        constraints.append(LinearConstraint(inequality(j, i, big_back, -1.0), (slew - 2.0 * big_back).numpy(), np.inf))
    low = np.concatenate([np.zeros(n), first.numpy(), np.zeros(pairs)])
    high = np.concatenate([np.ones(n), last.numpy(), np.ones(pairs)])
    kinds = np.concatenate([np.ones(n), np.zeros(n), np.ones(pairs)])
    cost = np.concatenate([-payments[target].numpy(), np.zeros(n + pairs)])
    plan = milp(cost, constraints=constraints, bounds=Bounds(low, high), integrality=kinds, options={"time_limit": seconds})
    if plan.x is None:  # nothing found in time
        return target[:0], target[:0]
    x = torch.from_numpy(plan.x)
    picks = torch.nonzero(x[:n] > 0.5).flatten()
    time = x[n : 2 * n][picks]
    order = torch.argsort(time)
    return target[picks][order], time[order].long()


def _pairs(
    env: SatelliteTasking, row: int, target: Tensor, first: Tensor, last: Tensor, envelope: Envelope
) -> tuple[Tensor, Tensor, Tensor]:
    """Return pairs of windows that an image of one may keep from the other, and the ticks of the slew, [p] each."""
    reach = envelope.longest
    near = (first.unsqueeze(1) <= last + reach) & (first <= last.unsqueeze(1) + reach) & (target.unsqueeze(1) != target)
    i, j = torch.nonzero(near.triu(1), as_tuple=True)
    tick = 0.5 * (torch.maximum(first[i], first[j]) + torch.minimum(last[i], last[j]))
    satellite = cast(BoundImagingSatellite, env.satellite)
    position = satellite_positions(satellite, torch.full_like(i, row), tick * env.simulator.h)
    places = env.simulator.scenario_state["target_r_LP_P"][row]
    angle = angle_between(places[target[i]] - position, places[target[j]] - position)
    slew = envelope.least(angle, direct=True).double()
    blocks = (last[i] - first[j] + slew > 0.0) & (last[j] - first[i] + slew > 0.0)
    blocks |= (first[j] < last[i] + slew) & (first[i] < last[j] + slew)
    return i[blocks], j[blocks], slew[blocks]


class ScheduledPolicy(TensorDictModuleBase):
    """Flies a schedule in closed loop: the next target of the list that has no image yet and whose window has not closed.

    Where an image is late, those after it wait; what has become impossible is left out. Behind the end of the schedule, and where
    the window of the next image is far away, ``otherwise`` acts.
    """

    in_keys: ClassVar[list[str]] = ["observation", "action_mask"]
    out_keys: ClassVar[list[str]] = ["action"]

    def __init__(self, env: SatelliteTasking, schedule: Schedule, otherwise: Callable[[TensorDictBase], TensorDictBase]) -> None:
        """Fly ``schedule`` in the episodes of ``env`` that it was made for; ``otherwise`` is any policy.

        ValueError for a schedule of another number of episodes.
        """
        super().__init__()
        if len(schedule.target) != len(env.env_ids):
            raise ValueError(f"the schedule has {len(schedule.target)} episodes, the environment {len(env.env_ids)}")
        self.env, self.schedule, self.otherwise = env, schedule, otherwise

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action``, [N]: targets by their index."""
        tensordict = self.otherwise(tensordict)
        satellite = cast(BoundImagingSatellite, self.env.satellite)
        now, h = satellite.simulator.sim_time.unsqueeze(1), satellite.simulator.h
        opens, closes = satellite.next_opportunities(satellite.target_types)
        target, time = self.schedule.target.clamp(min=0), self.schedule.tick * h
        opens, closes = opens.gather(1, target), closes.gather(1, target)
        possible = (self.schedule.target >= 0) & torch.isfinite(closes) & (closes > now + 2 * h) & (opens <= time + GRACE)
        k = possible.long().argmax(1, keepdim=True)
        soon = possible.any(1) & ((opens.gather(1, k) - now).squeeze(1) <= self.env.max_step_duration)
        action = image_target(target.gather(1, k).squeeze(1))
        return tensordict.set("action", torch.where(soon, action, tensordict["action"]))
