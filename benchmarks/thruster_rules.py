"""Head-room of CWDocking-v1 and CWInspection-v1: the rule, the rule tuned by search, trained policies, and an upper bound.

Usage:
    python benchmarks/thruster_rules.py [--preset CWDocking-v1] [--settings 256] [--episodes 256] [--first 7700000]
        [--runs FOLDER ...] [--out FILE.json]

All play the same unseen episodes, and gains over the tuned rule are paired. The share is the gain as a part of the way from
random actions to the upper bound, which no policy can exceed: see ``docking_bound`` and ``MOST_INSPECTED``.
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import harness
import torch
from torch import Tensor

import bsk_torch
from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.evaluation.evaluate import Evaluation, evaluate, start_episodes
from bsk_torch.rl.evaluation.statistics import mean
from bsk_torch.tasks.safe_autonomy.dyn import MEAN_MOTION
from bsk_torch.tasks.safe_autonomy.preset_docking import LIMIT, DockingReward
from bsk_torch.tasks.safe_autonomy.preset_inspection import LitPointsReward

RULES: dict[str, tuple[str, dict[str, tuple[float, float]]]] = {
    "CWDocking-v1": ("glide", {"share": (0.5, 1.1), "gain": (2.0, 12.0)}),
    "CWInspection-v1": ("seek", {"speed": (0.05, 0.6), "distance": (20.0, 120.0), "back": (0.002, 0.03), "gain": (0.3, 2.4)}),
}
"""The rule of each preset, and the ranges of its numbers."""

MOST_INSPECTED = 99 * LitPointsReward.point + LitPointsReward.success
"""Return of an inspection of all points without any thrust."""

RADIUS = 0.2
"""Distance at which the deputy docks, m."""

SLACK = 4.0
"""Seconds that a docking can gain by the first decision, whose initial speed of up to 0.8 m/s may be above the safe speed."""

COLUMNS = {
    "entrant": "{entrant}",
    "return": "{return:.4f} +- {half:.4f}",
    "minus the tuned rule": "{gain:+.4f} +- {gain_half:.4f}",
    "share of the way": "{share:+.4f} +- {share_half:.4f}",
    "survival": "{survival:.1%}",
    "core-seconds": "{cpu:.1f}",
}


def docking_bound(distance: Tensor, limit: Tensor) -> Tensor:
    """Return an upper bound of the return of dockings from ``distance`` [n] m, where the safe speed is ``limit`` [n] m/s, [n].

    The flight is straight to the docking radius r at the safe speed L at all times, and its thrust is free. Rewards for
    approaching sum up to 2 (1 - exp(-a d)) at most, and docking at the time t pays 2 - t / 2000 s. With dL/dd = 2 n, t is at
    least ln(L(d) / L(r)) / 2 n. Speeding does not pay: an excess of e m/s for a second costs e, and saves e / L(r) s at most.
    """
    steep = 2.0 * MEAN_MOTION
    seconds = (limit / (limit - steep * (distance - RADIUS))).log() / steep - SLACK
    approach = DockingReward.approach * -torch.expm1(-math.log(2.0) / DockingReward.half_distance * distance)
    return approach + 2.0 - seconds / LIMIT


def bounds(env: SatelliteTasking, seeds: range) -> Tensor:
    """Return upper bounds of the returns of episodes, [n]."""
    start_episodes(env, seeds)
    dynamics = env.satellite.dynamics
    if hasattr(dynamics, "docked"):
        return docking_bound(dynamics.distance, dynamics.speed_limit)
    return torch.full_like(dynamics.distance, MOST_INSPECTED)


def figures(entrant: str, result: Evaluation, cpu: float, tuned: Evaluation, way: float) -> dict[str, Any]:
    """Return the figures of an entrant; the interval of the share is that of its gain, on the same scale."""
    gain = result.gain_over(tuned)
    return {
        "entrant": entrant,
        "return": result.mean_return.mean,
        "half": result.mean_return.half_width,
        "gain": gain.mean,
        "gain_half": gain.half_width,
        "share": gain.mean / way,
        "share_half": gain.half_width / way,
        "survival": result.survival,
        "cpu": cpu,
    }


def main() -> None:
    """Tune the rule, play all entrants, and print a table."""
    parsed = harness.parser(__doc__, preset="CWDocking-v1", settings=256, episodes=256, first=7_700_000)
    parsed.add_argument("--runs", nargs="+", default=[], metavar="FOLDER", help="folders of trainings")
    options, described = harness.begin(parsed)
    name, ranges = RULES[options.preset]
    env = bsk_torch.make(options.preset, num_envs=options.episodes, env_ids=[0] * options.episodes)
    assert isinstance(env, SatelliteTasking)
    seeds = range(options.first, options.first + options.episodes)
    tuning = bsk_torch.tune(bsk_torch.rule(name, env).module, env, ranges, settings=options.settings, zooms=0, fresh=2)
    print(tuning.thresholds, flush=True)
    best = f"{name}, tuned"
    policies = {policy: policy for policy in ("random", name)} | {best: tuning.rule}
    policies |= {f"policy {Path(run).name}": run for run in options.runs}
    played: dict[str, tuple[Evaluation, float]] = {}
    for entrant, policy in policies.items():
        clock = time.process_time()
        result = evaluate(policy, env, seeds=seeds)
        played[entrant] = result, time.process_time() - clock
    tuned, most = played[best][0], bounds(env, seeds)
    way = mean(most - played["random"][0].returns)
    rows = [figures(entrant, result, cpu, tuned, way) for entrant, (result, cpu) in played.items()]
    rest = {"bound": mean(most), "room": mean(most - tuned.returns) / way}
    found = {key: getattr(tuning, key) for key in ("thresholds", "episodes", "core_seconds")}
    harness.write(options, described, rows=rows, tuning=found, **rest)
    print(harness.table(COLUMNS, rows))
    print(f"upper bound {rest['bound']:.4f}, above the tuned rule by {rest['room']:.4f} of the way")


if __name__ == "__main__":
    main()
