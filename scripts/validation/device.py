"""Check environments on a device of torch, such as a GPU, against the host, and measure them there.

    python scripts/validation/device.py --device cuda --out benchmarks/results/device.json
    python scripts/validation/device.py --device cpu --presets CWDocking-v1 --batches 4 --rows 2 --seconds 0.1

The parts, in this order, print a line for each row, and every row is written as soon as it is there: parity of presets with the
host, independence of the batch size, speed, training. What has not begun after ``--minutes`` is listed as not measured. An
environment on a device compiles its tick once for each batch size, which takes a minute or so and is not part of a rate.

Parity: the device integrates orbits by Picard iteration on tensors and runs ticks on tensors, the host by its kernels. Both solve
the same equations to rounding and to the tolerances of the solvers; observations of short flights agree to 2e-8 on the host
(``tests/env/test_compiled.py``), and GPUs contract products and sums differently. Hence ``TOLERANCE`` for what is observed and
earned, of order 1. Booleans must be the same.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase

import bsk_torch
from bsk_torch.presets import PRESETS
from bsk_torch.rl.marl.runs import configure, training_of
from bsk_torch.rl.training.collect import Batches, make_collector
from bsk_torch.rl.training.trainer import shut_down

TOLERANCE = 1e-6
"""Largest difference of parity: 50 times what two back ends of the host differ by."""

SHORT: dict[str, Any] = {"max_step_duration": 5.0, "time_limit": 600.0, "seed": 4}
"""Few ticks, because those of eager mode are launched operation by operation."""

SMALLER: dict[str, dict[str, Any]] = {
    "Constellation-v1": {"n_satellites": 3, "n_planes": 1, "phasing": 0, "n_targets": 300},
    "AEOS-v1": {"n_targets": 300},
}

STEPS = 4

Row = dict[str, Any]


def synchronize(device: torch.device) -> None:
    """Wait until a device has done its work."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def peak(device: torch.device) -> int:
    """Most memory that tensors of the device, or the process on the host, have had, bytes."""
    if device.type == "cuda":
        return torch.cuda.max_memory_allocated(device)
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))


def waits(device: torch.device, step: Callable[[], object]) -> int | None:
    """How often the host waits for the device in a step, by torch's own count; None on the host."""
    if device.type != "cuda":
        return None
    torch.cuda.set_sync_debug_mode("warn")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        step()
    torch.cuda.set_sync_debug_mode("default")
    return sum("synchroniz" in str(warning.message) for warning in caught)


def difference(one: TensorDictBase, other: TensorDictBase) -> tuple[float, str]:
    """Largest difference of two tensordicts, infinite where truth values differ, and its entry."""
    largest = 0.0, ""
    for key in one.keys(True, True):
        a, b = one[key].cpu(), other[key].cpu()
        if a.dtype.is_floating_point:
            apart = (a.double() - b.double()).abs().nan_to_num(0.0 if a.isnan().equal(b.isnan()) else torch.inf)
            largest = max(largest, (float(apart.max()), str(key)))
        elif not torch.equal(a, b):
            largest = max(largest, (torch.inf, str(key)))
    return largest


def together(envs: Sequence[Any], seen: Sequence[slice]) -> tuple[float, str]:
    """Play environments with the random actions of the first; return the largest difference of the rows ``seen``."""
    torch.manual_seed(0)
    tds = [env.reset() for env in envs]
    worst = 0.0, ""
    for _ in range(STEPS):
        tds[0] = envs[0].rand_action(tds[0])
        for env, td in zip(envs[1:], tds[1:], strict=True):
            for key in env.action_keys:
                td[key] = tds[0][key][: len(td)].to(env.device)
        tds = [env.step(td)["next"] for env, td in zip(envs, tds, strict=True)]
        shown = [td[rows] for td, rows in zip(tds, seen, strict=True)]
        worst = max(worst, *(difference(shown[0], other) for other in shown[1:]))
        if bool(tds[0]["done"].any()):
            break
    return worst


def made(preset: str, num_envs: int, device: torch.device, **options: Any) -> Any:
    """An environment of a preset with short steps."""
    return bsk_torch.make(preset, num_envs=num_envs, device=device, **{**SHORT, **SMALLER.get(preset, {}), **options})


def parity(preset: str, backend: str, options: argparse.Namespace) -> Row:
    """Compare some steps with the kernels of the host."""
    envs = made(preset, options.rows, torch.device("cpu")), made(preset, options.rows, options.device, backend=backend)
    worst, key = together(envs, [slice(None)] * 2)
    return {"difference": worst, "entry": key, "agrees": worst <= TOLERANCE}


def independence(preset: str, options: argparse.Namespace) -> Row:
    """Compare the first row of a batch with a separate environment."""
    envs = [made(preset, rows, options.device, backend="eager") for rows in (options.rows, 1)]
    worst, key = together(envs, [slice(0, 1), slice(0, 1)])
    return {"difference": worst, "entry": key, "agrees": worst == 0.0}


def speed(preset: str, num_envs: int, options: argparse.Namespace) -> Row:
    """Measure random steps, resets included."""
    if options.device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(options.device)
    begin = time.perf_counter()
    env = bsk_torch.make(preset, num_envs=num_envs, device=options.device, seed=0, **SMALLER.get(preset, {}))
    td = env.reset()
    _, td = env.step_and_maybe_reset(env.rand_action(td))
    synchronize(options.device)
    ready, begin, steps, simulated = time.perf_counter() - begin, time.perf_counter(), 0, torch.zeros((), device=options.device)
    while time.perf_counter() - begin < options.seconds or not steps:
        played, td = env.step_and_maybe_reset(env.rand_action(td))
        simulated, steps = simulated + played["next", "duration"].double().sum(), steps + 1
        synchronize(options.device)
    wall = time.perf_counter() - begin
    acted = env.rand_action(td)
    return {
        "decisions_per_s": steps * num_envs / wall,
        "simulated_s_per_s": float(simulated) / wall,
        "ready_s": ready,
        "waits": waits(options.device, lambda: env.step(acted)),
        "peak_bytes": peak(options.device),
    }


def training(preset: str, num_envs: int, options: argparse.Namespace) -> Row:
    """Measure a training by the preset's recipe, with environments and learner on the device."""
    alone: dict[str, Any] = dict(
        collector="single", workers=1, ahead=False, evaluate_every=0, patience=None, seconds=None, frames=10**12
    )
    config = configure(preset, None, num_envs=num_envs, options={"device": str(options.device)}, loggers=("csv",), **alone)
    with tempfile.TemporaryDirectory() as folder:
        training = training_of(config, Path(folder) / "run")
        batches = Batches(make_collector(config, training.env, training.actor, None), False, lambda: None)
        try:
            training.learner.learn(batches.take())  # compiles
            begin, count = time.perf_counter(), 0
            while time.perf_counter() - begin < options.seconds or not count:
                training.learner.learn(batches.take())
                synchronize(options.device)
                count += config.batch
            wall = time.perf_counter() - begin
        finally:
            batches.close()
            shut_down(batches.collector)
            training.lock.release()
    return {"decisions_per_s": count / wall, "peak_bytes": peak(options.device)}


def parts(options: argparse.Namespace) -> Iterator[tuple[str, str, Callable[[], Row]]]:
    """What to do, in this order: the part, its case, and a function that does it."""
    for preset in options.presets:
        yield "parity", preset, lambda preset=preset: parity(preset, "eager", options)
    for preset in options.measured[:1]:
        yield "parity, compiled", preset, lambda preset=preset: parity(preset, "compiled", options)
    for preset in options.measured:
        yield "independence", preset, lambda preset=preset: independence(preset, options)
    for num_envs in options.batches:
        for preset in options.measured:
            yield "speed", f"{preset} {num_envs}", lambda preset=preset, n=num_envs: speed(preset, n, options)
    for preset in options.measured[:1]:
        batch = options.batches[0]
        yield "training", f"{preset} {batch}", lambda preset=preset, n=batch: training(preset, n, options)


def main() -> None:
    """Do all parts and write their rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", type=torch.device, required=True)
    parser.add_argument("--presets", nargs="+", choices=PRESETS, default=list(PRESETS), metavar="PRESET", help="of parity; all")
    measured = ["NadirScan-v1", "AEOS-v1"]
    parser.add_argument("--measured", nargs="+", choices=PRESETS, default=measured, metavar="PRESET", help="default %(default)s")
    parser.add_argument("--batches", type=int, nargs="+", default=[4096, 32768, 262144], help="default %(default)s")
    parser.add_argument("--rows", type=int, default=8, help="environments of parity and independence, default 8")
    parser.add_argument("--seconds", type=float, default=10.0, help="of a measurement, default 10")
    parser.add_argument("--minutes", type=float, default=8.0, help="after which nothing begins, default 8")
    parser.add_argument("--out", type=Path, metavar="FILE.json")
    options, begin = parser.parse_args(), time.perf_counter()
    name = torch.cuda.get_device_name(options.device) if options.device.type == "cuda" else "host"
    versions = {"torch": torch.__version__, "bsk_torch": bsk_torch.__version__}
    rows: list[Row] = []
    for part, case, do in parts(options):
        row: Row = {"part": part, "case": case}
        if time.perf_counter() - begin > 60.0 * options.minutes:
            row["not_measured"] = "out of time"
        else:
            try:
                row |= do()
            except Exception as error:  # is in the row; the next ones are measured all the same
                row["failed"] = f"{type(error).__name__}: {error}"[:500]
            row["wall_s"] = time.perf_counter() - begin
        rows.append(row)
        print(*(f"{key}={value:.6g}" if isinstance(value, float) else f"{key}={value}" for key, value in row.items()), flush=True)
        if options.out:
            content = {"device": str(options.device), "name": name, **versions, "tolerance": TOLERANCE, "rows": rows}
            options.out.write_text(json.dumps(content, indent=1, default=str) + "\n")


if __name__ == "__main__":
    main()
