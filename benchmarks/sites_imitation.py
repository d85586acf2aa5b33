"""What share of a planner's gain over the rule does a network keep in Sites-v1 when it imitates the planner?

Usage:
    python benchmarks/sites_imitation.py [--gain convex] [--risk 0] [--futures 0] [--seeds 0 1 2 3 4] [--rounds 3]
        [--episodes 128] [--evaluate 256] [--horizon 180] [--tried 8] [--hidden 64 64] [--epochs 12] [--temperature 0.1]
        [--rate 0.001] [--time-limit 2850] [--runs FOLDER] [--out FILE.json]

The planner is that of ``sites.py``: in copies of the episode, it tries the actions that the rule *commit* prefers, each followed
by the rule. In the first round it plays new episodes, in the others the network plays and the planner judges each decision (Ross
et al. 2011, arXiv:1011.0686). After each round, an attention network learns from the decisions of all rounds the probabilities
proportional to exp(value / temperature). Gains over the rule are paired, in the fresh episodes of ``sites.py``. With ``--runs``,
policies are saved as ``FOLDER/seed_K``, for all commands that take one.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import harness
import torch
from expert_iteration import learn
from sites import FIRST, GAMMA, environment, play, row
from sites import figures as figures_of
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

import bsk_torch
from bsk_torch import SatelliteTasking
from bsk_torch.env.rollout import ACTION_VALUE, play_episodes
from bsk_torch.lab.planners import ActionValues
from bsk_torch.presets.aeos import ORBIT
from bsk_torch.rl.evaluation.evaluate import start_episodes
from bsk_torch.rl.networks.plans import AttentionPlan
from bsk_torch.rl.policies.files import POLICY, save_policy

LESSONS, ROUND = 8_000_000, 1_000
"""First seed of the episodes in which networks learn, and the number of seeds of a round; each training has the next rounds."""

COLUMNS = {
    "entrant": "{entrant}",
    "decisions": "{decisions:,}",
    "return": "{return:.2f} ± {half:.2f}",
    "episodes": "{episodes}",
    "minus the rule": "{gain:+.2f} ± {gain_half:.2f}",
    "share of the way": "{share:+.3f} ± {share_half:.3f}",
    "core-seconds of the training": "{training:.0f}",
}


@torch.no_grad()
def judged(env: SatelliteTasking, judge: ActionValues, student: TensorDictModuleBase | None, seeds: range) -> TensorDictBase:
    """Return the decisions of ``student``, or of the planner, in the episodes of ``seeds``, with the ``value`` of each action."""

    def act(td: TensorDictBase) -> TensorDictBase:
        td = judge(td)
        if student is not None:
            return td.set("action", student(td.select(*student.in_keys))["action"])
        value = td[ACTION_VALUE][:, 0]
        best = value.nan_to_num(nan=-torch.inf).argmax(1)
        return td.set("action", torch.where(value.isnan().all(1), td["action"], best))

    parts = []
    for playing, step in play_episodes(env, act, start_episodes(env, seeds)):
        value = step[ACTION_VALUE][:, 0]
        choosing = playing & ((~value.isnan()).sum(1) > 1)
        parts.append(step.select("observation", "action_mask")[choosing].set("value", value[choosing]))
    return torch.cat(parts)


def train(options: argparse.Namespace, seed: int) -> tuple[TensorDictModuleBase, int]:
    """Return a policy that imitates the planner, and the number of decisions that it has learned from."""
    torch.manual_seed(seed)
    env = environment(options, options.episodes, as_set=True)
    assert isinstance(env, SatelliteTasking)
    judge = ActionValues(
        env,
        bsk_torch.rule("commit", env),
        horizon=options.horizon,
        gamma=GAMMA,
        budget=options.tried,
        futures=options.futures or None,
    )
    plan, draws = AttentionPlan.of(env, options.hidden), torch.Generator().manual_seed(seed)
    networks, lessons = plan.build(), []
    for turn in range(options.rounds):
        first = LESSONS + (seed * options.rounds + turn) * ROUND
        lesson = judged(env, judge, networks.policy if turn else None, range(first, first + options.episodes))
        networks.normaliser.update(lesson)
        lessons.append(lesson)
        learn(networks.policy, torch.cat(lessons), options.temperature, options.epochs, options.rate, draws, last=0.05)
    if options.runs is not None:
        folder = options.runs / f"seed_{seed}"
        folder.mkdir(parents=True, exist_ok=True)
        task = {"as_set": True, "gain": options.gain, "risk": options.risk, "time_limit": options.time_limit}
        save_policy(folder / POLICY, plan, networks, options.preset, task)
    return networks.policy, sum(map(len, lessons))


def main() -> None:
    """Train, compare, and print a table."""
    parsed = harness.parser(
        __doc__, preset="Sites-v1", gain="convex", risk=0.0, futures=0, seeds=[0, 1, 2, 3, 4], rounds=3, episodes=128,
        evaluate=256, horizon=180.0, tried=8, hidden=[64, 64], epochs=12, temperature=0.1, rate=1e-3, time_limit=ORBIT / 2,
    )  # fmt: skip
    parsed.add_argument("--runs", type=Path, metavar="FOLDER", help="folder for the policies")
    options, described = harness.begin(parsed)
    unseen = environment(options, options.evaluate, as_set=True)
    rule, chance = (play(bsk_torch.rule(name, unseen), unseen, FIRST)[0] for name in ("commit", "random"))
    rows: list[dict[str, Any]] = []
    for seed in options.seeds:
        clock = time.process_time()
        policy, decisions = train(options, seed)
        spent = time.process_time() - clock
        with torch.no_grad():
            result = row(*play(policy, unseen, FIRST), rule, chance)
        rows.append(figures_of(f"imitation, seed {seed}", result) | {"decisions": decisions, "training": spent})
        print(harness.table(COLUMNS, rows[-1:]), flush=True)
        harness.write(options, described, rows=rows)
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    main()
