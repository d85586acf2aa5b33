"""Simulated seconds per core-second of NadirScan-v1 with random actions, and of bsk_rl on Basilisk where it is installed.

Usage:
    python benchmarks/speed.py [--batches 1 64 1024 4096] [--seconds 10] [--basilisk PYTHON] [--out speed.json]

``--basilisk`` names the Python interpreter of an environment with bsk and bsk_rl (see scripts/record_basilisk.py); it is then
measured in turns with ours. Times are CPU seconds of one thread; compilation is timed apart; figures are medians over steps, or
over turns. Resets are part of the steps.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import subprocess
import time
from pathlib import Path
from typing import Any

import torch

import bsk_torch

BASILISK = Path(__file__).with_name("basilisk_speed.py")


def measure(backend: str, batch: int, seconds: float) -> dict[str, Any]:
    """Steps of one batch for about ``seconds``: rate with its quartiles, and the time of the first step."""
    env = bsk_torch.make("NadirScan-v1", num_envs=batch, seed=0, backend=backend)
    begin = time.perf_counter()
    td = env.reset()
    td = env.step_and_maybe_reset(td.set("action", env.action_spec.rand()))[1]
    first = time.perf_counter() - begin
    rates = []
    begin = time.thread_time()
    while time.thread_time() - begin < seconds or len(rates) < 3:
        start = time.thread_time()
        step, td = env.step_and_maybe_reset(td.set("action", env.action_spec.rand()))
        rates.append(float(step["next", "duration"].sum()) / (time.thread_time() - start))
    low, median, high = statistics.quantiles(rates, n=4)
    return {
        "backend": backend,
        "batch": batch,
        "simulated_seconds_per_core_second": round(median),
        "quartiles": [round(low), round(high)],
        "first_reset_and_step_s": round(first, 1),
        "steps": len(rates),
    }


def measure_basilisk(python: str) -> float:
    """Rate of bsk_rl in the interpreter ``python``."""
    result = subprocess.run([python, str(BASILISK)], capture_output=True, text=True, check=True)
    return float(result.stdout.strip().splitlines()[-1])


def machine() -> dict[str, Any]:
    """What the figures depend on."""
    names = [line.split(":")[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line]
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    versions = {"torch": torch.__version__, "python": platform.python_version(), "bsk_torch": bsk_torch.__version__}
    return {
        "processor": names[0] if names else platform.processor(),
        "threads": torch.get_num_threads(),
        "commit": commit,
        **versions,
    }


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 64, 1024, 4096])
    parser.add_argument("--backends", nargs="+", default=["eager", "compiled"])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--basilisk", metavar="PYTHON")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows, peer = [], []
    for batch in options.batches:
        for backend in options.backends:
            rows.append(measure(backend, batch, options.seconds))
            peer += [measure_basilisk(options.basilisk)] if options.basilisk else []
    reference = statistics.median(peer) if peer else None
    print("| back end | batch | simulated s per core-s | quartiles | x Basilisk | first reset and step, s |")
    print("|---|---|---|---|---|---|")
    for row in rows:
        rate = row["simulated_seconds_per_core_second"]
        ratio = f"{rate / reference:.2g}" if reference else "-"
        low, high = row["quartiles"]
        print(
            f"| {row['backend']} | {row['batch']} | {rate:,} | {low:,} to {high:,} | {ratio} | {row['first_reset_and_step_s']} |"
        )
    if reference:
        print(
            f"\nBasilisk: {reference:,.0f} simulated s per core-s (median of {len(peer)}; {min(peer):,.0f} to {max(peer):,.0f})"
        )
    if options.out:
        options.out.write_text(json.dumps({"machine": machine(), "rows": rows, "basilisk": peer}, indent=1) + "\n")


if __name__ == "__main__":
    main()
