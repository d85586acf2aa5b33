"""BSK-RL's search for windows over one place after another: splines, Brent's methods, and what they lose.

Times at which a satellite is near a place are known from samples every 30 s. Between the ends of such a span it looks for
one crossing of the least elevation, or, where both ends are below it, for the highest elevation. A span that lasts longer than
about a quarter of a revolution can make the search for the highest elevation end at another pass, or outside of the span: then
the pass is lost, or another window is found. ``bsk_torch.bsk_rl`` finds all windows so; ``compat="bsk_rl"`` those of long spans.
"""

from __future__ import annotations

import itertools
import logging
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from bsk_torch.sim.orbit.grid import PLAN_STEP

logger = logging.getLogger(__name__)

Vector = NDArray[np.float64]
Window = tuple[float, float]

SHORTEST = 0.1  # seconds that a window within the search must last
NEAR = 1.1  # factor of the slant range over a flat Earth within which samples are near a place


class Interpolator:
    """Cubic spline through positions ``y`` [n, 3] m at times ``x`` [n] s."""

    def __init__(self, x: Vector, y: Vector) -> None:
        from scipy.interpolate import CubicSpline

        self.x, self.y = x, y
        self._spline = CubicSpline(x, y)
        self._rows: list[list[float]] | None = None

    def __call__(self, t: float | Vector) -> Vector:
        """Return positions at times [...], [..., 3] m."""
        return np.asarray(self._spline(t), dtype=np.float64)

    def at(self, t: float) -> tuple[float, float, float]:
        """Return the position at one time as plain numbers, which is several times as fast as an array."""
        if self._rows is None:
            c = self._spline.c  # [4, n - 1, 3]
            self._rows = np.concatenate([c[..., axis] for axis in range(3)]).T.tolist()
        k = min(max(int((t - self.x[0]) / PLAN_STEP), 0), len(self._rows) - 1)
        s = t - (self.x[0] + k * PLAN_STEP)
        a3, a2, a1, a0, b3, b2, b1, b0, c3, c2, c1, c0 = self._rows[k]
        return ((a3 * s + a2) * s + a1) * s + a0, ((b3 * s + b2) * s + b1) * s + b0, ((c3 * s + c2) * s + c1) * s + c0


def elevation_error(position: Interpolator, place: Sequence[float], least: float) -> Callable[[float], float]:
    """Return the function of time that gives the least elevation minus the elevation of a satellite seen from a place, rad."""
    x, y, z = (float(c) for c in place)
    radius = math.sqrt(x * x + y * y + z * z)

    def error(t: float) -> float:
        rx, ry, rz = position.at(t)
        dx, dy, dz = rx - x, ry - y, rz - z
        cosine = (x * dx + y * dy + z * dz) / (radius * math.sqrt(dx * dx + dy * dy + dz * dz))
        return least - (0.5 * math.pi - math.acos(min(1.0, max(-1.0, cosine))))

    return error


def near_samples(positions: Vector, places: Vector, least: Vector) -> NDArray[np.bool_]:
    """Return which samples [n, 3] m are near each place [P, 3] m with its least elevation [P] rad, [P, n]."""
    highest = np.max(np.linalg.norm(positions, axis=-1))
    with np.errstate(divide="ignore"):  # above an elevation of 0 all are near
        reach = NEAR * (highest - np.linalg.norm(places, axis=-1)) / np.sin(least)
    near = np.empty((len(places), len(positions)), dtype=bool)
    for some in range(0, len(places), 256):  # tables of a few megabytes
        part = slice(some, some + 256)
        near[part] = np.linalg.norm(positions - places[part, None], axis=-1) < reach[part, None]
    return near


def near_spans(near: NDArray[np.bool_], times: Vector) -> list[Window]:
    """Return the spans of time of neighboring near samples [n], widened by a sample on both sides."""
    indices = np.flatnonzero(near)
    if not len(indices):
        return []
    last = len(times) - 1
    breaks = np.flatnonzero(np.diff(indices) != 1)
    starts, ends = indices[np.r_[0, breaks + 1]], indices[np.r_[breaks, len(indices) - 1]]
    return [(times[max(0, a - 1)], times[min(last, b + 1)]) for a, b in zip(starts.tolist(), ends.tolist(), strict=True)]


def windows_in(error: Callable[[float], float], span: Window, bounds: Window, log: logging.Logger = logger) -> Iterator[Window]:
    """Yield the windows, s, within one of :func:`near_spans`, in which the :func:`elevation_error` is negative.

    Those that reach a bound of the search are cut there; ``log`` gets a warning where a window is longer than the search.
    """
    from scipy.optimize import minimize_scalar, root_scalar

    at_start, at_end = error(span[0]), error(span[1])
    if at_start < 0 and at_end < 0:
        log.warning("initial_generation_duration is shorter than the maximum window length; some windows may be neglected.")
        return
    if at_start < 0 or at_end < 0:
        crossing = root_scalar(error, bracket=span).root
        if span[0] == bounds[0]:
            yield bounds[0], crossing
        elif span[1] == bounds[1]:
            yield crossing, bounds[1]
        return
    highest = minimize_scalar(error, bracket=span, tol=1e-4)
    if highest.fun < 0:
        opens = root_scalar(error, bracket=(span[0], highest.x)).root
        closes = root_scalar(error, bracket=(highest.x, span[1])).root
        if closes - opens > SHORTEST:
            yield opens, closes


def searched_by_interval(
    samples: Vector, start: float, edges: Sequence[float], places: Vector, least: Vector
) -> list[tuple[int, float, float]]:
    """Return the windows found over places in one interval after another: place, opening and closing, s.

    ``samples`` [K, 3] are Earth-fixed positions, m, every 30 s from ``start`` s on, ``edges`` the begin of the first interval
    and the ends of all, s, ``places`` [P, 3] Earth-fixed positions, m, and ``least`` [P] the least elevations, rad.
    """
    times, windows_of = start + PLAN_STEP * np.arange(len(samples), dtype=np.float64), dict[int, list[Window]]()
    for begin, end in itertools.pairwise(edges):
        first, last = (round((edge - start) / PLAN_STEP) for edge in (begin, end))
        track = Interpolator(times[: last + 1], samples[: last + 1])  # the orbit has been propagated so far
        within = slice(first, last + 1)
        for place, near in enumerate(near_samples(samples[within], places, least)):
            error = elevation_error(track, places[place], float(least[place]))
            earlier = windows_of.setdefault(place, [])
            for span in near_spans(near, times[within]):
                for opens, closes in windows_in(error, span, (begin, end)):
                    joined = next((k for k, window in enumerate(earlier) if opens == begin == window[1]), None)
                    earlier.append((opens if joined is None else earlier.pop(joined)[0], closes))
    return [(place, *window) for place, windows in windows_of.items() for window in windows]
