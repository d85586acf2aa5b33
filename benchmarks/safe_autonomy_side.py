"""The other side of safe_autonomy.py: the rate of an environment of AFRL's safe-autonomy-sims with random actions.

Usage:
    python benchmarks/safe_autonomy_side.py [--preset CWDocking-v1] [--steps 100] [--weak 0.02]

It runs in an interpreter with safe-autonomy-sims, which does not need torch, and prints decisions per core-second.
"""

import argparse
import sys
import time

import numpy as np


def parsed() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", choices=("CWDocking-v1", "CWInspection-v1"), default="CWDocking-v1")
    parser.add_argument("--steps", type=int, default=100, help="measured decisions, default 100")
    parser.add_argument("--weak", type=float, default=0.02, help="largest random force, N, default 0.02")
    return parser.parse_args()


def main() -> None:
    """Print the rate, after two decisions that are not measured."""
    options = parsed()
    if options.preset == "CWDocking-v1":
        from safe_autonomy_sims.gym.docking import DockingEnv as Environment
    else:
        from safe_autonomy_sims.gym.inspection import InspectionEnv as Environment
    env, rng = Environment(), np.random.default_rng(0)
    env.reset(seed=0)
    begin = 0.0
    for step in range(options.steps + 2):
        if step == 2:
            begin = time.process_time()
        _, _, terminated, truncated, _ = env.step((options.weak * rng.uniform(-1.0, 1.0, 3)).astype(np.float32))
        if terminated or truncated:
            env.reset()
    sys.stdout.write(f"{options.steps / (time.process_time() - begin)}\n")


if __name__ == "__main__":
    main()
