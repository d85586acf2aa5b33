"""What a plan of aeossp_standard needs in order to be flown as promised: faster slews, or longer gaps."""

from __future__ import annotations

import math

import numpy as np

from bsk_torch.tasks.aeossp.files import Case, Observations
from bsk_torch.tasks.aeossp.flight import TICK, Flight, fly
from bsk_torch.tasks.aeossp.geometry import Array, Numbers, Tracks, angle, tracks
from bsk_torch.tasks.aeossp.slews import required_gap

MOST_FACTOR = 4.0
"""Largest factor of slew limits that is tried."""

RESOLUTION = 0.01
"""How close a factor is to the smallest one."""


def fitting_factor(case: Case, observations: Observations, *, power: str = "case", tick: float = TICK) -> float:
    """Return the factor of slew limits with which all observations of a plan are delivered; infinite above :data:`MOST_FACTOR`.

    The same factor multiplies rate and acceleration of all satellites. It is found by bisection for each satellite that does
    not deliver all with its own limits, all at once; those that cannot need the largest factor are left out.
    """

    def misses(crew: Numbers, factors: Array) -> Numbers:
        flight = fly(case, observations, factor=list(factors), power=power, tick=tick, satellites=crew.tolist())
        return crew[np.isin(crew, observations.satellite[~flight.delivered])]

    everyone = np.arange(len(case.satellites))
    late = wanting = misses(everyone, np.ones(len(everyone)))
    if not len(late):
        return 1.0
    if len(misses(late, np.full(len(late), MOST_FACTOR))):
        return math.inf
    low, high = np.ones(len(everyone)), np.full(len(everyone), MOST_FACTOR)
    while len(late := late[high[late] > low[late].max() + RESOLUTION]):
        middle = 0.5 * (low + high)
        wrong = np.isin(late, misses(late, middle[late]))
        low[late[wrong]], high[late[~wrong]] = middle[late[wrong]], middle[late[~wrong]]
    return float(high[wanting].max())


def thinned(case: Case, observations: Observations, margin: float, positions: Tracks | None = None) -> Observations:
    """Return a plan without the observations whose gap is not ``margin`` s longer than the verifier requires.

    Observations of a satellite are taken in the order of their starts, each against the last one that is kept.
    """
    positions = tracks(case) if positions is None else positions
    kept = []
    for number, satellite in enumerate(case.satellites):
        mine = np.flatnonzero(observations.satellite == number)
        line, end = None, 0
        for k in mine[np.argsort(observations.start_s[mine], kind="stable")]:
            first, last = (int(times[k]) // case.step_s for times in (observations.start_s, observations.end_s))
            at = np.int64(number), observations.task[k]
            before = -positions.r[number, first] if line is None else line
            degrees = np.degrees(angle(before, positions.sight(*at, np.int64(first))))
            if observations.start_s[k] - end >= required_gap(satellite, degrees) + margin - 1e-9:
                kept.append(k)
                line, end = positions.sight(*at, np.int64(last)), int(observations.end_s[k])
    return observations.take(np.sort(np.array(kept, dtype=np.int64)))


def completed_weight(case: Case, observations: Observations) -> float:
    """Return the weight of the tasks that are observed, over the weight of all: the benchmark's WCR of a valid plan."""
    weight = case.requests.weight
    return float(weight[np.unique(observations.task)].sum() / weight.sum())


def delivered(observations: Observations, flight: Flight) -> Observations:
    """Return the observations that a flight delivered."""
    return observations.take(flight.delivered)
