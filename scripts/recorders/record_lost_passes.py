"""Record the windows that bsk_rl knows of satellites that stay near ground stations for long, into ``lost_passes.json``.

Usage::

    python scripts/recorders/record_lost_passes.py

Windows are those after the reset, which searches one long interval, and after a search of more intervals. See ``recording.py``
for what it needs.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from Basilisk.utilities import orbitalMotion
from bsk_rl import SatelliteTasking, act, data, obs, sats, scene
from bsk_rl.sim import dyn, fsw
from bsk_rl.utils.orbital import random_orbit
from recording import RECORDINGS

UTC = "2012 MAR 04 05:06:07.000 (UTC)"

ORBITS = {  # km, -, deg
    "1300 km": dict(a=7671.0, e=0.0, i=50.0, Omega=10.0, omega=0.0, f=30.0),
    "2500 km": dict(a=8871.0, e=0.0, i=97.0, Omega=200.0, omega=0.0, f=110.0),
    "eccentric": dict(a=9038.0, e=0.21, i=97.5, Omega=61.6, omega=299.3, f=76.7),
    "synchronous": dict(a=42164.0, e=0.0, i=20.0, Omega=120.0, omega=0.0, f=0.0),
}

LIMIT, SEGMENT, MORE = 9000.0, 600.0, 40


class Seeing(sats.AccessSatellite):
    """Sees ground stations."""

    observation_spec = (obs.Time(),)
    action_spec = (act.Charge(duration=60.0),)
    dyn_type = dyn.GroundStationDynModel
    fsw_type = fsw.ImagingFSWModel


def windows(satellite: Any) -> list[tuple[str, float, float]]:
    """Return the known windows: station, opening and closing, s."""
    return [(str(known["object"]), *map(float, known["window"])) for known in satellite.opportunities]


def main() -> None:
    """Write the file."""
    parser = argparse.ArgumentParser(description="Record the windows of satellites that stay near ground stations for long.")
    parser.add_argument("--out", type=Path, default=RECORDINGS, help="folder of the file")
    folder = parser.parse_args().out
    found = {}
    for name, elements in ORBITS.items():
        oe = random_orbit(**elements)
        r, v = orbitalMotion.elem2rv(orbitalMotion.MU_EARTH * 1e9, oe)
        args = dict(oe=None, rN=r, vN=v, imageTargetMinimumElevation=0.8)
        env = SatelliteTasking(
            satellite=Seeing("Seeing", args, generation_duration=SEGMENT),
            scenario=scene.Scenario(),
            rewarder=data.NoReward(),
            world_args=dict(utc_init=UTC),
            time_limit=LIMIT,
            log_level="ERROR",
        )
        env.reset(seed=0)
        first = windows(env.unwrapped.satellite)
        for _ in range(MORE):
            env.unwrapped.satellite.calculate_additional_windows(SEGMENT)
        found[name] = dict(rN=r.tolist(), vN=v.tolist(), windows=first, more=windows(env.unwrapped.satellite))
    fixed = dict(utc_init=UTC, time_limit=LIMIT, generation_duration=SEGMENT, intervals=MORE)
    (folder / "lost_passes.json").write_text(json.dumps(fixed | dict(orbits=found)) + "\n")


if __name__ == "__main__":
    main()
