"""Comparison of policies with random actions and rules in the same unseen episodes."""

from __future__ import annotations

from collections.abc import Mapping

from bsk_torch.env import Tasking
from bsk_torch.rl.evaluation.evaluate import FRESH, Evaluation, evaluate
from bsk_torch.rl.policies.shared_policy import shared_baselines
from bsk_torch.wrappers.policies import Actor


def compare(policies: Mapping[str, Actor], env: Tasking, seed: int) -> dict[str, Evaluation]:
    """Evaluate policies trained with ``seed``, and every applicable baseline, in the same unseen episodes.

    Args:
        policies: Policies by name; see :func:`~bsk_torch.rl.evaluation.evaluate.evaluate`.
        env: The environment, which plays one episode in each row.
        seed: Seed of the training; evaluation uses the episodes of ``seed`` + :data:`FRESH`.

    Returns:
        Results by name, the given policies first.
    """
    players = {**policies, **shared_baselines(env, seed)}
    return {name: evaluate(player, env, seed=seed + FRESH) for name, player in players.items()}


def comparison_table(results: Mapping[str, Evaluation]) -> str:
    """Return a Markdown table of returns with 95 % confidence intervals, survival and mean counts.

    The table lists the gain of the first policy over each of the others in the same episodes.
    """
    first = next(iter(results.values()))
    counted = list(first.counts)
    columns = ["policy", "return", "gain of the first", "survival", *counted]
    lines = [_line(columns), _line(["---"] * len(columns))]
    for name, result in results.items():
        gain = "-" if result is first else str(first.gain_over(result))
        counts = [f"{float(result.counts[count].double().mean()):.1f}" for count in counted]
        lines.append(_line([name, str(result.mean_return), gain, f"{result.survival:.1%}", *counts]))
    return "\n".join(lines)


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"
