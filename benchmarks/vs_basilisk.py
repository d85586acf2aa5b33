"""Simulated seconds per core-second of scanning and of agile imaging, here and in bsk_rl on Basilisk.

Usage:
    python benchmarks/vs_basilisk.py [--basilisk PYTHON] [--only CASE ...] [--turns 5] [--seconds 10] [--out FILE.json]

The cases are named by batch, those of imaging by number of targets and batch: imaging-1k-1024 has 1,000 targets. In
4096-wheels, the scanning satellites have four wheels instead of three. In
gymnasium-own, the two pointing errors are custom properties in torch.
``PYTHON`` is an interpreter with bsk and bsk_rl (see recording.py); without it, only bsk_torch is measured. The two alternate, so
that both run on the same machine; the figure of a case is the median over turns of the ratio of rates, with the smallest and the
largest. Rates are simulated seconds per second of CPU time of the whole process: Basilisk runs in a thread of its own. Both play
random actions, draw every episode again, and include resets with the search for access windows; a turn continues where the
previous one stopped. It goes on after its seconds until whole episodes have ended, in batches of bsk_torch as many as there are
environments, or a multiple. Batches start staggered and warm up for the length of an episode (see harness.py); Basilisk plays one
episode at a time.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any, NamedTuple

import gymnasium
import harness
import torch
from harness import Player, Step, Turn
from torch import Tensor
from torchrl.collectors import Collector

import bsk_torch
from bsk_torch import data, obs, scene
from bsk_torch.astro.frames import angle_between
from bsk_torch.presets.nadir_scan import ScanningDownlinkDynModel, ScanningSatellite, scanning_args
from bsk_torch.rl.networks.plans import MLPPlan
from bsk_torch.wrappers import GymEnv

HIDDEN = (64, 64)
"""Layers of the policy that the collector asks."""

STEPS_PER_BATCH = 8
"""Steps of all environments that the collector hands over at a time."""


class Case(NamedTuple):
    """A batch size, a type of the simulation, what plays it, and a key of ``harness.TASKS``."""

    batch: int
    dtype: str
    play: Callable[[Case], Player]
    task: str = "scan"


def directly(case: Case) -> Player:
    """Random actions, by ``step_and_maybe_reset``."""
    return harness.rollout(harness.make_env(case.task, case.batch, case.dtype))


def collected(case: Case) -> Player:
    """An untrained policy, nearly uniform, behind TorchRL's collector; an item is a batch of steps."""
    env = harness.make_env(case.task, case.batch, case.dtype)
    collector = Collector(
        env,
        MLPPlan.of(env, HIDDEN).build().policy,
        frames_per_batch=case.batch * STEPS_PER_BATCH,
        total_frames=-1,
        auto_register_policy_transforms=False,
        track_traj_ids=False,
    )
    return (harness.step_of(batch["next"]) for batch in collector)


def wrapped(case: Case) -> Player:
    """Random actions, through Gymnasium's interface."""
    task = harness.TASKS[case.task]
    options = {"sim_dtype": getattr(torch, case.dtype), "time_limit": harness.EPISODE} | task.options
    env = gymnasium.make(f"bsk_torch/{task.preset}", **options)
    return alone(env)


class OwnDynModel(ScanningDownlinkDynModel):
    """The two pointing errors as a user writes them in torch, as properties of all satellites."""

    def _in_N(self, axis: str) -> Tensor:
        return (self.BN.mT @ self.satellite.sat_args[axis].unsqueeze(-1)).squeeze(-1)

    @property
    def instrument_error(self) -> Tensor:
        """Angle between instrument axis and nadir direction, [N] rad."""
        return angle_between(-self.r_BN_N, self._in_N("inst_pHat_B"))

    @property
    def solar_error(self) -> Tensor:
        """Angle between panel normal and Sun direction, [N] rad."""
        return angle_between(self._in_N("nHat_B"), self.world.r_SN_N)


class OwnSatellite(ScanningSatellite):
    """The preset's satellite with custom properties in place of its observables."""

    dyn_type = OwnDynModel
    observation_spec = (
        obs.SatProperties(
            *ScanningSatellite.observation_spec[0].entries[:3],
            dict(prop="instrument_error", norm=torch.pi),
            dict(prop="solar_error", norm=torch.pi),
        ),
        *ScanningSatellite.observation_spec[1:],
    )


def own_env(batch: int) -> bsk_torch.SatelliteTasking:
    """Scanning with custom properties in torch."""
    return bsk_torch.SatelliteTasking(
        OwnSatellite("Scanner1", scanning_args()),
        scenario=scene.UniformNadirScanning(value_per_second=1 / harness.EPISODE),
        rewarder=data.ScanningTimeReward(),
        failure_penalty=-1.0,
        terminate_on_time_limit=True,
        num_envs=batch,
        time_limit=harness.EPISODE if batch == 1 else harness.Staggered(batch),
    )


def own(case: Case) -> Player:
    """Random actions, through Gymnasium's interface, with custom properties in torch."""
    return alone(GymEnv(own_env(case.batch)))


def alone(env: gymnasium.Env[Any, Any]) -> Player:
    """Random actions in one episode at a time."""
    env.action_space.seed(0)
    env.reset(seed=0)
    while True:
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
        yield Step(info["duration"], int(terminated or truncated))


CASES = {
    "4096": Case(4096, "float64", directly),
    "4096-float32": Case(4096, "float32", directly),
    "4096-collector": Case(4096, "float64", collected),
    "4096-wheels": Case(4096, "float64", directly, "scan-4-wheels"),
    "64": Case(64, "float64", directly),
    "gymnasium": Case(1, "float64", wrapped),
    "gymnasium-own": Case(1, "float64", own),
    "64-collector": Case(64, "float64", collected),
    **{str(batch): Case(batch, "float64", directly) for batch in (1, 2, 4, 8, 16)},
    **{f"imaging-1k-{batch}": Case(batch, "float64", directly, "imaging-1k") for batch in (1024, 64, 1)},
    "imaging-10k-1024": Case(1024, "float64", directly, "imaging-10k"),
}

COLUMNS = {
    "case": "{case}",
    "batch": "{batch}",
    "type": "{dtype}",
    "simulated s per core-s": "{rate:,.0f}",
    "Basilisk": "{basilisk_rate:,.0f}",
    "decisions per core-s": "{decision_rate:,.0f}",
    "Basilisk's": "{basilisk_decision_rate:,.1f}",
    "x Basilisk": "{ratio:.3g}",
    "smallest to largest": "{ratio_low:.3g} to {ratio_high:.3g}",
    "in wall time": "{wall_ratio:.3g}",
    "episodes ended": "{ended}",
    "ready after, s": "{ready_s:.1f}",
}


def measure(
    case: Case, python: str | None, turns: int, seconds: float, warm_up: int
) -> tuple[list[tuple[Turn | None, Turn]], float]:
    """Alternating turns of Basilisk (None without an interpreter) and bsk_torch, and the seconds until bsk_torch was ready."""
    items = -(-warm_up // STEPS_PER_BATCH) if case.play is collected else warm_up
    player, ready = harness.start(lambda: case.play(case), items)
    with harness.basilisk(python, case.task) if python else nullcontext(lambda seconds: None) as other:
        return [(other(seconds), harness.play(player, seconds, whole=case.batch)) for _ in range(turns)], ready


def row_of(name: str, case: Case, turns: list[tuple[Turn | None, Turn]], ready: float) -> dict[str, Any]:
    """The row of a case: medians over its turns, and the turns themselves."""
    row = {
        "case": name,
        "task": case.task,
        "batch": case.batch,
        "dtype": case.dtype,
        "rate": statistics.median(ours.rate for _, ours in turns),
        "decision_rate": statistics.median(ours.decision_rate for _, ours in turns),
        "ended": sum(ours.ended for _, ours in turns),
        "ready_s": ready,
        "turns": [{"basilisk": theirs._asdict() if theirs else None, "ours": ours._asdict()} for theirs, ours in turns],
    }
    pairs = [(theirs, ours) for theirs, ours in turns if theirs]
    ratios = [ours.rate / theirs.rate for theirs, ours in pairs]
    compared = (
        {
            "ratio": statistics.median(ratios),
            "ratio_low": min(ratios),
            "ratio_high": max(ratios),
            "wall_ratio": statistics.median(ours.wall_rate / theirs.wall_rate for theirs, ours in pairs),
            "basilisk_rate": statistics.median(theirs.rate for theirs, _ in pairs),
            "basilisk_decision_rate": statistics.median(theirs.decision_rate for theirs, _ in pairs),
        }
        if pairs
        else {}
    )
    return row | compared


def crossover(rows: list[dict[str, Any]]) -> str:
    """Below which of the measured batch sizes Basilisk is faster at scanning."""
    scanning = [row for row in rows if "ratio" in row and CASES[row["case"]] == Case(row["batch"], "float64", directly)]
    ratios = {row["batch"]: row["ratio"] for row in scanning}
    slower = [batch for batch, ratio in sorted(ratios.items()) if ratio < 1.0]
    faster = [batch for batch in sorted(ratios) if batch > max(slower, default=0)]
    if not slower:
        return f"Basilisk is slower from a batch of {min(faster)} on." if faster else ""
    return f"Basilisk is faster up to a batch of {max(slower)}" + (f" and slower from {min(faster)} on." if faster else ".")


def main() -> None:
    """Measure and print a table."""
    arguments = harness.parser(__doc__, turns=5, seconds=10.0)
    arguments.add_argument("--basilisk", metavar="PYTHON", help="interpreter with bsk and bsk_rl")
    arguments.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), metavar="CASE", help=", ".join(CASES))
    options, described = harness.begin(arguments)
    rows = harness.Rows(options, described)
    for name in options.only:
        steps = harness.warm_up(options, CASES[name].task)
        turns, ready = measure(CASES[name], options.basilisk, options.turns, options.seconds, steps)
        rows.append(row_of(name, CASES[name], turns, ready))
        print(harness.cell("{case}: {rate:,.0f}", rows[-1]), harness.cell("{ratio:.3g} x Basilisk", rows[-1]), flush=True)
    print(harness.table(COLUMNS, rows), crossover(rows), sep="\n\n")
    harness.write(options, described, rows=rows, crossover=crossover(rows))


if __name__ == "__main__":
    main()
