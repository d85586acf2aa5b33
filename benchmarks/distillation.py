"""Search, then distil: what share of a planner's gain does a network keep, and in what time?

Usage:
    python benchmarks/distillation.py [--presets AEOS-v1 NadirScan-v1] [--seeds 3] [--episodes 64] [--evaluate 64]
        [--epochs 12] [--rate 0.0005] [--limit 0] [--out FILE.json]

The tasks are those of ``return_vs_computation.py``. The planner, rollout over the network of the package, plays ``--episodes``
new episodes for each seed. A network, at first that of the package, learns the planner's actions by cross entropy: the actions
of one seed, and those of all seeds together. Gains over the network of the package are paired by episode, in unseen episodes
that are the same for all.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import harness
import torch
from expert_iteration import MINIBATCH, logits
from return_vs_computation import CASES, Line, environment, policy_of
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.env import Tasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.rl.evaluation import Estimate, Evaluation, evaluate
from bsk_torch.rl.evaluation.evaluate import start_episodes
from bsk_torch.rl.evaluation.statistics import confidence
from bsk_torch.rl.policies.files import build_policy, read_card
from bsk_torch.rl.policies.pretrained import pretrained_file
from bsk_torch.rl.training.loss import log_probabilities, log_probability

UNSEEN, LESSONS = 910_000_000, 1_000_000
"""First seed of the episodes that compare policies, and the number of seeds in which the planner plays for each training."""

TEACHERS = {"AEOS-v1": dict(budget=8), "NadirScan-v1": dict(horizon=600.0)}
"""Sizes of the planner: the least that gains about as much as larger ones in ``return_vs_computation.py``."""

COLUMNS = {
    "task": "{task}",
    "policy": "{policy}",
    "decisions": "{decisions:,}",
    "return": "{value:.3f} +- {half:.3f}",
    "gain over the network": "{gain:+.3f} +- {gain_half:.3f}",
    "share of the planner's": "{share:.0%} +- {share_half:.0%}",
    "collection, core-s": "{collecting:.0f}",
    "training, core-s": "{training:.0f}",
}


class Lesson(NamedTuple):
    """Decisions of the planner, what was observed with ``action``, and the CPU seconds that they took."""

    decisions: TensorDictBase
    seconds: float


@torch.no_grad()
def collected(teacher: TensorDictModuleBase, env: Tasking, first: int) -> Lesson:
    """Return the decisions of a planner in the episodes of the seeds ``first`` and following, one in each row of ``env``."""
    begin, parts = time.process_time(), []
    for playing, step in play_episodes(env, teacher, start_episodes(env, range(first, first + env.num_envs))):
        parts.append(step.select("observation", "action_mask", "action")[playing])
    return Lesson(torch.cat(parts), time.process_time() - begin)


def learn(policy: TensorDictModuleBase, decisions: TensorDictBase, epochs: int, rate: float, seed: int) -> float:
    """Train a policy on actions, in place, and return the CPU seconds."""
    begin, draws = time.process_time(), torch.Generator().manual_seed(seed)
    optimizer = torch.optim.Adam(policy.parameters(), lr=rate)
    for _ in range(epochs):
        for part in torch.randperm(len(decisions), generator=draws).split(MINIBATCH):
            sample = decisions[part].clone()
            table = log_probabilities(logits(policy, sample), sample["action_mask"])
            loss = -log_probability(table, sample["action"]).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    return time.process_time() - begin


def share(gain: Tensor, whole: Tensor) -> Estimate:
    """Return mean(gain) / mean(whole) of paired gains [n], with its 95 % interval by the delta method."""
    ratio = float(gain.mean() / whole.mean())
    return Estimate(ratio, confidence(gain - ratio * whole).half_width / abs(float(whole.mean())))


class Comparison:
    """What policies gain in the unseen episodes of a task."""

    def __init__(self, task: str, env: Tasking, network: TensorDictModuleBase, teacher: TensorDictModuleBase) -> None:
        """Play the network of the package and the planner."""
        self.task, self.env = task, env
        self.network, self.teacher = self.played(network), self.played(teacher)

    @torch.no_grad()
    def played(self, policy: TensorDictModuleBase) -> Evaluation:
        """Return the unseen episodes of a policy."""
        return evaluate(policy, self.env, seeds=range(UNSEEN, UNSEEN + self.env.num_envs))

    def row(self, name: str, found: Evaluation, **more: Any) -> dict[str, Any]:
        """Return the figures of a policy."""
        value, gain = found.mean_return, found.gain_over(self.network)
        part = share(found.returns - self.network.returns, self.teacher.returns - self.network.returns)
        figures = dict(value=value.mean, half=value.half_width, gain=gain.mean, gain_half=gain.half_width)
        return dict(task=self.task, policy=name, **figures, share=part.mean, share_half=part.half_width) | more


def compare(task: str, options: Any, done: Callable[[dict[str, Any]], None]) -> None:
    """Collect, train and play in a task, and hand each row to ``done``."""
    case, card = CASES[task], read_card(pretrained_file(CASES[task].preset))
    line = Line("planner", "rollout", "trained", ())

    def planned(env: Tasking) -> TensorDictModuleBase:
        return policy_of(env, case, line, TEACHERS[task])

    unseen = environment(case, options.evaluate, options.limit)
    compared = Comparison(task, unseen, build_policy(card), planned(unseen))
    done(compared.row("network", compared.network))
    done(compared.row("planner", compared.teacher))
    lessons = environment(case, options.episodes, options.limit)
    teacher = planned(lessons)
    heard = [collected(teacher, lessons, (seed + 1) * LESSONS) for seed in range(options.seeds)]
    together = torch.cat([lesson.decisions for lesson in heard])
    for seed, lesson in enumerate(heard):
        for name, decisions, seconds in (
            (f"student, seed {seed}", lesson.decisions, lesson.seconds),
            (f"student of all, seed {seed}", together, sum(each.seconds for each in heard)),
        ):
            student = build_policy(card)
            training = learn(student, decisions, options.epochs, options.rate, seed)
            figures = dict(decisions=len(decisions), collecting=seconds, training=training)
            done(compared.row(name, compared.played(student), **figures))


def main() -> None:
    """Distil, compare, and print a table."""
    parsed = harness.parser(__doc__, presets=list(TEACHERS), seeds=3, episodes=64, evaluate=64, epochs=12, rate=5e-4, limit=0.0)
    options, described = harness.begin(parsed)
    rows: list[dict[str, Any]] = []

    def done(row: dict[str, Any]) -> None:
        rows.append(row)
        print(harness.cell("{task}, {policy}: gain {gain:+.3f} +- {gain_half:.3f}, {share:.0%}", row), flush=True)
        harness.write(options, described, teachers=TEACHERS, rows=rows)

    for task in options.presets:
        compare(task, options, done)
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    main()
