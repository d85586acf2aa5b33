"""The other side of aeos_speed.py: the rate of AEOS-Bench on Basilisk, under the benchmark's greedy rule.

Usage:
    python benchmarks/aeos_speed_side.py [--satellites 8] [--tasks 50] [--seconds 20]

It runs in an interpreter with the extra ``basilisk``, and flies with the modules and the order of the recordings of this project
(``scripts/recorders/record_aeos_bench.py``). It prints satellite-seconds per core-second.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

RECORDERS = Path(__file__).parents[1] / "scripts" / "recorders"


def parsed() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--satellites", type=int, default=8, help="default 8")
    parser.add_argument("--tasks", type=int, default=50, help="default 50")
    parser.add_argument("--seconds", type=int, default=20, help="measured seconds of flight, default 20")
    return parser.parse_args()


def main() -> None:
    """Print the rate, after five seconds of flight that are not measured."""
    options = parsed()
    sys.path.insert(0, str(RECORDERS))
    from record_aeos_bench import Flight, Progress, drawn, greedy_rule

    rng = np.random.RandomState(0)
    tasks = [
        {
            "id": k,
            "release_time": 0,
            "due_time": 3600,
            "duration": 15,
            "coordinate": [rng.uniform(-90, 90), rng.uniform(-180, 180)],
            "sensor_type": 1,
        }
        for k in range(options.tasks)
    ]
    scenario = {"constellation": drawn(rng, options.satellites, (0.2, 1.0)), "taskset": tasks}
    flight, progress, rule, begin, warm = Flight(scenario), Progress(scenario), greedy_rule(), 0.0, 5
    for tick in range(warm + options.seconds):
        if tick == warm:
            begin = time.process_time()
        flight.run_to(tick)
        choice, toggle = rule(flight, progress.open(tick))
        progress.add(flight, flight.access)
        flight.act(choice, toggle)
    sys.stdout.write(f"{options.satellites * options.seconds / (time.process_time() - begin)}\n")


if __name__ == "__main__":
    main()
