"""Simulators of satellites that belong to no environment."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import torch

from bsk_torch.sim.assembly.satellite_type import SimulationOptions, Usage, satellite_type
from bsk_torch.sim.draw_table import DrawTable
from bsk_torch.sim.simulator import Simulator

OPTIONS = {option.name for option in fields(SimulationOptions)}


def make_simulator(
    dyn_type: type,
    fsw_type: type,
    sat_args: Mapping[str, Any] | Sequence[Mapping[str, Any]],
    world_args: Mapping[str, Any],
    *,
    num_envs: int,
    horizon: float = 0.0,
    scenario_state: DrawTable | None = None,
    **options: Any,
) -> Simulator:
    """A simulator; ``options`` are those of :class:`SimulationOptions` and of :class:`Usage`."""
    how = SimulationOptions(device=torch.device("cpu"), **{name: value for name, value in options.items() if name in OPTIONS})
    usage = Usage(**{name: value for name, value in options.items() if name not in OPTIONS})
    made = satellite_type((dyn_type, fsw_type), sat_args, world_args, how, usage, num_envs=num_envs)
    return Simulator(made, num_envs, horizon=horizon, scenario_state=scenario_state)
