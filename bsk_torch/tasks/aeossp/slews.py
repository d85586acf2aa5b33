"""How long a satellite of a case takes from one task to the next, in numpy: by the benchmark's rule, and as a body can fly it.

Directions are unit vectors in an inertial frame, [..., 3]; their rates, rad/s, are perpendicular to them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bsk_torch.tasks.aeossp.files import CaseSatellite
from bsk_torch.tasks.aeossp.geometry import Array, angle

Flags = NDArray[np.bool_]

STILL = 1e-9
"""Largest angle without a slew, deg, and how much shorter than required a gap may be, s, in the benchmark."""


class Line(NamedTuple):
    """Lines of sight: unit vectors and their derivatives, rad/s, [..., 3] each."""

    unit: Array
    rate: Array


Fits = Callable[[CaseSatellite, Array, Line, Line], Flags]
"""Whether gaps, s, [...], are long enough for slews of a satellite from lines of sight to others."""


def required_gap(satellite: CaseSatellite, degrees: Array) -> Array:
    """Return the benchmark's time for slews by angles, deg, and settling, s: from rest to rest, about one axis."""
    rate, acceleration = satellite.slew_rate, satellite.slew_acceleration
    ramps = rate * rate / acceleration
    short = 2.0 * np.sqrt(degrees / acceleration)
    slew = np.where(degrees <= ramps, short, 2.0 * rate / acceleration + (degrees - ramps) / rate)
    return np.where(degrees <= STILL, 0.0, slew) + satellite.settling_s


def verifier(satellite: CaseSatellite, gap: Array, before: Line, after: Line) -> Flags:
    """Return whether the benchmark accepts gaps: lines of sight at their ends count, their rates do not."""
    return gap + STILL >= required_gap(satellite, np.degrees(angle(before.unit, after.unit)))


SPLITS = np.radians(np.arange(0.0, 91.0, 7.5))
"""Angles that share a slew's limits between its two axes: the along-track axis gets the cosine of each, the other the sine."""


def flyable(satellite: CaseSatellite, gap: Array, before: Line, after: Line) -> Flags:
    """Return whether the benchmark accepts gaps, and a body under the same limits can fly them.

    Such a body leaves the first line of sight at its rate, and meets direction and rate of the second one at the end of the gap,
    with no time to settle: a control law that knows the slew ahead follows it closely. It moves as two double integrators, along
    the great circle between both lines and across it, whose rates and accelerations together do not exceed the limits: for one
    of :data:`SPLITS`, each axis keeps its own share. The displacements which a double integrator with limited rate can reach
    between two rates within a time are an interval, whose ends accelerate first and last.
    """
    normal = np.cross(before.unit, after.unit)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    along = before.rate - after.rate  # any direction serves where both lines are the same
    fallback = np.cross(before.unit, along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-12))
    normal = np.where(length > 1e-9, normal / np.maximum(length, 1e-12), fallback)
    ends = [(np.sum(line.rate * np.cross(normal, line.unit), -1), np.sum(line.rate * normal, -1)) for line in (before, after)]
    distance = np.arctan2(length[..., 0], np.sum(before.unit * after.unit, -1))
    fits = np.zeros(gap.shape, dtype=bool)
    for split in SPLITS:
        fits |= _reaches(satellite, np.cos(split), gap, distance, ends[0][0], ends[1][0]) & _reaches(
            satellite, np.sin(split), gap, np.zeros_like(distance), ends[0][1], ends[1][1]
        )
    return fits & verifier(satellite, gap, before, after)


def _reaches(satellite: CaseSatellite, share: float, gap: Array, distance: Array, begin: Array, end: Array) -> Flags:
    """Return whether one axis with a share of the limits moves by distances, rad, between two rates within gaps."""
    rate, acceleration = share * np.radians(satellite.slew_rate), share * np.radians(satellite.slew_acceleration)
    slow = np.maximum(np.abs(begin), np.abs(end)) <= rate
    slow &= np.abs(end - begin) <= acceleration * gap
    most = _farthest(rate, acceleration, gap, begin, end)
    least = -_farthest(rate, acceleration, gap, -begin, -end)
    return slow & (least <= distance) & (distance <= most)


def _farthest(rate: float, acceleration: float, gap: Array, begin: Array, end: Array) -> Array:
    """Return the largest displacement: acceleration, coasting at the highest rate, and deceleration."""
    top = np.minimum(rate, 0.5 * (begin + end + acceleration * gap))
    ramps = (2.0 * top - begin - end) / max(acceleration, 1e-12)
    return (2.0 * top**2 - begin**2 - end**2) / max(2.0 * acceleration, 1e-12) + top * np.maximum(gap - ramps, 0.0)


MODELS: dict[str, Fits] = {"verifier": verifier, "flyable": flyable}
"""Transition models by name."""
