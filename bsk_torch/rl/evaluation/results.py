"""Results of evaluations in the same unseen episodes: tables on the screen and in Markdown, JSON and CSV files."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import torch

from bsk_torch.env import Tasking
from bsk_torch.files import write_file
from bsk_torch.own_objects import name_of
from bsk_torch.rl.evaluation.evaluate import FRESH, Evaluation, evaluate
from bsk_torch.rl.evaluation.statistics import mean, nan_confidence
from bsk_torch.rl.policies.shared_policy import shared_baselines
from bsk_torch.tables import print_table
from bsk_torch.wrappers.policies import Actor

TRAINED = "trained"
"""Name of the trained policy of a run or file."""

EVALUATION = "evaluation.json"
"""File of a run folder with the results of the final comparison."""

INTERVAL = "95 % interval"
"""Column with the confidence interval of the survival, which stands before it."""


class Comparison(dict[str, Evaluation]):
    """Results by name of several policies in the same episodes; printed, :func:`comparison_table`."""

    def __str__(self) -> str:
        return comparison_table(self) if self else "no results"


def compare(
    policies: Mapping[str, Actor] | Sequence[Actor],
    env: Tasking,
    seed: int = 0,
    *,
    seeds: Sequence[int] | None = None,
    rules: bool = True,
) -> Comparison:
    """Evaluate policies in the same episodes, by default unseen ones, and every rule that applies.

    Printed, the result is a table with paired differences from the first policy and 95 % confidence intervals.

    Args:
        policies: Policies by name, or a list; see :func:`~bsk_torch.rl.evaluation.evaluate.evaluate` for what they may be.
        env: The environment, which plays one episode in each row, unless ``seeds`` are given.
        seed: Seed of the training; evaluation uses the episodes of ``seed`` + :data:`FRESH`, which training does not see.
        seeds: Seeds of the episodes instead.
        rules: Whether to add the rules of the package that apply, and random actions.

    Returns:
        Results by name, the given policies first.

    Raises:
        TypeError: For what is not a policy, or a list of them.
        ValueError: See :func:`~bsk_torch.rl.evaluation.evaluate.evaluate`.
    """
    if isinstance(policies, str) or not isinstance(policies, Mapping | Sequence):
        raise TypeError(f"policies={policies!r:.80} must be a list of policies, or a dictionary of them by name")
    named = policies if isinstance(policies, Mapping) else _named(policies)
    players = {
        **named,
        **{name: rule for name, rule in (shared_baselines(env, seed) if rules else {}).items() if name not in named},
    }
    episodes = {"seed": seed + FRESH} if seeds is None else {"seeds": seeds}
    return Comparison({name: evaluate(player, env, **episodes) for name, player in players.items()})


def _named(policies: Sequence[Actor]) -> dict[str, Actor]:
    """Return policies by their names, numbered where several have the same."""
    names: list[str] = []
    for policy in policies:
        base = str(policy) if isinstance(policy, str | Path) else name_of(policy)
        names.append(
            base if base not in names else next(n for k in range(2, len(names) + 3) if (n := f"{base} {k}") not in names)
        )
    return dict(zip(names, policies, strict=True))


def comparison_table(results: Mapping[str, Evaluation]) -> str:
    """Return a Markdown table of returns with 95 % confidence intervals, survival and mean counts.

    The table lists the gain of the first policy over each of the others in the same episodes.
    """
    first = next(iter(results.values()))
    counters = list(first.counts)
    columns = ["policy", "return", "gain of the first", "survival", *counters]
    lines = [columns, ["---"] * len(columns)]
    for name, result in results.items():
        gain = "-" if result is first else str(first.gain_over(result))
        counts = [f"{float(result.counts[count].double().mean()):.1f}" for count in counters]
        lines.append([name, str(result.mean_return), gain, f"{result.survival:.1%}", *counts])
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def print_results(results: Mapping[str, Evaluation], title: str, chosen: str | None = None) -> None:
    """Print a table of all results: the paired gain of the ``chosen`` policy over the others, and causes of death, if any."""
    mortal = any(result.causes for result in results.values())
    plans = any(result.simulated is not None for result in results.values())
    rows = {name: {"return": str(result.mean_return)} for name, result in results.items()}
    for name, row in rows.items():
        if chosen is not None:
            gain = results[chosen].gain_over(results[name])
            row[f"gain of {chosen}"] = "" if name == chosen else f"{gain.mean:+.3f} ± {gain.half_width:.3f}"
        row |= _row(results[name], mortal)
        if plans:
            simulated = results[name].simulated_per_decision
            row["simulated s / decision"] = "" if simulated is None else f"{simulated:,.0f}"
    counts = dict.fromkeys(name for result in results.values() for name in result.counts)
    expendable = (INTERVAL, "decisions", "simulated s / decision", "fill", "collected", *reversed(counts), "deaths")
    print_table([{"policy": name} | row for name, row in rows.items()], title, expendable, left=("policy",))


def _row(result: Evaluation, mortal: bool) -> dict[str, str]:
    low, high = result.survival_interval
    row = {"survival": f"{result.survival:.1%}", INTERVAL: f"{100.0 * low:.1f}–{high:.1%}"}
    row |= {"collected": f"{mean(result.collected):.3f}"} if mortal else {}
    row |= {} if result.fill is None else {"fill": f"{mean(result.fill):.0%}"}
    row |= {"decisions": f"{mean(result.decisions):.0f}"} | {name: f"{mean(n):.1f}" for name, n in result.counts.items()}
    row |= {name: f"{nan_confidence(value).mean:,.4g}" for name, value in result.measures.items()}
    deaths = ", ".join(f"{n} {cause.removesuffix('_valid')}" for cause, n in result.causes.items())
    return row | ({"deaths": deaths or "none"} if mortal else {})


def save_results(results: Mapping[str, Evaluation], path: Path, chosen: str) -> None:
    """Write the :meth:`Evaluation.summary` of every policy, with the paired gain of the ``chosen`` one over the others."""
    baselines = {name: result for name, result in results.items() if name != chosen}
    summaries = {name: result.summary(baselines if name == chosen else None) for name, result in results.items()}
    write_file(path, json.dumps(summaries, indent=2) + "\n")


def save_episodes(results: Mapping[str, Evaluation], seeds: Sequence[int], path: Path) -> None:
    """Write a line of CSV for every episode of every policy."""
    plans = any(result.simulated is not None for result in results.values())
    lines = [{"policy": name} | line for name, result in results.items() for line in _episodes(result, seeds, plans)]
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(lines[0]))
    writer.writeheader()
    writer.writerows(lines)
    write_file(path, text.getvalue())


def _episodes(result: Evaluation, seeds: Sequence[int], plans: bool) -> Iterator[dict[str, object]]:
    """Yield the results of each episode, by name; with what planners have simulated, s, if any of the policies ``plans``."""
    columns = {"return": result.returns, "collected": result.collected, "survived": result.survived.int()}
    columns |= {"decisions": result.decisions, "seconds": result.seconds}
    columns |= {} if result.fill is None else {"fill": result.fill}
    if plans:
        columns["simulated"] = torch.zeros_like(result.returns) if result.simulated is None else result.simulated
    lists = {name: column.tolist() for name, column in (columns | result.counts | result.measures).items()}
    failed = {name: column.tolist() for name, column in result.deaths.items()}
    for k, seed in enumerate(seeds):
        causes = " ".join(name for name, column in failed.items() if column[k])
        yield {"seed": seed} | {name: column[k] for name, column in lists.items()} | {"deaths": causes}
