"""Times between images that satellites cannot beat for long: records flights, fits times by a linear program, and checks them.

Usage:
    python benchmarks/sustained.py [--scale 1.0] [--planned 8] [--searched 0] [--planned-time 5700] [--reserve 52] [--margin 8]
        [--enough 20] [--share 0.25] [--lag 0.04] [--sectors 8] [--near 25000] [--rounds 2] [--seed 11] [--time-limit 17100]
        [--window 1200] [--envelope FILE.json] [--fitted FILE.json] [--lowered 1.0] [--spare 2.0] [--out FILE.json]

Several policies fly AEOS-v1, AEOSCity-v1 and AEOSPower-v1. A rollout planner flies ``--planned`` episodes of ``--planned-time``
seconds, and beam search ``--searched`` episodes; ``--reserve`` is the lead in ticks that the times are chosen for, and
``--margin`` is added to the largest lead of these flights. Angles are measured from where satellites point when they take an
image: ``--lag`` rad beside the target, in the direction of the target before, one of ``--sectors``, or as before where that
target is nearer than ``--near`` meters. No time is longer than the quantile ``--share`` of its bin. The program weights each
angle by how often the best path of the bound uses it, in ``--window`` seconds of two episodes with 9,999 targets, and is solved
``--rounds`` times: the first weights are those of the flights. The times are then checked on as many other episodes of the
planners, and half as many of the other policies. ``--scale`` multiplies the number of episodes of the policies; ``--envelope``
names the file for the times, such as ``bsk_torch/lab/bounds/agile_sustained.json``. ``--fitted`` names times of an earlier run,
which are only checked on the episodes of another ``--seed``: how late images come after their windows on the clock of these
times, each and all of a flight together. ``--envelope`` then gets the times, multiplied by ``--lowered``, with a reserve
``--margin`` above the latest image, and ``--spare`` times the lateness of the latest flight; without lowering, neither is less
than before.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import harness
import torch
from envelope import Soonest
from image_leads import NODES, SPACING, ImageSequences, bins_of, lateness, leads, record_images, sustained_envelope
from torch import Tensor

import bsk_torch
from bsk_torch.lab.bounds import Envelope, ImagingBound, imaging_bound
from bsk_torch.lab.bounds.envelope import SOONEST
from bsk_torch.lab.bounds.tasks import agility
from bsk_torch.lab.bounds.windows import satellite_positions
from bsk_torch.lab.planners import planner
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

PLANNERS = {"rollout over trained": ("rollout", 8), "beam search over trained": ("beam", 256)}
"""Planners and their budgets."""

PLANNED: tuple[Case, ...] = tuple(("AEOS-v1", 9999, name) for name in PLANNERS)
"""What planners fly."""

HELD_OUT, WEIGHED = 1000, 2000
"""What is added to the seed for flights that are checked, and for episodes whose bound gives weights."""

BINS, WIDTH = 190, 0.005
"""Bins of the angle, and their width, rad."""

NEARBY = 9
"""Bins over which weights are averaged: a path of the bound uses a few of them, and which ones is chance."""

SHOWN = (0.02, 0.04, 0.06, 0.08, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
"""Angles in the table of times, rad."""

LEADS = {
    "task": "{task}",
    "policy": "{policy}",
    "images": "{images:,}",
    "largest lead, s": "{largest:.1f}",
    "latest image, s": "{latest:.1f}",
    "lateness, s in 1,000 s": "{lateness:.2f}",
    "flights beyond": "{beyond:,}",
}
TIMES = {
    "angle, rad": "{low:.2f} to {high:.2f}",
    "transitions": "{count:,}",
    "sustained, s": "{sustained:.1f}",
    "quickest tenth, s": "{tenth:.1f}",
    "median, s": "{median:.1f}",
}


def fly(options: Any, case: Case, episodes: int, seed: int) -> tuple[ImageSequences, dict[str, str]]:
    """Record one case."""
    preset, targets, player = case
    world: dict[str, Any] = dict(num_envs=episodes, backend=options.backend, time_limit=limit_of(options, case))
    world |= {"n_targets": targets} if targets else {}
    learned = player in ("trained", *PLANNERS)
    env: Any = bsk_torch.make(preset, **world, **({"as_set": True} if learned else {}))
    policy: Any = pretrained(preset) if learned else None
    if player in PLANNERS:
        kind, budget = PLANNERS[player]
        policy = planner(kind, env, base=policy, budget=budget, horizon=240.0, gamma=0.99)
    elif isinstance(player, int):
        policy = Soonest(player, seed)
    elif not learned:
        policy = BASELINES[player](env, seed)
    images = record_images(env, policy, seed)
    print(preset, targets, player, images.transitions, flush=True)
    return images, agility(env.satellite)


def images_of(env: Any, bound: ImagingBound) -> ImageSequences:
    """Return the best path of the bound, as if a satellite had flown it."""
    tick = bound.tick
    target = bound.target.clamp(min=0).unsqueeze(-1).expand(-1, -1, 3)
    places = env.simulator.scenario_state["target_r_LP_P"].gather(1, target)
    later = tick.clamp(min=0).unsqueeze(-1) + SPACING * torch.arange(NODES)
    time = later.clamp(max=int(env.state.limit_ticks.max())).flatten() * env.simulator.h
    row = torch.arange(len(tick)).repeat_interleave(tick.shape[1] * NODES)
    nodes = satellite_positions(env.satellite, row, time).view(*tick.shape, NODES, 3)
    return ImageSequences(tick, places, nodes, tick, bound.lower, 0)


def used(env: Any, bound: ImagingBound, envelope: Envelope) -> Tensor:
    """Return the share of each bin of the angle in the best path of the bound, [BINS], averaged over nearby ones."""
    soonest = (SOONEST,) * BINS  # whose clock is that of the path
    angle = leads(images_of(env, bound), replace(envelope, direct=soonest, any=soonest)).angle
    use = bins_of(angle, WIDTH, BINS).double()
    smooth = torch.nn.functional.avg_pool1d(use.view(1, 1, -1), NEARBY, 1, NEARBY // 2, count_include_pad=False).view(-1)
    return smooth / smooth.sum().clamp(min=1.0)


def fitted(options: Any, images: ImageSequences, args: dict[str, str]) -> Envelope:
    """Fit times, with the weights that the bound gives them."""
    limit = min(options.window, options.time_limit)
    env: Any = bsk_torch.make("AEOS-v1", n_targets=9999, num_envs=2, time_limit=limit, backend=options.backend)
    env.set_seed(options.seed + WEIGHED)
    env.reset()
    chosen = dict(reserve=options.reserve, margin=options.margin, enough=options.enough, width=WIDTH, bins=BINS)
    chosen |= dict(lag=options.lag, sectors=options.sectors, near=options.near, share=options.share)
    weight: Tensor | None = None
    best: tuple[float, Envelope] | None = None
    for _ in range(options.rounds):
        made = sustained_envelope(images, weight=weight, step=float(args["sim_rate"]), arguments=args, **chosen)
        bound = imaging_bound(env, envelope=made, iterations=80, bits=2)
        upper, use = float(bound.upper.mean()), used(env, bound, made)
        print(f"reserve {made.reserve} ticks, bound {upper:.2f} of {float(bound.in_view.mean()):.2f}", flush=True)
        best = min(best or (upper, made), (upper, made), key=lambda pair: pair[0])
        weight = use if weight is None else 0.5 * (weight + use)
    assert best is not None
    return best[1]


def limit_of(options: Any, case: Case) -> float:
    """Return the time limit of the flights of a case, s."""
    return min(options.time_limit, options.planned_time) if case in PLANNED else options.time_limit


def leads_of(options: Any, case: Case, images: ImageSequences, envelope: Envelope) -> dict[str, Any]:
    """Row of the table of leads; ``beyond`` are flights with more lateness than the envelope has, in an image or altogether."""
    h, limit, late = envelope.step, limit_of(options, case), lateness(images, envelope)
    latest, total = late.amax(1), late.sum(1)
    name = f"one of {case[2]}" if isinstance(case[2], int) else case[2]
    row: dict[str, Any] = dict(task=case[0] if case[1] is None else f"{case[0]}/{case[1]}", policy=name)
    row |= dict(images=int((images.tick >= 0).sum()), largest=float(leads(images, envelope).lead.max()) * h)
    row |= dict(latest=float(latest.max()) * h, lateness=float(total.max()) * h / limit * 1000.0)
    beyond = (latest > envelope.reserve) | (total > envelope.most_late(round(limit / h)))
    return row | dict(beyond=int(beyond.sum()))


def limits(envelope: Envelope) -> dict[str, float | None]:
    """Return what the envelope allows: the lateness of an image, s, and that of a flight beyond one reserve, s in 1,000 s."""
    share = envelope.lateness
    return dict(reserve=envelope.reserve * envelope.step, lateness=None if share is None else share * 1000.0)


def times_of(images: ImageSequences, envelope: Envelope) -> list[dict[str, float]]:
    """Rows of the table of times, for some angles."""
    angle, ticks, h = leads(images, envelope).angle[:, 1:], images.tick.diff(dim=1), envelope.step
    rows = []
    for low in SHOWN:
        high = low + 2 * WIDTH
        here = (angle >= low) & (angle < high)
        times = ticks[here].double() * h if bool(here.any()) else torch.full((1,), torch.nan, dtype=torch.float64)
        tenth, median = torch.quantile(times, torch.tensor([0.1, 0.5], dtype=torch.float64)).tolist()
        sustained = envelope.direct[min(round(low / WIDTH), BINS - 1)] * h
        rows.append(dict(low=low, high=high, count=int(here.sum()), sustained=sustained, tenth=tenth, median=median))
    return rows


def flights(options: Any, share: float, seed: int) -> tuple[list[tuple[Case, ImageSequences]], dict[str, str]]:
    """Record all cases, those of policies with a ``share`` of their episodes, and return the arguments of their satellite."""
    cases = [(case, max(1, round(share * episodes * options.scale))) for case, episodes in CASES]
    cases += [(case, count) for case, count in zip(PLANNED, (options.planned, options.searched), strict=True) if count]
    found, args = [], {}
    for case, episodes in cases:
        images, args = fly(options, case, episodes, seed)
        found.append((case, images))
    return found, args


def main() -> None:
    """Record, fit, check, and print tables."""
    arguments = harness.parser(
        __doc__, scale=1.0, planned=8, searched=0, planned_time=5700.0, reserve=52, margin=8, enough=20, share=0.25, lag=0.04,
        sectors=8, near=25_000.0, rounds=2, seed=11, time_limit=17_100.0, window=1200.0, backend="compiled", envelope="",
        fitted="", lowered=1.0, spare=2.0,
    )  # fmt: skip
    options, described = harness.begin(arguments)
    if options.fitted:
        envelope = Envelope.load(Path(options.fitted))
        if options.lowered < 1.0:
            ticks = tuple(max(SOONEST, int(time * options.lowered)) for time in envelope.direct)
            envelope = replace(envelope, direct=ticks, any=ticks, reserve=0, lateness=None)
        flown, _ = flights(options, 1.0, options.seed)
        rows = [leads_of(options, case, images, envelope) for case, images in flown]
        latest = round(max(row["latest"] for row in rows) / envelope.step) + options.margin
        share = options.spare * max(row["lateness"] for row in rows) / 1000.0
        found = replace(envelope, reserve=max(envelope.reserve, latest), lateness=max(envelope.lateness or 0.0, share))
        if options.envelope:
            found.save(Path(options.envelope))
        print(harness.table(LEADS, rows))
        check = dict(known=limits(envelope), found=limits(found))
        print(json.dumps(check))
        harness.write(options, described, check=check, leads=rows)
        return
    known, args = flights(options, 1.0, options.seed)
    every = ImageSequences.joined([images for _, images in known])
    envelope = fitted(options, every, args)
    if options.envelope:
        envelope.save(Path(options.envelope))
    others, _ = flights(options, 0.5, options.seed + HELD_OUT)
    fit, checked = ([leads_of(options, case, images, envelope) for case, images in part] for part in (known, others))
    check = dict(reserve=envelope.reserve * envelope.step, transitions=every.transitions, carried_over=every.carried)
    check |= dict(largest=float(leads(every, envelope).lead.max()) * envelope.step)
    rows = times_of(every, envelope)
    print(harness.table(TIMES, rows))
    print(harness.table(LEADS, fit))
    print(harness.table(LEADS, checked))
    print(json.dumps(check))
    harness.write(options, described, check=check, rows=rows, fit=fit, leads=checked)


if __name__ == "__main__":
    main()
