"""Probabilities of rare events by subset simulation or screened sampling, next to those of independent episodes.

Usage:
    python benchmarks/risk.py [--questions NAME ...] [--method subset] [--pool 1000000] [--episodes 500] [--repetitions 8]
        [--plain 20000] [--num-envs 1000] [--time-limit S] [--out FILE.json]

The questions are in :data:`QUESTIONS`. A textbook case comes first: the sum of ten standard normal numbers over the square root
of ten exceeds the quantiles of 1e-3 and 1e-6. It is repeated with other seeds, to count the intervals that contain the true
probability. Screened sampling does not see the last term, which stands for noise.
Independent episodes are those of seeds that no estimate draws; their intervals are Wilson's.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from statistics import NormalDist
from typing import Any

import harness
import torch
from tensordict import TensorDict
from torch import Tensor

import bsk_torch
from bsk_torch.env import Tasking
from bsk_torch.lab.planners.base_policies import Base, base_of
from bsk_torch.lab.risk.estimate import METHODS, SUBSET, Risk, interval, learned_from, risk
from bsk_torch.lab.risk.rare_events import rare_event
from bsk_torch.lab.risk.rare_flights import Flights
from bsk_torch.lab.risk.screened import ScreenedSampling
from bsk_torch.lab.risk.subset import SubsetSimulation, Tally
from bsk_torch.rand import Key
from bsk_torch.rl.evaluation.statistics import wilson
from bsk_torch.rl.policies.pretrained import pretrained_file

TERMS = 10
"""Number of terms of the textbook case."""

FRESH = 2**55
"""Seed of the first independent episode; estimates draw seeds below 2**53."""

SHOWN = 6
"""Number of drawn quantities in the file."""


@dataclass(frozen=True)
class Question:
    """An event under a policy of a preset; ``plain``: whether independent episodes are flown as well."""

    preset: str
    policy: str
    event: str = "death"
    plain: bool = True
    options: dict[str, Any] = field(default_factory=dict)


ORBIT = 5700.0
"""Length of an orbit, s."""

QUESTIONS = {
    "scan": Question("NadirScan-v1", "pretrained"),
    "faults": Question("FaultyScan-v1", "pretrained"),
    "orbit": Question("NadirScan-v1", "pretrained", options={"time_limit": ORBIT}),
    "cautious": Question("NadirScan-v1", "cautious", plain=False, options={"time_limit": ORBIT}),
    "low": Question("NadirScan-v1", "pretrained", "battery_charge_fraction<0.12", options={"time_limit": ORBIT}),
    "half_hour": Question("NadirScan-v1", "pretrained", "battery_charge_fraction<0.1555", options={"time_limit": 1800.0}),
    "quarter": Question("NadirScan-v1", "pretrained", "battery_charge_fraction<0.208", options={"time_limit": 900.0}),
    "charge": Question("NadirScan-v1", "rule", "battery_charge_fraction<0.02", plain=False, options={"time_limit": ORBIT}),
}
"""Questions by name."""

COLUMNS = {
    "question": "{name}",
    "estimate": "{mean:.2e} ({low:.1e} to {high:.1e})",
    "episodes": "{episodes}",
    "independent": "{plain_mean:.2e} ({plain_low:.1e} to {plain_high:.1e})",
    "episodes, independent": "{plain_episodes}",
    "simulated time saved": "{saved:.1f}",
    "core-seconds": "{cpu:.0f}",
}


def terms(seeds: Tensor, count: int = TERMS) -> Tensor:
    """Return the first terms of the textbook case, [m, count]."""
    none = torch.zeros_like(seeds)
    return torch.cat([Key(seeds, none, none, f"term {k}").normal(1) for k in range(count)], 1)


def known(probability: float, options: Any, seed: int) -> tuple[Tensor, Tally]:
    """Return estimates [R] of a known probability, and their cost."""
    limit = NormalDist().inv_cdf(1.0 - probability)

    def fly(seeds: Tensor) -> TensorDict:
        total = terms(seeds).sum(1) / TERMS**0.5
        level = torch.where(total > limit, torch.inf, total)
        return TensorDict({"level": level, "seconds": torch.ones_like(total)}, total.shape)

    if options.method == SUBSET:
        simulation = SubsetSimulation(fly, options.episodes, seed)
        stages = simulation.climb(0.1 * probability).stages
        return simulation.repeat(stages, options.repetitions).estimates, simulation.tally
    learned = learned_from(options.episodes, options.repetitions)
    sampling = ScreenedSampling(fly, lambda seeds: terms(seeds, TERMS - 1), options.episodes, options.pool, learned, limit, seed)
    return sampling.repeat(sampling.learn(), options.repetitions).estimates, sampling.tally


def textbook(probability: float, options: Any) -> dict[str, Any]:
    """Return estimates of a known probability, and the share of intervals that contain it."""
    estimates, inside, flown, runs = [], 0, 0, options.runs
    for seed in range(runs):
        found, tally = known(probability, options, seed)
        low, high = interval(found)[1:]
        inside += low <= probability <= high
        flown += tally.episodes
        estimates.append(found)
    table = torch.stack(estimates)
    mean, of_one = float(table.mean()), float(table.std()) / probability
    return {
        "probability": probability,
        "runs": runs,
        "mean": mean,
        "standard_error": float(table.mean(1).std()) / runs**0.5 if runs > 1 else None,
        "relative_error_of_one_repetition": of_one,
        "intervals_with_the_truth": inside,
        "episodes": flown / runs,
        "saved": (1.0 - probability) / (probability * of_one**2 / options.repetitions) / (flown / runs),
    }


def asked(question: Question, options: Any) -> tuple[Risk, dict[str, Any]]:
    """Return the answer to a question, and its figures."""
    given = question.options | ({} if options.time_limit is None else {"time_limit": options.time_limit})
    env: Tasking = bsk_torch.make(question.preset, num_envs=options.num_envs, env_ids=[0] * options.num_envs, **given)
    policy: Base = pretrained_file(question.preset) if question.policy == "pretrained" else question.policy
    clock = time.process_time()
    shared = {name: getattr(options, name) for name in ("method", "pool", "episodes", "repetitions", "seed")}
    found = risk(env, policy, event=question.event, **shared)
    figures: dict[str, Any] = {"question": asdict(question) | {"options": given}, "cpu": time.process_time() - clock}
    figures |= found.to_dict()
    figures["shifts"] = figures["shifts"][:SHOWN]
    if question.plain and options.plain:
        figures["plain"] = independent(env, policy, question, options.plain)
    return found, figures


def independent(env: Tasking, policy: Base, question: Question, episodes: int) -> dict[str, Any]:
    """Return the share of independent episodes with the event."""
    env.reset()
    clock = time.process_time()
    flown = Flights(env, base_of(policy, env), rare_event(env, question.event, None))(torch.arange(episodes) + FRESH)
    seen = int((flown["level"] == torch.inf).sum())
    low, high = wilson(seen, episodes)
    return {
        "episodes": episodes,
        "seen": seen,
        "mean": seen / episodes,
        "low": low,
        "high": high,
        "seconds": float(flown["seconds"].sum()),
        "cpu": time.process_time() - clock,
    }


def row(name: str, figures: dict[str, Any]) -> dict[str, Any]:
    """Return the cells of a question."""
    plain = figures.get("plain", {})
    return {
        "name": name,
        **figures["probability"],
        "episodes": figures["episodes"],
        **({} if figures["saved"] is None else {"saved": figures["saved"]}),
        "cpu": figures["cpu"],
        **{f"plain_{key}": value for key, value in plain.items()},
    }


def main() -> None:
    """Ask all questions, and print a table."""
    parsed = harness.parser(__doc__, episodes=500, repetitions=8, plain=20_000, num_envs=1000, runs=16, seed=0, pool=1_000_000)
    parsed.add_argument("--questions", nargs="*", choices=QUESTIONS, default=list(QUESTIONS))
    parsed.add_argument("--method", choices=METHODS, default=SUBSET)
    parsed.add_argument("--probabilities", nargs="*", type=float, default=[1e-3, 1e-6], help="those of the textbook case")
    parsed.add_argument("--time-limit", type=float, help="length of an episode, s, instead of the preset's")
    options, described = harness.begin(parsed)
    found: dict[str, Any] = {}
    cases = [textbook(p, options) for p in options.probabilities] if options.runs else []
    for case in cases:
        print(
            f"textbook case: {case['mean']:.3e} for {case['probability']:.0e}, {case['intervals_with_the_truth']} of "
            f"{case['runs']} intervals contain it, simulated time saved {case['saved']:.1f}",
            flush=True,
        )
    for name in options.questions:
        _, found[name] = asked(QUESTIONS[name], options)
        print(harness.table(COLUMNS, [row(name, found[name])]), flush=True)
        harness.write(options, described, textbook=cases, questions=found)
    print(harness.table(COLUMNS, [row(name, figures) for name, figures in found.items()]))
    harness.write(options, described, textbook=cases, questions=found)


if __name__ == "__main__":
    main()
