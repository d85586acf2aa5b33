"""One episode of AEOS-v1 as a rule, the trained policy, a planner and the schedule of a mixed-integer program fly it.

Usage:
    python benchmarks/side_by_side.py [--targets 3000] [--time-limit 1900] [--seconds 60] [--budget 8] [--seed 2000000]
        [--figure FILE.png] [--out FILE.json]

``--seconds`` bounds HiGHS, ``--budget`` is the number of actions that the planner tries for each decision. The figure has a row
of images for each policy, darker for targets of higher priority, and the sum of priorities over time.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import harness
import torch
from torchrl.envs.utils import step_mdp

import bsk_torch
from bsk_torch.lab.bounds import ScheduledPolicy, imaging_bound, milp_schedule
from bsk_torch.lab.planners import planner
from bsk_torch.rl.policies import pretrained
from bsk_torch.rl.rules.baselines import BASELINES

COLUMNS = {
    "policy": "{policy}",
    "images": "{images}",
    "return": "{value:.2f}",
    "share of the bound": "{share:.1%}",
    "s of computation": "{seconds:.3g}",
}


def fly(env: Any, policy: Any, seed: int) -> tuple[list[tuple[float, float]], float]:
    """Return time, s, and priority of each image of an episode, and CPU seconds of all decisions."""
    env.set_seed(seed)
    td, now, images, seconds = env.reset(), 0.0, [], 0.0
    while True:
        begin = time.process_time()
        td = policy(td)
        seconds += time.process_time() - begin
        td = env.step(td)
        after = td["next"]
        now += float(after["duration"])
        if float(after["reward"]) > 0.0:
            images.append((now, float(after["reward"])))
        if bool(after["done"]):
            return images, seconds
        td = step_mdp(td)


def players(options: Any) -> tuple[dict[str, tuple[Any, Any, float]], float]:
    """Return environment, policy and CPU seconds of planning ahead by name; and the bound."""
    world = dict(n_targets=options.targets, num_envs=1, time_limit=options.time_limit, backend=options.backend)
    env, sets = bsk_torch.make("AEOS-v1", **world), bsk_torch.make("AEOS-v1", **world, as_set=True)
    hasty: Any = BASELINES["hasty"](env, 0)
    env.set_seed(options.seed)
    env.reset()
    begin = time.process_time()
    programs = ScheduledPolicy(env, milp_schedule(env, seconds=options.seconds), hasty)
    planning = time.process_time() - begin
    looking = planner("rollout", env, base="hasty", budget=options.budget, horizon=240.0, gamma=0.99)
    upper = float(imaging_bound(env).upper)
    return {
        "hasty": (env, hasty, 0.0),
        "trained": (sets, pretrained("AEOS-v1"), 0.0),
        "rollout over hasty": (env, looking, 0.0),
        "MILP, flown": (env, programs, planning),
    }, upper


def draw(flown: dict[str, list[tuple[float, float]]], path: Path) -> None:
    """Draw the images of all policies and what they are worth together."""
    from bsk_torch.viz.figures import style

    figure, (rows, sums) = style.panels([0.4 * len(flown) + 0.4, 3.0])
    for k, (name, images) in enumerate(flown.items()):
        color, times = style.PALETTE[k], [when for when, _ in images]
        for when, priority in images:
            rows.plot([when, when], [k - 0.35, k + 0.35], color=color, linewidth=1.6, alpha=0.15 + 0.85 * min(1.0, priority))
        worth = torch.tensor([priority for _, priority in images], dtype=torch.float64).cumsum(0).tolist()
        sums.step([0.0, *times], [0.0, *worth], where="post", color=color, label=name)
    rows.set_yticks(range(len(flown)), list(flown))
    rows.invert_yaxis()
    rows.grid(visible=False)
    style.label(sums, "sum of priorities")
    sums.legend(frameon=False)
    sums.set_xlabel("time, s")
    style.save(figure, path)


def main() -> None:
    """Fly all policies, and print a table."""
    parsed = harness.parser(
        __doc__, targets=3000, time_limit=1900.0, seconds=60.0, budget=8, seed=2_000_000, backend="compiled", figure=""
    )
    options, described = harness.begin(parsed)
    chosen, upper = players(options)
    flown, rows = {}, []
    for name, (env, policy, planning) in chosen.items():
        flown[name], seconds = fly(env, policy, options.seed)
        value = sum(priority for _, priority in flown[name])
        row = dict(policy=name, images=len(flown[name]), value=value, share=value / upper, seconds=planning + seconds)
        rows.append(row)
    print(harness.table(COLUMNS, rows))
    if options.figure:
        draw(flown, Path(options.figure))
    harness.write(options, described, rows=rows, bound=upper, images=flown)


if __name__ == "__main__":
    main()
