"""Speed and memory of this checkout beside another one, such as a release, without Basilisk.

Usage:
    python benchmarks/compare.py --base CHECKOUT [--only CASE ...] [--turns 5] [--processes 3] [--seconds 5] [--out FILE.json]

Each checkout runs in a process of its own, through the public interface only, and plays the same random actions from the same
seed. The base measures how many steps take ``--seconds``; a turn is that number of steps on both sides, one after the other, in
alternating order. The same program differs by some percent from one process to the next, so several pairs of processes play.
The work of a turn is the same if both simulate the same numbers, which the column ``same`` states: whether simulated seconds and
ended episodes of every turn are equal. Cases that are programs run as a whole, in a process each, once for each turn; half of a
process is then the import of torch. The ratio of a turn is base's CPU time divided by this
checkout's; above 1, this checkout is faster. Memory is ``env.bytes_per_env`` and the growth of the process after the last turn.
"""

from __future__ import annotations

import itertools
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import constellation
import drop_in
import harness
import torch
import vs_basilisk
from harness import Player, Step, Turn

from bsk_torch.wrappers import GymEnv

HERE = Path(__file__).resolve().parents[1]


class Case(NamedTuple):
    """A batch size, how its environment is made, how it is played, and steps of warming up."""

    batch: int
    make: Callable[[], Any]
    play: Callable[[Any], Player]
    steps: int


def alone(task: str, batch: int) -> Case:
    """One satellite per episode: a task of ``harness.TASKS``."""
    return Case(batch, lambda: harness.make_env(task, batch), harness.rollout, harness.TASKS[task].steps)


def together(mode: str, satellites: int, rows: int) -> Case:
    """Constellations with ``rows`` satellites in all."""
    batch = rows // satellites
    return Case(batch, lambda: constellation.make(mode, satellites, batch), constellation.rollout, constellation.WARM_UP)


def drop_in_case(name: str) -> Case:
    """A program of bsk_rl, played with random actions; its last turn may end in an episode."""
    make = drop_in.PROGRAMS[name]
    return Case(1, lambda: make(drop_in.load("bsk_torch.bsk_rl"), harness.EPISODE), drop_in_player, 20)


def drop_in_player(env: Any) -> Player:
    """Random actions in one episode at a time; a step's simulated seconds are those by which the clock moves."""
    space, seeds = env.action_space, itertools.count()
    space.seed(0)
    env.reset(seed=next(seeds))
    while True:
        before = env.simulator.sim_time
        *_, terminated, truncated, _ = env.step(space.sample())
        yield Step(env.simulator.sim_time - before, int(terminated or truncated))
        if terminated or truncated:
            env.reset(seed=next(seeds))


CASES: dict[str, Case] = {
    "4096": alone("scan", 4096),
    "64": alone("scan", 64),
    "1": alone("scan", 1),
    "imaging-1k-1024": alone("imaging-1k", 1024),
    "4096-own": Case(4096, lambda: vs_basilisk.own_env(4096), harness.rollout, harness.TASKS["scan"].steps),
    "gymnasium": Case(1, lambda: GymEnv("NadirScan-v1", time_limit=harness.EPISODE), vs_basilisk.alone, 300),
    "gymnasium-own": Case(1, lambda: GymEnv(vs_basilisk.own_env(1)), vs_basilisk.alone, 300),
    "imaging-1k-256": alone("imaging-1k", 256),
    "constellation-3": together("tasks", 3, 3),
    **{f"drop-in-{name.replace(',', '').replace(' ', '-')}": drop_in_case(name) for name in drop_in.PROGRAMS},
    "constellation-16": together("tasks", 16, 1024),
    "constellation-16-intervals": together("intervals", 16, 1024),
}

MADE = 'import bsk_torch; env = bsk_torch.make("NadirScan-v1", seed=0)'
PLAYED = f"{MADE}; env.reset()"
PROGRAMS = {
    "import-drop-in": "import bsk_torch.bsk_rl",
    "make": MADE,
    "first-reset": PLAYED,
    "200-steps": f"{PLAYED}; env.rollout(200, break_when_any_done=False)",
}
"""Whole programs; kernels are compiled before the first turn."""

DEFAULT = ["4096", "64", "1", "imaging-1k-1024", "constellation-16"]

COLUMNS = {
    "case": "{case}",
    "steps per turn": "{steps}",
    "base, CPU ms per step": "{base_ms:.3f}",
    "here": "{here_ms:.3f}",
    "ratio of medians": "{ratio:.3f}",
    "of turns": "{turn_low:.3f} to {turn_high:.3f}",
    "same": "{same}",
    "bytes per env, base": "{base_bytes:,.0f}",
    "here ": "{here_bytes:,.0f}",
    "growth of the process per env, base, kB": "{base_growth:,.1f}",
    "here  ": "{here_growth:,.1f}",
}


Pair = dict[str, Turn]
"""A turn of each checkout."""


def serve(name: str, warm_up: int) -> None:
    """Play turns in this process: of ``seconds``, or of exactly ``steps``, as each line of input asks; the last one is empty."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    torch.set_num_threads(1)
    torch.manual_seed(0)
    case, before = CASES[name], harness.resident()
    env = case.make()
    player, _ = harness.start(lambda: case.play(env), warm_up)
    for line in sys.stdin:
        request = json.loads(line)
        if request == "memory":
            sizes = Turn(getattr(env, "bytes_per_env", 0), 0, 0, 0, (harness.resident() - before) / case.batch / 1e3, 0.0)
            print(json.dumps(sizes._asdict()), file=answers, flush=True)
        else:
            turn = harness.play(player, request.get("seconds", 0.0), request.get("steps", 1), most=request.get("steps"))
            print(json.dumps(turn._asdict()), file=answers, flush=True)


def play_pair(name: str, base: Path, turns: int, seconds: float, steps: int, warm_up: int) -> tuple[list[Pair], Pair]:
    """Turns of a new process of each checkout, and their sizes; the base measures the steps of a turn if they are 0."""
    with ExitStack() as stack:
        command = [sys.executable, str(Path(__file__).resolve()), "--serve", name, "--warm-up", str(warm_up)]
        sides = {
            side: stack.enter_context(harness.other_process(command, PYTHONPATH=str(root)))
            for side, root in (("base", base), ("here", HERE))
        }
        steps = sides["base"]({"steps": steps} if steps else {"seconds": seconds}).steps
        sides["here"]({"steps": steps})
        order, pairs = ["base", "here"], []
        for _ in range(turns):
            pairs.append({side: sides[side]({"steps": steps}) for side in order})
            order.reverse()
        return pairs, {side: play("memory") for side, play in sides.items()}


def run_programs(name: str, base: Path, turns: int) -> dict[str, Any]:
    """The row of a program: CPU time of its processes."""

    def run(root: Path) -> float:
        before = sum(os.times()[2:4])
        surroundings = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(root)}
        subprocess.run([sys.executable, "-c", PROGRAMS[name]], env=surroundings, check=True)
        return sum(os.times()[2:4]) - before

    order, pairs = [base, HERE], []
    for _ in range(turns + 1):
        spent = {root: run(root) for root in order}
        pairs.append((spent[base], spent[HERE]))
        order.reverse()
    pairs = pairs[1:]
    ratios, medians = [theirs / ours for theirs, ours in pairs], [statistics.median(side) for side in zip(*pairs, strict=True)]
    times = {"base_ms": 1e3 * medians[0], "here_ms": 1e3 * medians[1], "ratio": medians[0] / medians[1]}
    return {"case": name, "steps": 1, **times, "turn_low": min(ratios), "turn_high": max(ratios), "turns": pairs}


def compare(name: str, base: Path, turns: int, seconds: float, warm_up: int, processes: int) -> dict[str, Any]:
    """The row of a case."""
    pairs, memory = play_pair(name, base, turns, seconds, 0, warm_up)
    steps = pairs[0]["base"].steps
    for _ in range(processes - 1):
        pairs += play_pair(name, base, turns, seconds, steps, warm_up)[0]
    medians = {side: statistics.median(pair[side].cpu for pair in pairs) for side in memory}
    ratios = [pair["base"].cpu / pair["here"].cpu for pair in pairs]
    return {
        "case": name,
        "steps": steps,
        **{f"{side}_ms": 1e3 * medians[side] / steps for side in memory},
        "ratio": medians["base"] / medians["here"],
        "turn_low": min(ratios),
        "turn_high": max(ratios),
        "same": all(
            (pair["base"].simulated, pair["base"].ended) == (pair["here"].simulated, pair["here"].ended) for pair in pairs
        ),
        **{f"{side}_bytes": sizes.simulated for side, sizes in memory.items()},
        **{f"{side}_growth": sizes.cpu for side, sizes in memory.items()},
        "turns": [{side: turn._asdict() for side, turn in pair.items()} for pair in pairs],
    }


def main() -> None:
    """Measure and print a table, or play one side of it."""
    arguments = harness.parser(__doc__, turns=5, seconds=5.0)
    arguments.add_argument("--base", type=Path, metavar="CHECKOUT", help="folder of the other checkout")
    arguments.add_argument("--processes", type=int, default=3, help="pairs of processes for each case, one after the other")
    every = [*CASES, *PROGRAMS]
    arguments.add_argument("--only", nargs="+", choices=every, default=DEFAULT, metavar="CASE", help=", ".join(every))
    arguments.add_argument("--serve", choices=CASES, help="play turns of one case in this process: for this script's own use")
    options, described = harness.begin(arguments)
    if options.serve:
        serve(options.serve, options.warm_up)
        return
    if options.base is None or not (options.base / "bsk_torch").is_dir():
        arguments.error(f"--base {options.base} must be a checkout with the folder bsk_torch")
    rows = harness.Rows(options, described)
    for name in options.only:
        if name in PROGRAMS:
            rows.append(run_programs(name, options.base.resolve(), options.turns))
            continue
        steps = CASES[name].steps if options.warm_up is None else options.warm_up
        rows.append(compare(name, options.base.resolve(), options.turns, options.seconds, steps, options.processes))
        print(harness.cell("{case}: {ratio:.3f}", rows[-1]), flush=True)
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
