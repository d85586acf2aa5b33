"""Passes over the ground that bsk_rl's own search loses, and which ``compat="bsk_rl"`` loses, too.

It takes the times at which a satellite is near a place, and maximises the elevation from both ends of them on. Where they last
longer than 0.38 revolutions, the maximiser's bracket ends nearer to the next pass than to this one, and converges elsewhere.
"""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from bsk_torch import SatelliteTasking, act, dyn, fsw, obs, sats

RADIUS, MU, SPIN = 6378136.6, 3.986004418e14, 7.2921159e-5
STEP, DAY = 30.0, 86400.0


def circular(altitude: float, inclination: float, node: float, start: float, time: np.ndarray) -> np.ndarray:
    """Earth-fixed positions [T, 3] m on a circular orbit without perturbations."""
    radius = RADIUS + altitude
    u, turn = start + math.sqrt(MU / radius**3) * time, node - SPIN * time
    x, y, z = np.cos(u), np.sin(u) * math.cos(inclination), np.sin(u) * math.sin(inclination)
    return radius * np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, z], -1)


def passes_and_windows(altitude: float, limit: float, seed: int) -> tuple[list[float], list[tuple[float, float]]]:
    """Times within passes over a random place in a day, by brute force, and bsk_rl's windows over it."""
    from bsk_rl.sats.access_satellite import AccessSatellite
    from scipy.interpolate import interp1d

    draw, time = np.random.default_rng(seed), np.arange(0.0, DAY + STEP, STEP)
    path = circular(altitude, math.acos(draw.uniform(-1.0, 1.0)), *draw.uniform(0.0, 2.0 * math.pi, 2), time)
    place = draw.normal(size=3)
    place *= RADIUS / np.linalg.norm(place)
    offset = path - place
    up = np.arcsin(offset @ place / RADIUS / np.linalg.norm(offset, axis=1)) > limit
    rises, sets = (np.flatnonzero(edge) + 1 for edge in (up[1:] & ~up[:-1], up[:-1] & ~up[1:]))
    middles = [0.5 * STEP * (rise + min(sets[sets > rise]) - 1) for rise in rises if (sets > rise + 2).any()]
    known = interp1d(time, path, kind="cubic", axis=0, fill_value="extrapolate")
    near = 1.1 * (np.linalg.norm(path, axis=1).max() - RADIUS) / math.sin(limit)
    windows = []
    for some in AccessSatellite._find_candidate_windows(place, time, path, near):
        roots = AccessSatellite._find_elevation_roots(known, place, limit, some)
        windows += AccessSatellite._refine_window(roots, some, (time[0], time[-1]))
    return middles, windows


@pytest.mark.basilisk
@pytest.mark.parametrize(
    ("elevation", "altitude", "least", "most"),
    [(10.0, 800e3, 0.0, 0.0), (10.0, 1500e3, 0.9, 1.0), (20.0, 2000e3, 0.0, 0.0), (20.0, 3300e3, 0.5, 1.0)],
)
def test_bsk_rl_loses_passes_of_high_orbits(elevation, altitude, least, most):
    lost = total = 0
    for seed in range(12):
        middles, windows = passes_and_windows(altitude, math.radians(elevation), seed)
        total += len(middles)
        lost += sum(not any(opens <= middle <= closes for opens, closes in windows) for middle in middles)
    assert total > 20
    assert least <= lost / total <= most


RECORDED = json.loads((Path(__file__).parent / "recordings" / "lost_passes.json").read_text())

CLOSE = 5e-3
"""Largest difference of windows, s."""


class Seeing(sats.AccessSatellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Charge(duration=60.0),)
    dyn_type = dyn.GroundStationDynModel
    fsw_type = fsw.ImagingFSWModel


def windows_here(orbit: dict, compat: str | None, intervals: int = 0) -> list[tuple[str, float, float]]:
    """Return the windows of a recorded orbit: station, opening and closing, s."""
    args = dict(rN=orbit["rN"], vN=orbit["vN"], imageTargetMinimumElevation=0.8)
    env = SatelliteTasking(
        Seeing("Seeing", args, generation_duration=RECORDED["generation_duration"]),
        world_args=dict(utc_init=RECORDED["utc_init"]),
        time_limit=RECORDED["time_limit"],
        compat=compat,
        backend="eager",
        num_envs=1,
    )
    env.reset()
    if intervals:
        env.satellite.calculate_additional_windows(intervals * RECORDED["generation_duration"])
    found, names = env.satellite.opportunities_dict(0, "ground_station"), list(env.simulator.world.stations)
    return [(names[place], *window) for place, windows in found.items() for window in windows]


@pytest.mark.parametrize("name", RECORDED["orbits"])
@pytest.mark.parametrize("more", [False, True], ids=["after the reset", "after more intervals"])
def test_recorded_windows_are_those_under_compat(name, more):
    orbit = RECORDED["orbits"][name]
    # bsk_rl also offers a pass of the eccentric orbit twice more, from before the epoch on
    wanted = sorted(tuple(window) for window in orbit["more" if more else "windows"] if window[1] >= 0.0)
    found = sorted(windows_here(orbit, "bsk_rl", RECORDED["intervals"] if more else 0))
    assert [window[0] for window in wanted] == [window[0] for window in found]
    assert np.allclose([w[1:] for w in found], [w[1:] for w in wanted], rtol=0.0, atol=CLOSE) or not wanted


def test_recorded_windows_are_fewer_than_the_passes():
    lost = [name for name, orbit in RECORDED["orbits"].items() if len(windows_here(orbit, None)) > len(orbit["windows"])]
    assert lost == ["1300 km", "2500 km", "synchronous"]
