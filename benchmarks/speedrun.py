"""Time of a training until its policy reaches a threshold: a table of records to which anyone can add a row.

Usage:
    python benchmarks/speedrun.py --preset NadirScan-v1 [--threshold "survival 0.945"] [--network mlp] [--seeds 0 1 2]
        [--seconds 180 | --frames 0] [--every 0] [--episodes 1024] [--screened 256] [--settings NAME=VALUE ...]
        [--name "the recipe"] [--out benchmarks/results/records.json] [--figure FILE.png]

Trains as ``bsk-torch train`` does, with the preset's recipe for ``--network`` and changed ``--settings``, once for each seed.
The clock starts after compilation, when the first decision is made. After the first batch that completes another ``--every``
decisions (0: after every batch), the clock stops, and the current policy plays ``--screened`` episodes of validation. If it
reaches the threshold there, it is judged in ``--episodes`` fresh episodes, which are used neither in training nor in validation.
The first policy that reaches the threshold there ends the training. It is evaluated once more in as many other episodes, because
the first success of several is a selection: this result is reported, whether or not it reaches the threshold.

Thresholds:
    "survival 0.945"   part of the episodes in which all satellites survive
    "return 0.75"      mean return
    "hasty + 3"        mean gain over a rule in the same episodes
    "beyond hasty"     a gain whose 95 % confidence interval lies above zero

Core-seconds are those of all processes, without Ray's. While batches are collected ahead, the clock runs until the batch in
progress is complete. The limit (``--seconds`` or ``--frames``) also sets the schedule of the learning rate. ``--out`` adds the
row to the rows in the file, in place of the one with the same task, threshold, name and processor. ``--figure`` draws validation
over both times of all rows in the file with this task and threshold.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import harness

from bsk_torch.env import Tasking
from bsk_torch.rl.evaluation.evaluate import FRESH, Evaluation, evaluate
from bsk_torch.rl.marl.runs import configure, training_of
from bsk_torch.rl.policies.shared_policy import rule, shared
from bsk_torch.rl.training import override
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.rl.training.trainer import VALIDATION, Training

THRESHOLDS = {
    "NadirScan-v1": "beyond cautious",
    "AEOS-v1": "hasty + 3",
    "AEOSPower-v1": "beyond hasty",
    "AEOSCity-v1": "beyond hasty",
    "CloudyAEOS-v1": "beyond hasty",
    "AEOSConstellation-v1": "beyond hasty",
}
"""The gain over the rule that published policies have, or any gain over the best rule."""

REPORT = 3 * FRESH
"""Added to a seed, the seed of the episodes that are reported; no other episodes have it."""

KEY = ("task", "threshold", "name", "processor")
"""What tells the rows of a file of records apart."""

SHAPES = '"survival 0.945", "return 0.75", "hasty + 3" or "beyond hasty"'

COLUMNS = {
    "task": "{task}",
    "threshold": "{threshold}",
    "trained by": "{name}",
    "reached": "{reached}",
    "in other episodes": "{reported}",
    "wall s": "{wall}",
    "core-s": "{core}",
    "decisions": "{decisions}",
}


@dataclass(frozen=True)
class Threshold:
    """What a policy must reach: ``least`` of ``measure``, which is ``"survival"``, ``"return"`` or the gain over a rule.

    ``least`` is None for a gain that is larger than zero beyond chance.
    """

    measure: str
    least: float | None

    @classmethod
    def of(cls, text: str) -> Threshold:
        """Read a threshold; ValueError for another form."""
        match text.replace("+", " + ").split():
            case ["beyond", name]:
                return cls(name, None)
            case [("survival" | "return") as name, least]:
                return cls(name, float(least))
            case [name, "+", least]:
                return cls(name, float(least))
        raise ValueError(f"threshold {text!r} must read {SHAPES}")

    @property
    def rule(self) -> str | None:
        """The rule to compare with; None for none."""
        return None if self.measure in ("survival", "return") else self.measure

    def judged(self, result: Evaluation, compared: Evaluation | None) -> tuple[float, float]:
        """Return the value of the measure and half the width of its 95 % confidence interval."""
        if self.measure == "survival":
            low, high = result.survival_interval
            return result.survival, 0.5 * (high - low)
        estimate = result.mean_return if compared is None else result.gain_over(compared)
        return estimate.mean, estimate.half_width

    def reached(self, value: float, half: float) -> bool:
        """Return whether such a value suffices."""
        return value > half if self.least is None else value >= self.least


class Court:
    """Episodes in which policies are judged, and what the rule returns in them."""

    def __init__(self, config: PPOConfig, threshold: Threshold, seed: int, episodes: int) -> None:
        """Play the rule, if the threshold compares with one."""
        self.env: Tasking = config.make_env(0, episodes)
        self.threshold, self.seed = threshold, seed
        named = threshold.rule
        self.compared = evaluate(rule(named, self.env, config.seed), self.env, seed=seed) if named else None

    def judge(self, policy: Any) -> tuple[float, float]:
        """Return the measure of a policy, and half the width of its interval."""
        return self.threshold.judged(evaluate(shared(policy, self.env), self.env, seed=self.seed), self.compared)


def core_seconds() -> float:
    """CPU time of this process and of those that collect for it, s."""
    ticks = 0
    for child in multiprocessing.active_children():
        fields = Path(f"/proc/{child.pid}/stat").read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])
    return time.process_time() + ticks / os.sysconf("SC_CLK_TCK")


class Watch:
    """Looks at a training after its batches, until its policy reaches the threshold."""

    def __init__(self, run: Training, screen: Court, final: Court, every: int) -> None:
        """Look every so many decisions."""
        self.run, self.screen, self.final, self.every = run, screen, final, max(every, 1)
        self.looked, self.core = 0, 0.0
        self.judging = {"seconds": 0.0, "core_seconds": 0.0}
        self.curve: list[dict[str, float]] = []
        self.verdict: tuple[float, float] | None = None

    def __call__(self) -> bool:
        """Return whether the threshold is reached; called at the start, too."""
        progress, core, begin = self.run.progress, core_seconds(), time.perf_counter()
        if not progress.frames:
            self.core = core
        if progress.frames // self.every == self.looked // self.every:
            return False
        self.looked = progress.frames
        used = {"seconds": progress.seconds, "core_seconds": core - self.core, "decisions": progress.frames}
        reached = self._judge(used)
        elsewhere = core_seconds() - core
        self.core += elsewhere
        self.judging["seconds"] += time.perf_counter() - begin
        self.judging["core_seconds"] += elsewhere
        return reached

    def _judge(self, used: dict[str, float]) -> bool:
        """Judge the policy as it is, and add it to the curve."""
        value, half = self.screen.judge(self.run.policy)
        self.curve.append(used | {"value": value, "half": half})
        said = f"{used['seconds']:.1f} s, {used['decisions']:,} decisions: {value:.3f} +- {half:.3f}"
        reached = self.screen.threshold.reached(value, half)
        if reached:
            self.verdict = self.final.judge(self.run.policy)
            reached = self.final.threshold.reached(*self.verdict)
            said += "; in fresh episodes {:.3f} +- {:.3f}".format(*self.verdict)
        print(said, flush=True)
        return reached


def run_seed(options: argparse.Namespace, threshold: Threshold, seed: int) -> dict[str, Any]:
    """Train with a seed; what the first policy that reached the threshold took, or all of the budget."""
    print(f"{options.preset}, {options.threshold}, seed {seed}", flush=True)
    common = dict(seed=seed, evaluate_every=0, checkpoint_every=0, **harness.budget(options))
    config = override(configure(options.preset, options.network or None, **common), options.settings)
    screen = Court(config, threshold, seed + VALIDATION, options.screened)
    final = Court(config, threshold, seed + FRESH, options.episodes)
    with tempfile.TemporaryDirectory() as folder:
        run = training_of(config, Path(folder) / "run")
        watch = Watch(run, screen, final, options.every)
        run.run(bar=False, enough=watch)
    if not watch.curve:
        raise SystemExit(
            f"no policy was judged in {run.progress.frames} decisions: choose a smaller --every or a longer training"
        )
    *_, last = watch.curve
    value, half = watch.verdict or (last["value"], last["half"])
    report = Court(config, threshold, seed + REPORT, options.episodes).judge(run.policy)
    print("reported, in other episodes: {:.3f} +- {:.3f}".format(*report), flush=True)
    return {
        "seed": seed,
        "reached": watch.verdict is not None and threshold.reached(value, half),
        **{name: last[name] for name in ("seconds", "core_seconds", "decisions")},
        "value": value,
        "half": half,
        "report": dict(zip(("value", "half"), report, strict=True)),
        "judging": watch.judging,
        "curve": watch.curve,
    }


def shown(row: Mapping[str, Any]) -> dict[str, str]:
    """Return the entries of a row of the table: of each seed, the time until the threshold was reached, or a dash."""
    runs = row["runs"]
    times = {
        "wall": [f"{run['seconds']:.1f}" if run["reached"] else "-" for run in runs],
        "core": [f"{run['core_seconds']:.1f}" if run["reached"] else "-" for run in runs],
        "decisions": [f"{run['decisions']:,}" if run["reached"] else "-" for run in runs],
    }
    count = sum(run["reached"] for run in runs)
    reports = [run["report"] for run in runs if "report" in run]  # which older rows lack
    return {
        **{name: str(row[name]) for name in KEY},
        "reached": f"{count} of {len(runs)}",
        "reported": " / ".join(f"{report['value']:.3f} +- {report['half']:.3f}" for report in reports) or "-",
        **{name: " / ".join(entries) for name, entries in times.items()},
    }


def add(path: Path, row: dict[str, Any]) -> list[dict[str, Any]]:
    """Write a row into a file of records, in place of an earlier one of the same :data:`KEY`; all rows."""
    rows: list[dict[str, Any]] = json.loads(path.read_text())["rows"] if path.exists() else []
    kept = [each for each in rows if any(each[name] != row[name] for name in KEY)]
    rows = sorted([*kept, row], key=lambda each: (each["task"], each["threshold"]))
    path.write_text(json.dumps({"rows": rows}, indent=1, default=str) + "\n")
    return rows


def draw(rows: Sequence[Mapping[str, Any]], threshold: Threshold, path: Path) -> None:
    """Draw validation of each seed over wall time and over core-seconds, a color for each row."""
    from bsk_torch.viz.figures import style

    figure, panels = style.panels([2.8, 2.8])
    for panel, clock in zip(panels, ("seconds", "core_seconds"), strict=True):
        for row, color in zip(rows, itertools.cycle(style.PALETTE), strict=False):
            for run in row["runs"]:
                times, values = ([point[name] for point in run["curve"]] for name in (clock, "value"))
                first = run is row["runs"][0]
                panel.plot(times, values, "o-", markersize=3, linewidth=1.4, color=color, label=row["name"] if first else None)
        panel.axhline(threshold.least or 0.0, color="0.5", linewidth=0.8)
        style.label(panel, threshold.measure if threshold.rule is None else f"gain over {threshold.rule}")
        style.caption(panel, "over wall time" if clock == "seconds" else "over core-seconds")
    panels[0].legend(frameon=False, fontsize=9)
    panels[1].set_xlabel("time, s", color=style.INK, fontsize=9.5)
    panels[1].set_xlim(left=0.0)
    style.headline(figure, f"{rows[0]['task']}: validation until {rows[0]['threshold']}")
    style.save(figure, path)


def main() -> None:
    """Train, judge, print a table, and add the row to the records."""
    sizes = dict(seeds=[0, 1, 2], seconds=180.0, frames=0, every=0, episodes=1024, screened=256)
    parsed = harness.parser(__doc__, preset="NadirScan-v1", threshold="", network="", name="", **sizes)
    parsed.add_argument("--settings", nargs="+", default=[], metavar="NAME=VALUE", help="settings that differ from the recipe")
    parsed.add_argument("--figure", type=Path, metavar="FILE.png", help="needs the extra viz")
    options, described = harness.begin(parsed)
    options.threshold = options.threshold or THRESHOLDS.get(options.preset, "")
    try:
        threshold = Threshold.of(options.threshold)
    except ValueError as error:
        parsed.error(str(error))
    row = {
        "task": options.preset,
        "threshold": options.threshold,
        "name": options.name or " ".join(["recipe", *options.settings]),
        "processor": described["processor"],
        "date": f"{datetime.now(timezone.utc):%Y-%m-%d}",
        "machine": described,
        "options": harness.given(options),
        "runs": [run_seed(options, threshold, seed) for seed in options.seeds],
    }
    print(harness.table(COLUMNS, [shown(row)]))
    rows = add(options.out, row) if options.out else [row]
    if options.figure:
        draw([each for each in rows if all(each[name] == row[name] for name in KEY[:2])], threshold, options.figure)


if __name__ == "__main__":
    main()
