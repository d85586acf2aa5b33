"""Flights as CCSDS Orbit Ephemeris Messages, which STK, GMAT, Orekit and others read."""

from __future__ import annotations

import numpy as np

from bsk_torch.astro.element_sets import Ephemeris
from bsk_torch.formats.ccsds import write_oem
from bsk_torch.recording.recording import Recording
from bsk_torch.viewer.czml import flight_over_earth

__all__ = ["oem"]


def oem(recording: Recording, track: int = 0) -> str:
    """Return the orbits of a track as the text of an OEM: a segment for each satellite, with a state at each keyframe.

    Recordings keep positions to 0.5 m and velocities to 0.5 mm/s.

    Args:
        recording: Flights around the Earth.
        track: Which of its tracks.

    Raises:
        IndexError: For a track that does not exist.
        ValueError: For a flight without the Earth.
    """
    flight, scene = flight_over_earth(recording, track, "an OEM")
    times, orbits = flight.arrays["key_times"], []
    states = np.concatenate([flight.arrays[name].astype("f8") for name in ("r_N", "v_N")], -1)
    for k, craft in enumerate(recording.satellites):
        kept = np.isfinite(states[:, k]).all(-1) & np.concatenate([[True], np.diff(times) > 0.0])
        if kept.any():
            orbits.append(Ephemeris(craft.name, craft.name, scene.et + times[kept], states[kept, k]))
    return write_oem(orbits)
