"""Whether rows of a saved state are such as satellites of a type have."""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.sim.arguments.values import merge
from bsk_torch.sim.assembly.draws import TypeArguments
from bsk_torch.sim.assembly.initial_orbits import check_orbits
from bsk_torch.sim.assembly.satellite_type import SatelliteType
from bsk_torch.sim.component import asked
from bsk_torch.sim.satellite_state import ArgumentState, SatelliteState

CLOSE = 1e-9  # relative difference of parameters that two machines compute from the same arguments


def check_saved(satellite_type: SatelliteType, saved: SatelliteState, path: str) -> None:
    """Check that arguments and parameters of a saved state are such as are drawn here; ``path`` is its place in the state.

    ValueError for arguments that are not allowed, or parameters that do not follow from them.
    """
    arguments = satellite_type.arguments
    drawn = saved.tables["arguments"]
    assert isinstance(drawn, ArgumentState)
    values, low, high = {name: drawn[name] for name in drawn}, *_bounds(arguments, drawn)
    wrong = ~((drawn.values >= low) & (drawn.values <= high))
    for name, place in drawn.places.items() if bool(wrong.any()) else ():
        limits = f"[{float(low[place].max()):g}, {float(high[place].min()):g}]"
        outside = wrong[place].movedim(-1, 0).reshape(values[name].shape)
        saved.refuse(f"{path}arguments.{name}", values[name], outside, f"it must lie in {limits}")
    for name, value in values.items():
        if arguments.argument(name).shared:
            saved.refuse(f"{path}arguments.{name}", value, value != value[:1], "it must be the same in all episodes")
            values[name] = value[:1]
    on_host = {name: value.cpu() for name, value in values.items()} | saved.constants
    for part, part_values in asked(arguments.parts, on_host):
        if part.check is not None:
            part.check(part_values)
    check_orbits(on_host, arguments.orbit)
    parameters = satellite_type.tick.own.rows(merge(on_host, arguments.parts, "prepare"), saved.rows).to(saved.device).mT
    wrong = ~torch.isclose(saved.parameters.mT, parameters, rtol=CLOSE, atol=0.0, equal_nan=True)
    saved.refuse(f"{path}parameters", saved.parameters.mT, wrong, "it does not follow from the arguments of the satellite")


def _bounds(arguments: TypeArguments, drawn: ArgumentState) -> tuple[Tensor, Tensor]:
    """Return the smallest and the largest value of each plane of the arguments, [C, 1]."""
    bounds = torch.zeros(2, len(drawn.values), 1, dtype=torch.float64, device=drawn.device)
    for name, place in drawn.places.items():
        arg = arguments.argument(name)
        bounds[0, place], bounds[1, place] = (0, len(arg.choices) - 1) if arg.kind == "choice" else (arg.low, arg.high)
    return bounds[0], bounds[1]
