"""What communication is worth to rules in constellations, and how much of what is in view they collect.

Usage:
    python benchmarks/communication.py [--only RelayConstellation-v1 ...] [--rules nearest] [--episodes 128] [--batch 128]
        [--seed 1000010] [--time-limit 0] [--out FILE.json]

All play the same episodes. ``gain`` is the mean difference of the returns to those without communication. What is in view is the
sum of the priorities of all targets that any satellite could image at some time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import harness
import torch
from torch import Tensor

import bsk_torch
from bsk_torch import comm
from bsk_torch.lab.bounds.windows import openings
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.evaluation.statistics import confidence
from bsk_torch.sats import ImagingSatellite

METHODS: dict[str, Callable[[], comm.CommunicationMethod]] = {
    "none": comm.NoCommunication,
    "in line of sight": comm.LOSCommunication,
    "with all": comm.FreeCommunication,
}
"""Methods of communication, after every step, by name; gains are those over the first."""

COLUMNS = {
    "preset": "{preset}",
    "rule": "{rule}",
    "communication": "{communication}",
    "return": "{value:.2f} +- {half:.2f}",
    "gain": "{gain:+.2f} +- {gain_half:.2f}",
    "in view": "{in_view:.2f}",
}


def in_view(env: Any) -> Tensor:
    """Return the sum of the priorities of all targets that any satellite could image in the episodes that have begun, [N]."""
    seen = torch.zeros(env.num_envs, env.scenario.most_targets, dtype=torch.bool)
    for satellite in env.fleet.satellites:
        if isinstance(satellite, ImagingSatellite):
            state = satellite.simulator.state
            every = openings(satellite, state.of_env(env.state.limit_ticks))
            seen[every.row // state.count, every.target] = True
    return (seen * env.scenario.priority).sum(1)


def play(preset: str, rule: str, method: str, options: Any) -> tuple[Tensor, Tensor]:
    """Return returns and what is in view of all episodes, which are played a batch at a time."""
    returns, seen = [], []
    for first in range(0, options.episodes, options.batch):
        rows = range(first, min(first + options.batch, options.episodes))
        world: dict[str, Any] = dict(num_envs=len(rows), env_ids=rows, backend=options.backend, communicator=METHODS[method]())
        world |= {"time_limit": options.time_limit} if options.time_limit else {}
        env: Any = bsk_torch.make(preset, **world)
        env.set_seed(options.seed)
        env.reset()
        seen.append(in_view(env))
        returns.append(evaluate(bsk_torch.rule(rule, env), env, seed=options.seed).returns)
    return torch.cat(returns), torch.cat(seen)


def main() -> None:
    """Play, and print a table."""
    arguments = harness.parser(
        __doc__,
        only=["RelayConstellation-v1"],
        rules=["nearest"],
        episodes=128,
        batch=128,
        seed=1_000_010,
        time_limit=0.0,
        backend="compiled",
    )
    options, described = harness.begin(arguments)
    rows = harness.Rows(options, described)
    for preset in options.only:
        for rule in options.rules:
            silent = None
            for method in METHODS:
                returns, seen = play(preset, rule, method, options)
                silent = returns if silent is None else silent
                value, gain = confidence(returns), confidence(returns - silent)
                row = dict(preset=preset, rule=rule, communication=method, value=value.mean, half=value.half_width)
                rows.append(row | dict(gain=gain.mean, gain_half=gain.half_width, in_view=float(seen.mean())))
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
