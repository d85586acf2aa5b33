"""What are forecasts of clouds worth: policies of CloudyAEOS-v1 that see none, their mean, and their mean and spread.

Usage:
    python benchmarks/clouds.py [--seconds 150] [--seeds 3] [--episodes 512] [--worlds NAME ...] [--views NAME ...]
        [--out FILE.json] [--figure FILE.png]

Only images without clouds pay. Clouds differ by how far forecasts are off, see :data:`WORLDS`; policies by what they see of them,
see :data:`VIEWS`, all trained with the preset's recipe and for the same time. A rule of the package flies beside each: ``hasty``,
which sees no clouds, and the same with the chance of a clear image as a part of each target's worth.
"""

from __future__ import annotations

import math
import statistics
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import harness
import torch
from torch import Tensor

import bsk_torch
from bsk_torch import obs, rand, scene
from bsk_torch.env import SatelliteTasking
from bsk_torch.presets import PRESETS
from bsk_torch.presets.aeos import CLOUDS, SATELLITE, AgileSatellite, agile_args, agile_environment, targets_ahead
from bsk_torch.rl.evaluation.evaluate import Evaluation, evaluate
from bsk_torch.rl.rules.baselines import BASELINES, imaging_rule
from bsk_torch.rl.rules.imaging import by_discounted_priority
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.rl.training.recipes import RECIPES
from bsk_torch.rl.training.trainer import Training

PRESET = "CloudyAEOS-v1"

WORLDS = {"good": (0.01, 0.05), "poor": (0.0, 0.6)}
"""Bounds of the standard deviation of forecasts, drawn for each target: bsk_rl's, and one in which many mean little."""

JUDGED = 2_700_003
"""Seed of the episodes in which policies are compared."""

THRESHOLD = 0.7
"""Largest cloud cover of an image that pays."""


def cloud_sigma(satellite: Any, targets: Any) -> Tensor:
    """Return the standard deviation of the forecast over each target, [N, n]."""
    return satellite.simulator.look_up(satellite.scenario.cloud_forecast_sigma, targets.place)


SPREAD = dict(fn=cloud_sigma, name="cloud_sigma")

VIEWS: dict[str, tuple[dict[str, Any], ...]] = {"nothing": (), "mean": (CLOUDS,), "mean and spread": (CLOUDS, SPREAD)}
"""What is observed of the clouds over each target."""

RULE, CHANCE = "hasty", "hasty by chance"
"""The rule ``hasty``, which sees no clouds, and with the chance of a clear image in the worth of targets."""


def satellite_seeing(view: str, as_set: bool) -> type[AgileSatellite]:
    """Return the class of a satellite with a view of the clouds."""
    parts: list[obs.Observation] = [obs.SatProperties(*SATELLITE), targets_ahead(*VIEWS[view], as_set=as_set), obs.Time()]
    return type("CloudWatcher", (AgileSatellite,), {"observation_spec": parts})


def preset_of(world: str, view: str) -> Callable[..., SatelliteTasking]:
    """Return a function like a preset, of CloudyAEOS-v1 with other forecasts and another view."""

    def make(*, as_set: bool = False, **options: Any) -> SatelliteTasking:
        targets = scene.UniformTargets(options.pop("n_targets", 1000))
        clouds = dict(
            scenario=scene.CloudyTargets(targets, forecast_sigma=rand.Uniform(*WORLDS[world])),
            rewarder=bsk_torch.data.CloudFreeImageReward(THRESHOLD),
        )
        kinds = satellite_seeing(view, False), satellite_seeing(view, True)
        return agile_environment(kinds, agile_args(), as_set, clouds | options)

    return make


def chance_of_clear(see: Any, observation: Any) -> Tensor:
    """Return about how probable a clear image is, [N, n]: ``P(forecast + sigma n <= threshold)`` with n standard normal."""
    forecast, sigma = (see.read(observation, name) for name in ("cloud_forecast", "cloud_sigma"))
    z = (THRESHOLD - forecast) / sigma.clamp(min=1e-3)
    return 0.5 * (1.0 + torch.erf(z / math.sqrt(2.0)))


def by_chance(see: Any, observation: Any) -> Tensor:
    """Return the worth of targets, [N, n]: that of the rule ``hasty`` times the chance of a clear image."""
    worth = by_discounted_priority(see, observation)
    return torch.where(worth > 0.0, worth * chance_of_clear(see, observation), worth)  # targets that will be gone stay last


def train(name: str, seed: int, options: Any, folder: Path) -> tuple[Any, int]:
    """Return a policy, and the number of decisions that it has learned from."""
    limits = dict(seconds=None, frames=options.frames) if options.frames else dict(seconds=options.seconds)
    recipe = RECIPES[PRESET]["attention"] | dict(num_envs=options.num_envs, evaluate_every=0) | limits
    world = dict(as_set=True, time_limit=options.time_limit, backend=options.backend)
    training = Training(PPOConfig(name, network="attention", seed=seed, options=world, **recipe), folder)
    policy = training.run()
    return policy, training.progress.frames


def judge(make_policy: Callable[[SatelliteTasking], Any], name: str, options: Any) -> Evaluation:
    """Fly the episodes of the comparison."""
    env = bsk_torch.make(name, num_envs=options.episodes, as_set=True, time_limit=options.time_limit, backend=options.backend)
    return evaluate(make_policy(env), env, seed=JUDGED)


def summary(found: Evaluation, beside: Evaluation, frames: int) -> dict[str, Any]:
    """Return what is written down: return, half width of its interval, and the gain over the rule that sees no clouds."""
    gain = found.gain_over(beside)
    return {
        "return": found.mean_return.mean,
        "half": found.mean_return.half_width,
        "gain": gain.mean,
        "gain_half": gain.half_width,
        "frames": frames,
    }


def study(world: str, options: Any, folder: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the results in one world by policy: one for each seed of a training, one for each rule."""
    for view in VIEWS:
        PRESETS[f"Clouds-{world}-{view}"] = preset_of(world, view)
    widest = f"Clouds-{world}-mean and spread"
    hasty = judge(lambda env: BASELINES[RULE](env, 0), widest, options)
    chance = judge(lambda env: imaging_rule(by_chance)(env, 0), widest, options)
    found = {RULE: [summary(hasty, hasty, 0)], CHANCE: [summary(chance, hasty, 0)]}
    for view in options.views:
        name, rows = f"Clouds-{world}-{view}", []
        for seed in range(options.seeds):
            policy, frames = train(name, seed, options, folder / f"{world}-{view}-{seed}")
            rows.append(summary(judge(lambda env, policy=policy: policy, name, options), hasty, frames))  # type: ignore[misc]
        found[view] = rows
    return found


def shown(rows: list[dict[str, Any]]) -> dict[str, str]:
    """Return the entries of a row of the table."""
    returns = [row["return"] for row in rows]
    mean = f"{statistics.fmean(returns):.2f}"
    gains = ", ".join(f"{row['gain']:+.2f} ± {row['gain_half']:.2f}" for row in rows)
    return {"mean": mean if len(rows) == 1 else f"{mean} ({min(returns):.2f} to {max(returns):.2f})", "gains": gains}


def draw(found: Mapping[str, Mapping[str, list[dict[str, Any]]]], path: Path) -> None:
    """Draw the gain over the rule that sees no clouds, of each seed by what it sees, a panel for each world."""
    from bsk_torch.viz.figures import style

    figure, panels = style.panels([2.2] * len(found))
    for panel, (world, rows) in zip(panels, found.items(), strict=True):
        names = [name for name in rows if name != RULE]
        for k, name in enumerate(names):
            places = [k + 0.08 * (n - 0.5 * (len(rows[name]) - 1)) for n in range(len(rows[name]))]
            gains, halves = ([row[key] for row in rows[name]] for key in ("gain", "gain_half"))
            panel.errorbar(places, gains, halves, fmt="o", markersize=4, color=style.PALETTE[k % len(style.PALETTE)])
        panel.axhline(0.0, color="0.5", linewidth=0.8)
        panel.set_xticks(range(len(names)), names)
        panel.set_xlim(-0.5, len(names) - 0.5)
        style.label(panel, f"gain, {world} forecasts")
    style.save(figure, path)


def main() -> None:
    """Train, compare, and print a table."""
    parsed = harness.parser(__doc__, seconds=150.0, seeds=3, episodes=512, num_envs=256, frames=0, time_limit=17_100.0)
    parsed.add_argument("--worlds", nargs="+", choices=WORLDS, default=list(WORLDS), metavar="NAME")
    parsed.add_argument("--views", nargs="+", choices=VIEWS, default=list(VIEWS), metavar="NAME")
    parsed.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    parsed.add_argument("--figure", type=Path, metavar="FILE.png", help="needs the extra viz")
    options, described = harness.begin(parsed)
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for world in options.worlds:
            found[world] = study(world, options, Path(folder))
    columns = {"forecasts": "{world}", "policy": "{name}", "return (seeds)": "{mean}", "gain over hasty, each seed": "{gains}"}
    rows = [{"world": world, "name": name} | shown(parts) for world, by in found.items() for name, parts in by.items()]
    print(harness.table(columns, rows))
    if options.figure:
        draw(found, options.figure)
    harness.write(options, described, found=found)


if __name__ == "__main__":
    main()
