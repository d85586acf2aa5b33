"""Schedules by mixed-integer programs beside rules, trained policies, planners and bounds, in AEOS-v1 with few and many targets.

Usage:
    python benchmarks/milp.py [--targets 100 1000 3000 10000] [--episodes 16] [--seconds 30] [--iterations 30] [--seed 1000003]
        [--time-limit 17100] [--budget 8] [--figure FILE.png] [--out FILE.json]

Each schedule is made at the beginning of the episode, with learned times between images, and flown in closed loop; behind its
end the rule "hasty" acts. ``--seconds`` bounds HiGHS for each episode. The planner tries ``--budget`` actions of the trained
policy for every decision, in copies of the episode. Gains are paired: mean differences to "hasty" in the same episodes. Seconds
are CPU seconds of one core for each episode: of planning, and of all decisions in flight, those of copies included, the episode
left out.
"""

from __future__ import annotations

import itertools
import time
from pathlib import Path
from typing import Any

import harness
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

import bsk_torch
from bsk_torch.lab.bounds import ScheduledPolicy, imaging_bound, milp_schedule, relaxed_schedule
from bsk_torch.lab.planners import planner
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.evaluation.statistics import confidence
from bsk_torch.rl.policies import pretrained
from bsk_torch.rl.rules.baselines import BASELINES

AHEAD = dict(horizon=240.0, gamma=0.99)
"""How far the planner looks ahead, s, and its discount per second: those of ``benchmarks/planners.py``."""

COLUMNS = {
    "targets": "{targets:,}",
    "policy": "{policy}",
    "return": "{value:.1f} +- {half:.1f}",
    "gain over hasty": "{gain:+.2f} +- {gain_half:.2f}",
    "share of the bound": "{share:.1%}",
    "s for each episode": "{seconds:.3g}",
}


class Timed(TensorDictModuleBase):
    """A policy whose decisions are timed, CPU s in ``seconds``."""

    def __init__(self, policy: Any) -> None:
        """Wrap ``policy``."""
        super().__init__()
        self.policy, self.seconds = policy, 0.0
        self.in_keys, self.out_keys = policy.in_keys, policy.out_keys

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Decide as the policy does."""
        begin = time.process_time()
        tensordict = self.policy(tensordict)
        self.seconds += time.process_time() - begin
        return tensordict


def row(targets: int, policy: str, returns: Tensor, rule: Tensor, upper: Tensor, seconds: float) -> dict[str, Any]:
    """Figures of ``returns`` beside those of ``rule`` and the bounds ``upper`` of the same episodes, all [N]."""
    value, gain = confidence(returns), confidence(returns - rule)
    figures = dict(value=value.mean, half=value.half_width, gain=gain.mean, gain_half=gain.half_width)
    share = dict(share=float(returns.sum() / upper.sum()), seconds=seconds / len(returns))
    return dict(targets=targets, policy=policy) | figures | share


def rows_of(options: Any, targets: int) -> list[dict[str, Any]]:
    """Fly all policies in the same episodes."""
    world = dict(n_targets=targets, num_envs=options.episodes, time_limit=options.time_limit, backend=options.backend)
    env, sets = bsk_torch.make("AEOS-v1", **world), bsk_torch.make("AEOS-v1", **world, as_set=True)
    env.set_seed(options.seed)
    env.reset()
    clock = [time.process_time()]
    bound = imaging_bound(env, iterations=options.iterations)
    clock.append(time.process_time())
    relaxed = relaxed_schedule(env, iterations=options.iterations)
    clock.append(time.process_time())
    programs = milp_schedule(env, seconds=options.seconds)
    clock.append(time.process_time())
    seconds = [later - sooner for sooner, later in itertools.pairwise(clock)]
    hasty: Any = BASELINES["hasty"](env, 0)
    trained = pretrained("AEOS-v1")
    players: list[tuple[str, Any, Any, float]] = [
        ("hasty", env, hasty, 0.0),
        ("nearest", env, BASELINES["nearest"](env, 0), 0.0),
        ("trained", sets, trained, 0.0),
        ("rollout over trained", sets, planner("rollout", sets, base=trained, budget=options.budget, **AHEAD), 0.0),
        ("multipliers, flown", env, ScheduledPolicy(env, relaxed, hasty), seconds[1]),
        ("MILP, flown", env, ScheduledPolicy(env, programs, hasty), seconds[2]),
    ]
    rows: list[dict[str, Any]] = []
    returns: dict[str, Tensor] = {}
    for name, where, policy, planning in players:
        timed = Timed(policy)
        returns[name] = evaluate(timed, where, seed=options.seed).returns
        rows.append(row(targets, name, returns[name], returns["hasty"], bound.upper, planning + timed.seconds))
        print(harness.cell("{targets} {policy}: {value:.1f}, {share:.1%}", rows[-1]), flush=True)
    return [*rows, row(targets, "bound", bound.upper, returns["hasty"], bound.upper, seconds[0])]


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the share of the bound over the number of targets, a line for each policy."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7.0, 4.0), layout="constrained")
    for name in dict.fromkeys(row["policy"] for row in rows if row["policy"] != "bound"):
        mine = [row for row in rows if row["policy"] == name]
        axes.plot([row["targets"] for row in mine], [100.0 * row["share"] for row in mine], marker="o", label=name)
    axes.set(xscale="log", xlabel="targets", ylabel="return, % of the bound")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Plan, fly, and print a table."""
    arguments = harness.parser(
        __doc__,
        targets=[100, 1000, 3000, 10_000],
        episodes=16,
        seconds=30.0,
        iterations=30,
        seed=1_000_003,
        time_limit=17_100.0,
        budget=8,
        backend="compiled",
        figure="",
    )
    options, described = harness.begin(arguments)
    rows = harness.Rows(options, described, (row for targets in options.targets for row in rows_of(options, targets)))
    print(harness.table(COLUMNS, rows))
    if options.figure:
        draw(rows, Path(options.figure))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
