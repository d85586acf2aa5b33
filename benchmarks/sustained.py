"""Times between images that satellites cannot beat for long: records flights, fits times by a linear program, and checks them.

Usage:
    python benchmarks/sustained.py [--scale 1.0] [--planned 2] [--planned-time 17100] [--reserve 60] [--margin 6] [--enough 500]
        [--rounds 3] [--seed 11] [--time-limit 17100] [--window 1500] [--fitted FILE.json] [--envelope FILE.json]
        [--out FILE.json]

Several policies fly AEOS-v1, AEOSCity-v1 and AEOSPower-v1; ``--reserve`` is the lead in ticks that the times are chosen for, and
``--margin`` is added to the largest lead of these flights. The program weights each angle by how often the best path of the bound
uses it, in ``--window`` seconds of two episodes with 9,999 targets, and is solved ``--rounds`` times: the first weights are those
of the flights. The times are then checked on other episodes of the same policies. Since a planner gets ahead of them, they are
multiplied by the largest of 0.99, 0.98 and so on with which ``--planned`` episodes of a planner, ``--planned-time`` seconds long,
keep within the reserve, and checked on as many others. ``--scale`` multiplies the number of episodes of the policies;
``--fitted`` names the times of an earlier run, so that only the planner flies and other results in the file of ``--out`` stay;
``--envelope`` names the file for the times, such as ``bsk_torch/plan/bounds/agile_sustained.json``.
"""

from __future__ import annotations

import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

import harness
import torch
from envelope import Soonest
from torch import Tensor

import bsk_torch
from bsk_torch.astro.frames import angle_between
from bsk_torch.plan import planner
from bsk_torch.plan.bounds import Envelope, ImageSequences, ImagingBound, imaging_bound, leads, record_images, sustained_envelope
from bsk_torch.plan.bounds.envelope import SOONEST
from bsk_torch.plan.bounds.sustained import bins_of
from bsk_torch.plan.bounds.tasks import agility
from bsk_torch.plan.bounds.windows import satellite_positions
from bsk_torch.rl.policies import pretrained
from bsk_torch.rl.rules.baselines import BASELINES

Case = tuple[str, int | None, str | int]

CASES: tuple[tuple[Case, int], ...] = (
    (("AEOS-v1", 9999, "hasty"), 64),
    (("AEOS-v1", 9999, "trained"), 64),
    (("AEOS-v1", 9999, 4), 48),
    (("AEOS-v1", 9999, 12), 32),
    (("AEOS-v1", 3000, "hasty"), 48),
    (("AEOS-v1", 3000, 3), 32),
    (("AEOSCity-v1", None, "hasty"), 32),
    (("AEOSCity-v1", None, 3), 24),
    (("AEOSPower-v1", 5000, "hasty"), 32),
)
"""Preset, targets, a policy or the number of targets among which actions are drawn, and episodes."""

PLANNED: Case = ("AEOS-v1", 9999, "rollout over trained")
"""What the times are lowered for."""

HELD_OUT, WEIGHED = 1000, 2000
"""What is added to the seed for flights that are checked, and for episodes whose bound gives weights."""

BINS, WIDTH = 70, 0.02
"""Bins of the angle, and their width, rad."""

LEADS = {
    "task": "{task}",
    "policy": "{policy}",
    "images": "{images:,}",
    "largest lead, s": "{largest:.1f}",
    "beyond the reserve": "{beyond:,}",
}
TIMES = {
    "angle, rad": "{low:.2f} to {high:.2f}",
    "transitions": "{count:,}",
    "sustained, s": "{sustained:.1f}",
    "least in one step, s": "{least:.1f}",
    "median, s": "{median:.1f}",
}


def fly(options: Any, case: Case, episodes: int, seed: int) -> tuple[ImageSequences, dict[str, str]]:
    """Record one case."""
    preset, targets, player = case
    world: dict[str, Any] = dict(num_envs=episodes, backend=options.backend, time_limit=options.time_limit)
    world |= {"n_targets": targets} if targets else {}
    learned = player in ("trained", PLANNED[2])
    env: Any = bsk_torch.make(preset, **world, **({"as_set": True} if learned else {}))
    policy: Any = pretrained(preset) if learned else None
    if player == PLANNED[2]:
        policy = planner("rollout", env, base=policy, budget=8, horizon=240.0, gamma=0.99)
    elif isinstance(player, int):
        policy = Soonest(player, seed)
    elif not learned:
        policy = BASELINES[player](env, seed)
    images = record_images(env, policy, seed)
    print(preset, targets, player, images.transitions, flush=True)
    return images, agility(env.satellite)


def used(env: Any, bound: ImagingBound) -> Tensor:
    """Return how often the best path of the bound uses each bin of the angle, [BINS]."""
    satellite, places = env.satellite, env.simulator.scenario_state["target_r_LP_P"]
    row, k = torch.nonzero(bound.tick[:, 1:] >= 0, as_tuple=True)
    time = bound.tick[row, k].clamp(max=int(env.state.limit_ticks.max())) * env.simulator.h
    here = satellite_positions(satellite, row, time)
    angle = angle_between(places[row, bound.target[row, k]] - here, places[row, bound.target[row, k + 1]] - here)
    return bins_of(angle, WIDTH, BINS)


def fitted(options: Any, images: ImageSequences, args: dict[str, str]) -> Envelope:
    """Fit times, with the weights that the bound gives them."""
    limit = min(options.window, options.time_limit)
    env: Any = bsk_torch.make("AEOS-v1", n_targets=9999, num_envs=2, time_limit=limit, backend=options.backend)
    env.set_seed(options.seed + WEIGHED)
    env.reset()
    chosen = dict(reserve=options.reserve, margin=options.margin, enough=options.enough, width=WIDTH, bins=BINS)
    weight: Tensor | None = None
    best: tuple[float, Envelope] | None = None
    for _ in range(options.rounds):
        made = sustained_envelope(images, weight=weight, step=float(args["sim_rate"]), arguments=args, **chosen)
        bound = imaging_bound(env, envelope=made, iterations=80, bits=2)
        upper, use = float(bound.upper.mean()), used(env, bound).double()
        print(f"reserve {made.reserve} ticks, bound {upper:.2f} of {float(bound.in_view.mean()):.2f}", flush=True)
        best = min(best or (upper, made), (upper, made), key=lambda pair: pair[0])
        share = use / use.sum().clamp(min=1.0)
        weight = share if weight is None else 0.5 * (weight + share)
    assert best is not None
    return best[1]


def leads_of(case: Case, images: ImageSequences, envelope: Envelope) -> dict[str, Any]:
    """Row of the table of leads."""
    lead = leads(images, envelope).lead
    name = f"one of {case[2]}" if isinstance(case[2], int) else case[2]
    task = case[0] if case[1] is None else f"{case[0]}/{case[1]}"
    largest, beyond = float(lead.max()) * envelope.step, int((lead > envelope.reserve).sum())
    return dict(task=task, policy=name, images=int((images.tick >= 0).sum()), largest=largest, beyond=beyond)


def times_of(images: ImageSequences, envelope: Envelope) -> list[dict[str, float]]:
    """Rows of the table of times, for every tenth of a radian."""
    angle, ticks, least, h = leads(images, envelope).angle[:, 1:], images.tick.diff(dim=1), Envelope.load(), envelope.step
    rows = []
    for k in range(0, BINS, 5):
        low, high = k * WIDTH, (k + 5) * WIDTH
        here = (angle >= low) & (angle < high)
        median = float(ticks[here].double().median()) * h if bool(here.any()) else float("nan")
        times = dict(sustained=envelope.direct[k] * h, least=least.direct[k] * h, median=median)
        rows.append(dict(low=low, high=high, count=int(here.sum())) | times)
    return rows


def lowered(envelope: Envelope, images: ImageSequences, margin: int) -> tuple[Envelope, float]:
    """Return times multiplied by the largest number of hundredths with which flights keep within the reserve, and that number."""
    for hundredths in range(100, 0, -1):
        ticks = tuple(max(SOONEST, time * hundredths // 100) for time in envelope.direct)
        found = replace(envelope, direct=ticks, any=ticks)
        if int(leads(images, found).lead.max()) <= envelope.reserve - margin:
            return found, hundredths / 100
    raise ValueError("the flights are ahead of any times")


def policies(options: Any) -> tuple[Envelope, dict[str, Any]]:
    """Fit times to the flights of policies, and return them with what others are ahead of them."""
    flights: list[ImageSequences] = []
    args: dict[str, str] = {}
    for case, episodes in CASES:
        images, args = fly(options, case, max(1, round(episodes * options.scale)), options.seed)
        flights.append(images)
    every = ImageSequences.joined(flights)
    envelope = fitted(options, every, args)
    checked = []
    for case, episodes in CASES:
        count = max(1, round(0.5 * episodes * options.scale))
        images, _ = fly(options, case, count, options.seed + HELD_OUT)
        checked.append(leads_of(case, images, envelope))
    check = dict(reserve=envelope.reserve * envelope.step, transitions=every.transitions, carried_over=every.carried)
    check |= dict(largest=float(leads(every, envelope).lead.max()) * envelope.step)
    return envelope, dict(check=check, rows=times_of(every, envelope), leads=checked)


def main() -> None:
    """Record, fit, check, and print tables."""
    arguments = harness.parser(
        __doc__, scale=1.0, planned=2, planned_time=17_100.0, reserve=60, margin=6, enough=500, rounds=3, seed=11,
        time_limit=17_100.0, window=1500.0, backend="compiled", fitted="", envelope="",
    )  # fmt: skip
    options, described = harness.begin(arguments)
    if options.fitted:
        envelope, results = Envelope.load(Path(options.fitted)), json.loads(options.out.read_text())
        results = {name: results[name] for name in ("check", "rows", "leads")}
    else:
        envelope, results = policies(options)
    print(harness.table(TIMES, results["rows"]))
    print(harness.table(LEADS, results["leads"]))
    short = Namespace(**vars(options) | {"time_limit": min(options.time_limit, options.planned_time)})
    images, _ = fly(short, PLANNED, options.planned, options.seed)
    made, share = lowered(envelope, images, options.margin)
    others, _ = fly(short, PLANNED, options.planned, options.seed + HELD_OUT)
    planned = [leads_of(PLANNED, *pair) for pair in ((images, envelope), (others, envelope), (images, made), (others, made))]
    print(harness.table(LEADS, planned))
    print(json.dumps(results["check"] | {"share": share}))
    if options.envelope:
        made.save(Path(options.envelope))
    harness.write(options, described, **results, share=share, planned=planned)


if __name__ == "__main__":
    main()
