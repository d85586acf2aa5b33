"""What are forecasts of clouds worth: policies of CloudyAEOS-v1 that see none, the mean, mean and spread, or may repeat images.

Usage:
    python benchmarks/clouds.py [--seconds 150] [--seeds 3] [--episodes 512] [--worlds NAME ...] [--views NAME ...]
        [--out FILE.json] [--figure FILE.png]

Only images without clouds pay. Clouds differ by how far forecasts are off and by whether they move, see :data:`WORLDS`; policies
by what they see of them, see :data:`VIEWS`, all trained with the preset's recipe and for the same time. A rule of the package
flies beside each: ``hasty``, which sees no clouds, and the same with the chance of a clear image as a part of targets' worth.

Where clouds move, images may be repeated, see :class:`BeliefReward`. Policies with the view ``repeats`` observe the belief that a
target has been seen without clouds; no satellite is told what an image shows.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import harness
import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

import bsk_torch
from bsk_torch import rand, scene
from bsk_torch.data import CloudFreeImageReward, ImageReward
from bsk_torch.env import SatelliteTasking
from bsk_torch.presets import PRESETS
from bsk_torch.presets.aeos import CLOUDS, ORBIT, AgileSatellite, agile_args, agile_environment, imagers, looking_ahead
from bsk_torch.rl.evaluation.evaluate import Evaluation, evaluate
from bsk_torch.rl.rules.baselines import BASELINES
from bsk_torch.rl.rules.imaging import ImagingRule, Worth, by_discounted_priority, ranking_rule
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.rl.training.recipes import RECIPES
from bsk_torch.rl.training.trainer import Training

PRESET = "CloudyAEOS-v1"

WORLDS = {"good": (0.01, 0.05), "poor": (0.0, 0.6), "moving": (0.0, 0.6)}
"""Bounds of the standard deviation of forecasts, drawn for each target: bsk_rl's, and one in which many mean little. Clouds stay
in these; in ``moving`` they are those of :class:`MovingClouds`."""

MOVING = "moving"

JUDGED = 2_700_003
"""Seed of the episodes in which policies are compared."""

THRESHOLD = 0.7
"""Largest cloud cover of an image that pays."""


STAY = 1800.0
"""Seconds for which clouds stay what they are in the world in which they move."""

ENOUGH = 0.95
"""Belief from which on a target needs no image any more."""


# -- clouds that move, and images that are repeated ----------------------------------------------------------------------------


def chance_of_clear(forecast: Tensor, sigma: Tensor) -> Tensor:
    """Return about how probable a clear image is: ``P(forecast + sigma n <= threshold)`` with n standard normal."""
    z = (THRESHOLD - forecast) / sigma.clamp(min=1e-3)
    return 0.5 * (1.0 + torch.erf(z / math.sqrt(2.0)))


class MovingClouds(scene.CloudyTargets):
    """Targets whose cloud cover, and its forecast, are others every half hour; when they change differs between targets.

    Covers and errors are drawn as those of :class:`bsk_torch.scene.CloudyTargets`, whose own are not used; a target keeps its
    standard deviation. The forecasts of all half hours are known from the beginning.
    """

    def __init__(self, targets: scene.UniformTargets, bounds: tuple[float, float], time_limit: float) -> None:
        """``bounds`` are those of the forecasts' standard deviation; episodes last at most ``time_limit`` s."""
        super().__init__(targets, forecast_sigma=rand.Uniform(*bounds))
        self.changes = math.ceil(time_limit / STAY) + 1

    def draw(self, key: rand.Key) -> dict[str, Tensor]:
        """Draw ``covers`` and ``forecasts``, [n, T, changes], and ``since_change``, [n, T] s at reset, too."""
        drawn, t = super().draw(key), self.most_targets
        covers = (1.348 * key.named("covers").uniform(t * self.changes).view(len(key), t, -1)).clamp(max=1.0)
        errors = key.named("forecasts").normal(t * self.changes).view(len(key), t, -1)
        forecasts = (covers + drawn["cloud_forecast_sigma"].unsqueeze(2) * errors).clamp(0.0, 1.0)
        since_change = STAY * key.named("since_change").uniform(t)
        return drawn | {"covers": covers, "forecasts": forecasts, "since_change": since_change}

    def _bounds(self) -> dict[str, tuple[float, float]]:
        """See :meth:`Scenario._bounds`."""
        return super()._bounds() | {"covers": (0.0, 1.0), "forecasts": (0.0, 1.0), "since_change": (0.0, STAY)}

    def at(self, table: Tensor, since_change: Tensor, time: Tensor) -> Tensor:
        """Return the entries of a table [..., changes] at ``time`` [...] s since reset, [...]."""
        number = ((time + since_change) / STAY).long().clamp(max=self.changes - 1)
        return table.gather(-1, number.unsqueeze(-1)).squeeze(-1)

    def now(self, name: str) -> Tensor:
        """Return the drawn values of a name, ``covers`` or ``forecasts``, at present, [N, T]."""
        since_change = self.drawn("since_change")
        return self.at(self.drawn(name), since_change, self.fleet.sim_time.unsqueeze(1).expand_as(since_change))

    @property
    def cloud_cover(self) -> Tensor:
        """Present true cover, [N, T]."""
        return self.now("covers")

    @property
    def cloud_forecast(self) -> Tensor:
        """Forecast for the present, [N, T]."""
        return self.now("forecasts")


class BeliefReward(ImageReward):
    """Pays for the first image of every target without clouds; images may be repeated, and what they show is not told.

    With the chance c_k of a clear image by the forecast at the time of image k, the belief that some image is clear is
    ``1 - prod_k (1 - c_k)``. Targets are hidden from :data:`ENOUGH` on, and after an image while their clouds stay. The counter
    ``repeated`` [N, 1] is the number of images of targets that had one.
    """

    def link(self, scenario: Any, fleet: Any) -> None:
        """Declare beliefs, times of the last images, and which targets have been seen without clouds."""
        super().link(scenario, fleet)
        for name, initial in (("belief", 0.0), ("imaged_at", -math.inf)):
            self.memory.declare(name, initial, scenario.most_targets)
        self.memory.declare("seen", 0, scenario.most_targets, dtype=torch.bool)
        self.memory.declare("repeated", 0, fleet.size)

    def counts(self) -> dict[str, Tensor]:
        """See the class."""
        return {"repeated": self.memory["repeated"]}

    def selectable(self) -> Tensor:
        """Targets that have probably not been seen, and whose clouds have changed since the last image, [N, 1, T]."""
        stays = self.fleet.sim_time.unsqueeze(1) - self.memory["imaged_at"] < STAY
        return (self.scenario.available & (self.memory["belief"] < ENOUGH) & ~stays).unsqueeze(1)

    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        """Return the reward [N, 1] and update the beliefs."""
        scenario, memory = self.scenario, self.memory
        known = scenario.priority, scenario.cloud_cover, scenario.cloud_forecast, scenario.cloud_forecast_sigma
        priority, cover, forecast, sigma = (table.gather(1, target) for table in known)
        belief, imaged_at, seen = (memory[name].gather(1, target) for name in ("belief", "imaged_at", "seen"))
        clear = taken & (cover <= THRESHOLD)
        after = 1.0 - (1.0 - belief) * (1.0 - chance_of_clear(forecast, sigma))
        now = self.fleet.sim_time.unsqueeze(1)
        memory["repeated"] = memory["repeated"] + (taken & (imaged_at >= 0.0))
        memory["belief"] = memory["belief"].scatter(1, target, torch.where(taken, after, belief))
        memory["imaged_at"] = memory["imaged_at"].scatter(1, target, torch.where(taken, now, imaged_at))
        memory["seen"] = memory["seen"].scatter(1, target, seen | clear)
        return torch.where(clear & ~seen, priority, 0.0)


# -- what policies see ---------------------------------------------------------------------------------------------------------


def cloud_sigma(satellite: Any, targets: Any) -> Tensor:
    """Return the standard deviation of the forecast over each target, [N, n]."""
    return satellite.simulator.look_up(satellite.scenario.cloud_forecast_sigma, targets.place)


def coming_forecast(satellite: Any, targets: Any) -> Tensor:
    """Return the forecast of moving clouds over each target for the opening of its window, or for now if it is open, [N, n]."""
    clouds, simulator = satellite.scenario, satellite.simulator
    forecasts, since_change = (simulator.look_up(clouds.drawn(name), targets.place) for name in ("forecasts", "since_change"))
    return clouds.at(forecasts, since_change, torch.maximum(targets.open, simulator.sim_time.unsqueeze(1)))


def belief(satellite: Any, targets: Any) -> Tensor:
    """Return the belief that each target has been seen without clouds, [N, n]."""
    return satellite.simulator.look_up(satellite.rewarder.memory["belief"], targets.place)


SPREAD = dict(fn=cloud_sigma, name="cloud_sigma")

COMING = dict(prop="cloud_forecast", fn=coming_forecast)

BELIEF = dict(fn=belief, name="belief")

REPEATS = "repeats"

VIEWS: dict[str, tuple[dict[str, Any], ...]] = {
    "nothing": (),
    "mean": (CLOUDS,),
    "mean and spread": (CLOUDS, SPREAD),
    REPEATS: (CLOUDS, SPREAD, BELIEF),
}
"""What is observed of the clouds over each target. :data:`REPEATS` is for clouds that move: others show the same again."""

RULE, CHANCE, REPEATING = "hasty", "hasty by chance", "hasty by chance, repeats"
"""The rule ``hasty``, which sees no clouds; with the chance of a clear image in the worth of targets; and of the first such."""


def preset_of(world: str, view: str) -> Callable[..., SatelliteTasking]:
    """Return a function like a preset, of CloudyAEOS-v1 with other clouds and another view."""

    def make(*, as_set: bool = False, **options: Any) -> SatelliteTasking:
        targets, bounds = scene.UniformTargets(options.pop("n_targets", 1000)), WORLDS[world]
        clouds = scene.CloudyTargets(targets, forecast_sigma=rand.Uniform(*bounds))
        if world == MOVING:
            clouds = MovingClouds(targets, bounds, options.get("time_limit", 3 * ORBIT))
        rewarder = BeliefReward() if view == REPEATS else CloudFreeImageReward(THRESHOLD)
        seen = [COMING if world == MOVING and part is CLOUDS else part for part in VIEWS[view]]
        options = dict(scenario=clouds, rewarder=rewarder) | options
        (satellite,) = imagers(AgileSatellite, ["EO1"], agile_args(), options, **looking_ahead(*seen, as_set=as_set))
        return agile_environment(satellite, options)

    return make


def views_of(world: str, views: list[str]) -> list[str]:
    """Return the views that make sense in a world."""
    return [view for view in views if view != REPEATS or world == MOVING]


# -- rules, trainings and comparisons ------------------------------------------------------------------------------------------


def by_chance(see: Any, observation: Any) -> Tensor:
    """Return the worth of targets, [N, n]: that of the rule ``hasty`` times the chance of a clear image."""
    worth = by_discounted_priority(see, observation)
    chance = chance_of_clear(*(see.read(observation, name) for name in ("cloud_forecast", "cloud_sigma")))
    return torch.where(worth > 0.0, worth * chance, worth)  # targets that will be gone stay last


def by_first_chance(see: Any, observation: Any) -> Tensor:
    """Return the worth of targets, [N, n]: that of :func:`by_chance` times the belief that no image has been clear."""
    worth = by_chance(see, observation)
    return torch.where(worth > 0.0, worth * (1.0 - see.read(observation, "belief")), worth)


def ranked(worth: Worth, env: SatelliteTasking) -> TensorDictModule:
    """Return the rule that images the target with the largest ``worth``."""
    return ranking_rule(partial(ImagingRule.of, worth=worth))(env, 0)


def train(name: str, seed: int, options: Any, folder: Path) -> tuple[Any, int]:
    """Return a policy, and the number of decisions that it has learned from."""
    recipe = RECIPES[PRESET]["attention"] | dict(num_envs=options.num_envs, evaluate_every=0) | harness.budget(options)
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
    for view in views_of(world, list(VIEWS)):
        PRESETS[f"Clouds-{world}-{view}"] = preset_of(world, view)
    widest = f"Clouds-{world}-mean and spread"
    hasty = judge(lambda env: BASELINES[RULE](env, 0), widest, options)
    chance = judge(lambda env: ranked(by_chance, env), widest, options)
    found = {RULE: [summary(hasty, hasty, 0)], CHANCE: [summary(chance, hasty, 0)]}
    if world == MOVING:
        again = judge(lambda env: ranked(by_first_chance, env), f"Clouds-{world}-{REPEATS}", options)
        found[REPEATING] = [summary(again, hasty, 0)]
    for view in views_of(world, options.views):
        name, rows = f"Clouds-{world}-{view}", []
        for seed in range(options.seeds):
            policy, frames = train(name, seed, options, folder / f"{world}-{view}-{seed}")
            rows.append(summary(judge(lambda env, policy=policy: policy, name, options), hasty, frames))  # type: ignore[misc]
        found[view] = rows
    return found


def shown(rows: list[dict[str, Any]]) -> dict[str, str]:
    """Return the entries of a row of the table."""
    gains = ", ".join(f"{row['gain']:+.2f} ± {row['gain_half']:.2f}" for row in rows)
    return {"mean": harness.of_seeds([row["return"] for row in rows], "{:.2f}"), "gains": gains}


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
