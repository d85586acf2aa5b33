"""What planners gain over their base rule and over trained policies, and what they take: the same fresh episodes for all.

Usage:
    python benchmarks/planners.py [--presets AEOS-v1 AEOSPower-v1 NadirScan-v1] [--episodes 16] [--first 2000000]
        [--time-limit 0] [--budget 24] [--out FILE.json]

The episodes of the presets are shorter than theirs, see ``CASES``, unless ``--time-limit`` is not 0. Wall time is that of the
whole batch over its episodes, of one thread.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import harness
from tensordict.nn import TensorDictModuleBase

import bsk_torch
from bsk_torch.env import Tasking
from bsk_torch.lab.planners import planner
from bsk_torch.rl.evaluation import Estimate, Evaluation, evaluate
from bsk_torch.rl.policies import pretrained, pretrained_file, read_card
from bsk_torch.rl.policies.shared_policy import shared


class Case(NamedTuple):
    """A preset: its best rule, the length of episodes, s, how far planners look ahead, s, and their discount per second."""

    rule: str
    limit: float
    horizon: float
    gamma: float


CASES = {
    "AEOS-v1": Case("hasty", 2850.0, 240.0, 0.99),
    "AEOSPower-v1": Case("hasty", 2850.0, 360.0, 0.99),
    "NadirScan-v1": Case("rule", 5700.0, 2000.0, 1.0),
}

COLUMNS = {
    "preset": "{preset}",
    "policy": "{policy}",
    "return": "{value:.3f} +- {half:.3f}",
    "gain over the rule": "{gain:+.3f} +- {gain_half:.3f}",
    "of it": "{relative:+.1%}",
    "decisions": "{decisions:.0f}",
    "simulated s per decision": "{simulated:,.0f}",
    "wall s per episode": "{wall:.2f}",
    "decisions per CPU-second": "{rate:,.0f}",
}


def policies(env: Tasking, preset: str, budget: int) -> dict[str, TensorDictModuleBase]:
    """The rule, the trained policy, and planners with these as their base."""
    case, trained = CASES[preset], shared(pretrained(preset), env)
    options: dict[str, Any] = {"horizon": case.horizon, "gamma": case.gamma}
    return {
        case.rule: bsk_torch.rule(case.rule, env),
        "trained": trained,
        f"rollout over {case.rule}": planner("rollout", env, base=case.rule, budget=min(budget, 8), **options),
        "rollout over trained": planner("rollout", env, base=trained, budget=min(budget, 8), **options),
        f"beam over {case.rule}": planner("beam", env, base=case.rule, budget=budget, **options),
        f"mcts over {case.rule}": planner("mcts", env, base=case.rule, budget=budget, **options),
    }


def gains(gain: Estimate, rule: Evaluation) -> dict[str, float]:
    """A paired gain over the rule, and as a fraction of its return."""
    return {"gain": gain.mean, "gain_half": gain.half_width, "relative": gain.mean / rule.mean_return.mean}


def row(preset: str, name: str, found: Evaluation, rule: Evaluation, wall: float, cpu: float) -> dict[str, Any]:
    """Figures of one policy."""
    value = found.mean_return
    return {
        "preset": preset,
        "policy": name,
        "value": value.mean,
        "half": value.half_width,
        **({} if found is rule else gains(found.gain_over(rule), rule)),
        "survival": found.survival,
        "decisions": float(found.decisions.double().mean()),
        **({} if found.simulated is None else {"simulated": found.simulated_per_decision}),
        "wall": wall / len(found.returns),
        "rate": float(found.decisions.sum()) / cpu,
    }


def main() -> None:
    """Play and print a table."""
    arguments = harness.parser(__doc__, presets=list(CASES), episodes=16, first=2_000_000, time_limit=0.0, budget=24)
    options, described = harness.begin(arguments)
    rows, n = [], options.episodes
    for preset in options.presets:
        limit = options.time_limit or CASES[preset].limit
        world = read_card(pretrained_file(preset))["options"] | {"time_limit": limit, "env_ids": [0] * n}
        env = bsk_torch.make(preset, num_envs=n, **world)
        rule = None
        for name, policy in policies(env, preset, options.budget).items():
            clock, cpu = time.perf_counter(), time.process_time()
            found = evaluate(policy, env, seeds=range(options.first, options.first + n))
            rule = found if rule is None else rule
            rows.append(row(preset, name, found, rule, time.perf_counter() - clock, time.process_time() - cpu))
            print(harness.cell("{preset}, {policy}: {value:.3f}", rows[-1]), flush=True)
            harness.write(options, described, cases={name: case._asdict() for name, case in CASES.items()}, rows=rows)
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    main()
