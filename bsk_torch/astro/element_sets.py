"""Orbits of real satellites: element sets for SGP4, and states of an ephemeris, as initial orbits in N.

Both have ``state_at(et)``, which is what the argument ``oe`` of satellites asks at the epoch of each episode.

SGP4 is that of Vallado, Crawford, Hujsak and Kelso, "Revisiting Spacetrack Report #3" (AIAA 2006-6753), in the library sgp4.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from sgp4.api import SGP4_ERRORS, WGS72, WGS84, Satrec
from torch import Tensor

from bsk_torch.astro.earth_rotation import sidereal_time_1982, teme_axes
from bsk_torch.astro.ephemeris import DAY, date_in_words, utc_seconds
from bsk_torch.astro.matching import matched_velocity
from bsk_torch.constants import MU_EARTH

__all__ = ["ElementSet", "Ephemeris"]

logger = logging.getLogger(__name__)

GRAVITIES = {"wgs72": WGS72, "wgs84": WGS84}
"""Constants of SGP4 by name. Element sets are fitted with those of WGS72; WGS84 moves positions by up to 70 m in half a day."""

MAX_AGE_DAYS = 30.0
"""Days from the epoch of an element set up to which it is flown, unless the set says otherwise."""

OLD_DAYS = 7.0
"""Days from the epoch of an element set from which on a warning gives its age."""

FIRST_DAY = 18263.5
"""Days from 1949-12-31 00:00 UTC, from which SGP4 counts, to 2000-01-01 12:00 UTC."""

_warned: set[tuple[str, float]] = set()
"""Sets whose age has been logged."""


@dataclass(frozen=True)
class ElementSet:
    """Mean elements of a satellite for SGP4, as in a two-line set or OMM: in TEME, at an epoch.

    As ``sat_args["oe"]``, it is evaluated by SGP4 at the epoch ``utc_init`` of each episode.

    Attributes:
        name: Name of the satellite.
        norad_id: Its catalog number.
        epoch: ET of the elements, s past J2000.
        inclination: rad.
        node: Right ascension of the ascending node, rad.
        eccentricity: In [0, 1).
        perigee: Argument of perigee, rad.
        mean_anomaly: rad.
        mean_motion: rad/min, by Kozai's definition.
        bstar: Drag term, 1/Earth radii.
        gravity: Constants of SGP4, ``"wgs72"`` or ``"wgs84"``.
        max_age_days: Days from the epoch beyond which states raise an error.
        matched: Whether the velocity at the start is fitted, so that the flown orbit stays near SGP4's path; else it is SGP4's.
    """

    name: str
    norad_id: int
    epoch: float
    inclination: float
    node: float
    eccentricity: float
    perigee: float
    mean_anomaly: float
    mean_motion: float
    bstar: float
    gravity: str = "wgs72"
    max_age_days: float = MAX_AGE_DAYS
    matched: bool = True

    def __str__(self) -> str:
        return f"ElementSet({self.name!r}, {self.norad_id}, {date_in_words(self.epoch)})"

    def teme_states(self, et: Tensor) -> tuple[Tensor, Tensor]:
        """Return SGP4's positions, m, and velocities, m/s, in TEME at ET [n], s, each [n, 3]; ValueError where SGP4 has none."""
        record = _record(self)
        minutes = (et.detach().cpu().numpy() - self.epoch) / 60.0
        days = np.full_like(minutes, record.jdsatepoch)
        errors, r, v = record.sgp4_array(days, record.jdsatepochF + minutes / 1440.0)
        if errors.any():
            first = int(np.flatnonzero(errors)[0])
            raise ValueError(
                f"SGP4 has no state of {self.name!r} ({self.norad_id}) {minutes[first] / 1440.0:.6g} days after its epoch "
                f"{date_in_words(self.epoch)}: {SGP4_ERRORS[int(errors[first])]}"
            )
        return torch.from_numpy(r * 1e3).to(et.device), torch.from_numpy(v * 1e3).to(et.device)

    def state_at(self, et: Tensor) -> tuple[Tensor, Tensor]:
        """Return initial positions, m, and velocities, m/s, in N of orbits that start at ET [n], s, each [n, 3].

        Positions are SGP4's. Velocities differ from SGP4's, by up to 0.5 m/s in low circular orbits and meters per second in
        eccentric ones, so that the flown orbit stays near SGP4's path, see :mod:`bsk_torch.astro.matching`.

        Raises:
            ValueError: For epochs further than ``max_age_days`` from that of the set, and where SGP4 has no state.
        """
        self.check_age(et)
        if len(et) > 1 and bool((et == et[0]).all()):
            return tuple(part.expand(len(et), 3) for part in self.state_at(et[:1]))  # type: ignore[return-value]
        if len(et) == 1:
            return tuple(part.to(et.device) for part in _state_at(self, float(et)))  # type: ignore[return-value]
        return self._matched(et)

    def _matched(self, et: Tensor) -> tuple[Tensor, Tensor]:
        """Return the state as :meth:`state_at` does, of epochs near that of the set."""

        def positions(times: Tensor) -> Tensor:
            return self.teme_states((et.unsqueeze(-1) + times).flatten())[0].view(len(et), len(times), 3)

        (r, v), TN = self.teme_states(et), teme_axes(et)
        if self.matched:
            v = matched_velocity(positions, et, TN, sidereal_time_1982(et))
        r, v = ((TN.mT @ part.unsqueeze(-1)).squeeze(-1) for part in (r, v))
        return r, v

    def check_age(self, et: Tensor) -> None:
        """Raise ValueError if ET [n], s, is too far from the epoch of the set; log a warning if it is far."""
        days = (et - self.epoch) / DAY
        worst = float(days[days.abs().argmax()])
        about = f"the elements of {self.name!r} ({self.norad_id}) are of {date_in_words(self.epoch)}"
        if not abs(worst) <= self.max_age_days:
            when = date_in_words(self.epoch + worst * DAY)
            raise ValueError(
                f"{about}, {abs(worst):,.1f} days from the start of the episode, {when}; allowed are "
                f"{self.max_age_days:g}. Give an epoch near it, world_args={{'utc_init': '{date_in_words(self.epoch)}'}}, newer "
                "elements, or a larger max_age_days to the reader"
            )
        if abs(worst) > OLD_DAYS and (self.name, self.epoch) not in _warned:
            _warned.add((self.name, self.epoch))
            logger.warning("%s, %.1f days from the start of the episode: SGP4 is off by kilometers a day", about, abs(worst))


@lru_cache(4096)
def _state_at(elements: ElementSet, et: float) -> tuple[Tensor, Tensor]:
    """Return the state at one epoch, which episodes share that begin at the same time."""
    return elements._matched(torch.tensor([et], dtype=torch.float64))


@lru_cache(4096)
def _record(elements: ElementSet) -> Satrec:
    days = FIRST_DAY + float(utc_seconds(torch.tensor(elements.epoch, dtype=torch.float64))) / DAY
    record = Satrec()
    record.sgp4init(
        *(GRAVITIES[elements.gravity], "i", min(elements.norad_id, 339999), days, elements.bstar, 0.0, 0.0),
        *(elements.eccentricity, elements.perigee, elements.inclination, elements.mean_anomaly),
        *(elements.mean_motion, elements.node),
    )
    return record


@dataclass(frozen=True, eq=False)
class Ephemeris:
    """States of a satellite in N over time, such as from a CCSDS OEM, or a single one, from an OPM.

    Attributes:
        name: Name of the satellite.
        object_id: Its international designator.
        times: ET of the states, [K] s past J2000, increasing.
        states: Positions, m, and velocities, m/s, in N, [K, 6].
    """

    name: str
    object_id: str
    times: np.ndarray
    states: np.ndarray

    def __str__(self) -> str:
        return f"Ephemeris({self.name!r}, {date_in_words(self.times[0])} to {date_in_words(self.times[-1])})"

    def state_at(self, et: Tensor) -> tuple[Tensor, Tensor]:
        """Return positions, m, and velocities, m/s, in N at ET [n], s, each [n, 3].

        The polynomial through positions and velocities of the four states around (Hermite, degree 7); a single state is moved by
        up to a second. ValueError outside the span of the states.
        """
        times = et.detach().cpu().numpy()
        slack = 1.0 if len(self.times) == 1 else 1e-3
        outside = (times < self.times[0] - slack) | (times > self.times[-1] + slack)
        if outside.any():
            when = date_in_words(float(times[outside][0]))
            raise ValueError(
                f"the ephemeris of {self.name!r} reaches from {date_in_words(self.times[0])} to {date_in_words(self.times[-1])}; "
                f"an episode starts at {when}. Give a start within, such as world_args={{'utc_init': "
                f"'{date_in_words(self.times[0])}'}}"
            )
        interpolated = np.stack([self._at(time) for time in times])
        r, v = torch.from_numpy(interpolated).to(et.device).split(3, -1)
        return r, v

    def _at(self, time: float) -> np.ndarray:
        from scipy.interpolate import KroghInterpolator

        k = int(np.clip(np.searchsorted(self.times, time) - 2, 0, max(0, len(self.times) - 4)))
        near, states = self.times[k : k + 4], self.states[k : k + 4]
        if len(near) == 1:
            r, v, dt = states[0, :3], states[0, 3:], time - near[0]
            pull = -MU_EARTH * r / np.linalg.norm(r) ** 3
            return np.concatenate([r + v * dt + 0.5 * pull * dt**2, v + pull * dt])
        span = near[-1] - near[0]
        nodes, values = np.repeat((near - near[0]) / span, 2), np.empty((2 * len(near), 3))
        values[::2], values[1::2] = states[:, :3], states[:, 3:] * span
        path = KroghInterpolator(nodes, values)
        s = (time - near[0]) / span
        return np.concatenate([path(s), path.derivative(s) / span])
