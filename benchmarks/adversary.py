"""Adversarial scenarios: in which family of satellites does the policy of NadirScan-v1 lose to the rule?

Usage:
    python benchmarks/adversary.py [--boxes drawn wide] [--candidates 64] [--each 4] [--iterations 6] [--elite 10]
        [--episodes 512] [--certify 0] [--seeds 0] [--frames 400000] [--time-limit 28500]
        [--families FILE.json] [--alone battery ...] [--out FILE.json]

The cross-entropy method searches a box of arguments of the satellite, see ``BOXES``: all candidates fly as one batch, ``--each``
episodes of each, with the policy of the package and with the rule, and the ``--elite`` candidates at which the rule is ahead by
most give mean and deviation of the next ones. A family is the box between the 10th and the 90th percentile of the last elite.
Losses there are measured in fresh episodes, paired; with ``--alone``, also with single parameters of the family.
``--certify`` episodes of a family are flown again on Basilisk (needs the extra ``basilisk``). With ``--seeds``, the policy of
the package is trained further, half of the episodes from the family and half from the preset, and as a comparison with episodes
of the preset only.
"""

from __future__ import annotations

import copy
import json
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import harness
import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

import bsk_torch
from bsk_torch import rand
from bsk_torch.env import Tasking
from bsk_torch.lab.basilisk import certify
from bsk_torch.lab.suites.suite import Task
from bsk_torch.presets.nadir_scan import BATTERY, CAPACITY
from bsk_torch.rl.evaluation import Evaluation, evaluate
from bsk_torch.rl.policies import pretrained, pretrained_file, read_card
from bsk_torch.rl.policies.files import networks_of
from bsk_torch.rl.training import configure
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.rl.training.trainer import Training

PRESET, RULE = "NadirScan-v1", "rule"

SPEED, BAUD, TORQUE, PANEL, AXIS = 6000.0, -50 * 8e6, 1e-4, 0.25, 6_871_000.0
"""The preset's largest wheel speed, rpm, baud rate, bit/s, deviation of each component of the disturbance, N m, area of the
panel, m^2, and semi-major axis, m."""

Bounds = Mapping[str, tuple[float, float]]

NOMINAL: Bounds = {
    "battery": (1.0, 1.0),
    "charge": (0.3, 1.0),
    "storage": (0.0, 0.8),
    "spin": (0.5, 0.5),
    "fastest": (1.0, 1.0),
    "torque": (1.0, 1.0),
    "baud": (1.0, 1.0),
    "panel": (1.0, 1.0),
    "inclination": (0.0, 180.0),
}
"""The preset. Battery capacity, largest wheel speed, disturbance, baud rate and panel area are multiples of the preset's. Initial
charge and data are fractions of the capacities, and the bound of initial wheel speeds is a fraction of the largest speed. The
inclination is in degrees."""

BOXES: dict[str, Bounds] = {
    "drawn": {**NOMINAL, "spin": (0.0, 0.5)},
    "wide": {
        "battery": (0.3, 1.0),
        "charge": (0.3, 1.0),
        "storage": (0.0, 0.8),
        "spin": (0.0, 0.5),
        "fastest": (0.4, 1.0),
        "torque": (0.0, 5.0),
        "baud": (0.2, 1.0),
        "panel": (0.6, 1.0),
        "inclination": (0.0, 180.0),
    },
}
"""What is searched: within what the preset draws, and satellites with smaller parts."""

SEARCHED, FRESH, CERTIFIED = 3_100_000, 3_200_000, 3_300_000
"""Seeds of the search, of the episodes in which families are measured, and first seed of those on Basilisk."""

SMOOTHING = 0.7
"""Weight of the new mean and deviation."""

KEPT = 0.1, 0.9
"""Quantiles of the elite between which a family lies."""

COLUMNS = {
    "box": "{box}",
    "policy": "{policy}",
    "episodes from": "{condition}",
    "return": "{value:.3f} +- {half:.3f}",
    "over the rule": "{gain:+.3f} +- {gain_half:.3f}",
    "survival": "{survival:.1%}",
    "the rule's": "{rule_survival:.1%}",
}

Points = Callable[[rand.Key], Tensor]
"""Parameters [n, P] of a key's episodes, in the order of :data:`NOMINAL`."""


def between(bounds: Bounds, share: Tensor) -> Tensor:
    """Return the points at ``share`` [..., P] of the way between ``bounds``."""
    low, high = (torch.tensor([bounds[name][k] for name in NOMINAL], dtype=torch.float64) for k in (0, 1))
    return low + (high - low) * share


def uniform(bounds: Bounds) -> Points:
    """Return points that are uniform in a box."""
    return lambda key: between(bounds, key.named("family").uniform(len(NOMINAL)))


def listed(table: Tensor) -> Points:
    """Return the rows of a ``table`` [N, P], one for each environment."""
    return lambda key: table[key.env_id]


def mixed(first: Points, second: Points) -> Points:
    """Return points of which half are of the first kind, by chance."""

    def points(key: rand.Key) -> Tensor:
        return torch.where(key.named("mixture").uniform(1) < 0.5, first(key), second(key))

    return points


@dataclass(frozen=True)
class Of(rand.Distribution):
    """Values of an argument of the satellite by the point of its episode.

    Attributes:
        points: Points of episodes.
        value: From parameters by their name, [n, 1] each, and a key to values [n, 1], or [n, k].
        single: Whether the argument is one number.
    """

    points: Points
    value: Callable[[dict[str, Tensor], rand.Key], Tensor]
    single: bool = True

    def draw(self, key: rand.Key) -> Tensor:
        """See :meth:`bsk_torch.rand.Distribution.draw`."""
        values = self.value(dict(zip(NOMINAL, self.points(key).split(1, -1), strict=True)), key)
        return values.squeeze(-1) if self.single else values


def arguments(points: Points) -> dict[str, Any]:
    """Return the arguments of the satellite."""

    def orbit(at: dict[str, Tensor], key: rand.Key) -> Tensor:
        other = 2.0 * math.pi * key.uniform(3)
        inclination = torch.deg2rad(at["inclination"])
        return torch.cat([torch.full_like(inclination, AXIS), torch.zeros_like(inclination), inclination, other], -1)

    def one(value: Callable[[dict[str, Tensor]], Tensor]) -> Of:
        return Of(points, lambda at, key: value(at))

    return dict(
        batteryStorageCapacity=one(lambda at: BATTERY * at["battery"]),
        storedCharge_Init=one(lambda at: BATTERY * at["battery"] * at["charge"]),
        storageInit=one(lambda at: CAPACITY * at["storage"]),
        maxWheelSpeed=one(lambda at: SPEED * at["fastest"]),
        wheelSpeeds=Of(points, lambda at, key: SPEED * at["fastest"] * at["spin"] * (2.0 * key.uniform(3) - 1.0), False),
        disturbance_vector=Of(points, lambda at, key: TORQUE * at["torque"] * key.normal(3), False),
        transmitterBaudRate=one(lambda at: BAUD * at["baud"]),
        panelArea=one(lambda at: PANEL * at["panel"]),
        oe=Of(points, orbit, False),
    )


class Duel(NamedTuple):
    """The same episodes of a policy and of the rule."""

    policy: Evaluation
    rule: Evaluation

    @property
    def behind(self) -> Tensor:
        """Return of the rule minus that of the policy, [n]."""
        return self.rule.returns - self.policy.returns


def world(points: Points, count: int, options: Any, env_ids: range | None = None) -> Tasking:
    """Return an environment of ``count`` episodes with the given points."""
    common = dict(time_limit=options.time_limit, backend=options.backend)
    return bsk_torch.make(
        PRESET, num_envs=count, sat_args=arguments(points), **({} if env_ids is None else {"env_ids": env_ids}), **common
    )


@torch.no_grad()
def duel(env: Tasking, policy: TensorDictModuleBase, seed: int) -> Duel:
    """Fly the episodes of ``env`` twice."""
    return Duel(evaluate(policy, env, seed=seed), evaluate(bsk_torch.rule(RULE, env), env, seed=seed))


def searched(bounds: Bounds, policy: TensorDictModuleBase, options: Any) -> tuple[Bounds, list[float]]:
    """Return a family in a box, and the mean of (rule - policy) over the elite in each iteration."""
    draws = torch.Generator().manual_seed(0)
    shape = options.candidates, len(NOMINAL)
    mean, deviation, shares = torch.full(shape[1:], 0.5), torch.full(shape[1:], 0.5), torch.rand(shape, generator=draws)
    history, elite = [], shares
    for turn in range(options.iterations):
        table = between(bounds, shares.double()).repeat_interleave(options.each, 0)
        env = world(listed(table), len(table), options, range(len(table)))
        behind = duel(env, policy, SEARCHED + turn).behind.view(options.candidates, options.each).mean(1)
        best = behind.topk(options.elite)
        elite = shares[best.indices]
        history.append(float(best.values.mean()))
        print(f"iteration {turn + 1}: all {float(behind.mean()):+.3f}, elite {history[-1]:+.3f}", flush=True)
        mean = SMOOTHING * elite.mean(0) + (1.0 - SMOOTHING) * mean
        deviation = SMOOTHING * elite.std(0) + (1.0 - SMOOTHING) * deviation
        shares = (mean + deviation * torch.randn(shape, generator=draws)).clamp(0.0, 1.0)
    low, high = (between(bounds, elite.double().quantile(q, 0)) for q in KEPT)
    return dict(zip(NOMINAL, zip(low.tolist(), high.tolist(), strict=True), strict=True)), history


# -- confirmation -----------------------------------------------------------------------------------------------------


def row(box: str, policy: str, condition: str, found: Duel) -> dict[str, Any]:
    """Return the figures of a policy beside those of the rule in the same episodes."""
    value, gain = found.policy.mean_return, found.policy.gain_over(found.rule)
    return {
        "box": box,
        "policy": policy,
        "condition": condition,
        "episodes": len(found.behind),
        "value": value.mean,
        "half": value.half_width,
        "gain": gain.mean,
        "gain_half": gain.half_width,
        "survival": found.policy.survival,
        "rule_survival": found.rule.survival,
        "lost": float((found.behind > 0.0).double().mean()),
        "deaths": found.policy.causes,
    }


def on_basilisk(family: Bounds, options: Any) -> dict[str, Any]:
    """Return the certificates of the policy of the package and of the rule in episodes of a family."""
    fixed = dict(sat_args=arguments(uniform(family)), time_limit=options.time_limit)
    task = Task(PRESET, CERTIFIED, options.certify, fixed)
    entrants = {
        "package": lambda preset, make: (make(), pretrained(PRESET)),
        RULE: lambda preset, make: (lambda env: (env, bsk_torch.rule(RULE, env)))(make()),
    }
    found = {}
    for name, entrant in entrants.items():
        certificate = certify(task, entrant, options.certify, backend=options.backend)
        assert certificate is not None
        found[name] = certificate.summary()
    return found


class Further(Training):
    """A training that begins with the policy of the package."""

    def _build(self, saved: dict[str, Any] | None) -> None:
        super()._build(saved)
        self.learner.load_policy_state(next(iter(networks_of(read_card(pretrained_file(PRESET))).values())))


def trained(points: Points, seed: int, options: Any, folder: Path) -> TensorDictModuleBase:
    """Return the policy of the package after further training in episodes with the given points."""
    given = dict(sat_args=arguments(points), time_limit=options.time_limit, backend=options.backend)
    sizes = dict(frames=options.frames, seconds=None, num_envs=options.num_envs, learning_rate=options.rate)
    config: PPOConfig = configure(PRESET, seed=seed, **sizes, options=given)
    return copy.deepcopy(Further(config, folder).run())


def conditions(family: Bounds, alone: Sequence[str]) -> dict[str, Points]:
    """Return the episodes in which policies are judged, with single parameters of the family, and with all but these."""
    found = {"family": uniform(family), "preset": uniform(NOMINAL)}
    for name in alone:
        found[f"preset with the family's {name}"] = uniform({**NOMINAL, name: family[name]})
        found[f"family with the preset's {name}"] = uniform({**family, name: NOMINAL[name]})
    return found


def family_of(box: str, options: Any) -> dict[str, Any]:
    """Return a family, the history of its search and its certificates, new or from the results of ``--families``."""
    if options.families:
        known: dict[str, Any] = json.loads(options.families.read_text())["families"][box]
        return known
    family, history = searched(BOXES[box], pretrained(PRESET), options)
    return dict(family=family, history=history, basilisk=on_basilisk(family, options) if options.certify else None)


def main() -> None:
    """Search, confirm, train, and print a table."""
    parsed = harness.parser(
        __doc__,
        candidates=64,
        each=4,
        iterations=6,
        elite=10,
        episodes=512,
        certify=0,
        seeds=0,
        frames=400_000,
        num_envs=512,
        rate=1e-4,
        time_limit=28_500.0,
    )
    parsed.add_argument("--boxes", nargs="+", choices=BOXES, default=list(BOXES), metavar="NAME")
    parsed.add_argument("--alone", nargs="+", choices=NOMINAL, default=[], metavar="NAME", help="parameters to change alone")
    parsed.add_argument(
        "--families", type=Path, metavar="FILE.json", help="take the families of these results, and search nothing"
    )
    parsed.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    options, described = harness.begin(parsed)
    families: dict[str, Any] = {}
    rows: list[dict[str, Any]] = []
    for box in options.boxes:
        families[box] = family_of(box, options)
        points = conditions(families[box]["family"], options.alone)
        envs = {name: world(each, options.episodes, options) for name, each in points.items()}
        trainings = {"family and preset": mixed(points["family"], points["preset"]), "preset": points["preset"]}

        def judge(name: str, policy: TensorDictModuleBase, box: str = box, envs: dict[str, Tasking] = envs) -> None:
            for condition, env in envs.items():
                rows.append(row(box, name, condition, duel(env, policy, FRESH)))
                print(harness.cell("{box}, {policy}, {condition}: {value:.3f}, {gain:+.3f} over the rule", rows[-1]), flush=True)
            harness.write(options, described, boxes=BOXES, families=families, rows=rows)

        judge("package", pretrained(PRESET))
        with tempfile.TemporaryDirectory() as folder:
            for name, each in trainings.items():
                for seed in range(options.seeds):
                    judge(f"trained on {name}, seed {seed}", trained(each, seed, options, Path(folder) / f"{name}-{seed}"))
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    main()
