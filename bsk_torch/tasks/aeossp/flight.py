"""Flights of plans of aeossp_standard: each satellite of a case slews to its tasks and tracks them with body, wheels and battery.

The benchmark's verifier takes a satellite for an axis that turns from rest to rest. Here it is a rigid body with the wheels that
:func:`bsk_torch.craft.from_slew_limits` finds for the same limits. It tracks the task of each observation, begins the slew to
the next one as soon as an observation ends, and arrives in motion. An observation counts as delivered if the
pointing error, the rate error and the off-nadir angle stay within their limits at all ticks from its start to its end, and the
battery is not empty since the one before.

Satellites are a constellation, one batch of rows. Their orbits are those of SGP4 that the verifier has, ``orbit="sgp4"``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from bsk_torch import ConstellationTasking, act, craft, data, obs, sats, scene
from bsk_torch.astro.attitude import dcm_to_mrp
from bsk_torch.astro.element_sets import ElementSet
from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.astro.orbit import hill_frame
from bsk_torch.sim.dyn.effectors.wheel_set import wheel_defaults
from bsk_torch.sim.names import one_of
from bsk_torch.sim.simulator import Simulator
from bsk_torch.tasks.aeossp.files import Case, Observations
from bsk_torch.tasks.aeossp.geometry import Numbers, elements, on_ellipsoid, tracks
from bsk_torch.tasks.aeossp.models import HOLD_MODE, LOOK_MODE, FlownDynModel, FlownFSWModel, WheelPowerDynModel
from bsk_torch.tasks.aeossp.rules import find_slews
from bsk_torch.vec3 import Vec3

Flags = NDArray[np.bool_]

TICK = 0.1
"""Length of a tick, s."""

ANGLE, RATE = 0.01, 0.01
"""Largest pointing error, rad, and rate error, rad/s, while observing: those of BSK-RL's imaging satellites."""

GEOMETRY = math.radians(1e-3)
"""By which off-nadir angles may exceed their limit between the times of the grid on which the verifier tests them, rad."""

EARLY = 2.0
"""How long before its start the slew to an observation begins in longer gaps, over the verifier's time for it."""

REASONS = ("pointing", "rate", "off_nadir", "battery")

UTC = "%Y-%m-%dT%H:%M:%S.%fZ"
"""Format of the epoch of a case."""

POWERS = ("case", "wheels")
"""What slews draw from the battery."""


@dataclass(frozen=True)
class Flight:
    """What became of the n observations of a plan, in its order.

    Attributes:
        angle: Largest pointing error of each, rad, [n].
        rate: Largest rate error, rad/s, [n].
        off_nadir: Largest off-nadir angle, rad, [n].
        fastest: Largest rate of the body since the observation before, rad/s, [n].
        least: Least charge of the battery since the observation before, Wh, [n].
        missed: Why each was not delivered: the first of :data:`REASONS` that holds, [n]; -1 for delivered ones.
        final: Charge at the end of the horizon, Wh, [S].
    """

    angle: NDArray[np.float64]
    rate: NDArray[np.float64]
    off_nadir: NDArray[np.float64]
    fastest: NDArray[np.float64]
    least: NDArray[np.float64]
    missed: Numbers
    final: NDArray[np.float64]

    @property
    def delivered(self) -> Flags:
        """Which observations were delivered, [n]."""
        return self.missed < 0


class Flyer(sats.Satellite):
    """A satellite of a case."""

    observation_spec: ClassVar[Sequence[obs.Observation]] = (obs.Time(),)
    action_spec: ClassVar[Sequence[act.Action]] = (act.Drift(),)
    dyn_type = FlownDynModel
    fsw_type = FlownFSWModel


class WheelPowerFlyer(Flyer):
    """The same with the power of its wheels in place of that of slews."""

    dyn_type = WheelPowerDynModel


def fly(
    case: Case,
    observations: Observations,
    *,
    factor: float | Sequence[float] = 1.0,
    power: str = "case",
    tick: float = TICK,
    tolerance: tuple[float, float] = (ANGLE, RATE),
    satellites: Sequence[int] | None = None,
) -> Flight:
    """Return what becomes of the observations of a plan.

    Args:
        case: The case.
        observations: The plan, which need not be valid; those of a satellite must not overlap.
        factor: Factor of the slew limits, rate and acceleration, for all satellites or for each of those flown.
        power: Loads of slews: ``"case"``, the case's slew power while the reference slews, or ``"wheels"``, the mechanical power
            of the wheels, driven and braked alike.
        tick: Length of a tick, s; it must divide the step of the case.
        tolerance: Largest pointing error, rad, and rate error, rad/s, while observing.
        satellites: Numbers of the satellites that are flown (default: all); observations of others are not delivered.

    Raises:
        ValueError: For overlapping observations, another power, and ticks that do not divide the step of the case.
    """
    one_of("power", power, POWERS)
    crew = list(range(len(case.satellites))) if satellites is None else list(satellites)
    table = _schedule(observations, crew)
    if not math.isclose(case.step_s / tick, round(case.step_s / tick), rel_tol=1e-9):
        raise ValueError(f"tick={tick:g} s must divide the step of {case.step_s} s of the case")
    simulator = _simulator(case, crew, np.broadcast_to(np.asarray(factor, dtype=float), len(crew)), power, tick)
    return _flown(simulator, case, observations, table, tick, tolerance)


def _schedule(observations: Observations, crew: Sequence[int]) -> NDArray[np.int64]:
    """Return the numbers of the observations of each satellite in their order, [R, K]; -1 behind the last."""
    rows = []
    for number in crew:
        mine = np.flatnonzero(observations.satellite == number)
        mine = mine[np.argsort(observations.start_s[mine], kind="stable")]
        overlaps = np.flatnonzero(observations.start_s[mine[1:]] < observations.end_s[mine[:-1]])
        if len(overlaps):
            k = int(overlaps[0])
            raise ValueError(f"observations {mine[k]} and {mine[k + 1]} of satellite {number} overlap; they cannot be flown")
        rows.append(mine)
    table = np.full((len(crew), max(map(len, rows), default=0)), -1)
    for row, mine in zip(table, rows, strict=True):
        row[: len(mine)] = mine
    return table


def _simulator(case: Case, crew: list[int], factors: NDArray[np.float64], power: str, tick: float) -> Simulator:
    """Return the simulation of some satellites of a case at the start of the horizon; they look at nadir."""
    kind = Flyer if power == "case" else WheelPowerFlyer
    arguments = crew_arguments(case, crew, tick, factors, power)
    for row in arguments:
        del row["maxWheelSpeed"]
    env = ConstellationTasking(
        [kind(f"Satellite{number}", row) for number, row in zip(crew, arguments, strict=True)],
        scenario=scene.Scenario(),
        rewarder=data.NoReward(),
        world_args={"utc_init": case.start.strftime(UTC)},
        num_envs=1,
        time_limit=float(case.horizon_s),
        sim_rate=tick,
        orbit="sgp4",
        seed=0,
    )
    env.reset()
    (simulator,) = env.fleet.simulators
    return simulator


def _at_nadir(orbit: ElementSet, et: float) -> dict[str, object]:
    """Return the attitude and the rate, rad/s, with which B turns as the Hill frame does, at ET, s."""
    r, v = orbit.state_at(torch.tensor([et], dtype=torch.float64))
    rate = torch.linalg.cross(r, v).norm() / r.square().sum()
    return {
        "sigma_init": dcm_to_mrp(hill_frame(Vec3.of(r), Vec3.of(v))).stack()[0].tolist(),
        "omega_init": [0.0, 0.0, float(rate)],
    }


def crew_arguments(
    case: Case, crew: Sequence[int], tick: float, factors: NDArray[np.float64], power: str = "case"
) -> list[dict[str, object]]:
    """Return the arguments of satellites ``crew``: orbits, wheels of their slew limits, times ``factors``, and batteries."""
    rows = [_arguments(case, number, float(factor), power, tick) for number, factor in zip(crew, factors, strict=True)]
    return [row | {"wheels": rows[0]["wheels"]} for row in rows]  # of which each satellite has its own numbers


def _arguments(case: Case, number: int, factor: float, power: str, tick: float) -> dict[str, object]:
    satellite = case.satellites[number]
    spacecraft = craft.from_slew_limits(
        factor * satellite.slew_rate, factor * satellite.slew_acceleration, max(satellite.settling_s, 2.0 * tick), h=tick
    )
    numbers = {name: tuple(values) for name, values in wheel_defaults(spacecraft["wheels"]).items()}
    return {
        **spacecraft,
        **{name: numbers[name] for name in ("u_max", "rwJs")},
        "oe": elements(satellite),
        **_at_nadir(elements(satellite), parse_utc(case.start)),
        "idlePower": satellite.idle_w,
        "imagingPower": satellite.imaging_w,
        "slewPower": satellite.slew_w if power == "case" else 0.0,
        "chargePower": satellite.charge_w,
        "batteryStorageCapacity": satellite.capacity_wh * 3600.0,
        "storedCharge_Init": satellite.initial_wh * 3600.0,
    } | ({} if power == "case" else {"rwBasePower": 0.0, "rwMechToElecEfficiency": -1.0, "rwElecToMechEfficiency": 1.0})


def _flown(
    simulator: Simulator,
    case: Case,
    observations: Observations,
    table: NDArray[np.int64],
    tick: float,
    tolerance: tuple[float, float],
) -> Flight:
    """Fly the observations in ``table`` [R, K], all satellites at once, each at its own time."""
    total = len(observations)
    places = torch.from_numpy(on_ellipsoid(case.requests))
    begin = observations.start_s - EARLY * find_slews(case, observations, tracks(case)).required
    fields = {"angle": "look_angle", "rate": "look_rate", "off_nadir": "look_off_nadir"}
    fields |= {"fastest": "fastest", "least": "least_charge"}
    measured = {name: np.full(total, np.nan) for name in fields}

    def run_until(seconds: NDArray[np.float64], looks: Tensor) -> None:
        ticks = torch.from_numpy(np.ceil(seconds / tick - 1e-9)).long() - simulator.ticks
        simulator.run(torch.where(looks, ticks.clamp(min=0), 0))

    look, hold = simulator.mode_index(LOOK_MODE), simulator.mode_index(HOLD_MODE)
    for k, column in enumerate(table.T):
        flies = column >= 0
        looks, number = torch.from_numpy(flies), np.maximum(column, 0)
        simulator.command(looks, hold if k else look)
        simulator.write("sigma_RN", looks, simulator.read("sigma_BN"))
        simulator.write("r_LP_P", looks, torch.zeros(len(table), 3, dtype=torch.float64))
        run_until(begin[number], looks)
        least = simulator.read("least_charge").flatten().numpy()
        simulator.command(looks, look)
        simulator.write("r_LP_P", looks, places[torch.from_numpy(observations.task[number])])
        for name, seconds in (("look_first", observations.start_s), ("look_last", observations.end_s)):
            simulator.write(name, looks, torch.from_numpy(seconds[number] / tick))
        run_until(observations.end_s[number].astype(np.float64), looks)
        for name, field in fields.items():
            measured[name][column[flies]] = simulator.read(field).flatten().double().numpy()[flies]
        measured["least"][column[flies]] = np.minimum(measured["least"][column[flies]], least[flies])
    simulator.run(round(case.horizon_s / tick) - simulator.ticks)
    measured["least"] /= 3600.0
    limit = np.radians([satellite.off_nadir for satellite in case.satellites])[observations.satellite]
    wrong = np.stack(
        [
            ~(measured["angle"] <= tolerance[0]),
            ~(measured["rate"] <= tolerance[1]),
            ~(measured["off_nadir"] <= limit + GEOMETRY),
            ~(measured["least"] > 0.0),
        ]
    )
    missed = np.where(wrong.any(0), wrong.argmax(0), -1)
    return Flight(**measured, missed=missed, final=simulator.read("charge").flatten().numpy() / 3600.0)
