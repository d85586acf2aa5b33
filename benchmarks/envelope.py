"""Least times between images: records transitions in flight, fits an envelope below them, and checks it.

Usage:
    python benchmarks/envelope.py [--transitions 1000000] [--scale 1.0] [--seed 11] [--time-limit 17100] [--enough 2000]
        [--envelope FILE.json] [--out FILE.json]

Several policies fly AEOS-v1, AEOSCity-v1 and AEOSPower-v1, among them some that fail often: a step that ends without an image
leaves the satellite on its way. Rounds of fresh episodes follow one another until there are enough transitions. The envelope is
fitted below all of them. Whether it says something of flights that it has not seen is shown by another one, fitted below the
first round alone: the table tells how many of the later transitions lie below that. ``--scale`` multiplies the number of
episodes; ``--envelope`` names the file for the fitted envelope, such as ``bsk_torch/lab/bounds/agile.json``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import harness
import torch
from tensordict import TensorDictBase

import bsk_torch
from bsk_torch.lab.bounds import Envelope, Transitions, record_transitions
from bsk_torch.lab.bounds.tasks import agility
from bsk_torch.rl.rules.baselines import BASELINES

CASES: tuple[tuple[str, dict[str, Any], str | int, int], ...] = (
    ("AEOS-v1", {"n_targets": 9999}, "hasty", 96),
    ("AEOS-v1", {"n_targets": 9999}, 2, 96),
    ("AEOS-v1", {"n_targets": 9999}, 4, 96),
    ("AEOS-v1", {"n_targets": 9999}, 12, 96),
    ("AEOS-v1", {"n_targets": 4000}, "nearest", 128),
    ("AEOS-v1", {"n_targets": 3000}, "hasty", 256),
    ("AEOS-v1", {"n_targets": 3000}, 6, 192),
    ("AEOS-v1", {"n_targets": 1000}, "hasty", 512),
    ("AEOS-v1", {"n_targets": 1000}, 3, 384),
    ("AEOSCity-v1", {}, "hasty", 256),
    ("AEOSCity-v1", {}, 3, 256),
    ("AEOSPower-v1", {"n_targets": 5000}, "random", 128),
    ("AEOSPower-v1", {"n_targets": 5000}, "hasty", 128),
)
"""Preset, options, a rule or the number of targets among which actions are drawn, and episodes."""

COLUMNS = {
    "angle, rad": "{low:.2f} to {high:.2f}",
    "transitions": "{count:,}",
    "least in one step, s": "{direct:.1f}",
    "least, s": "{any:.1f}",
    "median in one step, s": "{median:.1f}",
}


class Soonest:
    """Images one of the ``k`` targets whose windows close next, with equal probability."""

    def __init__(self, k: int, seed: int) -> None:
        """Draw by ``seed``."""
        self.k, self.generator = k, torch.Generator().manual_seed(seed)

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action`` [N]."""
        lot = torch.rand(tensordict.batch_size, dtype=torch.float64, generator=self.generator)
        return tensordict.set("action", (lot * self.k).long())


def fly(options: Any, seed: int) -> tuple[Transitions, dict[str, str]]:
    """Record one round of all cases."""
    parts, args = [], {}
    for preset, task, player, episodes in CASES:
        batch = max(1, round(episodes * options.scale))
        world = dict(num_envs=batch, backend=options.backend, time_limit=options.time_limit)
        env: Any = bsk_torch.make(preset, **world, **task)
        policy = Soonest(player, seed) if isinstance(player, int) else BASELINES[player](env, seed)
        parts.append(record_transitions(env, policy, seed))
        args = agility(env.satellite)
        print(preset, task, player, len(parts[-1].ticks), flush=True)
    return Transitions.joined(parts), args


def rows_of(found: Transitions, envelope: Envelope) -> list[dict[str, float]]:
    """Rows of the table, for every fifth of a radian."""
    rows, h = [], envelope.step
    for k in range(0, len(envelope.direct), 5):
        low, high = k * envelope.width, (k + 5) * envelope.width
        here = (found.angle >= low) & (found.angle < high)
        one = here & found.one_step
        median = float(found.ticks[one].double().median()) * h if bool(one.any()) else float("nan")
        rows.append(
            dict(low=low, high=high, count=int(here.sum()), direct=envelope.direct[k] * h, any=envelope.any[k] * h, median=median)
        )
    return rows


def main() -> None:
    """Record, fit, check, and print a table."""
    arguments = harness.parser(
        __doc__, transitions=1_000_000, scale=1.0, seed=11, time_limit=17_100.0, enough=2000, backend="compiled", envelope=""
    )
    options, described = harness.begin(arguments)
    rounds: list[Transitions] = []
    args: dict[str, str] = {}
    while sum(len(part.ticks) for part in rounds) < options.transitions:
        part, args = fly(options, options.seed + len(rounds))
        rounds.append(part)
    found, h = Transitions.joined(rounds), float(args["sim_rate"])
    envelope = Envelope.below(*found[:3], step=h, arguments=args, enough=options.enough)
    check = dict(transitions=len(found.ticks), carried_over=found.carried, smallest_margin=envelope.smallest_margin(*found[:3]))
    if len(rounds) > 1:
        first, later = rounds[0], Transitions.joined(rounds[1:])
        fitted = Envelope.below(*first[:3], step=h, arguments=args, enough=options.enough)
        below = torch.where(later.one_step, fitted.least(later.angle, direct=True), fitted.least(later.angle, direct=False))
        check |= dict(fitted_on=len(first.ticks), checked_on=len(later.ticks), below=int((later.ticks < below).sum()))
    rows = rows_of(found, envelope)
    print(harness.table(COLUMNS, rows))
    print(json.dumps(check))
    if options.envelope:
        envelope.save(Path(options.envelope))
    harness.write(options, described, check=check, rows=rows)


if __name__ == "__main__":
    main()
