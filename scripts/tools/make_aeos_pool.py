"""Make the pool of satellites of `bsk_torch.tasks.aeos_bench.AEOSBenchGenerator`: those that pass the filter of AEOS-Bench.

    python scripts/tools/make_aeos_pool.py                     1,024 satellites, in a few minutes on one core

The benchmark draws bodies, wheels and gains, and keeps a satellite if it completes all of 36 tasks near the equator within two
hours by the benchmark's rule. Its own tasks are not known, and with those of this script more candidates pass, 590 of 1,024. Most
of those with wheels of 50 N m s are among them, but of 359 satellites in 32 of its test cases, one has such wheels, 182 have
wheels of 25, and 176 of 12 N m s. So only these two are drawn, and the pool has as many satellites with either.
"""

from __future__ import annotations

import argparse
import io
import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from bsk_torch.files import write_file
from bsk_torch.rand import Key, first_key
from bsk_torch.tasks.aeos_bench import AEOSBench, Cases, NearestTask
from bsk_torch.tasks.aeos_bench.files import TOP_SPEED, on_sphere
from bsk_torch.tasks.aeos_bench.preset import aeos_bench

FILE = Path(__file__).resolve().parents[2] / "bsk_torch/tasks/aeos_bench/tables/aeos_pool.npz"

MOMENTA = (12.0, 25.0)
"""Momenta of the wheels, N m s."""

TASKS, SECONDS = 36, 7200.0

COARSE = np.float32
"""Type of the numbers in the file."""


def candidates(key: Key) -> dict[str, Tensor]:
    """Return the arguments of satellites before the filter, [n, ...]."""
    u = key.named("satellite").uniform(21)

    def within(column: int, low: float, high: float, count: int = 1) -> Tensor:
        part = u[:, column : column + count]
        return (low + (high - low) * part).squeeze(1) if count == 1 else low + (high - low) * part

    moments = within(0, 50.0, 200.0, 3)
    momentum = torch.tensor(MOMENTA, dtype=torch.float64)[(u[:, 3] * len(MOMENTA)).long()]
    k = within(5, 2.0, 5.0) * moments.amax(1) / momentum
    ki = within(6, 0.0, 0.01)
    return {
        "inertia": torch.diag_embed(moments).flatten(1),
        "mass": within(9, 50.0, 200.0),
        "rwAxes_B": torch.eye(3, dtype=torch.float64).expand(len(u), 3, 3),
        "rwJs": (momentum / (TOP_SPEED * math.pi / 30.0)).unsqueeze(1).expand(-1, 3),
        "wheelSpeeds": within(10, 400.0, 750.0, 3),
        "rwBasePower": within(13, 5.0, 7.0, 3),
        "rwMechToElecEfficiency": within(16, 0.5, 0.6, 3),
        "K": k,
        "Ki": ki,
        "P": within(7, 2.0, 4.0) * k,
        "integralLimit": within(8, 0.0, 5.0) * ki,
        "sensorFieldOfView": torch.deg2rad(within(19, 0.5, 1.5)),
        "sensorPower": -within(20, 2.0, 8.0),
    }


def tests_of(crafts: dict[str, Tensor]) -> Cases:
    """Return a case for each satellite, with the same tasks."""
    n = len(crafts["mass"])
    u = first_key(1).named("tasks").uniform(2 * TASKS).view(1, TASKS, 2).expand(n, -1, -1)
    one = torch.ones(n, 1, dtype=torch.float64)
    fixed = {
        "batteryStorageCapacity": 3e6 * one,
        "storedCharge_Init": 3e6 * one,
        "panelArea": 0.3 * one,
        "panelEfficiency": 0.3 * one,
    }
    zero = torch.zeros(n, 1, 3, dtype=torch.float64)
    orbit = torch.tensor([7.2e6, 1e-4, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64).expand(n, 1, 6)
    whole = torch.ones(n, TASKS, dtype=torch.float64)
    vectors = {
        "oe": orbit,
        "sigma_init": zero,
        "r_CB_B": zero,
        "nHat_B": zero + torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64),
    }
    return Cases(
        names=(),
        satellites={name: value.unsqueeze(1) for name, value in crafts.items()} | fixed | vectors,
        present=one > 0.0,
        sensors=one,
        enabled=one < 0.0,
        places=on_sphere(-10.0 + 20.0 * u[..., 0], -180.0 + 360.0 * u[..., 1]),
        tasks={"release": 0.0 * whole, "due": SECONDS * whole, "duration": 10.0 * whole, "type": whole},
    )


def passing(key: Key, seconds: float, share: float) -> dict[str, Tensor]:
    """Return the candidates of a key that pass the filter, as the file will hold them."""
    crafts = {name: torch.from_numpy(value.numpy().astype(COARSE)).double() for name, value in candidates(key).items()}
    cases = tests_of(crafts)
    scenario = AEOSBench(cases, order="listed", horizon=seconds)
    env = aeos_bench(cases, order="listed", sensor="on", num_envs=len(key), seed=0, scenario=scenario, time_limit=seconds)
    td, rule = env.reset(), NearestTask(env)
    for _ in range(int(seconds)):
        td = env.step(td.set(("agents", "action"), rule(td["agents", "action_mask"])))["next"]
    passed = env.rewarder.measures()["CR"] >= share
    print(f"{int(passed.sum())} of {len(key)} candidates pass")
    return {name: value[passed] for name, value in crafts.items() if not name.startswith("sensor")}


def of_wheels(found: list[dict[str, Tensor]]) -> list[Tensor]:
    """Return the satellites with each of the momenta, as their numbers."""
    J_wheel = torch.cat([part["rwJs"][:, 0] for part in found]).unique(return_inverse=True)[1]
    return [torch.nonzero(J_wheel == k).squeeze(1) for k in range(len(MOMENTA))]


def main() -> None:
    """Draw candidates until enough have passed, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=1024, help="satellites of the pool (default: %(default)s)")
    parser.add_argument("--batch", type=int, default=1024, help="candidates flown together (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="length of the flight, s (default: %(default)s)")
    parser.add_argument("--share", type=float, default=0.99, help="share of the tasks that must succeed (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=FILE, help="file to write (default: %(default)s)")
    options = parser.parse_args()
    torch.set_num_threads(1)
    found: list[dict[str, Tensor]] = []
    each = options.size // len(MOMENTA)
    while not found or min(len(rows) for rows in of_wheels(found)) < each:
        key = first_key(options.batch)
        found.append(passing(Key(key.seed, key.env_id + options.batch * len(found), key.episode), options.seconds, options.share))
    chosen = torch.cat([rows[:each] for rows in of_wheels(found)])
    pool = {name: torch.cat([part[name] for part in found])[chosen] for name in found[0]}
    content = io.BytesIO()
    np.savez_compressed(content, **{name: value.numpy().astype(COARSE) for name, value in pool.items()})
    write_file(options.out, content.getvalue())
    print(f"{options.out}: {len(pool['mass'])} satellites, {len(content.getvalue()):,} bytes")


if __name__ == "__main__":
    main()
