"""What do rules and policies reach in AEOS-Bench, and how much is there to be gained?

Usage:
    python benchmarks/aeos_bench.py [--folder FOLDER] [--cases 32] [--batch 32] [--rules nearest_task soonest_task]
        [--policies FILE ...] [--satellites 1 50] [--tasks 50 300] [--orbits random] [--step 10] [--seed 1000] [--out FILE.json]

All fly the same cases: those of a folder with the benchmark's files, or random ones with the distributions of its training set,
``--orbits random``, or of its test set, ``--orbits real``.
``nearest_task`` is the benchmark's greedy rule, with its actions in every second and sensors always on; the others choose among
candidates, every ``--step`` seconds, and ``soonest_task@3,0.5`` every 3 s, with ``haste=0.5``. Measures are means over the cases,
with intervals of 95 percent; gains are those of CR over ``nearest_task``, and of rules over the rule before, of policies over the
last rule, paired by case. The bound is the share of tasks that satellites have above their horizons long enough.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import harness
import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

import bsk_torch
from bsk_torch import ConstellationTasking
from bsk_torch.rl.policies.files import policy_of_file, read_card
from bsk_torch.rl.policies.shared_policy import rule, shared
from bsk_torch.tasks.aeos_bench import read_cases
from bsk_torch.tasks.aeos_bench.bound import sight_bound

PRESET = "AEOSBench-v1"

GREEDY = "nearest_task"
"""The benchmark's rule, over which gains are."""

OF_TRAINING = ("candidates", "as_set", "step_duration", "until_done")
"""Options of their training with which policies fly."""

PERCENT = 100.0

COLUMNS = {
    "policy": "{policy}",
    "CR %": "{CR:.1f} +- {half:.1f}",
    "gain": "{gain:+.1f} +- {gain_half:.1f}",
    "over the last rule": "{over:+.2f} +- {over_half:.2f}",
    "PCR %": "{PCR:.1f}",
    "WCR %": "{WCR:.1f}",
    "TAT s": "{TAT:.0f}",
    "PC W s": "{PC:,.0f}",
    "CS": "{CS:.2f}",
    "cases": "{cases}",
    "core-seconds per case": "{cpu:.1f}",
}


def make_env(options: argparse.Namespace, batch: int, **preset: Any) -> ConstellationTasking:
    """Return an environment of the cases."""
    if options.folder:
        cases: dict[str, Any] = {"folder": options.folder, "order": "listed"}
    else:
        cases = {"satellites": tuple(options.satellites), "tasks": tuple(options.tasks), "orbits": options.orbits}
    world = dict(num_envs=batch, seed=0, time_limit=options.time_limit, backend=options.backend)
    env = bsk_torch.make(PRESET, **world, **cases, **preset)
    assert isinstance(env, ConstellationTasking)
    return env


def fly(env: ConstellationTasking, policy: TensorDictModuleBase | None, options: argparse.Namespace) -> dict[str, Tensor]:
    """Fly all cases, and return the measures of each; without a policy, the bound."""
    parts: list[dict[str, Tensor]] = []
    (batch,) = env.batch_size
    for first in range(0, options.cases, batch):
        env.set_seed(first if options.folder else options.seed + first)
        td = env.reset()
        if policy is None:
            parts.append({"CR": sight_bound(env)})
            continue
        while not bool(td["done"].all()):
            td = env.step(policy(td))["next"]
        parts.append(env.rewarder.measures())
    return {name: torch.cat([part[name] for part in parts])[: options.cases] for name in parts[0]}


def half_width(values: Tensor) -> float:
    """Half of the interval of 95 percent of a mean."""
    return 1.96 * float(values.std() / len(values) ** 0.5)


def row(name: str, found: dict[str, Tensor], greedy: Tensor, last: Tensor, cpu: float) -> dict[str, Any]:
    """Figures of a policy; ``greedy`` and ``last`` are the completion rates of two rules in the same cases."""
    rate, gain, over = PERCENT * found["CR"], PERCENT * (found["CR"] - greedy), PERCENT * (found["CR"] - last)
    means = {key: float(value.nanmean()) for key, value in found.items()}
    return {
        "policy": name,
        **means,
        **{key: PERCENT * means[key] for key in ("CR", "PCR", "WCR", "WPCR") if key in means},
        "half": half_width(rate),
        "gain": float(gain.mean()),
        "gain_half": half_width(gain),
        "over": float(over.mean()),
        "over_half": half_width(over),
        "cases": len(rate),
        "cpu": cpu / len(rate),
    }


def main() -> None:
    """Fly the cases, and print a table."""
    rules = [GREEDY, "soonest_task"]
    parsed = harness.parser(__doc__, folder="", cases=32, batch=32, rules=rules, step=10.0, seed=1000, time_limit=3600.0)
    parsed.add_argument("--policies", nargs="*", default=[], metavar="FILE", help="policies of bsk-torch train")
    for name, usual in (("satellites", (1, 50)), ("tasks", (50, 300))):
        parsed.add_argument(f"--{name}", nargs=2, type=int, default=usual, help="smallest and largest number in a random case")
    parsed.add_argument("--orbits", choices=("random", "real"), default="random", help="orbits of random cases")
    parsed.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    options, described = harness.begin(parsed)
    if options.folder:
        options.cases = min(options.cases, len(read_cases(options.folder)))
    batch, names = min(options.batch, options.cases), [GREEDY, *(name for name in options.rules if name != GREEDY)]
    rows: list[dict[str, Any]] = []
    rates: list[Tensor] = []

    def compare(name: str, policy: TensorDictModuleBase | None, env: ConstellationTasking) -> None:
        clock = time.process_time()
        with torch.no_grad():
            found = fly(env, policy, options)
        rates.append(found["CR"])
        last = rates[max(min(len(rates) - 1, len(names)) - 1, 0)]
        blank = dict.fromkeys(("PCR", "WCR", "TAT", "PC", "CS"), float("nan"))
        rows.append(blank | row(name, found, rates[0], last, time.process_time() - clock))
        print(harness.cell("{policy}: CR {CR:.1f} %, gain {gain:+.1f} +- {gain_half:.1f}", rows[-1]), flush=True)
        harness.write(options, described, rows=rows)

    every = make_env(options, batch, sensor="on")
    compare(GREEDY, rule(GREEDY, every), every)
    for name in names[1:]:
        plain, _, given = name.partition("@")
        step, haste = (float(part) for part in given.split(",")) if given else (options.step, 1.0)
        chosen = make_env(options, batch, candidates=True, step_duration=step, haste=haste)
        compare(name, rule(plain, chosen), chosen)
    for k, file in enumerate(options.policies):
        given = read_card(file)["options"]
        env = make_env(options, batch, **{key: given[key] for key in OF_TRAINING if key in given})
        compare(f"trained, seed {k}", shared(policy_of_file(file), env), env)
    compare("bound", None, every)
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    main()
