"""The other side of safe_autonomy.py: decisions per second of an environment of AFRL's safe-autonomy-sims with random actions."""

import sys
import time

import numpy as np


def main(preset: str, steps: int, weak: float) -> None:
    """Print the rate."""
    if preset == "CWDocking-v1":
        from safe_autonomy_sims.gym.docking import DockingEnv as Environment
    else:
        from safe_autonomy_sims.gym.inspection import InspectionEnv as Environment
    env, rng = Environment(), np.random.default_rng(0)
    env.reset(seed=0)
    begin = time.perf_counter()
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step((weak * rng.uniform(-1.0, 1.0, 3)).astype(np.float32))
        if terminated or truncated:
            env.reset()
    sys.stdout.write(f"{steps / (time.perf_counter() - begin)}\n")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]))
