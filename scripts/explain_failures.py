"""Why a policy's satellites die, and whether any policy could have saved them.

    python scripts/explain_failures.py rule --seeds 0:2000
    python scripts/explain_failures.py runs/best --seeds 0:2000 --out failures.json

Every episode in which the satellite dies is searched for actions that survive it, from its start and from as late a decision as
possible; what is called lost is proven to be. See :mod:`bsk_torch.rl.failures`.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import logging
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.table import Table
from tensordict.nn import TensorDictModuleBase

from bsk_torch.env import SatelliteTasking
from bsk_torch.presets import make
from bsk_torch.rl.baselines import BASELINES
from bsk_torch.rl.failures import Failure, Moment, can_be_saved, explain
from bsk_torch.rl.policies import build_policy, check_fits, read_card
from bsk_torch.rl.replay import Flown
from bsk_torch.rl.rescue import LOST, OPEN, SAVED
from bsk_torch.rl.statistics import confidence
from bsk_torch.sim.params import nearest

PRESET = "NadirScan-v1"


def seed_range(text: str) -> torch.Tensor:
    """Seeds of ``first:end``."""
    first, colon, end = text.partition(":")
    if not colon or not first.isdigit() or not end.isdigit() or int(first) >= int(end):
        raise argparse.ArgumentTypeError(f"{text!r} must be first:end, such as 0:2000")
    return torch.arange(int(first), int(end))


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description="Why a policy's satellites die, and whether any policy could have saved them.")
    parser.add_argument("policy", help=f"folder of a training, or file, or one of {', '.join(BASELINES)}")
    parser.add_argument("--seeds", type=seed_range, default="0:2000", help="episodes: the first of each of these seeds")
    parser.add_argument("--starts", type=seed_range, help="also: can these episodes be survived, whatever the policy does?")
    parser.add_argument("--num-envs", type=int, default=1024, help="episodes, or states of a search, at once")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, help="JSON file for the results")
    return parser.parse_args()


def build(name: str, num_envs: int) -> tuple[TensorDictModuleBase, SatelliteTasking]:
    """A policy, and its environment."""
    if name in BASELINES:
        env = make(PRESET, num_envs=num_envs, env_ids=[0] * num_envs)
        return BASELINES[name](env, 0), env
    card = read_card(name)
    env = make(card["preset"], num_envs=num_envs, env_ids=[0] * num_envs, **card["options"])
    check_fits(card, env, card["preset"])
    return build_policy(card), env


def summary(flown: Flown, failures: list[Failure]) -> dict[str, Any]:
    """Figures of all episodes."""
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


def starts(env: SatelliteTasking, seeds: torch.Tensor) -> dict[str, Any]:
    """How many episodes a plan survives; where that is all of them, the 95 % bound (Clopper-Pearson) on how often none does."""
    saved, n = int(can_be_saved(env, seeds).sum()), len(seeds)
    figures: dict[str, Any] = {"seeds": [int(seeds[0]), int(seeds[-1]) + 1], "survived": saved}
    return figures | ({"lost_at_most": float(f"{1.0 - 0.05 ** (1.0 / n):.2g}")} if saved == n else {})


def statistics(moments: list[Moment]) -> dict[str, Any]:
    """Least, median and largest value of the moments' numbers, and how often each action was chosen; empty for none."""
    if not moments:
        return {}
    numbers = {name: torch.tensor([getattr(moment, name) for moment in moments]) for name in ("charge", "wheel_rpm", "dark")}
    ranges = {name: [round(float(f()), 4) for f in (v.min, v.median, v.max)] for name, v in numbers.items()}
    return {**ranges, "actions": dict(Counter(moment.action for moment in moments))}


COLUMNS = (
    "seed",
    "cause",
    "died, s",
    "outcome",
    "last chance, s",
    "action then",
    "charge",
    "wheels, rpm",
    "dark, s",
    "lost after",
)


def table(failures: list[Failure]) -> Table:
    """A line for every failure: when it could last be saved, and how many decisions later that is proven to be over."""
    drawn = Table(*COLUMNS, box=None, header_style="")
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


def main() -> None:
    """Explain, print, write."""
    options = arguments()
    torch.set_num_threads(options.threads)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    console = Console(width=None if sys.stdout.isatty() else 140)
    try:
        policy, env = build(options.policy, options.num_envs)
    except (FileNotFoundError, KeyError, ValueError) as error:
        raise SystemExit(f"explain_failures: {error}; {nearest(options.policy, BASELINES)}") from None
    begin = time.perf_counter()
    flown, failures = explain(policy, env, options.seeds)
    figures = summary(flown, failures)
    if options.starts is not None:
        figures["starts"] = starts(env, options.starts)
    if failures:
        console.print(table(failures))
    console.print_json(json.dumps(figures))
    if options.out:
        seeds = [int(options.seeds[0]), int(options.seeds[-1]) + 1]
        seconds = round(time.perf_counter() - begin, 1)
        write(options.out, {"policy": Path(options.policy).name, "seeds": seeds, **figures, "seconds": seconds}, failures)


def write(path: Path, figures: dict[str, Any], failures: list[Failure]) -> None:
    """Figures line by line, then a line for every failure."""
    lines = [f"{json.dumps(name)}: {json.dumps(value)}" for name, value in figures.items()]
    told = ",\n  ".join(json.dumps(dataclasses.asdict(failure)) for failure in failures)
    path.write_text("{\n " + ",\n ".join([*lines, f'"failures": [\n  {told}\n ]']) + "\n}\n")


if __name__ == "__main__":
    main()
