"""Basilisk's side of vs_basilisk.py: the paper's scanning environment in bsk_rl, random actions, resets included.

Runs in an interpreter that has bsk and bsk_rl but need not have torch. For every line of input, a number of seconds, it plays
that long and answers with a line of JSON: simulated seconds, ended episodes, steps, and seconds of all cores and of the wall
clock. Basilisk runs in a thread of its own, so only the time of the whole process counts its work.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))

from record_basilisk import BATTERY, EPISODE, FIXED, PAPER_MODES, STORAGE, paper_observations, scanner_class

Step = tuple[float, bool]
"""Simulated seconds of a step, and whether an episode ended with it."""

DRAWN: dict[str, Any] = {
    "storageInit": lambda: int(np.random.uniform(0.0, 0.8) * STORAGE),
    "storedCharge_Init": lambda: np.random.uniform(0.3, 1.0) * BATTERY,
    "disturbance_vector": lambda: np.random.normal(scale=1e-4, size=3),
    "wheelSpeeds": lambda: np.random.uniform(-3000.0, 3000.0, 3),
}
"""What bsk_rl draws at every reset as the preset does; orbit, attitude and epoch are random by default."""


def make_env() -> gym.Env:
    """The paper's environment with random episodes."""
    from bsk_rl import data, scene

    satellite = scanner_class(PAPER_MODES, paper_observations())("Scanner1", sat_args=FIXED | DRAWN)
    return gym.make(
        "SatelliteTasking-v1",
        satellite=satellite,
        scenario=scene.UniformNadirScanning(value_per_second=1 / EPISODE),
        rewarder=data.ScanningTimeReward(),
        time_limit=EPISODE,
        failure_penalty=-1.0,
        terminate_on_time_limit=True,
        log_level="ERROR",
        disable_env_checker=True,
    )


def episodes() -> Iterator[Step]:
    """Play on for ever."""
    env, rng = make_env(), np.random.default_rng(0)
    env.reset(seed=0)
    while True:
        _, _, terminated, truncated, info = env.step(int(rng.integers(len(PAPER_MODES))))
        if terminated or truncated:
            env.reset()
        yield float(info["d_ts"]), terminated or truncated


def play(player: Iterator[Step], seconds: float) -> dict[str, float]:
    """A turn of about ``seconds`` of the wall clock; the entries are those of ``Turn`` in harness.py."""
    steps: list[Step] = []
    cpu, wall = time.process_time(), time.perf_counter()
    while time.perf_counter() - wall < seconds:
        steps.append(next(player))
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    simulated, ended = sum(step[0] for step in steps), sum(step[1] for step in steps)
    return {"simulated": simulated, "ended": ended, "steps": len(steps), "cpu": cpu, "wall": wall}


def main() -> None:
    """Answer until the input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Basilisk talks
    player = episodes()
    next(player)
    for line in sys.stdin:
        print(json.dumps(play(player, float(line))), file=answers, flush=True)


if __name__ == "__main__":
    main()
