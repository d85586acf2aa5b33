"""What an impulsive manoeuvre costs, with look-ahead that follows it or does not, in microseconds for each satellite.

Usage:
    python benchmarks/manoeuvres.py [--batches 1024 64 1] [--targets 1000] [--rounds 20] [--drift 100] [--out FILE.json]

All satellites of a batch change their velocity by some metres per second, ask for the next four targets and the next eclipse, and
fly on for ``--drift`` seconds. ``thrust`` is the manoeuvre itself with the first hour of the new orbit, ``targets`` and
``eclipse`` are the queries after it, ``flight`` is the run. ``still`` is all of that without a manoeuvre, after those with one.
Times are of one thread, medians over rounds.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import harness
import torch

from bsk_torch import SatelliteTasking, act, data, obs, sats, scene
from bsk_torch.sim import dyn, fsw

SPEED = 3.0
"""Standard deviation of the components of a change of velocity, m/s."""

WAYS = (("arc", True), ("arc", False), ("integrated", True), ("integrated", False))
"""How orbits are computed, and whether look-ahead follows manoeuvres."""

COLUMNS = {
    "batch": "{batch:,}",
    "orbit": "{orbit}",
    "replan": "{replan}",
    "thrust, us": "{thrust:.1f}",
    "targets, us": "{targets:.1f}",
    "eclipse, us": "{eclipse:.1f}",
    "flight, us": "{flight:.1f}",
    "all, us": "{all:.1f}",
    "still, us": "{still:.1f}",
}


class Imager(sats.ImagingSatellite):
    """Takes images and manoeuvres."""

    dyn_type = (dyn.ImagingDynModel, dyn.GroundStationDynModel)
    fsw_type = (fsw.MagicOrbitalManeuverFSWModel, fsw.ImagingFSWModel)
    observation_spec = (
        obs.SatProperties({"prop": "dv_available"}, {"prop": "r_BN_P"}),
        obs.OpportunityProperties({"prop": "opportunity_open"}, {"prop": "opportunity_close"}, n_ahead_observe=4),
        obs.Eclipse(norm=5700.0),
        obs.Time(),
    )
    action_spec = (act.Drift(duration=60.0), act.Image(n_ahead_image=4))


def make_env(batch: int, targets: int, backend: str, **options: Any) -> SatelliteTasking:
    """An environment whose episodes last for five orbits."""
    return SatelliteTasking(
        Imager("Imager", {"dv_available_init": 1e6}),
        scenario=scene.UniformTargets(targets),
        rewarder=data.UniqueImageReward(),
        num_envs=batch,
        seed=0,
        time_limit=harness.EPISODE,
        backend=backend,
        **options,
    )


def turn(env: SatelliteTasking, dv_N: torch.Tensor | None, drift: float) -> dict[str, float]:
    """Microseconds for each satellite of a manoeuvre, or of none, of the queries after it and of the flight."""
    everyone, ticks = torch.ones(env.num_envs, dtype=torch.bool), round(drift / env.fleet.h)
    parts: dict[str, Callable[[], Any]] = {
        "thrust": lambda: None if dv_N is None else env.simulator.thrust(everyone, dv_N),
        "targets": lambda: env.satellite.find_next_opportunities(4),
        "eclipse": env.satellite.next_eclipse,
        "flight": lambda: env.fleet.run(everyone, env.fleet.ticks + ticks, env.fleet.ticks + ticks),
    }
    spent = {}
    for name, part in parts.items():
        clock = time.thread_time()
        part()
        spent[name] = 1e6 * (time.thread_time() - clock) / env.num_envs
    return spent | {"all": sum(spent.values())}


def costs(env: SatelliteTasking, rounds: int, drift: float) -> dict[str, Any]:
    """Medians of the parts over rounds in which every satellite manoeuvres, and of all of them without."""
    env.reset()
    generator = torch.Generator().manual_seed(0)
    dv_N = SPEED * torch.randn(rounds + 1, env.num_envs, 3, generator=generator, dtype=torch.float64)
    turns = [turn(env, change, drift) for change in dv_N][1:]
    still = [turn(env, None, drift)["all"] for _ in range(rounds + 1)][1:]
    return {name: statistics.median(one[name] for one in turns) for name in turns[0]} | {"still": statistics.median(still)}


def main() -> None:
    """Measure and print a table."""
    arguments = harness.parser(
        __doc__, batches=[1024, 64, 1], targets=1000, rounds=20, drift=100.0, orbits=["arc", "integrated"], backend="compiled"
    )
    options, described = harness.begin(arguments)
    rows = harness.Rows(options, described)
    for batch in options.batches:
        for orbit, replan in (way for way in WAYS if way[0] in options.orbits):
            env = make_env(batch, options.targets, options.backend, orbit=orbit, replan=replan)
            case = {"batch": batch, "orbit": orbit, "replan": "on" if replan else "off"}
            rows.append(case | costs(env, options.rounds, options.drift))
            print(harness.cell("{batch}, {orbit}, replan {replan}: {all:.1f} us", rows[-1]), flush=True)
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
