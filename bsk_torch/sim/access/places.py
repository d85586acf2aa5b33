"""Places on the ground that satellites may see: ground stations of the world, targets of the scenario."""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.rand import first_key
from bsk_torch.sim.access.passes import Places
from bsk_torch.sim.access.windows import AccessWindows, PlacesOf
from bsk_torch.sim.environment.world import station_arrays
from bsk_torch.sim.params import Arguments
from bsk_torch.sim.state import StateTable, look_up

TARGETS = "target_r_LP_P"
"""Name under which scenarios draw the positions of targets."""

STATION_KIND, TARGET_KIND = "ground_station", "target"
"""Kinds of places, which are types of opportunities."""

ADVICE = {
    STATION_KIND: "add stations to world_args['groundStationsData'], lower gsMinimumElevation",
    TARGET_KIND: "all have been imaged, or too few lie below the orbit: ask for more targets, lower imageTargetMinimumElevation",
}
"""What a user can do if no place comes into view."""


def place_kinds(world_args: Arguments, scenario: StateTable, arguments: StateTable) -> dict[str, PlacesOf]:
    """Return the places that satellites can see, by kind.

    Args:
        world_args: Arguments of the world, with the ground stations.
        scenario: Draws of the scenario, [num_envs, ...] each; read whenever places are requested.
        arguments: Arguments of the satellites, [N, ...] each; likewise.
    """
    kinds: dict[str, PlacesOf] = {}
    if "groundStationsData" in world_args.table:
        arrays = station_arrays(world_args.draw(first_key(1)))
        r_LP_P = arrays["station_positions_P"].view(1, 3, -1).mT.contiguous().to(arguments.device)
        stations = Places(r_LP_P, arrays["station_sin_elevations"].to(arguments.device))
        kinds[STATION_KIND] = lambda rows: stations
    if TARGETS in scenario and "imageTargetMinimumElevation" in arguments:

        def targets(rows: Tensor) -> Places:
            envs = rows // arguments.count
            r_LP_P, exists = scenario[TARGETS][envs], scenario["target_exists"][envs] > 0.5  # copies
            sin_min_elevation = torch.sin(arguments["imageTargetMinimumElevation"][rows]).unsqueeze(-1)
            return Places(r_LP_P.masked_fill_(~exists.unsqueeze(-1), torch.nan), sin_min_elevation.expand_as(exists))

        kinds[TARGET_KIND] = targets
    return kinds


def place_positions(access: AccessWindows, scenario: StateTable, kind: str, place: Tensor) -> Tensor:
    """Return the Earth-fixed positions, [N, n, 3] m, of places [N, n] of a kind.

    Targets are read from the draws of the ``scenario``; stations are the same for all satellites.
    """
    if kind == TARGET_KIND:
        return look_up(scenario[TARGETS], place)
    return access.kinds[kind](place[:, 0]).r_LP_P[0, place]
