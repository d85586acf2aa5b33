"""The rules of aeossp_standard: which plans are valid, and their metrics, in numpy.

Verdicts, metrics and the amounts of a :class:`Report` are those of the benchmark's verifier (github.com/Mtrya/astro-reason, MIT
license, commit ffd1e89), whose reports a test compares with them. They are computed from the description of its rules.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bsk_torch.tasks.aeossp.files import Case, Observations
from bsk_torch.tasks.aeossp.geometry import Array, Numbers, Tracks, angle, sunlit, tracks
from bsk_torch.tasks.aeossp.slews import STILL, Line, required_gap


@dataclass(frozen=True)
class Slews:
    """Slews before each of n observations; the first of a satellite begins at its nadir.

    Attributes:
        previous: Number of the satellite's previous observation, -1 before its first, [n].
        gap: Time since its end, or since the start of the horizon, s, [n].
        degrees: Angle between the lines of sight, deg, [n].
        required: Time of slew and settling, s, [n].
    """

    previous: Numbers
    gap: Array
    degrees: Array
    required: Array


@dataclass(frozen=True)
class Power:
    """Battery of each of S satellites.

    Attributes:
        least_wh: Least charge, Wh, [S].
        least_s: When it is reached first, s from the start of the horizon, [S].
        full_s: When it was full the last time before, zero if never, s, [S].
        final_wh: Charge at the end, Wh, [S].
        used_wh: Energy of all loads, Wh, [S].
        charged_wh: Energy of the panels, Wh, [S].
        imaging_s: Time of observations, s, [S].
        slewing_s: Time of slews and settling, s, [S].
    """

    least_wh: Array
    least_s: Array
    full_s: Array
    final_wh: Array
    used_wh: Array
    charged_wh: Array
    imaging_s: Array
    slewing_s: Array


@dataclass(frozen=True)
class Report:
    """What the rules say about a plan.

    Attributes:
        violations: The number of an observation, -1 for a battery, and what is wrong; a plan with any is void.
        completed: Number of the observation that completes each task, -1 for none, [T].
        WCR: Weight of completed tasks over the weight of all; zero, as the following ones, for a void plan.
        CR: Completed tasks over all.
        TAT: Mean time from release to the end of the observation of completed tasks, s; None if there are none.
        PC: Energy of all loads, Wh.
        slews: Slews before the observations.
        power: Batteries.
    """

    violations: tuple[tuple[int, str], ...]
    completed: Numbers
    WCR: float
    CR: float
    TAT: float | None
    PC: float
    slews: Slews
    power: Power

    @property
    def valid(self) -> bool:
        """Whether nothing is violated."""
        return not self.violations


def check(case: Case, observations: Observations, positions: Tracks | None = None) -> Report:
    """Return whether observations are a valid plan for a case, and its metrics.

    Each gap is checked against the previous observation, even if that is invalid itself.

    Args:
        case: The case.
        observations: The plan.
        positions: :func:`bsk_torch.tasks.aeossp.geometry.tracks` of the case, computed unless given.

    Raises:
        ValueError: If SGP4 has no orbit for a satellite.
    """
    positions = tracks(case) if positions is None else positions
    slews = find_slews(case, observations, positions)
    power = find_power(case, observations, slews)
    violations = [*_wrong(case, observations, positions, slews), *_empty(case, power)]
    completed = _completed(case, observations)
    done, requests = completed >= 0, case.requests
    waits = observations.end_s[completed[done]] - requests.release_s[done]
    void = bool(violations)
    return Report(
        violations=tuple(violations),
        completed=completed,
        WCR=0.0 if void else float(requests.weight[done].sum() / requests.weight.sum()),
        CR=0.0 if void else float(done.mean()),
        TAT=None if void or not done.any() else float(waits.mean()),
        PC=0.0 if void else float(power.used_wh.sum()),
        slews=slews,
        power=power,
    )


def find_slews(case: Case, observations: Observations, positions: Tracks) -> Slews:
    """Return the slews before observations."""
    o, n = observations, len(observations)
    order = np.lexsort((np.arange(n), o.end_s, o.start_s, o.satellite))
    previous = np.full(n, -1)
    follows = np.flatnonzero(o.satellite[order[1:]] == o.satellite[order[:-1]])
    previous[order[follows + 1]] = order[follows]
    begin, end = o.start_s // case.step_s, o.end_s // case.step_s
    before = positions.sight(o.satellite, o.task[previous], end[previous])
    first = previous < 0
    before[first] = -positions.r[o.satellite[first], begin[first]]
    degrees = np.degrees(angle(before, positions.sight(o.satellite, o.task, begin)))
    required = np.zeros(n)
    for number, satellite in enumerate(case.satellites):
        mine = o.satellite == number
        required[mine] = required_gap(satellite, degrees[mine])
    gap = np.where(first, o.start_s, o.start_s - o.end_s[previous]).astype(np.float64)
    return Slews(previous, gap, degrees, required)


def lines(positions: Tracks, observations: Observations, seconds: Numbers, step_s: int) -> Line:
    """Return the lines of sight of observations at seconds [n] on the grid."""
    k = seconds // step_s
    at = (observations.satellite, observations.task, k)
    return Line(positions.sight(*at), positions.sight_rate(*at))


# -- violations -----------------------------------------------------------------------------------------------------------------


def _wrong(case: Case, observations: Observations, positions: Tracks, slews: Slews) -> list[tuple[int, str]]:
    """Return numbers of observations that break a rule, and the first that each breaks, in the order of the plan."""
    o, requests = observations, case.requests
    sensors = np.array([satellite.sensor for satellite in case.satellites])[o.satellite]
    rules: list[tuple[NDArray[np.bool_], Callable[[int], str]]] = [
        (o.end_s <= o.start_s, lambda k: f"ends at {o.end_s[k]} s, and starts at {o.start_s[k]} s"),
        (
            (o.start_s < requests.release_s[o.task]) | (o.end_s > requests.due_s[o.task]),
            lambda k: (
                f"lasts from {o.start_s[k]} to {o.end_s[k]} s, and the task's window from "
                f"{requests.release_s[o.task[k]]} to {requests.due_s[o.task[k]]} s"
            ),
        ),
        (
            o.end_s - o.start_s != requests.duration_s[o.task],
            lambda k: f"lasts {o.end_s[k] - o.start_s[k]} s instead of {requests.duration_s[o.task[k]]} s",
        ),
        (
            sensors != np.array(requests.sensor)[o.task],
            lambda k: f"has the sensor {sensors[k]!r} instead of {requests.sensor[o.task[k]]!r}",
        ),
        (~_in_cone(case, o, positions), lambda k: "leaves the cone of allowed off-nadir angles"),
        (slews.gap < 0.0, lambda k: f"overlaps the previous observation, number {slews.previous[k]}"),
        (
            slews.gap + STILL < slews.required,
            lambda k: f"needs {slews.required[k]:.3f} s for slew and settling, and has {slews.gap[k]:g} s",
        ),
    ]
    broken = np.stack([mask for mask, _ in rules])
    first = np.argmax(broken, axis=0)
    return [(int(k), rules[first[k]][1](int(k))) for k in np.flatnonzero(broken.any(axis=0))]


def _in_cone(case: Case, observations: Observations, positions: Tracks) -> NDArray[np.bool_]:
    """Return whether observations see their tasks at all times of the grid, from start to end."""
    o, step = observations, case.step_s
    samples = np.maximum((o.end_s - o.start_s) // step + 1, 1)
    rows = np.repeat(np.arange(len(o)), samples)
    k = o.start_s[rows] // step + np.arange(len(rows)) - np.repeat(np.cumsum(samples) - samples, samples)
    off_nadir = np.array([satellite.off_nadir for satellite in case.satellites])
    seen = positions.sees(o.satellite[rows], o.task[rows], k, off_nadir[o.satellite[rows]])
    return np.bincount(rows[~seen], minlength=len(o)) == 0


def _empty(case: Case, power: Power) -> list[tuple[int, str]]:
    return [
        (-1, f"the battery of {case.satellites[s].name!r} is empty: {power.least_wh[s]:.3f} Wh at {power.least_s[s]:.0f} s")
        for s in np.flatnonzero(power.least_wh < -STILL)
    ]


def _completed(case: Case, observations: Observations) -> Numbers:
    """Return the number of the observation of each task that ends first, -1 for none."""
    o = observations
    completed = np.full(len(case.requests), -1)
    latest_first = np.lexsort((np.arange(len(o)), o.start_s, o.end_s))[::-1]
    completed[o.task[latest_first]] = latest_first
    return completed


# -- energy ---------------------------------------------------------------------------------------------------------------------


def find_power(case: Case, observations: Observations, slews: Slews) -> Power:
    """Return the batteries during observations and their slews.

    A load is constant between the times of the case's grid, the ends of observations and of slews; a slew with its settling ends
    where its observation begins. Panels work if the middle of such a part is in sunlight, at any attitude.
    """
    rows = [_power_of(case, number, observations, slews) for number in range(len(case.satellites))]
    return Power(*(np.array(column) for column in zip(*rows, strict=True)))


def _power_of(case: Case, number: int, observations: Observations, slews: Slews) -> tuple[np.float64 | float, ...]:
    """Return the fields of a satellite's :class:`Power`."""
    satellite, horizon = case.satellites[number], float(case.horizon_s)
    mine = np.flatnonzero(observations.satellite == number)
    mine = mine[np.argsort(observations.start_s[mine], kind="stable")]
    start, end = observations.start_s[mine].astype(np.float64), observations.end_s[mine].astype(np.float64)
    turn = start - np.round(slews.required[mine], 6)  # the benchmark keeps microseconds
    times = np.unique(np.concatenate([np.arange(0.0, horizon, case.resource_step_s), start, end, turn, [horizon]]))
    times = times[(times >= 0.0) & (times <= horizon)]
    middle, seconds = 0.5 * (times[1:] + times[:-1]), np.diff(times)
    imaging, slewing = _active(middle, start, end), _active(middle, turn, start)
    load = satellite.idle_w + satellite.imaging_w * imaging + satellite.slew_w * slewing
    supply = satellite.charge_w * sunlit(case, number, middle)
    unlimited = satellite.initial_wh + np.cumsum((supply - load) * seconds) / 3600.0
    lost = np.maximum(np.maximum.accumulate(unlimited - satellite.capacity_wh), 0.0)
    charge = np.concatenate([[satellite.initial_wh], unlimited - lost])
    least = int(np.argmin(charge))
    full = np.flatnonzero(charge[:least] >= satellite.capacity_wh)
    used, charged = ((power * seconds).sum() / 3600.0 for power in (load, supply))
    when = times[least], times[full[-1]] if len(full) else 0.0
    return charge[least], *when, charge[-1], used, charged, seconds[imaging].sum(), seconds[slewing].sum()


def _active(times: Array, begin: Array, end: Array) -> NDArray[np.bool_]:
    """Return which times lie in any of some intervals, which are sorted."""
    if not len(begin):
        return np.zeros(len(times), dtype=bool)
    at = np.searchsorted(begin, times, side="right") - 1
    return (at >= 0) & (times < end[at])
