"""Where a satellite will be, as bsk_rl predicts it: positions every 30 s or another step, splines through them, and eclipses."""

from __future__ import annotations

import logging
import math

import numpy as np
import torch
from numpy.typing import NDArray

from bsk_torch.astro.eclipse import in_umbra
from bsk_torch.astro.ephemeris import earth_orientation
from bsk_torch.astro.interpolate import COUNT
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.codegen.kernel import Samples
from bsk_torch.constants import MU_EARTH
from bsk_torch.sim.access.passes.literal_search import Interpolator
from bsk_torch.sim.access.visibility.kernels import make_visibility
from bsk_torch.sim.access.visibility.planned import PlannedOrbits, position_between, take_rows
from bsk_torch.sim.arguments.values import convert
from bsk_torch.sim.component import Bus
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK
from bsk_torch.sim.environment.world import EPHEMERIS
from bsk_torch.sim.orbit.arcs import Arcs, segments_for
from bsk_torch.sim.orbit.builder import ARC
from bsk_torch.sim.orbit.grid import NODE_SPACING, PLAN_STEP
from bsk_torch.sim.orbit.kernel_solver import make_solver
from bsk_torch.vec3 import Vec3

logger = logging.getLogger(__name__)

Vector = NDArray[np.float64]

SEARCH_STEP = 6000.0
"""Seconds by which a search for eclipses goes further after each failure."""

ALL_HOURS = 1 << 30
"""More hours of the predicted orbit than any episode has: all of them are kept."""

BEHIND_SAMPLES = COUNT * NODE_SPACING
"""Seconds of the orbit behind the last sample, so that what is interpolated does not depend on how far it has been solved."""

ELEMENTS = "a", "e", "i", "Omega", "omega", "f"
"""Attributes of orbital elements: m, -, rad."""

NOT_FOUND = 1.0, 1.0
"""Answer of a search for eclipses that fails, s."""


def initial_state(rN: object, vN: object, oe: object, mu: float) -> tuple[Vector, Vector]:
    """Return position, m, and velocity, m/s, in N from either of bsk_rl's two forms.

    Raises:
        ValueError: Unless exactly one of ``oe`` and the pair ``rN``, ``vN`` is given, and if ``oe`` lacks an element.
    """
    if oe is None and rN is not None and vN is not None:
        return np.array(rN, dtype=float).reshape(3), np.array(vN, dtype=float).reshape(3)
    if oe is None or rN is not None or vN is not None:
        raise ValueError("an orbit is given by oe, or by rN and vN with oe=None; exactly one of the two")
    if not all(hasattr(oe, name) for name in ELEMENTS):
        raise ValueError(f"sat_args: oe={oe!r} must have the attributes {', '.join(ELEMENTS)}, such as random_orbit() returns")
    values = (torch.tensor(float(getattr(oe, name)), dtype=torch.float64) for name in ELEMENTS)
    r, v = elements_to_rv(Elements(*values), torch.tensor(float(mu), dtype=torch.float64))
    return r.stack().numpy(), v.stack().numpy()


class TrajectorySimulator:
    """Prediction of an orbit without drag and maneuvers, extended when needed; bsk_rl's class of this name.

    Attributes:
        dt: Seconds between samples.
        rN_init, vN_init: Position, m, and velocity, m/s, at time zero.
    """

    def __init__(
        self,
        utc_init: object,
        rN: object = None,
        vN: object = None,
        oe: object = None,
        mu: float = MU_EARTH,
        dt: float = PLAN_STEP,
        backend: str = "compiled",
    ) -> None:
        """Start at ``utc_init`` from elements or a state; nothing is computed yet.

        Positions have the error of bsk_rl's integration in steps of ``dt`` if that is 30 s, and otherwise none.

        Raises:
            ValueError: For an orbit that is given twice or not at all, or a ``dt`` that is not positive and finite.
        """
        if not 0.0 < dt < math.inf:
            raise ValueError(f"dt={dt} s must be a positive number, the time between two samples")
        self.utc_init, self.dt = utc_init, dt
        self.rN_init, self.vN_init = initial_state(rN, vN, oe, mu)
        self._backend, self._arcs, self._samples = backend, None, 1
        self._until = 0.0
        self._starts: list[float] = []
        self._ends: list[float] = []
        self._splines: dict[str, Interpolator] = {}
        self._dark: list[bool] = []

    _arcs: Arcs | None

    # -- the orbit ----------------------------------------------------------------------------------------------------

    @property
    def arcs(self) -> Arcs:
        """The predicted orbit, hour by hour."""
        if self._arcs is None:
            self._visibility = make_visibility(self._backend, torch.device("cpu"))
            solver = make_solver(1.0 if self._as_planned else self.dt, self._backend, torch.device("cpu"))
            self._arcs = Arcs(1, segments_for(self._samples * self.dt), solver, ALL_HOURS)
            et = convert(EPHEMERIS.args[0], [self.utc_init], 1).reshape(1)
            state = (torch.from_numpy(x).unsqueeze(0) for x in (self.rN_init, self.vN_init))
            self._arcs.solve(torch.zeros(1, dtype=torch.int64), et, *state)
        return self._arcs

    def extend_to(self, t: float) -> None:
        """Predict up to the last sample at or before ``t`` s."""
        wanted = 1 + math.floor(t / self.dt + 1e-9)
        if wanted <= self._samples:
            return
        self._samples = wanted
        ahead = 0.0 if self._as_planned else BEHIND_SAMPLES
        while self.arcs.length < (wanted - 1) * self.dt + ahead:
            self.arcs.grow()
        self._splines = {}

    @property
    def sim_time(self) -> float:
        """Time of the last sample, s."""
        return (self._samples - 1) * self.dt

    @property
    def times(self) -> Vector:
        """Times of the samples, [n] s."""
        return self.dt * np.arange(self._samples, dtype=np.float64)

    @property
    def _as_planned(self) -> bool:
        """Whether samples are those of the planned arc; others are interpolated on the flown one."""
        return self.dt == PLAN_STEP

    def _flown(self, first: int) -> tuple[Vec3, Bus]:
        """Return positions, Sun and Earth at the samples from number ``first`` on, by interpolation."""
        time = self.dt * torch.arange(first, self._samples, dtype=torch.float64)
        every = torch.zeros(len(time), dtype=torch.int64)
        flown, sky = (take_rows(track, every) for track in self.arcs.tracks((ARC, EPHEMERIS_TRACK)))
        return position_between(flown, sky, time)

    @property
    def r_BN_N(self) -> Interpolator:
        """Positions in N, m."""
        return self._spline("N")

    @property
    def r_BP_P(self) -> Interpolator:
        """Positions in the Earth-fixed frame, m."""
        return self._spline("P")

    def _spline(self, frame: str) -> Interpolator:
        if frame not in self._splines:
            if self._samples < 4:
                self.extend_to(3 * self.dt)
            r = self.arcs.planned[0, : self._samples] if self._as_planned else self._flown(0)[0].stack()
            if frame == "P":
                times = torch.arange(self._samples, dtype=torch.float64) * self.dt
                r = (earth_orientation(self.arcs.et + times) @ r.unsqueeze(-1)).squeeze(-1)
            self._splines[frame] = Interpolator(self.times, r.numpy())
        return self._splines[frame]

    # -- eclipses -----------------------------------------------------------------------------------------------------

    def next_eclipse(self, t: float, max_tries: int = 2) -> tuple[float, float]:
        """Return when the next eclipse starts, and when the next one ends, s; not always the same eclipse.

        Transitions are those between samples. A search that fails ``max_tries`` times returns one second, as in bsk_rl.
        """
        for k in range(max_tries + 1):
            starts, ends = ([time for time in transitions if time > t] for transitions in (self._starts, self._ends))
            if starts and ends:
                return min(starts), min(ends)
            self._search(t + k * SEARCH_STEP)
        logger.warning("no eclipse starts and ends within %.1f s", self._until - t)
        return NOT_FOUND

    def _search(self, until: float) -> None:
        """Note the transitions between the samples after those of the last search."""
        self.extend_to(until + self.dt)
        missing = self._samples - len(self._dark)
        if missing > 0 and not self._as_planned:
            r_BN_N, sky = self._flown(len(self._dark))
            self._dark += in_umbra(r_BN_N, sky.r_SN_N).tolist()
        elif missing > 0:
            arcs, zero = self.arcs, torch.zeros(1, dtype=torch.float64)
            orbits = PlannedOrbits(Samples(arcs.planned, zero - 0.5 * PLAN_STEP), Samples(arcs.ephemeris, zero))
            start = zero + len(self._dark) * PLAN_STEP
            self._dark += (self._visibility.umbra(orbits, start, missing)[0] > 0.0).tolist()
        first = math.floor(self._until / self.dt + 1e-9) + 1
        for k in range(first, self._samples - 1):  # a sample's shadow is that of the position one step before
            if self._dark[k] != self._dark[k - 1]:
                (self._starts if self._dark[k] else self._ends).append(k * self.dt)
        self._until = until
