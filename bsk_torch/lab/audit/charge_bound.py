"""Lower bound on the charge that a satellite needs to survive, regardless of its actions.

The bound assumes that the panel always faces the Sun, that only the base load and idle wheels draw power, and that turning is
free. Sunlight is computed along the orbit, which does not depend on actions.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from bsk_torch.env import SatelliteTasking
from bsk_torch.lab.bounds.windows import sunlight
from bsk_torch.sim.dyn.effectors.wheels import base_power_of_wheels

SINKS = ("instrumentPowerDraw", "transmitterPowerDraw", "thrusterPowerDraw")
"""Power of devices switched on by actions, W; negative for consumption."""

NEEDED = (
    *SINKS,
    "panelArea",
    "panelEfficiency",
    "basePowerDraw",
    "rwBasePower",
    "rwMechToElecEfficiency",
    "batteryStorageCapacity",
)
"""Arguments that determine the bound."""


def check_bounded(env: SatelliteTasking) -> None:
    """Raise ValueError if the bound does not hold: for satellites without its arguments, or with wheels that return power."""
    missing = [name for name in NEEDED if name not in env.satellite.sat_args]
    if missing:
        raise ValueError(f"the bound on the charge needs a satellite with the arguments {missing}, such as NadirScan-v1's")
    if env.satellite.sat_args["panelArea"].ndim > 1:
        raise ValueError("the bound on the charge covers one solar panel; the satellite has a list of panels")
    if bool((env.satellite.sat_args["rwMechToElecEfficiency"] > 0.0).any()):
        raise ValueError("rwMechToElecEfficiency is above 0: braking wheels give power back, which the bound does not count")


def most_power(env: SatelliteTasking, rows: Tensor) -> Tensor:
    """Return the maximum power into the battery, W, in ticks 1, 2, ... of ``rows`` [n], whose episodes have just begun, [n, T].

    ValueError from :func:`check_bounded`, and for episodes whose orbits are not solved to the end at reset.
    """
    check_bounded(env)
    last = int(env.state.limit_ticks[rows].max())
    fixed_orbit = env.simulator.orbit == "arc" and not env.simulator.has_tank
    if not fixed_orbit or last * env.simulator.h > env.simulator.arcs.length:
        raise ValueError(f"time_limit={last * env.simulator.h:g} s: the bound needs orbits solved to the end at reset")
    lit, flux = sunlight(env, rows, torch.arange(1, last + 1, dtype=torch.float64, device=env.device))
    scalars = (name for name in NEEDED if not name.startswith("rw"))
    args = {name: env.satellite.sat_args[name].expand(len(env.env_ids))[rows].unsqueeze(1) for name in scalars}
    always = args["basePowerDraw"] - base_power_of_wheels(env.satellite.sat_args, len(env.env_ids))[rows].unsqueeze(1)
    gifts = sum(args[name].clamp(min=0.0) for name in SINKS)
    return lit * flux * (args["panelArea"] * args["panelEfficiency"]) + always + gifts


def longest_action(env: SatelliteTasking) -> int:
    """Return the ticks of the longest action; ValueError for actions without fixed durations."""
    table = env.satellite.actions.table()
    if not bool(torch.isfinite(table.duration).all()):
        raise ValueError("the actions of this satellite have no fixed durations, which the search for failures needs")
    return math.ceil(min(float(table.duration.max()), env.max_step_duration) / env.simulator.h)


def least_charge(gain: Tensor, longest: int) -> Tensor:
    """Return the charge, W s, that a satellite must exceed at tick 0, 1, ... to survive; -infinity for none, [N, T + 1].

    A satellite dies if its battery is empty at the end of an action. An empty battery stays empty while the maximum gain is not
    positive. If this lasts for ``longest`` ticks, or to the end of the episode, an action ends during this time. Therefore,
    charge is needed at the first of these ticks, and earlier ticks need the losses until then in addition.

    Args:
        gain: Maximum gain of charge in each tick, [N, T] W s.
        longest: Ticks of the longest action.
    """
    n, last = gain.shape
    need, dark = gain.new_zeros(n), torch.zeros(n, dtype=torch.int64, device=gain.device)
    needs = [need]
    for tick in range(last - 1, -1, -1):
        need = need - gain[:, tick]
        need = torch.where(need >= 0.0, need, -torch.inf)
        dark = torch.where(gain[:, tick] <= 0.0, dark + 1, 0)
        empty = (dark >= longest - 1) | (tick + dark >= last)
        need = torch.where(empty, need.clamp(min=0.0), need)
        needs.append(need)
    return torch.stack(needs[::-1], 1)
