"""How much better than rules can policies of FaultyScan-v1 be?

Usage:
    python benchmarks/faults_headroom.py [--frames 3000000] [--seeds 3] [--episodes 1024] [--planned 128] [--futures 2]
        [--known past all] [--out FILE.json]

Rules, policies trained by the recipe of the preset, and planners over the rule ``cautious`` fly the same fresh episodes, of which
planners have only the first ones. One planner knows all faults in advance, the other only those that have happened: it averages
over ``--futures`` draws of the others. Gains over ``cautious`` are paired by episode. ``--planned 0`` leaves planners out,
``--seeds 0`` trainings.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import harness
from tensordict.nn import TensorDictModuleBase

import bsk_torch
from bsk_torch import SatelliteTasking
from bsk_torch.lab.planners import Rollout
from bsk_torch.rl.evaluation import Evaluation, evaluate
from bsk_torch.rl.policies.shared_policy import rule
from bsk_torch.rl.training import configure
from bsk_torch.rl.training.trainer import Training

PRESET = "FaultyScan-v1"

JUDGED = 3_700_003
"""Seed of the episodes in which policies are compared."""

BEST = "cautious"
"""The rule over which gains are, and that planners improve."""

RULES = (BEST, "rule")

HORIZON = 6000.0
"""How far planners look ahead, s."""

COLUMNS = {
    "policy": "{policy}",
    "return": "{return:.3f} +- {half:.3f}",
    "gain": "{gain:+.3f} +- {gain_half:.3f}",
    "survival": "{survival:.1%} ({survival_low:.1%} to {survival_high:.1%})",
    "episodes": "{episodes}",
    "core-seconds": "{cpu:.0f}",
}


def make_env(episodes: int, options: argparse.Namespace) -> SatelliteTasking:
    """Return the environment in which policies are compared; the first of many episodes are those of few."""
    env = bsk_torch.make(PRESET, num_envs=episodes, time_limit=options.time_limit, backend=options.backend)
    assert isinstance(env, SatelliteTasking)
    return env


def train(seed: int, options: argparse.Namespace, folder: Path) -> Any:
    """Return a policy trained by the recipe of the preset."""
    world = dict(time_limit=options.time_limit, backend=options.backend)
    config = configure(PRESET, seed=seed, num_envs=options.num_envs, frames=options.frames, seconds=None, options=world)
    return Training(config, folder).run(bar=False)


def row(name: str, found: Evaluation, best: Evaluation, cpu: float) -> dict[str, Any]:
    """Figures of a policy; ``best`` is the rule in the same episodes."""
    low, high = found.survival_interval
    gain = found.gain_over(best)
    return {
        "policy": name,
        "episodes": len(found.returns),
        "return": found.mean_return.mean,
        "half": found.mean_return.half_width,
        "gain": gain.mean,
        "gain_half": gain.half_width,
        "survival": found.survival,
        "survival_low": low,
        "survival_high": high,
        "cpu": cpu,
        **({} if found.simulated is None else {"simulated": found.simulated_per_decision}),
    }


def planners(env: SatelliteTasking, options: argparse.Namespace) -> dict[str, TensorDictModuleBase]:
    """Return planners over the best rule, by the faults that they know."""
    return {
        f"planner, {which} faults known": Rollout(
            env, BEST, horizon=HORIZON, gamma=1.0, futures=options.futures if which == "past" else None, rows=2048
        )
        for which in options.known
    }


def main() -> None:
    """Train, compare, and print a table."""
    parsed = harness.parser(
        __doc__, frames=3_000_000, seeds=3, episodes=1024, planned=128, futures=2, num_envs=1024, time_limit=28_500.0
    )
    parsed.add_argument("--known", nargs="+", choices=("past", "all"), default=["past", "all"], help="faults that planners know")
    parsed.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    options, described = harness.begin(parsed)
    rows: list[dict[str, Any]] = []
    best: dict[int, Evaluation] = {}

    def compare(name: str, policy: TensorDictModuleBase, env: SatelliteTasking) -> None:
        clock = time.process_time()
        found = evaluate(policy, env, seed=JUDGED)
        rows.append(row(name, found, best.setdefault(env.num_envs, found), time.process_time() - clock))
        print(harness.cell("{policy}: {return:.3f}, gain {gain:+.3f} +- {gain_half:.3f}", rows[-1]), flush=True)
        harness.write(options, described, rows=rows)

    env = make_env(options.episodes, options)
    for name in RULES:
        compare(name, rule(name, env), env)
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(options.seeds):
            compare(f"trained, seed {seed}", train(seed, options, Path(folder) / str(seed)), env)
    if options.planned:
        few = make_env(options.planned, options)
        compare(BEST, rule(BEST, few), few)
        for name, policy in planners(few, options).items():
            compare(name, policy, few)
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    main()
