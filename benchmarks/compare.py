"""Speed and memory of this checkout beside another one, such as a release, without Basilisk.

Usage:
    python benchmarks/compare.py --base CHECKOUT [--only CASE ...] [--turns 5] [--processes 3] [--seconds 5] [--out FILE.json]

Each checkout runs in a process of its own, through the public interface only, and plays the same random actions from the same
seed. The base measures how many steps take ``--seconds``; a turn is that number of steps on both sides, one after the other, in
alternating order. The same program differs by some percent from one process to the next, so several pairs of processes play.
The work of a turn is the same if both simulate the same numbers, which the column ``same`` states: whether simulated seconds and
ended episodes of every turn are equal. The ratio of a turn is base's CPU time divided by this
checkout's; above 1, this checkout is faster. Memory is ``env.bytes_per_env`` and the growth of the process after the last turn.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import constellation
import harness
import torch
from harness import Player, Turn

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


CASES = {
    "4096": alone("scan", 4096),
    "64": alone("scan", 64),
    "1": alone("scan", 1),
    "imaging-1k-1024": alone("imaging-1k", 1024),
    "constellation-16": together("tasks", 16, 1024),
    "constellation-16-intervals": together("intervals", 16, 1024),
}

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
            sizes = Turn(env.bytes_per_env, 0, 0, 0, (harness.resident() - before) / case.batch / 1e3, 0.0)
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
    arguments.add_argument("--only", nargs="+", choices=CASES, default=DEFAULT, metavar="CASE", help=", ".join(CASES))
    arguments.add_argument("--serve", choices=CASES, help="play turns of one case in this process: for this script's own use")
    options, described = harness.begin(arguments)
    if options.serve:
        serve(options.serve, options.warm_up)
        return
    if options.base is None or not (options.base / "bsk_torch").is_dir():
        arguments.error(f"--base {options.base} must be a checkout with the folder bsk_torch")
    rows = []
    for name in options.only:
        steps = CASES[name].steps if options.warm_up is None else options.warm_up
        rows.append(compare(name, options.base.resolve(), options.turns, options.seconds, steps, options.processes))
        print(harness.cell("{case}: {ratio:.3f}", rows[-1]), flush=True)
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
