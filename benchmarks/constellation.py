"""Satellite-seconds per core-second of constellations of different sizes, here and in bsk_rl on Basilisk.

Usage:
    python benchmarks/constellation.py [--basilisk PYTHON] [--satellites 1 4 16 64 256] [--rows 1024] [--out FILE.json]

The number of satellites simulated at once, ``--rows``, stays the same: constellations of S fly in rows / S episodes. Two ways of
deciding are measured. In ``intervals`` every satellite gets a new target once a minute, so that steps take as long whatever S is;
in ``tasks`` a step ends with the first task, so that steps become shorter as S grows. Satellites are those of Constellation-v1 in
one plane, with 5,000 targets, random actions, and everything told to everybody. Sizes take turns (of us and of Basilisk, if there
is one), so that all of them see the same machine; figures are medians. A turn of ours lasts until as many episodes have ended as
there are, three orbits each, so that it holds all its resets. ``PYTHON`` is an interpreter with bsk and bsk_rl; Basilisk plays
one episode for ``--seconds``, of up to ``--most`` satellites: its reset, which is not measured, takes seconds for each of them.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import harness
import torch
from harness import Player, Step, Turn

import bsk_torch
from bsk_torch import comm

TARGETS = 5000

INTERVAL = 60.0
"""Seconds between decisions, where they are at fixed times."""

LIMIT = 17_100.0
"""Seconds of an episode, three orbits."""

WARM_UP = 5
"""Steps before anything is measured."""

MODES = {"intervals": dict(variable_interval=False, max_step_duration=INTERVAL), "tasks": {}}

COLUMNS = {
    "decisions": "{mode}",
    "satellites": "{satellites}",
    "episodes": "{batch}",
    "satellite-s per core-s": "{rate:,.0f}",
    "of one satellite": "{share:.2f}",
    "s per step": "{step:.1f}",
    "Basilisk": "{basilisk_rate:,.0f}",
    "x Basilisk": "{ratio:,.0f}",
}


def make(mode: str, satellites: int, batch: int) -> bsk_torch.ConstellationTasking:
    """The constellation, in episodes whose ages are spread."""
    return bsk_torch.make(
        "Constellation-v1",
        n_satellites=satellites,
        n_planes=1,
        phasing=0,
        n_targets=TARGETS,
        communicator=comm.FreeCommunication(),
        num_envs=batch,
        seed=0,
        time_limit=harness.Staggered(batch, LIMIT),
        **MODES[mode],
    )


def rollout(env: bsk_torch.ConstellationTasking) -> Player:
    """Random legal actions; a step's simulated seconds are those of all satellites."""
    td = env.reset()
    while True:
        mask = td["agents", "action_mask"]
        action = torch.multinomial(mask.flatten(0, 1).float(), 1).view(mask.shape[:2])
        played, td = env.step_and_maybe_reset(td.set(("agents", "action"), action))
        seen = harness.step_of(played["next"])
        yield Step(seen.simulated * action.shape[1], seen.ended, int((action < mask.shape[-1] - 1).sum()))


def turns_of(mode: str, sizes: list[int], rows: int, python: str | None, options: Any) -> Iterator[tuple[int, Turn, Turn | None]]:
    """Turns of all sizes, one after the other: the size, ours, Basilisk's."""
    with ExitStack() as stack:
        players, others = {}, {}
        for size in sizes:
            players[size], _ = harness.start(lambda size=size: rollout(make(mode, size, rows // size)), WARM_UP)
            if python and size <= options.most:
                harness.TASKS[f"{mode}-{size}"] = harness.Task(
                    "Constellation-v1",
                    0,
                    {"satellites": size, "targets": TARGETS, "interval": INTERVAL if mode == "intervals" else None},
                )
                others[size] = stack.enter_context(harness.basilisk(python, f"{mode}-{size}"))
        for _ in range(options.turns):
            for size in sizes:
                theirs = others[size](options.seconds) if size in others else None
                yield size, harness.play(players[size], 0.0, whole=rows // size), theirs


def row_of(mode: str, size: int, rows: int, turns: list[tuple[Turn, Turn | None]]) -> dict[str, Any]:
    """Medians over the turns of one size."""
    row: dict[str, Any] = {"mode": mode, "satellites": size, "batch": rows // size}
    row["rate"] = statistics.median(ours.rate for ours, _ in turns)
    row["step"] = statistics.median(ours.simulated / ours.steps / rows for ours, _ in turns)
    row["turns"] = [{"ours": ours._asdict(), "basilisk": theirs._asdict() if theirs else None} for ours, theirs in turns]
    if all(theirs for _, theirs in turns):
        row["basilisk_rate"] = statistics.median(theirs.rate for _, theirs in turns if theirs)
        row["ratio"] = statistics.median(ours.rate / theirs.rate for ours, theirs in turns if theirs)
    return row


def main() -> None:
    """Measure and print a table."""
    arguments = harness.parser(__doc__, turns=3, seconds=10.0, satellites=[1, 4, 16, 64, 256], rows=1024)
    arguments.add_argument("--basilisk", metavar="PYTHON", help="interpreter with bsk and bsk_rl")
    arguments.add_argument("--most", type=int, default=16, help="satellites that Basilisk flies at most")
    arguments.add_argument("--modes", nargs="+", choices=MODES, default=list(MODES))
    options, described = harness.begin(arguments)
    table = harness.Rows(options, described)
    for mode in options.modes:
        turns: dict[int, list[tuple[Turn, Turn | None]]] = {}
        for size, ours, theirs in turns_of(mode, options.satellites, options.rows, options.basilisk, options):
            turns.setdefault(size, []).append((ours, theirs))
            print(f"{mode} {size}: {ours.rate:,.0f}", flush=True)
        found = [row_of(mode, size, options.rows, pairs) for size, pairs in turns.items()]
        table += [row | {"share": row["rate"] / found[0]["rate"]} for row in found]
    print(harness.table(COLUMNS, table))
    harness.write(options, described, rows=table)


if __name__ == "__main__":
    main()
