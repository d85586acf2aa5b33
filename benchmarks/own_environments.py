"""Do environments of users learn without settings?

Usage:
    python benchmarks/own_environments.py [--seconds 90] [--frames 0] [--seeds 3] [--episodes 256] [--only NAME ...]
        [--settings NAME=VALUE ...] [--out FILE.json] [--figure FILE.png]

Three environments as the how-to guides build them, see :data:`ENVIRONMENTS`: their rewards differ by a factor of a million, their
episodes in length, in what is observed, and in whether the time limit truncates or terminates. Each is trained by
``configure(name)`` for the same time with several seeds, and compared with random actions and every constant action in the same
fresh episodes. ``--figure`` draws the evaluations during training. ``--settings beyond_limit=true`` shows what a setting does.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import harness
import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

import bsk_torch
from bsk_torch import SatelliteTasking, act, data, dyn, fsw, obs, rand, sats, scene
from bsk_torch.presets import PRESETS
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.policies.shared_policy import shared_baselines
from bsk_torch.rl.training import configure, override
from bsk_torch.rl.training.log import EVALUATIONS, read_log
from bsk_torch.rl.training.trainer import Training

ORBIT = 5700.0
"""Period of an orbit, s."""

JUDGED = 2_700_001
"""Seed of the episodes in which policies are compared."""


class Frugal(sats.AccessSatellite):
    """Scans or charges; to scan all the time empties its small battery. It does not observe the time."""

    observation_spec = (
        obs.SatProperties(dict(prop="battery_charge_fraction"), dict(prop="storage_level_fraction")),
        obs.Eclipse(norm=ORBIT),
    )
    action_spec = (act.Scan(duration=180.0), act.Charge(duration=120.0))
    dyn_type = dyn.ContinuousImagingDynModel
    fsw_type = fsw.ContinuousImagingFSWModel


class Chooser(sats.ImagingSatellite):
    """Images one of the next five targets; their priorities differ."""

    observation_spec = (
        obs.SatProperties(dict(prop="omega_BH_H", norm=0.03), dict(prop="c_hat_H")),
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="target_angle", norm=torch.pi),
            dict(prop="opportunity_open", norm=300.0),
            dict(prop="opportunity_close", norm=300.0),
            n_ahead_observe=5,
        ),
        obs.Time(),
    )
    action_spec = (act.Image(n_ahead_image=5),)
    dyn_type = dyn.ImagingDynModel
    fsw_type = fsw.SteeringImagerFSWModel


class Relaying(dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel):
    """Scans and downlinks."""


class Courier(sats.AccessSatellite):
    """Scans or downlinks; its data buffer is full after 2,000 s of scanning."""

    observation_spec = (
        obs.SatProperties(dict(prop="storage_level_fraction")),
        obs.OpportunityProperties(
            dict(prop="opportunity_open", norm=ORBIT),
            dict(prop="opportunity_close", norm=ORBIT),
            type="ground_station",
            n_ahead_observe=1,
        ),
        obs.Time(),
    )
    action_spec = (act.Scan(duration=120.0), act.Downlink(duration=60.0))
    dyn_type = Relaying
    fsw_type = fsw.ContinuousImagingFSWModel


def frugal(**options: Any) -> SatelliteTasking:
    """Three orbits of scanning, worth a thousandth; truncated."""
    battery = 40.0 * 3600.0
    sat_args = dict(
        instrumentBaudRate=4e6,
        dataStorageCapacity=1e12,
        imageAttErrorRequirement=0.1,
        batteryStorageCapacity=battery,
        storedCharge_Init=rand.Uniform(0.4 * battery, battery),
        basePowerDraw=-10.0,
        instrumentPowerDraw=-30.0,
        panelArea=0.25,
    )
    defaults: dict[str, Any] = dict(
        scenario=scene.UniformNadirScanning(value_per_second=1e-3 / (3 * ORBIT)),
        rewarder=data.ScanningTimeReward(),
        time_limit=3 * ORBIT,
        failure_penalty=-1e-3,
    )
    return SatelliteTasking(Frugal("Frugal1", sat_args), **(defaults | options))


def chooser(**options: Any) -> SatelliteTasking:
    """Half an hour of imaging, worth the priorities of targets, from 0 to 1; truncated."""
    sat_args = dict(
        oe=rand.random_orbit(a=6371.0 + 500.0, i=45.0),
        imageTargetMinimumElevation=0.8,
        imageAttErrorRequirement=0.01,
        imageRateErrorRequirement=0.01,
        u_max=0.4,
        servo_P=30.0,
        omega_max=0.087,
        batteryStorageCapacity=1e9,
        storedCharge_Init=1e9,
        dataStorageCapacity=1e13,
    )
    defaults: dict[str, Any] = dict(
        scenario=scene.UniformTargets(5000), rewarder=data.UniqueImageReward(), time_limit=1800.0, max_step_duration=300.0
    )
    return SatelliteTasking(Chooser("Chooser1", sat_args), **(defaults | options))


def courier(**options: Any) -> SatelliteTasking:
    """Two orbits of scanning, worth a thousand; the time limit terminates."""
    sat_args = dict(
        instrumentBaudRate=4e6,
        dataStorageCapacity=8e9,
        transmitterBaudRate=-4e8,
        imageAttErrorRequirement=0.1,
        batteryStorageCapacity=1e9,
        storedCharge_Init=1e9,
    )
    defaults: dict[str, Any] = dict(
        scenario=scene.UniformNadirScanning(value_per_second=1e3 / (2 * ORBIT)),
        rewarder=data.ScanningTimeReward(),
        time_limit=2 * ORBIT,
        failure_penalty=-1e3,
        terminate_on_time_limit=True,
    )
    return SatelliteTasking(Courier("Courier1", sat_args), **(defaults | options))


ENVIRONMENTS: dict[str, Callable[..., SatelliteTasking]] = {
    "Frugal-v1": frugal,
    "Chooser-v1": chooser,
    "Courier-v1": courier,
}
"""What is trained, by name."""


def constant(action: int) -> TensorDictModule:
    """Return a policy that always takes an action."""

    def choose(mask: Tensor) -> Tensor:
        return torch.full(mask.shape[:-1], action)

    return TensorDictModule(choose, in_keys=["action_mask"], out_keys=["action"])


def measure(name: str, options: Any) -> dict[str, Any]:
    """Train in an environment with every seed; a row of the table."""
    world: dict[str, Any] = dict(backend=options.backend)
    env = bsk_torch.make(name, num_envs=options.episodes, **world)
    random = evaluate(shared_baselines(env, JUDGED)["random"], env, seed=JUDGED).mean_return
    constants = {
        env.satellite.action_description[k]: evaluate(constant(k), env, seed=JUDGED).mean_return.mean
        for k in range(env.satellite.actions.n_actions)
    }
    best = max(constants, key=constants.__getitem__)
    trained, half_widths, curves = [], [], []
    for seed in range(options.seeds):
        config = configure(name, seed=seed, options=dict(world), **harness.budget(options))
        with tempfile.TemporaryDirectory() as folder:
            training = Training(override(config, options.settings), Path(folder) / "run")
            result = evaluate(training.run(), env, seed=JUDGED).mean_return
            log = read_log(training.out / EVALUATIONS)
        trained.append(result.mean)
        half_widths.append(result.half_width)
        curves.append({name: log.get(name, []) for name in ("frames", "return")})
    found = {"random": random.mean, "constants": constants, "trained": trained, "half_widths": half_widths, "curves": curves}
    return found | {
        "name": name,
        "limit": float(env.time_limit.max()),
        "ends": "terminates" if env.terminate_on_time_limit else "truncates",
        "best": f"{constants[best]:.3g} ({best.removeprefix('action_')})",
        "returns": " ".join(f"{value:.3g}" for value in trained),
        "above": f"{sum(value > constants[best] for value in trained)} of {len(trained)}",
    }


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw returns of evaluations over decisions, with those of random and constant actions."""
    from bsk_torch.viz.figures import style

    figure, panels = style.panels([2.0] * len(rows))
    for panel, row in zip(panels, rows, strict=True):
        for k, curve in enumerate(row["curves"]):
            thousands = [frames / 1e3 for frames in curve["frames"]]
            panel.plot(thousands, curve["return"], ".-", color=style.PALETTE[0], label=None if k else "trained, by seed")
        panel.axhline(max(row["constants"].values()), color=style.PALETTE[1], label="best constant action")
        panel.axhline(row["random"], color="0.5", linestyle="--", label="random actions")
        style.label(panel, f"return in {row['name']}")
    panels[0].legend(fontsize=7, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)  # above all lines
    panels[-1].set_xlabel("decisions learned from, thousands")
    style.save(figure, path)


def main() -> None:
    """Train, compare, and print a table."""
    parsed = harness.parser(__doc__, seconds=90.0, frames=0, seeds=3, episodes=256)
    parsed.add_argument("--only", nargs="+", choices=ENVIRONMENTS, default=list(ENVIRONMENTS), metavar="NAME")
    parsed.add_argument("--settings", nargs="+", default=[], metavar="NAME=VALUE", help="settings that differ from the defaults")
    parsed.add_argument("--figure", type=Path, metavar="FILE.png", help="needs the extra viz")
    parsed.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    options, described = harness.begin(parsed)
    PRESETS.update(ENVIRONMENTS)
    rows = harness.Rows(options, described, (measure(name, options) for name in options.only))
    columns = {
        "environment": "{name}",
        "time limit, s": "{limit:,.0f}",
        "at the limit": "{ends}",
        "random": "{random:.3g}",
        "best constant action": "{best}",
        "trained, by seed": "{returns}",
        "above": "{above}",
    }
    print(harness.table(columns, rows))
    harness.write(options, described, rows=rows)
    if options.figure:
        draw(rows, options.figure)


if __name__ == "__main__":
    main()
