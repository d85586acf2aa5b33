"""How much better than rules can policies of FaultyScan-v1 be?

Usage:
    python benchmarks/faults_headroom.py [--frames 1000000] [--seeds 3] [--episodes 1024] [--planned 128] [--futures 4]
        [--trainings NAME ...] [--out FILE.json]

Rules, policies of several seeds (:data:`TRAININGS`), and planners over the rule ``cautious`` fly the same fresh episodes, of
which planners have only the first ones. One planner knows all faults in advance, the other only those that have happened: it
averages over ``--futures`` draws of the others; 0 leaves it out. Gains over ``cautious`` are paired by episode. ``--planned 0``
leaves planners out, ``--seeds 0`` trainings.
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
from bsk_torch.plan import Rollout
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

TRAININGS: dict[str, dict[str, Any]] = {
    "recipe": {},
    "memory": dict(network="gru"),
    "observed": dict(options=dict(observed=True)),
}
"""Settings that differ from those of the published policy: none, a memory, and faults that are observed."""

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


def make_env(episodes: int, options: argparse.Namespace, observed: bool = False) -> SatelliteTasking:
    """Return the environment in which policies are compared; the first of many episodes are those of few."""
    env = bsk_torch.make(PRESET, num_envs=episodes, observed=observed, time_limit=options.time_limit, backend=options.backend)
    assert isinstance(env, SatelliteTasking)
    return env


def train(name: str, seed: int, options: argparse.Namespace, folder: Path) -> Any:
    """Return a policy."""
    settings = dict(TRAININGS[name])
    world = dict(time_limit=options.time_limit, backend=options.backend) | settings.pop("options", {})
    config = configure(
        PRESET, seed=seed, num_envs=options.num_envs, frames=options.frames, seconds=None, options=world, **settings
    )
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


def planners(env: SatelliteTasking, futures: int) -> dict[str, TensorDictModuleBase]:
    """Return planners over the best rule, by what they know."""
    found = {"planner, all faults known": Rollout(env, BEST, horizon=HORIZON, gamma=1.0, rows=2048)}
    if futures:
        found["planner, past faults known"] = Rollout(env, BEST, horizon=HORIZON, gamma=1.0, futures=futures, rows=2048)
    return found


def main() -> None:
    """Train, compare, and print a table."""
    parsed = harness.parser(
        __doc__, frames=1_000_000, seeds=3, episodes=1024, planned=128, futures=4, num_envs=1024, time_limit=28_500.0
    )
    parsed.add_argument("--trainings", nargs="*", choices=TRAININGS, default=list(TRAININGS), metavar="NAME")
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
        for name in options.trainings:
            judged = make_env(options.episodes, options, observed=name == "observed")
            for seed in range(options.seeds):
                policy = train(name, seed, options, Path(folder) / f"{name}-{seed}")
                compare(f"trained, {name}, seed {seed}", policy, judged)
    if options.planned:
        few = make_env(options.planned, options)
        compare(BEST, rule(BEST, few), few)
        for name, policy in planners(few, options.futures).items():
            compare(name, policy, few)
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    main()
