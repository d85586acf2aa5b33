"""Return against computation: what rules, networks, planners and schedules gain in the same episodes, over seconds per decision.

Usage:
    python benchmarks/return_vs_computation.py [--presets AEOS-v1 AEOSPower-v1 CloudyAEOS-v1 NadirScan-v1 RSOInspection-v1]
        [--lines rule MILP ...] [--episodes 64] [--least 4] [--core-seconds 120] [--timing-seconds 2] [--first 3000000]
        [--dearest 15] [--limit 0] [--minute 0] [--together 64] [--out FILE.json]
    python benchmarks/return_vs_computation.py --draw FILE.json ... --figure FILE.png

Seconds are CPU seconds of one core for one decision, in an environment of a single episode: what a computer that decides for
one satellite needs. Returns come from batches, on which decisions do not depend. A policy plays as many episodes, a power of
two between ``--least`` and ``--episodes``, as would take ``--core-seconds`` one after the other; gains are paired with the best
rule in the same episodes. Sizes of planners are tried in the order of their computation; behind the first one that needs more
than ``--dearest`` seconds for a decision, the others of its line are left out. The episodes of tasks are shorter than those of
their presets, see ``CASES``, or have ``--limit`` seconds. The rules were chosen in other episodes. ``--minute 1``
adds planners that need about a minute for a decision, see ``MINUTE``; other values multiply their budgets. At most ``--together``
episodes are simulated at a time, each of which needs as many copies as its planner has sequences and futures.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import harness
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

import bsk_torch
from bsk_torch.env import Tasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.lab.bounds import Schedule, ScheduledPolicy, milp_schedule, relaxed_schedule
from bsk_torch.lab.planners import planner
from bsk_torch.rl.evaluation import Evaluation, evaluate
from bsk_torch.rl.evaluation.evaluate import start_episodes
from bsk_torch.rl.evaluation.statistics import confidence
from bsk_torch.rl.policies import pretrained, pretrained_file, read_card
from bsk_torch.rl.policies.shared_policy import shared
from bsk_torch.viz.figures import style

MARKS = {0.01: "10 ms", 1.0: "1 s", 60.0: "60 s"}
"""Times of a decision that the figure marks, s."""

FEWEST = 3
"""Decisions that are timed at least."""


class Line(NamedTuple):
    """A method with several sizes, each of which is a point of its curve.

    Attributes:
        name: Title.
        method: A planner by its name, a function that schedules whole episodes, or None for the base.
        base: ``"rule"`` or ``"trained"``.
        sizes: Arguments of the method.
    """

    name: str
    method: str | Callable[..., Schedule] | None
    base: str
    sizes: tuple[dict[str, Any], ...]


class Case(NamedTuple):
    """A task: its preset and options, its best rule, arguments of all planners, and what is compared."""

    preset: str
    options: dict[str, Any]
    rule: str
    planning: dict[str, Any]
    lines: tuple[Line, ...]


Sizes = list[dict[str, Any]]


def searches(over_rule: Sizes, rollout: Sizes, beam: Sizes, mcts: Sizes) -> tuple[Line, ...]:
    """Return the lines that all tasks have: bases, and planners with the given sizes."""
    return (
        Line("rule", None, "rule", ({},)),
        Line("network", None, "trained", ({},)),
        Line("rollout over the rule", "rollout", "rule", tuple(over_rule)),
        Line("rollout over the network", "rollout", "trained", tuple(rollout)),
        Line("beam search", "beam", "trained", tuple(beam)),
        Line("tree search", "mcts", "trained", tuple(mcts)),
    )


IMAGING = searches(
    [dict(budget=n) for n in (8, 32)],
    [dict(budget=n) for n in (2, 8, 32)],
    [dict(budget=24), dict(budget=96, width=8), dict(budget=384, width=32, depth=4)],
    [dict(budget=12), dict(budget=48)],
)

SCHEDULES = (
    Line("MILP", milp_schedule, "rule", (dict(seconds=10.0),)),
    Line("multipliers", relaxed_schedule, "rule", (dict(iterations=3), dict(iterations=30))),
)

SCANNING = searches(
    [dict(horizon=2000.0), dict(horizon=6000.0)],
    [dict(horizon=600.0), dict(horizon=2000.0), dict(horizon=6000.0)],
    [dict(budget=12), dict(budget=48, depth=6)],
    [dict(budget=12)],
)

CASES = {
    "AEOS-v1": Case(
        "AEOS-v1",
        dict(n_targets=3000, time_limit=1900.0),
        "farsighted",
        dict(horizon=240.0, gamma=0.99),
        (*IMAGING, *SCHEDULES),
    ),
    "AEOSPower-v1": Case("AEOSPower-v1", dict(time_limit=2850.0), "farsighted", dict(horizon=360.0, gamma=0.99), IMAGING),
    "CloudyAEOS-v1": Case(
        "CloudyAEOS-v1",
        dict(time_limit=2850.0),
        "farsighted",
        dict(horizon=360.0, gamma=0.99, futures=4),
        IMAGING,
    ),
    "NadirScan-v1": Case("NadirScan-v1", dict(time_limit=5700.0), "rule", dict(horizon=6000.0, gamma=1.0), SCANNING),
    "RSOInspection-v1": Case(
        "RSOInspection-v1",
        dict(time_limit=11400.0),
        "survey",
        dict(horizon=11400.0, gamma=1.0),
        searches(
            [dict(budget=n) for n in (2, 8, 32)],
            [dict(budget=n) for n in (2, 8, 32)],
            [dict(budget=24), dict(budget=96, width=8)],
            [dict(budget=12), dict(budget=48)],
        ),
    ),
}

MINUTE = {
    "AEOS-v1": Line("tree search", "mcts", "trained", (dict(budget=6000),)),
    "AEOSPower-v1": Line("tree search", "mcts", "trained", (dict(budget=6000),)),
    "CloudyAEOS-v1": Line("tree search", "mcts", "trained", (dict(budget=7500),)),
    "NadirScan-v1": Line("tree search over the rule", "mcts", "rule", (dict(budget=4000),)),
    "RSOInspection-v1": Line("tree search over the rule", "mcts", "rule", (dict(budget=500),)),
}
"""Planners that need about a minute for a decision with many choices, on one slow core."""

COLUMNS = {
    "task": "{task}",
    "policy": "{policy}",
    "size": "{size}",
    "episodes": "{episodes}",
    "return": "{value:.3f} +- {half:.3f}",
    "gain over the rule": "{gain:+.3f} +- {gain_half:.3f}",
    "of it": "{relative:+.1%}",
    "CPU s per decision": "{seconds:.3g}",
    "longest": "{longest:.3g}",
    "simulated s": "{simulated:,.0f}",
}


class ScheduleFirst(TensorDictModuleBase):
    """Schedules whole episodes at their first decision, and flies the schedules."""

    def __init__(self, env: Tasking, schedule: Callable[..., Schedule], otherwise: Any, **options: Any) -> None:
        """Schedule with ``schedule(env, **options)``; behind its end, and far from the next window, ``otherwise`` decides."""
        super().__init__()
        self.env, self.schedule, self.otherwise, self.options = env, schedule, otherwise, options
        self.in_keys, self.out_keys = ["observation", "action_mask"], ["action"]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action``, [N]."""
        if not bool(self.env.fleet.ticks.any()):
            self.flown = ScheduledPolicy(self.env, self.schedule(self.env, **self.options), self.otherwise)
        return self.flown(tensordict)


def environment(case: Case, count: int, limit: float = 0.0) -> Tasking:
    """Return the environment of a task, its episodes as long as the case says or ``limit`` s."""
    options = read_card(pretrained_file(case.preset))["options"] | case.options | ({"time_limit": limit} if limit else {})
    return bsk_torch.make(case.preset, num_envs=count, env_ids=[0] * count, **options)


def policy_of(env: Tasking, case: Case, line: Line, size: dict[str, Any]) -> TensorDictModuleBase:
    """Return the policy of one point."""
    base = bsk_torch.rule(case.rule, env) if line.base == "rule" else shared(pretrained(case.preset), env)
    if line.method is None:
        return base
    if isinstance(line.method, str):
        return planner(line.method, env, base=base, **(case.planning | size))
    return ScheduleFirst(env, line.method, base, **size)


class Timing(NamedTuple):
    """CPU seconds of decisions: their mean, the longest one, and how many were timed."""

    seconds: float
    longest: float
    timed: int


def timed(policy: TensorDictModuleBase, env: Tasking, seed: int, seconds: float) -> Timing:
    """Time decisions in the single episode of ``env``, for ``seconds`` behind the first one and :data:`FEWEST` at least.

    Schedules are timed in a whole episode, over whose decisions their computation is spread. All others decide once before.
    """
    start, spent = start_episodes(env, [seed]), []
    scheduled = isinstance(policy, ScheduleFirst)
    if not scheduled:
        policy(start.clone())

    def decide(tensordict: TensorDictBase) -> TensorDictBase:
        begin = time.process_time()
        tensordict = policy(tensordict)
        spent.append(time.process_time() - begin)
        return tensordict

    for _ in play_episodes(env, decide, start):
        if not scheduled and sum(spent[1:]) > seconds and len(spent) >= FEWEST:
            break
    return Timing(sum(spent) / len(spent), max(spent), len(spent))


def affordable(options: Any, cost: float) -> int:
    """Return how many episodes to play where one takes ``cost`` CPU s: a power of two times ``--least``."""
    count = options.least
    while 2 * count <= options.episodes and 2 * count * cost <= options.core_seconds:
        count *= 2
    return count


class Flights:
    """The episodes of a task, in environments of as many rows as are simulated together."""

    def __init__(self, case: Case, options: Any) -> None:
        """Make no environment yet."""
        self.case, self.options = case, options
        self._made: dict[int, Tasking] = {}

    def env(self, count: int) -> Tasking:
        """Return the environment of ``count`` episodes."""
        if count not in self._made:
            self._made[count] = environment(self.case, count, self.options.limit)
        return self._made[count]

    @torch.no_grad()
    def played(self, make: Callable[[Tasking], TensorDictModuleBase], count: int) -> Evaluation:
        """Return the first ``count`` episodes of a policy."""
        env, first = self.env(min(count, self.options.together)), self.options.first
        return evaluate(make(env), env, seeds=range(first, first + count))


def row(task: str, line: Line, size: dict[str, Any], found: Evaluation, rule: Evaluation, timing: Timing) -> dict[str, Any]:
    """Figures of one point; ``rule`` has the same episodes at its beginning."""
    value = found.mean_return
    n = len(found.returns)
    gain = confidence(found.returns - rule.returns[:n])
    return {
        "task": task,
        "policy": line.name,
        "size": " ".join(f"{name}={given:g}" for name, given in size.items()),
        "episodes": n,
        "value": value.mean,
        "half": value.half_width,
        "gain": gain.mean,
        "gain_half": gain.half_width,
        "relative": gain.mean / float(rule.returns[:n].mean()),
        "relative_half": gain.half_width / float(rule.returns[:n].mean()),
        "survival": found.survival,
        "decisions": float(found.decisions.double().mean()),
        **timing._asdict(),
        **({} if found.simulated is None else {"simulated": found.simulated_per_decision}),
    }


def rows_of(task: str, options: Any, done: Callable[[dict[str, Any]], None]) -> None:
    """Time and play everything in a task, and hand each row to ``done``."""
    case = CASES[task]
    flights = Flights(case, options)
    rule = flights.played(partial(policy_of, case=case, line=case.lines[0], size={}), options.episodes)
    lines = [line for line in case.lines if not options.lines or line.name in options.lines]
    if options.minute:
        longest = MINUTE[task]
        lines.append(longest._replace(sizes=tuple(dict(budget=round(options.minute * size["budget"])) for size in longest.sizes)))
    for line in lines:
        for size in line.sizes:
            single = flights.env(1)
            timing = timed(policy_of(single, case, line, size), single, options.first, options.timing_seconds)
            count = affordable(options, timing.seconds * float(rule.decisions.double().mean()))
            begin = time.process_time()
            found = rule if line is case.lines[0] else flights.played(partial(policy_of, case=case, line=line, size=size), count)
            done(row(task, line, size, found, rule, timing) | {"core_seconds": time.process_time() - begin})
            if timing.seconds > options.dearest:
                break


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the gains over the seconds of a decision, a panel for each task and a line for each method."""
    tasks = list(dict.fromkeys(row["task"] for row in rows))
    names = list(dict.fromkeys(row["policy"] for row in rows if row["policy"] != "rule"))
    figure, axes = style.panels([1.5] * len(tasks), style.COLUMN)
    for panel, task in zip(axes, tasks, strict=True):
        for seconds in MARKS:
            panel.axvline(seconds, color=style.FAINT, linewidth=1.0)
        panel.axhline(0.0, color=style.INK, linewidth=0.8)
        for color, marker, name in zip(style.PALETTE, "os^Dv<>p", names, strict=False):
            mine = [row for row in rows if row["task"] == task and row["policy"] == name]
            x, y, half = ([row[key] for row in mine] for key in ("seconds", "relative", "relative_half"))
            panel.plot(x, [100.0 * value for value in y], color=color, marker=marker, markersize=5, linewidth=1.2)
            panel.vlines(x, *([100.0 * (a + s * b) for a, b in zip(y, half, strict=True)] for s in (-1.0, 1.0)), color=color)
        style.caption(panel, task)
        style.label(panel, "gain, %")
    axes[-1].set_xscale("log")
    axes[-1].set_xticks([1e-3, *MARKS], ["1 ms", *MARKS.values()])
    axes[-1].minorticks_off()
    axes[-1].set_xlabel("CPU time of a decision", color=style.INK, fontsize=9.5)
    style.fit(figure, style.COLUMN)
    handles = [style.dot(m, c, c, name) for c, m, name in zip(style.PALETTE, "os^Dv<>p", names, strict=False)]
    style.legend(figure, handles, style.COLUMN, columns=2)
    style.save(figure, path)


def main() -> None:
    """Time, play, and print a table."""
    arguments = harness.parser(
        __doc__,
        presets=list(CASES),
        episodes=64,
        least=4,
        core_seconds=120.0,
        timing_seconds=2.0,
        first=3_000_000,
        dearest=15.0,
        limit=0.0,
        minute=0.0,
        together=64,
    )
    names = list(dict.fromkeys(line.name for case in CASES.values() for line in case.lines))
    arguments.add_argument("--lines", nargs="+", choices=names, help="only these methods")
    arguments.add_argument("--draw", type=Path, nargs="+", metavar="FILE.json", help="draw these results, and play nothing")
    arguments.add_argument("--figure", type=Path, metavar="FILE.png", help="draw what was played, or --draw")
    options, described = harness.begin(arguments)
    rows: list[dict[str, Any]] = []

    def done(found: dict[str, Any]) -> None:
        rows.append(found)
        print(harness.cell("{task}, {policy} {size}: {gain:+.3f} +- {gain_half:.3f} in {seconds:.3g} s", found), flush=True)
        harness.write(options, described, rows=rows)

    for task in () if options.draw else options.presets:
        rows_of(task, options, done)
    for path in options.draw or ():
        rows += json.loads(path.read_text())["rows"]
    if options.figure:
        draw(rows, options.figure)
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    main()
