"""Record Basilisk's stripLocation: the place that moves along a strip, and from when on it has access.

Usage::

    python scripts/recorders/record_strips.py              # strips.npz, into tests/basilisk/recordings

See ``recording.py`` for what it needs. bsk_rl has no strips; the module runs alone, with the Earth at rest.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.simulation import stripLocation
from Basilisk.utilities import SimulationBaseClass, macros
from recording import Array, record_files

RADIUS = 6378136.6
"""Radius of the sphere on which strips lie, m."""

TICK, TICKS = 0.5, 300


def fly(start: Array, end: Array, speed: float, before: float) -> dict[str, Array]:
    """Places [K, 3] m and access [K] of a strip, seen from above its middle."""
    sim = SimulationBaseClass.SimBaseClass()
    sim.CreateNewProcess("process").addTask(sim.CreateNewTask("task", macros.sec2nano(TICK)))
    strip = stripLocation.StripLocation()
    strip.planetRadius, strip.minimumElevation = RADIUS, 0.0
    strip.acquisitionSpeed, strip.preImagingTime = speed * 1e-9, int(before * 1e9)
    strip.r_LP_P_Start, strip.r_LP_P_End = start, end
    above = messaging.SCStatesMsgPayload()
    above.r_BN_N = 1.3 * (start + end)
    message = messaging.SCStatesMsg().write(above)
    strip.addSpacecraftToModel(message)
    sim.AddModelToTask("task", strip)
    place, access = strip.currentStripStateOutMsg.recorder(), strip.accessOutMsgs[0].recorder()
    for recorder in (place, access):
        sim.AddModelToTask("task", recorder)
    sim.InitializeSimulation()
    sim.ConfigureStopTime(macros.sec2nano(TICK * TICKS))
    sim.ExecuteSimulation()
    return dict(place=np.array(place.r_LN_N), access=np.array(access.hasAccess, dtype=bool))


def record(name: str) -> dict[str, Any]:
    """Five strips of different lengths, directions and speeds, in row."""
    rng = np.random.default_rng(5)
    rows: dict[str, list[Any]] = {}
    for speed, before in ((3000.0, 20.0), (3000.0, 0.0), (7000.0, 33.25), (1500.0, 60.0), (3000.0, 45.5)):
        start, other = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        along = np.cross(np.cross(start, other), start)
        angle = rng.uniform(50e3, 400e3) / RADIUS
        end = np.cos(angle) * start + np.sin(angle) * along / np.linalg.norm(along)
        given = dict(start=RADIUS * start, end=RADIUS * end, speed=speed, before=before)
        for key, value in (given | fly(**given)).items():
            rows.setdefault(key, []).append(value)
    return {key: np.array(value) for key, value in rows.items()}


RECORDERS: dict[str, Callable[[str], dict[str, Any]]] = {"strips": record}


if __name__ == "__main__":
    record_files(RECORDERS)
