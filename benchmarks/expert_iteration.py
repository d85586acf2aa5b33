"""Does training on audited decisions help a policy of the package?

Usage:
    python benchmarks/expert_iteration.py [--preset AEOS-v1] [--seeds 3] [--rounds 1] [--episodes 256] [--evaluate 256]
        [--time-limit 2850] [--horizon 240] [--gamma 0.99] [--budget 8] [--temperature 0.02] [--planned 32]
        [--out FILE.json]

In each round, the policy plays new episodes, and at each decision the actions that it prefers are flown in branches which
follow it (``bsk_torch.lab.planners.ActionValues``). The policy then learns from the decisions of all rounds the probabilities
proportional to exp(value / temperature). The mean regret is the best value minus that of the chosen action. Gains over the
policy of the package are paired by episode, in unseen episodes that are the same for all; the planner that takes the best
action plays the first ones.
"""

from __future__ import annotations

import copy
import time
from typing import Any, NamedTuple

import harness
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

import bsk_torch
from bsk_torch import SatelliteTasking
from bsk_torch.env.rollout import ACTION_VALUE, play_episodes
from bsk_torch.lab.planners import ActionValues, Rollout
from bsk_torch.rl.evaluation.evaluate import Evaluation, evaluate, start_episodes
from bsk_torch.rl.evaluation.statistics import confidence
from bsk_torch.rl.policies.files import build_policy, read_card
from bsk_torch.rl.policies.pretrained import pretrained_file
from bsk_torch.rl.training.loss import log_probabilities

UNSEEN, LESSONS = 900_000_000, 1_000_000
"""First seed of the episodes that compare policies, and the number of seeds in which each training plays its own."""

MINIBATCH = 512

COLUMNS = {
    "policy": "{policy}",
    "return": "{return:.2f} +- {half:.2f}",
    "gain": "{gain:+.2f} +- {gain_half:.2f}",
    "regret": "{regret:.4f}",
    "decisions": "{decisions}",
    "core-seconds": "{cpu:.0f}",
    "episodes": "{episodes}",
}


class Lesson(NamedTuple):
    """Audited decisions: what the policy observed, with the values of actions at ``value``, and the mean regret."""

    decisions: TensorDictBase
    regret: float


@torch.no_grad()
def audited(policy: TensorDictModuleBase, env: SatelliteTasking, seeds: range, **search: Any) -> Lesson:
    """Return the decisions of a policy in the episodes of ``seeds`` at which several actions have values."""
    judge = ActionValues(env, policy, **search)
    parts = []
    for playing, step in play_episodes(env, judge, start_episodes(env, seeds)):
        value = step[ACTION_VALUE][:, 0]
        choosing = playing & ((~value.isnan()).sum(1) > 1)
        parts.append(step.select("observation", "action_mask", "action")[choosing].set("value", value[choosing]))
    decisions = torch.cat(parts)
    value = decisions["value"]
    chosen = value.gather(1, decisions["action"].view(-1, 1)).squeeze(1)
    return Lesson(decisions, float((value.nan_to_num(nan=-torch.inf).amax(1) - chosen).mean()))


def learn(
    policy: TensorDictModuleBase,
    decisions: TensorDictBase,
    temperature: float,
    epochs: int,
    rate: float,
    draws: torch.Generator,
    last: float = 1.0,
) -> None:
    """Train a policy on the values of actions, in place; the learning ``rate`` falls to a part ``last`` of it."""
    optimizer = torch.optim.Adam(policy.parameters(), lr=rate)
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, last, epochs)
    for _ in range(epochs):
        for part in torch.randperm(len(decisions), generator=draws).split(MINIBATCH):
            sample = decisions[part].clone()
            value = sample["value"].float()
            taught = (value / temperature).masked_fill(value.isnan(), -torch.inf).softmax(1)
            loss = -(taught * log_probabilities(logits(policy, sample), sample["action_mask"])).sum(1).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        schedule.step()


def logits(policy: TensorDictModuleBase, sample: TensorDictBase) -> Tensor:
    """Return the logits [M, A] of a policy, a normalizer followed by an actor."""
    normaliser, actor = policy
    return actor[0](normaliser(sample))["logits"]


def row(name: str, found: Evaluation, base: Evaluation, cpu: float, **more: Any) -> dict[str, Any]:
    """Figures of a policy next to the policy of the package in the same episodes."""
    mean, gain = found.mean_return, confidence(found.returns - base.returns[: len(found.returns)])
    return {
        "policy": name,
        "return": mean.mean,
        "half": mean.half_width,
        "gain": gain.mean,
        "gain_half": gain.half_width,
        "cpu": cpu,
        "episodes": len(found.returns),
    } | more


def main() -> None:
    """Train, compare, and print a table."""
    parsed = harness.parser(
        __doc__,
        preset="AEOS-v1",
        seeds=3,
        rounds=1,
        episodes=256,
        evaluate=256,
        time_limit=2850.0,
        horizon=240.0,
        gamma=0.99,
        budget=8,
        temperature=0.02,
        epochs=12,
        rate=5e-4,
        planned=32,
    )
    parsed.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    options, described = harness.begin(parsed)
    card = read_card(pretrained_file(options.preset))
    search = {"horizon": options.horizon, "gamma": options.gamma, "budget": options.budget}
    rows: list[dict[str, Any]] = []

    def env(count: int) -> SatelliteTasking:
        fixed = {"time_limit": options.time_limit, "backend": options.backend}
        made = bsk_torch.make(options.preset, num_envs=count, env_ids=[0] * count, **(card["options"] | fixed))
        assert isinstance(made, SatelliteTasking)
        return made

    def played(policy: TensorDictModuleBase, env: SatelliteTasking) -> Evaluation:
        with torch.no_grad():
            return evaluate(policy, env, seeds=range(UNSEEN, UNSEEN + env.num_envs))

    def tell(name: str, found: Evaluation, cpu: float, **more: Any) -> None:
        rows.append(row(name, found, base, cpu, **more))
        print(harness.cell("{policy}: {return:.2f}, gain {gain:+.2f} +- {gain_half:.2f}", rows[-1]), flush=True)
        harness.write(options, described, rows=rows)

    unseen, lessons = env(options.evaluate), env(options.episodes)
    base = played(build_policy(card), unseen)
    tell("of the package", base, 0.0)
    for seed in range(options.seeds):
        policy, clock = build_policy(card), time.process_time()
        draws, heard = torch.Generator().manual_seed(seed), []
        for turn in range(options.rounds):
            first = (seed + 1) * LESSONS + turn * options.episodes
            lesson = audited(copy.deepcopy(policy), lessons, range(first, first + options.episodes), **search)
            heard.append(lesson.decisions)
            learn(policy, torch.cat(heard), options.temperature, options.epochs, options.rate, draws)
            cpu = time.process_time() - clock
            name = f"audited, seed {seed}, round {turn + 1}"
            decisions = sum(len(part) for part in heard)
            tell(name, played(policy, unseen), cpu, regret=lesson.regret, decisions=decisions)
    if options.planned:
        planner, clock = env(options.planned), time.process_time()
        tell("planner", played(Rollout(planner, build_policy(card), **search), planner), time.process_time() - clock)
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    main()
