"""Simulated seconds per CPU second of the paper's scanning environment in bsk_rl, random actions, resets included.

Runs in an interpreter that has bsk and bsk_rl, and prints one number. Used by speed.py.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))

DURATION = 15.0
"""CPU seconds to measure."""


def main() -> None:
    """Step random episodes for a while."""
    from record_basilisk import VARIANTS, draw_initial, make_env, paper_observations  # needs bsk_rl

    rng = np.random.default_rng(0)
    nominal = VARIANTS["nominal"]
    env = make_env(nominal, draw_initial(rng, nominal), paper_observations())
    env.reset(seed=0)
    simulated, begin = 0.0, time.process_time()
    while time.process_time() - begin < DURATION:
        _, _, terminated, truncated, info = env.step(int(rng.integers(4)))
        simulated += info["d_ts"]
        if terminated or truncated:
            env.reset()
    print(simulated / (time.process_time() - begin))


if __name__ == "__main__":
    main()
