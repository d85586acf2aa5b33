"""Flights as CCSDS Orbit Ephemeris Messages, which STK, GMAT, Orekit and others read."""

from __future__ import annotations

import numpy as np

from bsk_torch.astro.element_sets import Ephemeris
from bsk_torch.formats.ccsds import write_oem
from bsk_torch.recording.recording import Recording

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
    if not 0 <= track < len(recording.tracks):
        raise IndexError(f"track={track} must lie from 0 to {len(recording.tracks) - 1}")
    flight = recording.tracks[track]
    scene = recording.scenes[flight.scene]
    if not scene.PN0:
        raise ValueError(f"{recording.preset or 'the recording'} has no Earth, which an OEM needs; write .html instead")
    times, found = flight.arrays["key_times"], []
    states = np.concatenate([flight.arrays[name].astype("f8") for name in ("r_N", "v_N")], -1)
    for k, craft in enumerate(recording.satellites):
        kept = np.isfinite(states[:, k]).all(-1) & np.concatenate([[True], np.diff(times) > 0.0])
        if kept.any():
            found.append(Ephemeris(craft.name, craft.name, scene.et + times[kept], states[kept, k]))
    return write_oem(found)
