"""What do rules reach in ThreeSensors-v1 and Walker4-v1, next to the studies that the presets are from?

Usage:
    python benchmarks/teams.py [--episodes 10] [--only walker-local ...] [--out FILE.json]

Cases are those of the studies: satellites that know their own images only (``independent``) decide by the rule ``local``, those
that know all (``ideal``) by ``centralized``. In ``three-shared``, satellites know all and decide for themselves, of which no
result is published, and none of the rule ``prompt`` either.
"""

from __future__ import annotations

import argparse
import time
from typing import Any, NamedTuple

import harness
from torch import Tensor

import bsk_torch
from bsk_torch import ConstellationTasking
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.evaluation.statistics import confidence
from bsk_torch.rl.policies.shared_policy import rule

SEED = 0


class Case(NamedTuple):
    """What is played, and the means of the study: 50 episodes of three sensors, 5 of four.

    Attributes:
        preset: The preset.
        rule: The rule.
        information: What imagers know of the images of others.
        mixture: Shares of kinds of orbits in the catalog.
        published: Paid captures and deliveries, reward, captured and delivered share of the objects in percent, duplicate
            attempts, and wasted time in percent; None if there are none.
    """

    preset: str
    rule: str
    information: str
    mixture: str | tuple[float, float, float]
    published: tuple[float, ...] | None


MIXED = (0.5, 0.3, 0.2)

THREE, FOUR = "ThreeSensors-v1", "Walker4-v1"

CASES = {
    "three-local": Case(THREE, "local", "independent", "LEO", (281.6, 263.94, 280.77, 93.92, 93.68, 370.6, 37.4)),
    "three-centralized": Case(THREE, "centralized", "ideal", "LEO", (308.96, 290.08, 308.4, 94.04, 93.68, 0.0, 0.0)),
    "three-shared": Case(THREE, "local", "ideal", "LEO", None),
    "three-mixed-local": Case(THREE, "local", "independent", MIXED, (322.6, 302.2, 320.01, 96.78, 96.6, 488.4, 45.3)),
    "three-mixed-centralized": Case(THREE, "centralized", "ideal", MIXED, (350.94, 335.82, 349.67, 97.16, 96.96, 0.0, 0.0)),
    "three-prompt": Case(THREE, "prompt", "independent", "LEO", None),
    "three-shared-prompt": Case(THREE, "prompt", "ideal", "LEO", None),
    "walker-local": Case(FOUR, "local", "independent", MIXED, (361.2, 337.4, 359.9, 100.0, 100.0, 704.4, 48.2)),
    "walker-centralized": Case(FOUR, "centralized", "ideal", MIXED, (396.2, 382.2, 394.8, 100.0, 100.0, 0.0, 0.0)),
    "walker-prompt": Case(FOUR, "prompt", "independent", MIXED, None),
    "walker-shared-prompt": Case(FOUR, "prompt", "ideal", MIXED, None),
}

COLUMNS = {
    "case": "{case}",
    "acquisitions": "{acquisitions[0]:.1f} +- {acquisitions[1]:.1f}",
    "services": "{services[0]:.1f} +- {services[1]:.1f}",
    "reward": "{reward[0]:.1f} +- {reward[1]:.1f}",
    "captured, %": "{captured_share[0]:.1f}",
    "delivered, %": "{delivered_share[0]:.1f}",
    "duplicate attempts": "{duplicate_attempts[0]:.1f}",
    "wasted, %": "{wasted_share[0]:.1f}",
    "decisions": "{decisions[0]:.0f}",
    "core-seconds per episode": "{cpu:.1f}",
}


def flown(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Play the episodes of a case; figures are means and half-widths."""
    case = CASES[name]
    team: dict[str, Any] = dict(
        as_set=case.rule == "prompt", information=case.information, mixture=case.mixture, n_targets=options.targets
    )
    world = dict(time_limit=options.time_limit, backend=options.backend)
    env = bsk_torch.make(case.preset, num_envs=options.episodes, **team, **world)
    assert isinstance(env, ConstellationTasking)
    clock = time.process_time()
    found = evaluate(rule(case.rule, env), env, seed=SEED)
    cpu = (time.process_time() - clock) / options.episodes
    ledger = env.rewarder.rewarders[0]
    lost = ledger.wasted_time.sum(1) / (options.time_limit * env.fleet.size)
    figures: dict[str, Tensor] = {
        **{count: found.counts[count] for count in ("acquisitions", "services", "duplicate_attempts")},
        "reward": found.returns,
        "captured_share": 100.0 * ledger.coverage["acquisition"],
        "delivered_share": 100.0 * ledger.coverage["delivery"],
        "wasted_share": 100.0 * lost,
        "decisions": found.decisions,
    }
    means = {title: confidence(values.double()) for title, values in figures.items()}
    return {"case": name, **case._asdict(), "cpu": cpu} | {
        title: [interval.mean, interval.half_width] for title, interval in means.items()
    }


def main() -> None:
    """Play all cases, and print a table."""
    parsed = harness.parser(__doc__, episodes=10, targets=100, time_limit=45_000.0)
    parsed.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), help="cases")
    parsed.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    options, described = harness.begin(parsed)
    rows: list[dict[str, Any]] = []
    for name in options.only:
        rows.append(flown(name, options))
        print(harness.cell("{case}: {reward[0]:.1f} +- {reward[1]:.1f}", rows[-1]), flush=True)
        harness.write(options, described, rows=rows)
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    main()
