"""How much better than the best rule a policy or planner is, by candidate for a task of a suite.

Usage:
    python benchmarks/headroom.py [--candidates NAME ...] [--policies NAME ...] [--episodes 128] [--planned 32] [--draws 24]
        [--tuned 32] [--first 3900003] [--out FILE.json]

The share of head-room is (best - best rule) / (best - random), where the best is a policy or a planner: 0 where none is better
than the rules, 1 where the best rule is no better than random actions. A suite admits a candidate whose share is at least a fifth
and whose best policy gains significantly over the best rule, in episodes that are not those of the suite.

Rules are those of the package that fit, and one whose thresholds are tuned for the candidate: the best of ``--draws`` random ones
in ``--tuned`` further episodes, see :data:`TUNED`. ``--policies`` are named as for ``bsk-torch bench``: run folders, planners,
functions. Planners play the first ``--planned`` episodes, in which their gains and shares are. A candidate that is measured again
replaces its row of ``--out``.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import harness
import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch._listed import PREFIX
from bsk_torch.env import SatelliteTasking, Tasking
from bsk_torch.env.rollout import Policy
from bsk_torch.lab.commands.entrants import entrant_of
from bsk_torch.lab.suites.suite import EPISODES, VIEWS, Entrant, Task, play, tasks_of
from bsk_torch.rl.evaluation.evaluate import Evaluation
from bsk_torch.rl.evaluation.statistics import confidence
from bsk_torch.rl.policies.shared_policy import RULES, baseline_of_groups, shared
from bsk_torch.rl.rules.baselines import ScanRule, ScienceRule, scan_rule
from bsk_torch.rl.rules.imaging import ImagingRule, ranking_rule
from bsk_torch.rl.rules.targets import Observation, TargetReader
from bsk_torch.tasks.inspection.rules import inspection_rule

ADMITTED = 0.2
"""Least share of head-room of a task."""

RANDOM, TUNED_RULE = "random", "tuned"

APART = 500_000
"""Distance of the seeds of episodes in which rules are tuned from those in which they are compared."""

RESAMPLED = 2000
"""Resamples of the episodes for the interval of a share."""


def candidate(name: str, preset: str, at_once: int = 256, **options: Any) -> Task:
    """Return a candidate: a preset with other options. Policies of trainings with other ones may play it."""
    return Task(preset, 0, at_once, options=options, name=name, drawn=(*options, "time_limit"))


DIM = dict(panelArea=0.12)
SLOW_DOWNLINK = dict(transmitterBaudRate=-12 * 8e6)
ORBIT = 5700.0

EXPLORED = (
    candidate("scan", "NadirScan-v1", failure_penalty=0.0),
    candidate("dim_scan_0.12", "NadirScan-v1", sat_args=DIM, failure_penalty=0.0),
    candidate("dim_scan_0.15", "NadirScan-v1", sat_args=dict(panelArea=0.15), failure_penalty=0.0),
    candidate(
        "dim_scan_frugal",
        "NadirScan-v1",
        sat_args=DIM | dict(transmitterBaudRate=-20 * 8e6, basePowerDraw=-5.0),
        failure_penalty=0.0,
    ),
    candidate("small_store", "AEOSPower-v1", n_targets=5000, time_limit=ORBIT, sat_args=dict(dataStorageCapacity=20 * 8e6)),
    candidate("few_choices_5000", "AEOS-v1", n_targets=5000, n_ahead=4, time_limit=ORBIT / 2),
    candidate("faulty_scan", "FaultyScan-v1", failure_penalty=0.0),
    candidate("faulty_dim_scan", "FaultyScan-v1", sat_args=dict(panelArea=0.15) | SLOW_DOWNLINK, failure_penalty=0.0),
    candidate("science", "NadirScience-v1", failure_penalty=0.0),
    dataclasses.replace(candidate("services", "Services-v1"), views=(*VIEWS, "order", "outlook")),
    candidate("relay", "RelayConstellation-v1"),
    candidate("multi_inspection", "MultiInspection-v1", actions="waypoints"),
    candidate("docking", "CWDocking-v1"),
    candidate("thrust_inspection", "CWInspection-v1"),
    candidate("hetero", "HeteroCluster-v1"),
)
"""Candidates that are no task of the suite."""

IN_SUITE = tuple(dataclasses.replace(task, episodes=EPISODES) for task in tasks_of("v2"))
"""Tasks of the suite, with more episodes than there."""

CANDIDATES = {task.title: task for task in (*IN_SUITE, *EXPLORED)}
"""Candidates by name: the tasks of the suite, in other episodes, and those that are not in it."""


# -- tuned rules ----------------------------------------------------------------------------------------------------------------


def scanning(env: SatelliteTasking, u: Sequence[float]) -> TensorDictModuleBase:
    """Return a rule for scanning with thresholds of five numbers in [0, 1]."""
    low = 0.04 + 0.36 * u[0]
    kind = ScanRule if any("solar_pointing_error" in path for path in env.satellite.observation_description) else ScienceRule
    rule = kind(fast=0.1 + 0.7 * u[1], low=low, enough=low + 0.5 * u[2], worth=0.6 * u[3], full=0.85 + 0.14 * u[4])
    return scan_rule(env, thresholds=rule)


def imaging(env: SatelliteTasking, u: Sequence[float]) -> TensorDictModuleBase:
    """Return the rule ``hasty`` with other times of turns and of patience; targets of low priority or under clouds come last."""
    slew, patience, least, cover = 40.0 + 140.0 * u[0], 8.0 * 20.0 ** u[1], 0.7 * u[2], 0.4 + 0.5 * u[3]

    def worth(see: TargetReader, observation: Observation) -> Tensor:
        angle, opens, closes = (see.read(observation, name) for name in ("target_angle", "opportunity_open", "opportunity_close"))
        priority = see.read(observation, "priority")
        seconds = torch.maximum(opens, slew * angle.clamp(min=0.0).sqrt())
        useless = (seconds > closes) | (priority < least)
        if "cloud_forecast" in see.column:
            useless = useless | (see.read(observation, "cloud_forecast") > cover)
        return priority * torch.exp(-seconds / patience) - useless.to(opens.dtype)

    return ranking_rule(lambda one: ImagingRule.of(one, worth))(env, 0)


def surveying(env: SatelliteTasking, u: Sequence[float]) -> TensorDictModuleBase:
    """Return the rule ``survey`` with another cost of time."""
    return inspection_rule("survey", 1e-5 * 100.0 ** u[0])(env, 0)


TunedRule = Callable[[SatelliteTasking, Sequence[float]], TensorDictModuleBase]

TUNED: tuple[TunedRule, ...] = (scanning, imaging, surveying)
"""Rules with thresholds that are functions of numbers in [0, 1]; the first that fits a candidate is tuned for it."""

KNOBS = 5
"""Number of these numbers."""


def tuned_entrant(numbers: Sequence[float]) -> Entrant:
    """Return what enters the rule of :data:`TUNED` that fits, with the thresholds of the ``numbers``; nothing where none fits."""

    def with_numbers(rule: TunedRule) -> Callable[[SatelliteTasking, int], TensorDictModuleBase]:
        return lambda view, seed: rule(view, numbers)

    def enter(preset: str, make: Callable[..., Tasking]) -> tuple[Tasking, Policy] | None:
        env = make()
        for rule in TUNED:
            try:
                return env, shared(baseline_of_groups(with_numbers(rule), env), env)
            except (KeyError, ValueError):
                continue
        return None

    return enter


def tune(task: Task, options: argparse.Namespace) -> list[float] | None:
    """Return the numbers of the rule with the highest mean return in episodes of tuning; None where no rule can be tuned."""
    where = dataclasses.replace(task, first_seed=options.first + APART)
    draws = torch.rand(options.draws, KNOBS, generator=torch.Generator().manual_seed(0)).tolist()
    found: dict[int, float] = {}
    for number, draw in enumerate(draws):
        score = play(where, tuned_entrant(draw), options.tuned)
        if score is None:
            return None
        found[number] = score.evaluation.mean_return.mean
    return draws[max(found, key=lambda number: found[number])] if found else None


# -- measurement ----------------------------------------------------------------------------------------------------------------


def entrants(task: Task, options: argparse.Namespace) -> dict[str, tuple[str, Entrant]]:
    """Return what enters a candidate by name, each with its kind: ``rule``, ``policy``, or ``planner``."""
    found = {name: ("rule", entrant_of(name, [task])) for name in RULES}
    if options.draws and (numbers := tune(task, options)) is not None:
        found[TUNED_RULE] = ("rule", tuned_entrant(numbers))
    for name in options.policies:
        found[name] = ("planner" if name.startswith(PREFIX) else "policy", entrant_of(name, [task]))
    return found


def measure(task: Task, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return a row for each policy that fits a candidate, with its returns."""
    rows, judged = [], dataclasses.replace(task, first_seed=options.first)
    for name, (kind, entrant) in entrants(task, options).items():
        clock = time.process_time()
        score = play(judged, entrant, options.planned if kind == "planner" else options.episodes)
        if score is not None:
            rows.append(row(task, name, kind, score.evaluation, time.process_time() - clock))
            print(harness.cell("{candidate}, {policy}: {return:.3f} +- {half:.3f}, {cpu:.1f} core-s", rows[-1]), flush=True)
    return rows


def row(task: Task, name: str, kind: str, found: Evaluation, cpu: float) -> dict[str, Any]:
    """Return the figures of a policy in a candidate."""
    return {
        "candidate": task.title,
        "preset": task.preset,
        "policy": name,
        "kind": RANDOM if name == RANDOM else kind,
        "episodes": len(found.returns),
        "return": found.mean_return.mean,
        "half": found.mean_return.half_width,
        "survival": found.survival,
        "cpu": cpu,
        "returns": found.returns.tolist(),
    }


def share_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the share of head-room of a candidate from the returns of its policies, with a bootstrap interval; see the module.

    The best policy or planner is the one with the largest mean gain over the best rule in the episodes that both played.
    """
    rules = [one for one in rows if one["kind"] == "rule"]
    best_rule = max(rules, key=lambda one: one["return"])
    others = [one for one in rows if one["kind"] in ("policy", "planner")]
    (chance,) = (one for one in rows if one["kind"] == RANDOM)
    gains = {one["policy"]: paired(one, best_rule) for one in others}
    best = max(others, key=lambda one: float(gains[one["policy"]].mean()))
    gain, n = confidence(gains[best["policy"]]), best["episodes"]
    over_random = paired(best, chance)
    picks = torch.randint(n, (RESAMPLED, n), generator=torch.Generator().manual_seed(0))
    shares = gains[best["policy"]][picks].mean(1) / over_random[picks].mean(1)
    low, high = shares.quantile(torch.tensor([0.025, 0.975], dtype=shares.dtype)).tolist()
    share = float(gains[best["policy"]].mean() / over_random.mean())
    return {
        "candidate": best["candidate"],
        "preset": best["preset"],
        "random": chance["return"],
        "rule": best_rule["policy"],
        "rule_return": best_rule["return"],
        "rule_half": best_rule["half"],
        "best": best["policy"],
        "best_return": best["return"],
        "best_half": best["half"],
        "episodes": n,
        "gain": gain.mean,
        "gain_half": gain.half_width,
        "share": share,
        "share_low": low,
        "share_high": high,
        "admitted": share >= ADMITTED and gain.mean > gain.half_width,
        "task": best["candidate"] in {task.title for task in tasks_of("v2")},
    }


def paired(one: Mapping[str, Any], other: Mapping[str, Any]) -> Tensor:
    """Return the differences of the returns of two policies in the episodes that both played, [n]."""
    n = min(one["episodes"], other["episodes"])
    a, b = (torch.tensor(each["returns"][:n], dtype=torch.float64) for each in (one, other))
    return a - b


COLUMNS = {
    "candidate": "{candidate}",
    "random": "{random:.3f}",
    "best rule": "{rule}: {rule_return:.3f} +- {rule_half:.3f}",
    "best policy or planner": "{best}: {best_return:.3f} +- {best_half:.3f}",
    "gain": "{gain:+.3f} +- {gain_half:.3f}",
    "share of head-room": "{share:.2f} ({share_low:.2f} to {share_high:.2f})",
    "admitted": "{admitted}",
}


def merged(path: Path | None, rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the rows of a file, if there is one, without those of the candidates of ``rows``, and then these."""
    before = json.loads(path.read_text())["rows"] if path is not None and path.exists() else []
    new = {row["candidate"] for row in rows}
    return [*(row for row in before if row["candidate"] not in new), *rows]


def main() -> None:
    """Measure candidates and print a table."""
    parsed = harness.parser(__doc__, candidates=list(CANDIDATES), episodes=128, planned=32, draws=24, tuned=32, first=3_900_003)
    parsed.add_argument("--policies", nargs="+", default=["pretrained"], metavar="NAME", help="policies and planners")
    options, described = harness.begin(parsed)
    shares: list[dict[str, Any]] = []
    for name in options.candidates:
        rows = measure(CANDIDATES[name], options)
        if not any(one["kind"] in ("policy", "planner") for one in rows):
            print(f"{name}: none of --policies {' '.join(options.policies)} plays it; left out", flush=True)
            continue
        shares.append(share_of(rows) | {"options": harness.given(options)})
        harness.write(options, described, rows=merged(options.out, shares))
    print(harness.table(COLUMNS, shares))


if __name__ == "__main__":
    main()
