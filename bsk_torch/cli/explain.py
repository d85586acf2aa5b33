"""``bsk-torch explain``: why a policy's satellites die, and whether any policy could have saved them."""

from __future__ import annotations

import dataclasses
import json
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import torch
import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from bsk_torch.cli.policies import named_policy
from bsk_torch.cli.results import WIDE
from bsk_torch.cli.shared import (
    Backend,
    Device,
    Threads,
    TimeLimit,
    check_writable,
    console,
    environment_options,
    fail,
    seed_range,
)
from bsk_torch.env import SatelliteTasking
from bsk_torch.files import write_file
from bsk_torch.rl.evaluation.counterfactual import LOST, OPEN, SAVED, check_searchable
from bsk_torch.rl.evaluation.failures import Failure, Moment, can_be_saved, explain
from bsk_torch.rl.evaluation.replay import Flown
from bsk_torch.rl.evaluation.statistics import confidence
from bsk_torch.rl.rules.baselines import BASELINES

COLUMNS = ("seed", "cause", "died, s", "outcome", "last chance, s", "action then", "charge", "wheels, rpm", "dark, s")
"""Columns of the table but the last, :data:`PROVEN`."""

PROVEN = "lost after"
"""Number of decisions from the last chance to the first that is proven to be too late."""


def explain_failures(
    policy: Annotated[
        str, typer.Argument(help=f"Folder of a training run, its policy.pt, 'pretrained', or a baseline: {', '.join(BASELINES)}.")
    ],
    preset: Annotated[str | None, typer.Option(help="Environment; that of the run unless given.")] = None,
    seeds: Annotated[str, typer.Option(help="'A:B' for the episodes of seeds A to B - 1, or a single seed.")] = "0:2000",
    starts: Annotated[
        str | None,
        typer.Option(help="Seeds of episodes to be tested for actions that survive them, whatever the policy."),
    ] = None,
    num_envs: Annotated[int, typer.Option(min=1, help="Episodes, or states of a search, at once.")] = 1024,
    out: Annotated[Path | None, typer.Option(help="JSON file for the results.")] = None,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Search every episode in which the satellite dies for actions that survive it, and prove which ones have none.

    The search goes from the start of the episode and from as late a decision as possible. An episode is called lost only if that
    is proven.
    """
    torch.set_num_threads(threads)
    episodes, begun = seed_range(seeds), None if starts is None else seed_range(starts, "--starts")
    check_writable(out)
    named = named_policy(policy, preset)
    env = named.environment(num_envs, environment_options(backend, device, time_limit))
    if not isinstance(env, SatelliteTasking):
        fail(f"{named.preset} has many satellites; failures are explained of one")
    actor = named.build(env, device)
    begin = time.perf_counter()
    try:
        check_searchable(env)
        with console.status(f"flying {len(episodes)} episodes"):
            flown, failures = explain(actor, env, torch.tensor(episodes))
            figures = summary(flown, failures) | ({} if begun is None else {"starts": survivable(env, begun)})
    except ValueError as error:
        fail(f"failures in {named.preset} cannot be explained: {error}")
    screen = Console(width=WIDE)
    if failures:
        screen.print(table(failures))
    screen.print_json(json.dumps(figures))
    if out is not None:
        about = {"policy": Path(policy).name, "seeds": [episodes.start, episodes.stop]}
        save(out, about | figures | {"seconds": round(time.perf_counter() - begin, 1)}, failures)


def summary(flown: Flown, failures: Sequence[Failure]) -> dict[str, Any]:
    """Return figures of all episodes: returns, deaths by cause and outcome, and bounds on the survival of the best policy."""
    outcomes, n = Counter(failure.outcome for failure in failures), len(flown.survived)
    returns = confidence(flown.returns)
    return {
        "episodes": n,
        "return": {"mean": round(returns.mean, 4), "half_width": round(returns.half_width, 4)},
        "died": len(failures),
        "causes": dict(Counter(failure.cause for failure in failures)),
        **{outcome: outcomes[outcome] for outcome in (SAVED, LOST, OPEN)},
        "survival": 1.0 - len(failures) / n,
        "survival_of_the_best": {"at_least": 1.0 - (outcomes[LOST] + outcomes[OPEN]) / n, "at_most": 1.0 - outcomes[LOST] / n},
        "starts_of_the_lost": statistics([failure.start for failure in failures if failure.outcome == LOST]),
        "last_chances": statistics([failure.last_chance for failure in failures if failure.last_chance]),
    }


def survivable(env: SatelliteTasking, seeds: range) -> dict[str, Any]:
    """Return how many episodes a plan survives.

    If that is all n of them, ``lost_at_most`` is the 95 % bound of Clopper and Pearson, 1 - 0.05^(1/n), on how often none does.
    """
    saved, n = int(can_be_saved(env, torch.tensor(seeds)).sum()), len(seeds)
    figures: dict[str, Any] = {"seeds": [seeds.start, seeds.stop], "survived": saved}
    return figures | ({"lost_at_most": float(f"{1.0 - 0.05 ** (1.0 / n):.2g}")} if saved == n else {})


def statistics(moments: Sequence[Moment]) -> dict[str, Any]:
    """Return the least, median and largest value of the moments' numbers, and how often each action was chosen."""
    if not moments:
        return {}
    numbers = {
        name: torch.tensor([getattr(moment, name) for moment in moments], dtype=torch.float64)
        for name in ("charge", "wheel_rpm", "dark")
    }
    ranges = {name: [round(float(f()), 4) for f in (v.min, v.median, v.max)] for name, v in numbers.items()}
    return {**ranges, "actions": dict(Counter(moment.action for moment in moments))}


def table(failures: Sequence[Failure]) -> Table:
    """Return a line for each failure: its last chance, and the number of decisions after which it is proven to be lost."""
    drawn = Table(*COLUMNS, PROVEN, box=SIMPLE_HEAD, pad_edge=False)
    for failure in failures:
        then = failure.last_chance or failure.start
        drawn.add_row(
            f"{failure.seed}",
            failure.cause.replace("_valid", ""),
            f"{failure.died:.0f}",
            failure.outcome,
            f"{then.time:.0f}" if failure.last_chance else "none",
            then.action.removeprefix("action_"),
            f"{then.charge:.1%}",
            f"{then.wheel_rpm:.0f}",
            f"{then.dark:.0f}",
            f"{failure.lost_from - then.decision}",
        )
    return drawn


def save(path: Path, figures: dict[str, Any], failures: Sequence[Failure]) -> None:
    """Write figures line by line, then a line for each failure."""
    lines = [f"{json.dumps(name)}: {json.dumps(value)}" for name, value in figures.items()]
    listed = ",\n  ".join(json.dumps(dataclasses.asdict(failure)) for failure in failures)
    write_file(path, "{\n " + ",\n ".join([*lines, f'"failures": [\n  {listed}\n ]']) + "\n}\n")
