"""Does training in a harder environment make policies of NadirScan-v1 more tolerant of faults?

Usage:
    python benchmarks/difficulty.py [--seconds 90] [--seeds 3] [--episodes 512] [--trainings NAME ...] [--out FILE.json]
        [--figure FILE.png]

The difficulty of an episode is a number from 0, the arguments of the preset, to 1: battery, largest wheel speed and baud rate of
the transmitter shrink, and the disturbance torque grows, see :data:`HARDEST`. Policies are trained at one difficulty, at one that
is drawn for each episode, or by a curriculum whose bound rises with the training, all with the preset's recipe and for the same
time. Each then flies the same fresh episodes at all difficulties, and with faults that no training has: see :data:`FAULTS`.
"""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import harness
from tensordict import TensorDictBase
from torch import Tensor

import bsk_torch
from bsk_torch import rand
from bsk_torch.presets.nadir_scan import BATTERY
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.rules import scan_rule
from bsk_torch.rl.training import configure
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.rl.training.trainer import Training

PRESET = "NadirScan-v1"

HARDEST = {"battery": 0.3, "speed": 0.4, "baud": 0.3, "torque": 5.0}
"""Factors at difficulty 1 on the battery's capacity, the largest wheel speed, the transmitter's baud rate and the disturbance; at
lower ones their power of the difficulty."""

SPEED, BAUD, TORQUE = 6000.0, -50 * 8e6, 1e-4
"""The preset's largest wheel speed, rpm, baud rate, bit/s, and standard deviation of each component of the disturbance, N m."""

CHARGED, FASTEST = (0.3, 1.0), 0.5
"""Bounds of the initial charge, in terms of the battery, and of initial wheel speeds, in terms of the largest one."""

RISE = 0.7
"""Part of the training after which a curriculum has reached all difficulties."""

JUDGED = 2_500_003
"""Seed of the episodes in which policies are compared."""


@dataclass
class Difficulty:
    """Difficulties of episodes: uniform between two bounds, the same for all arguments of an episode."""

    low: float
    high: float

    def of(self, key: rand.Key) -> Tensor:
        """Return the difficulties of the episodes of a key, [n, 1]."""
        return self.low + (self.high - self.low) * key.named("difficulty").uniform(1)

    def factor(self, key: rand.Key, name: str) -> Tensor:
        """Return factors on an argument, [n, 1]."""
        return HARDEST[name] ** self.of(key)


class Drawn(rand.Distribution):
    """Values of an argument by a function of a key that returns [n, 1], or [n, 3]."""

    def __init__(self, of_key: Callable[[rand.Key], Tensor], size: int | None = None) -> None:
        """Draw by ``of_key``; one number if ``size`` is None."""
        self.of_key, self.size = of_key, size

    def draw(self, key: rand.Key) -> Tensor:
        """See :meth:`bsk_torch.rand.Distribution.draw`."""
        values = self.of_key(key)
        return values.squeeze(1) if self.size is None else values


def arguments(difficulty: Difficulty) -> dict[str, Any]:
    """Return the arguments of the satellite that depend on the difficulty."""

    def charge(key: rand.Key) -> Tensor:
        low, high = CHARGED
        return BATTERY * difficulty.factor(key, "battery") * (low + (high - low) * key.uniform(1))

    def speeds(key: rand.Key) -> Tensor:
        return FASTEST * SPEED * difficulty.factor(key, "speed") * (2.0 * key.uniform(3) - 1.0)

    return dict(
        batteryStorageCapacity=Drawn(lambda key: BATTERY * difficulty.factor(key, "battery")),
        storedCharge_Init=Drawn(charge),
        maxWheelSpeed=Drawn(lambda key: SPEED * difficulty.factor(key, "speed")),
        wheelSpeeds=Drawn(speeds, 3),
        transmitterBaudRate=Drawn(lambda key: BAUD * difficulty.factor(key, "baud")),
        disturbance_vector=Drawn(lambda key: TORQUE * difficulty.factor(key, "torque") * key.normal(3), 3),
    )


TRAININGS = {
    "easy": (0.0, 0.0),
    "medium": (0.5, 0.5),
    "hard": (1.0, 1.0),
    "mixed": (0.0, 1.0),
    "curriculum": (0.0, 1.0),
}
"""Bounds of the difficulty in training: one, ``mixed`` for one drawn for each episode, ``curriculum`` for a bound that rises."""

CURRICULUM = "curriculum"

FAULTS: dict[str, dict[str, Any]] = {
    "panel 0.6": dict(panelArea=0.15),
    "torque x 10": dict(disturbance_vector=rand.Normal(0.0, 10 * TORQUE, 3)),
    "wheels 0.3": dict(maxWheelSpeed=0.3 * SPEED, wheelSpeeds=rand.Uniform(-0.15 * SPEED, 0.15 * SPEED, 3)),
    "all three": dict(
        panelArea=0.15,
        disturbance_vector=rand.Normal(0.0, 10 * TORQUE, 3),
        maxWheelSpeed=0.3 * SPEED,
        wheelSpeeds=rand.Uniform(-0.15 * SPEED, 0.15 * SPEED, 3),
    ),
}
"""Arguments, beside those of difficulty 0, of conditions that no training has."""

LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)


def conditions() -> dict[str, dict[str, Any]]:
    """Return the arguments of the satellite under which policies are compared, by name."""
    known = {f"{level:g}": arguments(Difficulty(level, level)) for level in LEVELS}
    return known | {name: arguments(Difficulty(0.0, 0.0)) | fault for name, fault in FAULTS.items()}


class Rising(Training):
    """A training in which the upper bound of the difficulty rises with the used part of the budget."""

    def __init__(self, config: PPOConfig, out: Path, difficulty: Difficulty) -> None:
        """Begin at the lower bound."""
        self.difficulty, self.goal = difficulty, difficulty.high
        difficulty.high = difficulty.low
        super().__init__(config, out)

    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        reached = min(1.0, self.progress.fraction / RISE)
        self.difficulty.high = self.difficulty.low + reached * (self.goal - self.difficulty.low)
        return super()._learn(batch)


def train(name: str, seed: int, options: Any, folder: Path) -> tuple[Any, int]:
    """Return a policy, and the number of decisions that it has learned from."""
    difficulty = Difficulty(*TRAININGS[name])
    sizes = dict(num_envs=options.num_envs, evaluate_every=0) | harness.budget(options)
    world = dict(sat_args=arguments(difficulty), time_limit=options.time_limit, backend=options.backend)
    config = configure(PRESET, seed=seed, **sizes, options=world)  # type: ignore[arg-type]
    training = Rising(config, folder, difficulty) if name == CURRICULUM else Training(config, folder)
    policy = training.run()
    return policy, training.progress.frames


def judge(make_policy: Callable[[Any], Any], options: Any) -> dict[str, dict[str, float]]:
    """Return survival and return by condition of what ``make_policy`` returns for an environment."""
    found = {}
    for name, sat_args in conditions().items():
        env = bsk_torch.make(
            PRESET, num_envs=options.episodes, sat_args=sat_args, time_limit=options.time_limit, backend=options.backend
        )
        result = evaluate(make_policy(env), env, seed=JUDGED)
        found[name] = {"survival": result.survival, "return": result.mean_return.mean, "half": result.mean_return.half_width}
    return found


def shown(rows: list[dict[str, dict[str, float]]], condition: str, what: str) -> str:
    """Return the entry of a table: mean, least and largest value of several trainings under a condition."""
    return harness.of_seeds([row[condition][what] for row in rows], "{:.1%}" if what == "survival" else "{:.3f}")


def draw(found: dict[str, list[dict[str, dict[str, float]]]], path: Path) -> None:
    """Draw survival and return of all trainings under all conditions."""
    from bsk_torch.viz.figures import style

    figure, panels = style.panels([2.6, 2.6])
    names = list(conditions())
    for panel, what, title in zip(panels, ("survival", "return"), ("fraction of episodes survived", "return"), strict=True):
        for k, (name, rows) in enumerate(found.items()):
            values = [[row[condition][what] for row in rows] for condition in names]
            places = [x + 0.12 * (k - len(found) / 2) for x in range(len(names))]
            color = style.PALETTE[k % len(style.PALETTE)]
            panel.vlines(places, [min(each) for each in values], [max(each) for each in values], color=color, linewidth=1.5)
            panel.plot(places, [statistics.fmean(each) for each in values], "o", color=color, markersize=4, label=name)
        panel.axvline(len(LEVELS) - 0.5, color="0.7", linewidth=0.8)
        panel.set_xticks(range(len(names)), names)
        style.label(panel, title)
    panels[0].legend(title="training", fontsize=7, title_fontsize=7, loc="lower left", frameon=False)
    panels[-1].set_xlabel("difficulty, and faults that no training has, at difficulty 0")
    style.save(figure, path)


def main() -> None:
    """Train, compare, and print two tables."""
    parsed = harness.parser(__doc__, seconds=90.0, seeds=3, episodes=512, num_envs=1024, frames=0, time_limit=28_500.0)
    parsed.add_argument("--trainings", nargs="+", choices=TRAININGS, default=list(TRAININGS), metavar="NAME")
    parsed.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    parsed.add_argument("--figure", type=Path, metavar="FILE.png", help="needs the extra viz")
    options, described = harness.begin(parsed)
    found: dict[str, list[dict[str, dict[str, float]]]] = {}
    frames: dict[str, list[int]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in options.trainings:
            trained = [train(name, seed, options, Path(folder) / f"{name}-{seed}") for seed in range(options.seeds)]
            found[name] = [judge(lambda env, policy=policy: policy, options) for policy, _ in trained]
            frames[name] = [count for _, count in trained]
    found["a rule"] = [judge(scan_rule, options)]
    for what in ("survival", "return"):
        columns = {"training": "{name}"} | {condition: f"{{at_{k}}}" for k, condition in enumerate(conditions())}
        rows = [
            {"name": name} | {f"at_{k}": shown(results, condition, what) for k, condition in enumerate(conditions())}
            for name, results in found.items()
        ]
        print(f"{what}\n\n{harness.table(columns, rows)}\n")
    if options.figure:
        draw(found, options.figure)
    harness.write(options, described, found=found, frames=frames)


if __name__ == "__main__":
    main()
