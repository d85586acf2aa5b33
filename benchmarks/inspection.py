"""Simulated seconds per core-second of inspection and of manoeuvres, here and in bsk_rl on Basilisk.

Usage:
    python benchmarks/inspection.py [--basilisk PYTHON] [--only CASE ...] [--batch 1024] [--turns 3] [--seconds 10] [--out FILE]

``1`` and ``3`` are RSOInspection-v1 with so many inspectors, which make small random manoeuvres; ``1-integrated`` integrates the
orbits in every tick, as Basilisk does. In ``manoeuvres`` a satellite changes its orbit in every step, drifts for some minutes,
and observes the next four of 1,000 targets and the next eclipse: those of the orbit that it flies (``replan=True``), where bsk_rl
goes on looking along the first one. ``manoeuvres-as-bsk_rl`` does as bsk_rl.

Seconds are those of episodes, whatever the number of satellites. Both sides draw new episodes each time. Turns are those of
vs_basilisk.py.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any, NamedTuple

import harness
import torch
from harness import Player

import bsk_torch
from bsk_torch import SatelliteTasking, act, data, obs, rand, sats, scene
from bsk_torch.sim import dyn, fsw

KICK, DRIFT = 0.01, (100.0, 2000.0)
"""Standard deviation of each component of an inspector's manoeuvre, m/s, and bounds of the drift after it, s."""

LARGE_KICK, SHORT_DRIFT = 1.0, (60.0, 300.0)
"""The same of the satellite that looks at targets."""


class Manoeuvring(sats.ImagingSatellite):
    """Changes its orbit in every step, and looks at the next targets."""

    observation_spec = (
        obs.SatProperties(dict(prop="dv_available", norm=1e4), dict(prop="r_BN_P", norm=6378136.6)),
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="opportunity_open", norm=300.0),
            dict(prop="opportunity_close", norm=300.0),
            n_ahead_observe=4,
        ),
        obs.Eclipse(norm=5700.0),
        obs.Time(),
    )
    action_spec = (act.ImpulsiveThrust(max_dv=60.0, max_drift_duration=600.0),)
    dyn_type = dyn.ImagingDynModel
    fsw_type = (fsw.MagicOrbitalManeuverFSWModel, fsw.ImagingFSWModel)


def random_thrust(shape: tuple[int, ...], kick: float, drift: tuple[float, float], generator: torch.Generator) -> torch.Tensor:
    """Random manoeuvres and drifts, [*shape, 4]."""
    dv = torch.randn(*shape, 3, dtype=torch.float64, generator=generator) * kick
    seconds = drift[0] + (drift[1] - drift[0]) * torch.rand(*shape, 1, dtype=torch.float64, generator=generator)
    return torch.cat([dv, seconds], -1)


def inspections(batch: int, n_inspectors: int, **options: Any) -> Player:
    """Play RSOInspection-v1."""
    limit = harness.Staggered(batch, 57_000.0)
    env = bsk_torch.make("RSOInspection-v1", n_inspectors=n_inspectors, num_envs=batch, seed=0, time_limit=limit, **options)
    generator, td = torch.Generator().manual_seed(0), env.reset()
    while True:
        td["chief", "action"] = td["chief", "action_mask"].long().argmax(-1)
        td["inspector", "action"] = random_thrust((batch, n_inspectors), KICK, DRIFT, generator)
        played, td = env.step_and_maybe_reset(td)
        yield harness.step_of(played["next"])


def manoeuvres(batch: int, n_targets: int, **options: Any) -> Player:
    """Play a satellite that manoeuvres in every step."""
    arguments = dict(
        oe=rand.random_orbit(a=7000.0, i=45.0),
        dv_available_init=1e4,
        batteryStorageCapacity=1e9,
        storedCharge_Init=1e9,
        imageTargetMinimumElevation=0.872665,
    )
    satellite = Manoeuvring("EO1", arguments, may_see_nothing=True)
    rewarder, limit = data.UniqueImageReward(), harness.Staggered(batch)
    given = dict(num_envs=batch, seed=0, time_limit=limit, terminate_on_time_limit=True)
    env = SatelliteTasking(satellite, scene.UniformTargets(n_targets), rewarder, **(given | options))  # type: ignore[arg-type]
    generator, td = torch.Generator().manual_seed(0), env.reset()
    while True:
        played, td = env.step_and_maybe_reset(td.set("action", random_thrust((batch,), LARGE_KICK, SHORT_DRIFT, generator)))
        yield harness.step_of(played["next"])


class Case(NamedTuple):
    """What plays a case here, the environment of basilisk_side.py, and the arguments of both; further ones are ours alone."""

    play: Callable[..., Player]
    theirs: str
    arguments: dict[str, Any]
    options: dict[str, Any] = {}  # noqa: RUF012 - a NamedTuple's default


CASES = {
    "1": Case(inspections, "RSOInspection-v1", {"n_inspectors": 1}),
    "1-integrated": Case(inspections, "RSOInspection-v1", {"n_inspectors": 1}, {"orbit": "integrated"}),
    "3": Case(inspections, "RSOInspection-v1", {"n_inspectors": 3}),
    "manoeuvres": Case(manoeuvres, "manoeuvres", {"n_targets": 1000}),
    "manoeuvres-as-bsk_rl": Case(manoeuvres, "manoeuvres", {"n_targets": 1000}, {"replan": False}),
}

COLUMNS = {
    "case": "{case}",
    "batch": "{batch:,}",
    "simulated s per core-s": "{rate:,.0f}",
    "Basilisk": "{basilisk_rate:,.0f}",
    "x Basilisk": "{ratio:.3g}",
    "smallest to largest": "{ratio_low:.3g} to {ratio_high:.3g}",
    "decisions per core-s": "{decision_rate:,.0f}",
}


def measure(name: str, options: Any) -> dict[str, Any]:
    """The row of a case: medians over alternating turns."""
    case, batch = CASES[name], options.batch
    player, _ = harness.start(lambda: case.play(batch, **case.arguments, **case.options), options.warm_up or 40)
    with harness.other_side(options.basilisk, case.theirs, case.arguments) if options.basilisk else nullcontext(None) as other:
        turns = [(other(options.seconds) if other else None, harness.play(player, options.seconds)) for _ in range(options.turns)]
    row = {
        "case": name,
        "batch": batch,
        "rate": statistics.median(ours.rate for _, ours in turns),
        "decision_rate": statistics.median(ours.decision_rate for _, ours in turns),
        "turns": [{"basilisk": theirs._asdict() if theirs else None, "ours": ours._asdict()} for theirs, ours in turns],
    }
    ratios = [ours.rate / theirs.rate for theirs, ours in turns if theirs]
    if ratios:
        row |= {"ratio": statistics.median(ratios), "ratio_low": min(ratios), "ratio_high": max(ratios)}
        row["basilisk_rate"] = statistics.median(theirs.rate for theirs, _ in turns if theirs)
    return row


def main() -> None:
    """Measure and print a table."""
    arguments = harness.parser(__doc__, batch=1024, turns=3, seconds=10.0)
    arguments.add_argument("--basilisk", metavar="PYTHON", help="interpreter with bsk and bsk_rl")
    arguments.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), metavar="CASE", help=", ".join(CASES))
    options, described = harness.begin(arguments)
    rows = harness.Rows(options, described, (measure(name, options) for name in options.only))
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
