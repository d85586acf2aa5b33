"""Record what bsk_rl draws and computes for one episode, as a small table that tests/bsk_rl compares the drop-in with.

Usage::

    python scripts/recorders/record_bsk_rl.py                 # tests/bsk_rl/data/recorded.json
    python scripts/recorders/record_bsk_rl.py --out FOLDER

Needs the extra ``basilisk`` and its support data; see ``recording.py``. Draws are of NumPy's global generator after
``np.random.seed(SEED)``; ``left`` is the number that follows them, so that nothing is drawn in between.
"""

from __future__ import annotations

import argparse
import inspect
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from bsk_rl import act, obs, sats, scene
from bsk_rl.scene.rso_points import RSOPoint
from bsk_rl.sim import dyn, fsw, world
from bsk_rl.utils import attitude, orbital
from bsk_rl.utils.actuator_primitives import balancedHR16Triad

SEED = 7
PAIRS = {
    "passive": (("DynamicsModel",), ("FSWModel",)),
    "basic": (("BasicDynamicsModel",), ("BasicFSWModel",)),
    "imager": (("GroundStationDynModel", "LOSCommDynModel"), ("ImagingFSWModel",)),
    "steering": (("ImagingDynModel",), ("SteeringImagerFSWModel",)),
    "scanner": (("ContinuousImagingDynModel", "GroundStationDynModel"), ("ContinuousImagingFSWModel",)),
    "rso": (("RSODynModel",), ("FSWModel",)),
    "inspector": (
        ("ConjunctionDynModel", "MaxRangeDynModel", "RSOInspectorDynModel", "LOSCommDynModel"),
        ("RSOInspectorFSWModel", "MagicOrbitalManeuverFSWModel"),
    ),
}
WORLDS = {
    "plain": ("WorldModel",),
    "full": ("EclipseWorldModel", "AtmosphereWorldModel", "GroundStationWorldModel"),
}
EPOCH = "2021 FEB 05 09:12:05.830 (UTC)"


class Named:
    """A satellite as argument randomizers and scenarios see it."""

    def __init__(self, name: str) -> None:
        """Keep the name."""
        self.name = name
        self.sat_args_generator = {"mu": orbital.orbitalMotion.MU_EARTH * 1e9}


def plain(value: Any) -> Any:
    """Return a value as JSON can hold it: arrays as lists, elements as dictionaries, functions as ``"drawn"``."""
    if inspect.isfunction(value) or inspect.isbuiltin(value):
        return "drawn"
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if hasattr(value, "Omega"):
        return {name: float(getattr(value, name)) for name in ("a", "e", "i", "Omega", "omega", "f")}
    if isinstance(value, dict):
        return {name: plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return value


def drawn(draw: Callable[[], Any]) -> dict[str, Any]:
    """Return what a function draws under the seed, and the number that follows."""
    np.random.seed(SEED)
    value = plain(draw())
    return {"value": value, "left": np.random.rand()}


def models(module: Any, names: tuple[str, ...]) -> tuple[type, ...]:
    """Return classes by name."""
    return tuple(getattr(module, name) for name in names)


def satellite_type(dyn_names: tuple[str, ...], fsw_names: tuple[str, ...]) -> type[sats.Satellite]:
    """Return a class of satellites with these models."""

    class Recorded(sats.Satellite):
        dyn_type = models(dyn, dyn_names)
        fsw_type = models(fsw, fsw_names)
        observation_spec = [obs.Time()]
        action_spec = [act.Drift()]

    return Recorded


def sat_args(dyn_names: tuple[str, ...], fsw_names: tuple[str, ...]) -> dict[str, Any]:
    """Return default arguments in order, their types, and a draw of them."""
    satellite = satellite_type(dyn_names, fsw_names)("Recorded")
    defaults = satellite.default_sat_args()

    def draw() -> dict[str, Any]:
        satellite.generate_sat_args()
        return satellite.sat_args

    return {"defaults": list(plain(defaults).items()), "drawn": drawn(draw)}


def world_args(names: tuple[str, ...]) -> dict[str, Any]:
    """Return default arguments of a world model in order, and a draw of them."""
    bases = models(world, names)
    defaults = type("World", bases, {}).default_world_args()
    draw = lambda: {name: value() if callable(value) else value for name, value in defaults.items()}
    return {"defaults": list(plain(defaults).items()), "drawn": drawn(draw)}


def targets(n_targets: Any, **options: Any) -> Callable[[], Any]:
    """Return a function that draws targets: names, positions and priorities."""

    def draw() -> Any:
        scenario = scene.UniformTargets(n_targets, **options)
        scenario.link_satellites([])
        scenario.reset_overwrite_previous()
        scenario.reset_pre_sim_init()
        return [(target.name, target.r_LP_P, target.priority) for target in scenario.targets]

    return draw


def walker(**options: Any) -> Callable[[], Any]:
    """Return a function that draws a Walker pattern of six satellites."""
    satellites = [Named(f"Sat{k}") for k in range(6)]
    return lambda: [args["oe"] for args in orbital.walker_delta_args(**options)(satellites).values()]


def formation() -> list[Any]:
    """Draw a chief and two deputies."""
    satellites = [Named(name) for name in ("Deputy1", "Chief", "Deputy2")]
    states = {
        "Deputy1": lambda: np.concatenate((np.random.uniform(-500, 500, 3), np.random.uniform(-1, 1, 3))),
        "Deputy2": [0.0, 1000.0, -200.0, 0.1, 0.0, -0.2],
    }
    args = orbital.relative_to_chief("Chief", orbital.random_orbit, states)(satellites)
    return [(satellite.name, args[satellite]["oe"]) for satellite in satellites]


def trajectory() -> dict[str, Any]:
    """Return positions along an orbit, and eclipses, one after another."""
    elements = orbital.random_orbit(i=45.0, a=6871.0, e=0.01, Omega=20.0, omega=30.0, f=40.0)
    flown = orbital.TrajectorySimulator(EPOCH, oe=elements, mu=orbital.orbitalMotion.MU_EARTH * 1e9)
    asked = [0.0, 10.0, 3000.0, 6000.0, 30000.0]
    eclipses = [flown.next_eclipse(t) for t in asked]
    times = [0.0, 47.0, 1000.0, 5432.1, 20000.0]
    return {
        "elements": plain(elements),
        "asked": asked,
        "eclipses": plain(eclipses),
        "sim_time": flown.sim_time,
        "times": times,
        "r_BN_N": plain(flown.r_BN_N(times)),
        "r_BP_P": plain(flown.r_BP_P(times)),
    }


def steps() -> list[dict[str, Any]]:
    """Return the same orbit in other steps than 30 s."""
    elements = orbital.random_orbit(i=45.0, a=6871.0, e=0.01, Omega=20.0, omega=30.0, f=40.0)
    found = []
    for dt in (7.5, 20.0, 60.0):
        flown = orbital.TrajectorySimulator(EPOCH, oe=elements, mu=orbital.orbitalMotion.MU_EARTH * 1e9, dt=dt)
        asked, times = [0.0, 3000.0, 6000.0], [0.0, 47.0, 1000.0, 5432.1, 11000.0]
        eclipses = [flown.next_eclipse(t) for t in asked]
        found.append({"dt": dt, "asked": asked, "eclipses": plain(eclipses), "sim_time": flown.sim_time, "times": times})
        found[-1] |= {"r_BN_N": plain(flown.r_BN_N(times)), "r_BP_P": plain(flown.r_BP_P(times))}
    return found


DRAWS: dict[str, Callable[[], Any]] = {
    "random_unit_vector": orbital.random_unit_vector,
    "random_orbit": orbital.random_orbit,
    "random_orbit_given": lambda: orbital.random_orbit(i=30.0, a=7000.0, e=0.1, omega=12.0),
    "random_circular_orbit": lambda: orbital.random_circular_orbit(alt=600.0),
    "random_epoch": orbital.random_epoch,
    "random_epoch_years": lambda: orbital.random_epoch(2010, 2012),
    "random_tumble": lambda: attitude.random_tumble(0.01),
    "hill_random": lambda: attitude.hill_frame_attitude(
        [7e6, 1e5, 2e5], [100.0, 7000.0, 2000.0], {"type": "uniform", "low": 0.1, "high": 2.0, "axis": "random"}
    ),
    "hill_velocity": lambda: attitude.hill_frame_attitude(
        [7e6, 1e5, 2e5], [100.0, 7000.0, 2000.0], {"rate": 1.0, "axis": "velocity"}
    ),
    "wheels": lambda: balancedHR16Triad(useRandom=True, randomBounds=(-300, 200))[2],
    "targets": targets(5),
    "targets_range": targets((3, 9), priority_distribution=lambda: np.random.uniform(1, 2), radius=6.4e6),
    "walker": walker(n_planes=3, rel_phasing=0.3, altitude=600, inc=60.0),
    "walker_clusters": walker(n_planes=2, clustersize=3, clusterspacing=2.0, randomize_lan=False),
    "formation": formation,
}


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parents[2] / "tests" / "bsk_rl" / "data")
    folder = parser.parse_args().out
    np.random.seed(SEED)
    point = RSOPoint(np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), 0.7, -1.0, 1.0, 0.1)
    table = {
        "seed": SEED,
        "epoch": EPOCH,
        "pairs": {name: {"dyn": pair[0], "fsw": pair[1], **sat_args(*pair)} for name, pair in PAIRS.items()},
        "worlds": {name: {"world": names, **world_args(names)} for name, names in WORLDS.items()},
        "draws": {name: drawn(draw) for name, draw in DRAWS.items()},
        "trajectory": trajectory(),
        "trajectory_steps": steps(),
        "fibonacci": plain(orbital.fibonacci_sphere(7)),
        "point": str(point),
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "recorded.json").write_text(json.dumps(table) + "\n")
    print(folder / "recorded.json")


if __name__ == "__main__":
    main()
