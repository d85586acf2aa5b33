"""What the benchmarks share: the environments and how they are played, clocks, new processes, tables and files.

Batches are measured in their steady state. Episodes that start together end together, in waves, so the first episode of row i
of n is cut at (i + 1) / n of the time limit, and nothing is measured before an episode's length has passed: ages are then spread
evenly, and resets come at a steady rate.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import platform
import statistics
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from multiprocessing import get_context, get_start_method
from pathlib import Path
from typing import Any, NamedTuple

import tensordict
import torch
import torchrl
from torch import Tensor
from torchrl.envs import EnvBase

import bsk_torch
from bsk_torch import rand
from bsk_torch.presets.nadir_scan import ORBIT
from bsk_torch.rand import Distribution, Key
from bsk_torch.sim import dyn

EPISODE = 5 * ORBIT
"""Time limit of all tasks, s."""

BASILISK_SIDE = Path(__file__).with_name("basilisk_side.py")

PATIENCE = 600.0
"""Seconds that processes wait for each other."""


# -- tasks ------------------------------------------------------------------------------------------------------------


class Task(NamedTuple):
    """What is played.

    Attributes:
        preset: The preset.
        steps: About how many random actions make an episode.
        options: Arguments of the preset.
        others: Arguments of Basilisk's environment; None for the same ones.
    """

    preset: str
    steps: int
    options: dict[str, Any]
    others: dict[str, Any] | None = None


FOUR_AXES = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [3**-0.5] * 3]
"""Axes of four wheels: those of bsk_rl's fault example."""

FOUR_WHEELS: dict[str, Any] = {
    "wheels": [dyn.Wheel("Honeywell_HR16", axis, 50.0) for axis in FOUR_AXES],
    "wheelSpeeds": rand.Uniform(-3000.0, 3000.0, 4),
}

TASKS = {
    "scan": Task("NadirScan-v1", 300, {}),
    "scan-4-wheels": Task("NadirScan-v1", 300, {"sat_args": FOUR_WHEELS}, {"axes": FOUR_AXES}),
    "imaging-100": Task("AEOS-v1", 110, {"n_targets": 100}),
    "imaging-1k": Task("AEOS-v1", 110, {"n_targets": 1000}),
    "imaging-10k": Task("AEOS-v1", 360, {"n_targets": 10_000}),
}
"""The paper's scanning, also with four wheels, and agile imaging.

With few targets most steps are the longest, 300 s, and bring no image.
"""


# -- options and results ----------------------------------------------------------------------------------------------


def parser(doc: str | None, **defaults: Any) -> argparse.ArgumentParser:
    """Options that every benchmark has; ``defaults`` become further ones, such as ``seconds=10.0`` or ``batches=[1, 64]``."""
    arguments = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, value in defaults.items():
        several = isinstance(value, list)
        kind = type(value[0] if several else value)
        arguments.add_argument(
            f"--{name.replace('_', '-')}",
            type=kind,
            default=value,
            nargs="+" if several else None,
            choices=TASKS if name == "tasks" else None,
            help=f"default {' '.join(map(str, value)) if several else value}",
        )
    arguments.add_argument("--warm-up", type=int, help="steps before measuring, default an episode's length")
    arguments.add_argument("--out", type=Path, metavar="FILE.json")
    return arguments


def machine() -> dict[str, Any]:
    """What the figures depend on; call it before measuring, for the load of the machine."""
    names = [line.split(":")[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line]
    describe = ["git", "--no-optional-locks", "describe", "--always", "--dirty"]
    commit = subprocess.run(describe, capture_output=True, text=True, check=False, cwd=Path(__file__).parent).stdout.strip()
    return {
        "processor": names[0] if names else platform.processor(),
        "capability": torch.backends.cpu.get_cpu_capability(),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "load": os.getloadavg()[0],
        "commit": commit,
        "python": platform.python_version(),
        "torch": torch.__version__,
        "torchrl": torchrl.__version__,
        "tensordict": tensordict.__version__,
        "bsk_torch": bsk_torch.__version__,
    }


def begin(arguments: argparse.ArgumentParser) -> tuple[argparse.Namespace, dict[str, Any]]:
    """Read the command line, keep torch to one thread, and describe the machine."""
    options = arguments.parse_args()
    torch.set_num_threads(1)
    return options, machine()


def warm_up(options: argparse.Namespace, task: str) -> int:
    """Steps before anything of ``task`` is measured."""
    return TASKS[task].steps if options.warm_up is None else options.warm_up


def cell(template: str, row: Mapping[str, Any]) -> str:
    """A row's entry of a column; a dash where the row has no such value."""
    try:
        return template.format_map(row)
    except KeyError:
        return "-"


def table(columns: Mapping[str, str], rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown table; ``columns`` are format strings by title, such as ``{"batch": "{batch:,}"}``."""
    lines = [list(columns), ["---"] * len(columns)]
    lines += [[cell(template, row) for template in columns.values()] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def of_seeds(values: Sequence[float], form: str) -> str:
    """Return the mean of several trainings in the format ``form``, with the least and the largest of them."""
    mean, low, high = (form.format(value) for value in (statistics.fmean(values), min(values), max(values)))
    return mean if len(values) == 1 else f"{mean} ({low} to {high})"


def budget(options: argparse.Namespace) -> dict[str, Any]:
    """Return the length of a training as fields of its configuration: ``frames`` if there are any, else ``seconds``."""
    return dict(seconds=None, frames=options.frames) if options.frames else dict(seconds=options.seconds)


def write(options: argparse.Namespace, described: dict[str, Any], **results: Any) -> None:
    """Write ``results``, the machine and the options into the file that the user named, if any."""
    if options.out:
        content = {"machine": described, "options": given(options), **results}
        options.out.write_text(json.dumps(content, indent=1, default=str) + "\n")


class Rows(list[dict[str, Any]]):
    """Rows of results; each is in the user's file, marked as unfinished, as soon as it is measured: a run may be cut off."""

    def __init__(self, options: argparse.Namespace, described: dict[str, Any], rows: Iterable[dict[str, Any]] = ()) -> None:
        """Begin with ``rows``, which may be measured one by one."""
        super().__init__()
        self._write = functools.partial(write, options, described, unfinished=True)
        self.extend(rows)

    def append(self, row: dict[str, Any]) -> None:
        """Add a row and write all."""
        super().append(row)
        self._write(rows=self)

    def extend(self, rows: Iterable[dict[str, Any]]) -> None:
        """Add rows one by one."""
        for row in rows:
            self.append(row)

    def __iadd__(self, rows: Iterable[dict[str, Any]]) -> Rows:  # type: ignore[override, misc]
        self.extend(rows)
        return self


def given(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options of a command line as a file of results has them."""
    return {name: _portable(name, value) for name, value in vars(options).items()}


def _portable(name: str, value: Any) -> Any:
    """Return an option without the folders of this machine."""
    if name in ("basilisk", "original") and value:
        return "PYTHON"
    return Path(value).name if isinstance(value, str | Path) and Path(value).is_absolute() else value


def spread(name: str, values: Sequence[float]) -> dict[str, float]:
    """Median and quartiles, as entries of a row: ``name``, ``name_low`` and ``name_high``."""
    low, median, high = statistics.quantiles(values, n=4, method="inclusive") if len(values) > 1 else [values[0]] * 3
    return {name: median, f"{name}_low": low, f"{name}_high": high}


# -- playing ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Staggered(Distribution):
    """Time limits, s: in the first episode of row i of ``rows`` (i + 1) / rows of ``limit``, later all of it."""

    rows: int
    limit: float = EPISODE

    def draw(self, key: Key) -> Tensor:
        """See :meth:`bsk_torch.rand.Distribution.draw`."""
        share = (key.env_id % self.rows + 1).double() / self.rows
        return self.limit * torch.where(key.episode == 0, share, torch.ones_like(share))


def make_env(task: str, batch: int, dtype: str = "float64", rank: int = 0, **options: Any) -> bsk_torch.SatelliteTasking:
    """The environment of a task, staggered; the ``rank``-th of several processes has episodes of its own."""
    return bsk_torch.make(
        TASKS[task].preset,
        **TASKS[task].options,
        num_envs=batch,
        seed=0,
        sim_dtype=getattr(torch, dtype),
        env_ids=range(rank * batch, (rank + 1) * batch),
        time_limit=Staggered(batch),
        **options,
    )


class Step(NamedTuple):
    """What a step of the whole batch did: simulated seconds, episodes that ended, and decisions."""

    simulated: float
    ended: int
    decisions: int = 1


Player = Iterator[Step]
"""Plays on for ever, one step of the batch at a time, resets included."""


def step_of(seen: Any) -> Step:
    """The step (or steps) whose outcome is ``seen``, a tensordict's ``next``."""
    return Step(float(seen["duration"].sum(dtype=torch.float64)), int(seen["done"].sum()), seen["done"].numel())


def rollout(env: EnvBase) -> Player:
    """Random actions."""
    td = env.reset()
    while True:
        played, td = env.step_and_maybe_reset(td.set("action", env.action_spec.rand()))
        yield step_of(played["next"])


class Turn(NamedTuple):
    """Several steps: the sums of theirs, their number, and seconds of all cores and of the wall clock."""

    simulated: float
    ended: int
    decisions: int
    steps: int
    cpu: float
    wall: float

    @property
    def rate(self) -> float:
        """Simulated seconds per core-second, whatever the threads."""
        return self.simulated / self.cpu

    @property
    def decision_rate(self) -> float:
        """Decisions per core-second."""
        return self.decisions / self.cpu

    @property
    def wall_rate(self) -> float:
        """Simulated seconds per second of the wall clock."""
        return self.simulated / self.wall


def play(player: Player, seconds: float, least: int = 1, whole: int = 0, most: int | None = None) -> Turn:
    """Play for ``seconds`` of the wall clock, at least ``least`` steps, and until a multiple of ``whole`` episodes have ended.

    With ``most``, play at most so many steps.

    Episodes are prepared in bulk about once for every batch of them that has ended, so such multiples have their share of it.
    """
    steps: list[Step] = []
    ended, complete = 0, False
    cpu, wall = time.process_time(), time.perf_counter()
    while len(steps) != most and (time.perf_counter() - wall < seconds or len(steps) < least or not complete):
        steps.append(next(player))
        before, ended = ended, ended + steps[-1].ended
        complete = not whole or ended // whole > before // whole
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return Turn(sum(step.simulated for step in steps), ended, sum(step.decisions for step in steps), len(steps), cpu, wall)


def start(make: Callable[[], Player], steps: int) -> tuple[Player, float]:
    """A player after ``steps`` steps of warming up, and the seconds until its first one was done, compilation included."""
    clock = time.perf_counter()
    player = make()
    next(player)
    first = time.perf_counter() - clock
    for _ in range(steps - 1):
        next(player)
    return player, first


# -- processes and memory ---------------------------------------------------------------------------------------------


def _join(barrier: Any) -> None:
    global _barrier
    _barrier = barrier


def meet() -> None:
    """Wait for the other processes of :func:`in_processes`."""
    _barrier.wait(PATIENCE)


def in_processes(count: int, function: Callable[..., Any], *args: Any) -> list[Any]:
    """Results of ``function(rank, *args)`` in ``count`` new processes at once."""
    context = get_context(get_start_method(allow_none=True) or "spawn")
    with ProcessPoolExecutor(count, context, _join, (context.Barrier(count),)) as pool:
        return [task.result() for task in [pool.submit(function, rank, *args) for rank in range(count)]]


Side = Callable[[Any], Turn]
"""Plays a turn in another process; its argument, such as a number of seconds, is sent as JSON."""


@contextmanager
def other_process(command: list[str], **environment: str) -> Iterator[Side]:
    """Start a process of one thread that answers every line of JSON with a turn as JSON, in ours and ``environment``."""
    surroundings = {**os.environ, "OMP_NUM_THREADS": "1", **environment}
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=surroundings)

    def turn(request: Any) -> Turn:
        print(json.dumps(request), file=process.stdin, flush=True)
        answer = process.stdout.readline() if process.stdout else ""
        if not answer:
            raise RuntimeError(f"{' '.join(command)} has stopped with exit code {process.wait()}")
        return Turn(**json.loads(answer))

    with process:
        yield turn
        if process.stdin:
            process.stdin.close()


def basilisk(python: str, task: str) -> AbstractContextManager[Side]:
    """Play turns of so many seconds of ``task`` in the interpreter ``python``, with bsk_rl on Basilisk."""
    played = TASKS[task]
    return other_side(python, played.preset, played.options if played.others is None else played.others)


def other_side(python: str, environment: str, options: Mapping[str, Any]) -> AbstractContextManager[Side]:
    """Play turns of so many seconds of an ``environment`` of basilisk_side.py in the interpreter ``python``."""
    return other_process([python, str(BASILISK_SIDE), environment, json.dumps(options)])


def resident() -> int:
    """Memory of this process, bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def peak() -> int:
    """Most memory that this process has had, bytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))


def available() -> int:
    """Memory that the machine has left, bytes."""
    lines = Path("/proc/meminfo").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable"))


# -- parts of a step --------------------------------------------------------------------------------------------------


class Stopwatch:
    """Time of this thread by part of a step, s, in ``spent``; a part's time is without the parts inside it."""

    def __init__(self, *closed: str) -> None:
        """Start with nothing; parts inside those named ``closed`` count as theirs."""
        self.spent: dict[str, float] = {}
        self._closed, self._open = closed, [("", 0.0)]

    def watch(self, owner: Any, name: str, part: str) -> None:
        """Let the method ``name`` of ``owner`` count as ``part`` from now on."""
        function = getattr(owner, name)

        def call(*args: Any, **kwargs: Any) -> Any:
            if self._open[-1][0] in self._closed:
                return function(*args, **kwargs)
            self._open.append((part, 0.0))
            clock = time.thread_time()
            result = function(*args, **kwargs)
            self._close(time.thread_time() - clock)
            return result

        setattr(owner, name, call)

    def _close(self, seconds: float) -> None:
        part, inside = self._open.pop()
        self.spent[part] = self.spent.get(part, 0.0) + seconds - inside
        outer, others = self._open[-1]
        self._open[-1] = outer, others + seconds
