"""Upper bound on what a satellite that scans along its ground track records: energy, storage and time as a linear program."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import torch
from torch import Tensor

from bsk_torch._checks import number
from bsk_torch.astro.ephemeris import sun_position
from bsk_torch.astro.frames import angle_between
from bsk_torch.data import ScanningTimeReward
from bsk_torch.env import SatelliteTasking
from bsk_torch.lab.bounds.windows import inertial_positions, sunlight
from bsk_torch.sats import BoundAccessSatellite
from bsk_torch.sim.dyn.effectors.wheels import base_power_of_wheels
from bsk_torch.sim.fsw import ContinuousImagingFSWModel

STATIONS = "ground_station"
"""Kind of opportunity in which data can be sent."""


@dataclass(frozen=True)
class ScanningBound:
    """Bounds of N episodes.

    Attributes:
        upper: No policy collects more, under the assumptions of :func:`scanning_bound`, [N].
        recorded: Seconds recorded in each interval by an optimum of the linear program, [N, K].
        downlinked: Seconds of downlink in each interval, [N, K].
        charge: Charge of the battery at the end of each interval, [N, K] W s.
        level: Data in the store at the end of each interval, [N, K] bit.
    """

    upper: Tensor
    recorded: Tensor
    downlinked: Tensor
    charge: Tensor
    level: Tensor


def check_scanning(env: SatelliteTasking) -> None:
    """ValueError, before anything is computed, unless the bound of scanning covers the task as it is now."""
    if not isinstance(env, SatelliteTasking) or type(env.rewarder) is not ScanningTimeReward:
        raise ValueError(
            f"{type(env).__name__} with {type(env.rewarder).__name__}: the bound of scanning covers one satellite with "
            "ScanningTimeReward, such as NadirScan-v1"
        )
    if env.rewarder.reward_fn is not None:
        raise ValueError("the bound of scanning needs ScanningTimeReward without reward_fn: it pays seconds in proportion")
    if not issubclass(type(env.satellite).fsw_type, ContinuousImagingFSWModel):
        raise ValueError(f"{type(env.satellite).fsw_type.__name__} does not scan; the bound needs ContinuousImagingFSWModel")
    env.guard.check_begun("scanning_bound(env)")
    args, simulator = env.satellite.sat_args, env.simulator
    if bool((args["rwMechToElecEfficiency"] > 0.0).any()):
        raise ValueError("rwMechToElecEfficiency is above 0: braking wheels give power back, which the bound does not count")
    for name in ("instrumentPowerDraw", "transmitterPowerDraw", "thrusterPowerDraw"):
        if bool((args[name] > 0.0).any()):
            raise ValueError(f"{name} is above 0: it gives power, which the bound does not count")
    if simulator.type.instruments:
        raise ValueError("the bound of scanning covers one instrument; the satellite has a list of instruments")
    if args["panelArea"].ndim > 1:
        raise ValueError("the bound of scanning covers one solar panel; the satellite has a list of panels")
    last = float(env.state.limit_ticks.max()) * simulator.h
    if simulator.orbit != "arc" or simulator.has_tank or last > simulator.arcs.length:
        raise ValueError(f"time_limit={last:g} s: the bound needs orbits that no action changes, solved to the end at reset")
    if bool((simulator.state.ticks != 0).any()):
        raise ValueError("the bound is that of whole episodes: call it after env.reset(), before the first step")


def scanning_bound(env: SatelliteTasking, *, interval: float = 60.0) -> ScanningBound:
    """Return an upper bound on the return of each episode that has just begun, such as NadirScan-v1's.

    Time is cut into intervals. In each of them, recording r_k and downlink d_k, s, may be done in any order and any number of
    pieces, one at a time:

        maximize value sum_k r_k
        r_k + d_k <= T_k, d_k <= (time in view of stations), r_k, d_k >= 0
        L_k <= L_(k-1) + b r_k,  L_k >= L_(k-1) + b r_k - R d_k,  0 <= L_k <= capacity
        E_k <= E_(k-1) + (sunlight on a panel that faces the Sun) + s_k r_k - (base load) T_k - P_i r_k - P_t d_k
        0 <= E_k <= capacity

    The panel faces the Sun except while recording: there the instrument is within its tolerance of nadir, and s_k <= 0 is the
    least loss of sunlight that this costs anywhere in the interval. Slews, momentum and torques cost nothing. The bound assumes
    that the battery does not run empty within an action and recovers before its end, which would be free energy. Dying pays at
    most nothing, as ``failure_penalty`` outweighs what it saves.

    Args:
        env: An environment after ``reset``.
        interval: Length of an interval, s.

    Raises:
        ValueError: For a task that the bound does not cover, before anything is computed; for an interval below a tick.
    """
    check_scanning(env)
    h = env.simulator.h
    ticks = int(number("interval", interval, h, unit="s") / h)
    rows = torch.arange(len(env.env_ids))
    passes = _passes(env)
    parts = [_row_bound(env, row, ticks, passes) for row in rows.split(1)]
    return ScanningBound(
        torch.tensor([part[0] for part in parts], dtype=torch.float64),
        *(torch.stack(c) for c in list(zip(*parts, strict=True))[1:]),
    )


def _light(env: SatelliteTasking, row: Tensor, ticks: Tensor) -> tuple[Tensor, Tensor]:
    """Return the power per area, W/m^2, of sunlight on a panel that faces the Sun, and the angle between Sun and nadir, [T] rad.

    Both are those at the ends of ``ticks`` [T] of one ``row`` [1].
    """
    arcs, rows, time = env.simulator.arcs, row.expand(len(ticks)), ticks * env.simulator.h
    lit, flux = sunlight(env, row, ticks)
    position = inertial_positions(arcs, rows, time)
    return (lit * flux).squeeze(0), angle_between(sun_position(arcs.et[rows] + time) - position, -position)


def _row_bound(
    env: SatelliteTasking, row: Tensor, width: int, passes: tuple[Tensor, Tensor]
) -> tuple[float, Tensor, Tensor, Tensor, Tensor]:
    """Solve the program of one episode: its value, and recording, downlink, charge and level of each interval."""
    h, limit = env.simulator.h, int(env.state.limit_ticks[row])
    args = {name: float(value[row]) for name, value in _scalars(env).items()}
    args["wheels"] = float(base_power_of_wheels(env.satellite.sat_args, len(env.env_ids))[row])
    ticks = torch.arange(1, limit + 1, dtype=torch.float64)
    power, angle = _light(env, row, ticks)
    gain = power * args["panelArea"] * args["panelEfficiency"]
    panel, instrument = env.satellite.sat_args["nHat_B"][row], env.satellite.sat_args["inst_pHat_B"][row]
    turned, tolerance = float(angle_between(panel, instrument)), 4.0 * math.atan(min(args["imageAttErrorRequirement"], 1.0))
    cosine = torch.cos(((angle - turned).abs() - tolerance).clamp(min=0.0)).clamp(min=0.0)
    intervals = math.ceil(limit / width)
    pad = intervals * width - limit
    collected = torch.nn.functional.pad(gain, (0, pad)).view(intervals, width).sum(1) * h
    loss = torch.nn.functional.pad(gain * (cosine - 1.0), (0, pad), value=-torch.inf).view(intervals, width).amax(1)
    length = torch.full((intervals,), width * h, dtype=torch.float64)
    length[-1] -= pad * h
    scenario: Any = env.scenario
    return _solve(
        args,
        collected,
        loss,
        length,
        _in_view([table[row].flatten() for table in passes], intervals, width * h, h),
        float(scenario.value_per_second),
    )


def _scalars(env: SatelliteTasking) -> dict[str, Tensor]:
    names = (
        "panelArea", "panelEfficiency", "imageAttErrorRequirement", "basePowerDraw", "instrumentPowerDraw",
        "transmitterPowerDraw", "batteryStorageCapacity", "storedCharge_Init", "dataStorageCapacity", "storageInit",
        "instrumentBaudRate", "transmitterBaudRate",
    )  # fmt: skip
    return {name: env.satellite.sat_args[name].expand(len(env.env_ids)) for name in names}


def _passes(env: SatelliteTasking) -> tuple[Tensor, Tensor]:
    """Return when passes over stations open and close, [N, K] s each; infinite where there is none."""
    satellite = cast(BoundAccessSatellite, env.satellite)
    if STATIONS not in satellite.opportunity_types:
        none = torch.zeros(len(env.env_ids), 0, dtype=torch.float64)
        return none, none
    opens, close = satellite.find_windows(env.state.limit_ticks.double() * env.simulator.h, STATIONS)[:2]
    return opens, close


def _in_view(passes: list[Tensor], intervals: int, length: float, h: float) -> Tensor:
    """Seconds of each interval in which a station is in view, no more than sums over stations; a tick more for each pass."""
    begin = torch.arange(intervals, dtype=torch.float64) * length
    opens, close = passes
    valid = torch.isfinite(close)
    opens, close = opens[valid] - h, close[valid] + h
    overlap = torch.minimum(close, begin.unsqueeze(1) + length) - torch.maximum(opens, begin.unsqueeze(1))
    return overlap.clamp(min=0.0).sum(1).clamp(max=length)


def _solve(
    args: dict[str, float], collected: Tensor, loss: Tensor, length: Tensor, view: Tensor, value: float
) -> tuple[float, Tensor, Tensor, Tensor, Tensor]:
    """Solve the program in units of seconds, and of capacities of battery and store."""
    import numpy as np
    from scipy import sparse
    from scipy.optimize import linprog

    k, battery = len(length), args["batteryStorageCapacity"]
    store = args["dataStorageCapacity"] if math.isfinite(args["dataStorageCapacity"]) else 1e15
    eye, before, none = sparse.identity(k), sparse.eye(k, k=-1), sparse.csr_matrix((k, k))
    base = args["basePowerDraw"] - args["wheels"]
    rate, downlink = args["instrumentBaudRate"] / store, -args["transmitterBaudRate"] / store
    spent = (loss.numpy() + args["instrumentPowerDraw"]) / battery
    first = np.zeros(k)
    first[0] = 1.0
    level = args["storageInit"] / store if args["storageInit"] <= store else 0.0  # as the store starts
    unequal = sparse.bmat(
        [
            [eye, eye, None, None],
            [-rate * eye, None, None, eye - before],
            [rate * eye, -downlink * eye, None, before - eye],
            [-sparse.diags(spent), -args["transmitterPowerDraw"] / battery * eye, eye - before, none],
        ],
        format="csr",
    )
    energy = (collected + base * length).numpy() / battery + first * args["storedCharge_Init"] / battery
    limits = np.concatenate([length.numpy(), first * level, -first * level, energy])
    bounds = [*((0.0, float(t)) for t in length), *((0.0, float(t)) for t in view), *[(0.0, 1.0)] * (2 * k)]
    cost = np.concatenate([-np.ones(k), np.zeros(3 * k)])
    solution = linprog(cost, A_ub=unequal, b_ub=limits, bounds=bounds, method="highs")
    if solution.status == 2:  # no plan keeps the battery charged: dying, which pays nothing at most, is the best that there is
        zeros = torch.zeros(k, dtype=torch.float64)
        return 0.0, zeros, zeros, zeros, zeros
    if solution.status != 0:
        raise RuntimeError(f"HiGHS did not solve the linear program of the bound: {solution.message}")
    recorded, sending, charge, data = torch.from_numpy(solution.x).view(4, k)
    return -solution.fun * value * (1.0 + 1e-9), recorded, sending, charge * battery, data * store
