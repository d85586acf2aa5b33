"""Simulated seconds per core-second of imaging in orbit, here and in bsk_rl on Basilisk, and what large catalogs cost.

Usage:
    python benchmarks/rso_imaging.py [--basilisk PYTHON] [--batches 1024 64 1] [--imagers 2] [--targets 50] [--turns 3]
        [--seconds 10] [--catalogs 1 50 200] [--many 4096] [--steps 12] [--out FILE.json]

Imagers on polar orbits image objects of a catalog in a plane above theirs, downlink and charge, by random legal actions, for one
orbit. Basilisk's turns are whole episodes with a reset and play one catalog; ours draw a catalog for each episode. A round is a
turn of Basilisk and one of each batch; the figure of a batch is the median over rounds of the ratio of rates, with the smallest
and the largest. Seconds are those of episodes, whatever the number of imagers, and of CPU time of the whole process.

The second table has one imager in each of ``--many`` environments, and catalogs of ``--catalogs`` objects: bytes of the orbits
and of all state, and CPU time of a reset, and of a decision with all its ticks, the median of ``--steps`` with quartiles.
"""

from __future__ import annotations

import argparse
import gc
import statistics
import time
from contextlib import nullcontext
from typing import Any

import harness
import torch
from harness import Player, Turn
from torch import Tensor

from bsk_torch import ConstellationTasking, act, obs, rand, sats
from bsk_torch.sim import dyn
from bsk_torch.tasks.objects import (
    ImageRSO,
    RandomRSOCatalog,
    RSOImageReward,
    RSOTargetProperties,
    RSOTargets,
    SpaceToSpaceImagingDynModel,
    SpaceToSpaceImagingFSWModel,
)

ORBIT = 5700.0
"""Length of an episode, s."""

ARGUMENTS: dict[str, Any] = dict(
    oe=rand.random_orbit(a=7000.0, i=90.0, Omega=17.0),
    imageAttErrorRequirement=0.02,
    instrumentBaudRate=8e6,
    dataStorageCapacity=1.6e8,
    batteryStorageCapacity=1e9,
    storedCharge_Init=1e9,
    u_max=0.4,
)

COLUMNS = {
    "episodes": "{batch:,}",
    "imagers": "{imagers}",
    "objects": "{targets}",
    "simulated s per core-s": "{rate:,.0f}",
    "Basilisk": "{basilisk_rate:,.0f}",
    "x Basilisk": "{ratio:.3g}",
    "smallest to largest": "{ratio_low:.3g} to {ratio_high:.3g}",
    "decisions per core-s": "{decision_rate:,.0f}",
}

CATALOG_COLUMNS = {
    "objects": "{targets}",
    "environments": "{batch:,}",
    "kB of orbits each": "{orbits_kb:.1f}",
    "kB of state each": "{state_kb:.1f}",
    "reset, us each": "{reset_us:.0f}",
    "decision, us each": "{decision_us:.0f} ({decision_us_low:.0f} to {decision_us_high:.0f})",
    "simulated s in it": "{simulated:.0f}",
}


class Eye(sats.AccessSatellite):
    """Images one of the next ten objects, downlinks, or charges."""

    observation_spec = (
        obs.SatProperties(dict(prop="storage_level_fraction")),
        RSOTargetProperties(n_ahead_observe=10),
        obs.Time(),
    )
    action_spec = (
        act.Charge(duration=60.0),
        act.Downlink(duration=90.0),
        ImageRSO(10, max_duration=200.0, min_pointing_hold_s=5.0),
    )
    dyn_type = (SpaceToSpaceImagingDynModel, dyn.GroundStationDynModel)
    fsw_type = SpaceToSpaceImagingFSWModel


def environment(batch: int, imagers: int, targets: int, limit: Any = ORBIT) -> ConstellationTasking:
    """Imagers and a random catalog of objects in a plane above theirs."""
    names = [f"Eye{k}" for k in range(imagers)]
    catalog = RandomRSOCatalog(targets, oe=rand.random_orbit(a=7050.0, i=90.0, Omega=17.0))
    return ConstellationTasking(
        [Eye(name, ARGUMENTS) for name in names],
        scenario=RSOTargets(catalog, names),
        rewarder=RSOImageReward(multi_imager_credit="shared"),
        time_limit=limit,
        num_envs=batch,
        seed=0,
    )


def legal(mask: Tensor, generator: torch.Generator) -> Tensor:
    """Random legal actions, [N, A]."""
    chosen = torch.multinomial(mask.flatten(0, 1).double(), 1, generator=generator)
    return chosen.view(mask.shape[:2])


def episodes(batch: int, imagers: int, targets: int) -> Player:
    """Play on for ever, with episodes that start staggered."""
    env = environment(batch, imagers, targets, harness.Staggered(batch, ORBIT))
    generator, td = torch.Generator().manual_seed(0), env.reset()
    while True:
        td["agents", "action"] = legal(td["agents", "action_mask"], generator)
        played, td = env.step_and_maybe_reset(td)
        yield harness.step_of(played["next"])


def rounds(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Rows of the first table, from rounds of turns."""
    size = dict(n_imagers=options.imagers, n_targets=options.targets)
    steps = 90 if options.warm_up is None else options.warm_up
    players = [harness.start(lambda b=b: episodes(b, *size.values()), steps)[0] for b in options.batches]
    with harness.other_side(options.basilisk, "rso_imaging", size) if options.basilisk else nullcontext(None) as other:
        played = []
        for k in range(options.turns):
            theirs = other(options.seconds) if other else None
            whole = zip(players, options.batches, strict=True)
            played.append((theirs, [harness.play(player, options.seconds, whole=batch) for player, batch in whole]))
            print(f"round {k + 1} of {options.turns}", flush=True)
    return [row_of(batch, options, [(theirs, ours[k]) for theirs, ours in played]) for k, batch in enumerate(options.batches)]


def row_of(batch: int, options: argparse.Namespace, turns: list[tuple[Turn | None, Turn]]) -> dict[str, Any]:
    """The row of a batch: medians over its turns, and the turns themselves."""
    row = {
        "batch": batch,
        "imagers": options.imagers,
        "targets": options.targets,
        "rate": statistics.median(ours.rate for _, ours in turns),
        "decision_rate": statistics.median(ours.decision_rate for _, ours in turns),
        "turns": [{"basilisk": theirs._asdict() if theirs else None, "ours": ours._asdict()} for theirs, ours in turns],
    }
    pairs = [(theirs, ours) for theirs, ours in turns if theirs]
    ratios = [ours.rate / theirs.rate for theirs, ours in pairs]
    if ratios:
        row |= {"ratio": statistics.median(ratios), "ratio_low": min(ratios), "ratio_high": max(ratios)}
        row["basilisk_rate"] = statistics.median(theirs.rate for theirs, _ in pairs)
    return row


def catalog_cost(batch: int, targets: int, steps: int) -> dict[str, Any]:
    """The row of a catalog of the second table."""
    env = environment(batch, 1, targets)
    generator, td = torch.Generator().manual_seed(0), env.reset()
    clock = time.process_time()
    td = env.reset()
    reset = time.process_time() - clock
    spent, simulated = [], []
    for _ in range(steps):
        td["agents", "action"] = legal(td["agents", "action_mask"], generator)
        clock = time.process_time()
        td = env.step(td)["next"]
        spent.append(1e6 * (time.process_time() - clock) / batch)
        simulated.append(float(td["duration"].double().mean()))
    kept = {"orbits_kb": 1e-3 * env.scenario.orbits.nbytes / batch, "state_kb": 1e-3 * env.state.nbytes / batch}
    row = {"targets": targets, "batch": batch, "reset_us": 1e6 * reset / batch, "simulated": statistics.fmean(simulated)}
    return row | kept | harness.spread("decision_us", spent)


def main() -> None:
    """Measure and print two tables."""
    arguments = harness.parser(
        __doc__, batches=[1024, 64, 1], imagers=2, targets=50, turns=3, seconds=10.0, catalogs=[1, 50, 200], many=4096, steps=12
    )
    arguments.add_argument("--basilisk", metavar="PYTHON", help="interpreter with bsk and bsk_rl")
    options, described = harness.begin(arguments)
    rows = rounds(options)
    print(harness.table(COLUMNS, rows), flush=True)
    costs = []
    for targets in options.catalogs:
        gc.collect()
        costs.append(catalog_cost(options.many, targets, options.steps))
    print(harness.table(CATALOG_COLUMNS, costs))
    harness.write(options, described, rows=rows, catalogs=costs)


if __name__ == "__main__":
    main()
