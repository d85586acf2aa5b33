"""Saving and restoring everything that an environment's future depends on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from bsk_torch.sim.access import Windows
from bsk_torch.sim.orbit import Arcs

if TYPE_CHECKING:
    from bsk_torch.sim.simulator import Simulator


def simulation_state(simulator: Simulator) -> TensorDict:
    """State of a simulation, [N] rows."""
    arcs, eclipses = simulator.arcs, simulator.eclipses
    values: dict[str, Tensor | TensorDict] = {
        "pack": simulator.pack.mT,
        "own": simulator.own.mT,
        "ticks": simulator.ticks,
        "mode": simulator.mode,
        "flown": arcs.flown,
        "planned": arcs.planned,
        "arc_start": arcs.start,
        "et": arcs.et,
        "sampled": eclipses.sampled,
        "known": eclipses.known,
    }
    arguments = {name: value for name, value in simulator.drawn.items() if isinstance(value, Tensor)}
    values["arguments"] = TensorDict(arguments, [simulator.num_envs])
    if simulator.access is not None:
        values["windows_until"] = simulator.access.until
        values |= {f"windows_{name}": table for name, table in simulator.access.windows._asdict().items()}
    return TensorDict(values, [simulator.num_envs], device=simulator.device).clone()


def _matching_arcs(simulator: Simulator, saved: TensorDictBase) -> tuple[Tensor, Tensor]:
    """Saved arcs, made as long as the simulation's; the simulation's are made longer where the saved ones are."""
    arcs = simulator.arcs
    other = Arcs(len(saved), 1, arcs.solver)
    other.flown, other.planned = saved["flown"].clone(), saved["planned"].clone()
    other.start, other.et = saved["arc_start"], saved["et"]
    while arcs.length < other.length:
        arcs.grow()
    while other.length < arcs.length:
        other.grow()
    return other.flown, other.planned


def restore_simulation(simulator: Simulator, saved: TensorDictBase, rows: Tensor) -> None:
    """Put the saved state [N] back into ``rows`` [n] of a simulation."""
    if not bool(simulator.arcs.et.any()):  # never reset: there is nothing to extend to the saved length
        simulator.arcs.flown, simulator.arcs.planned = saved["flown"].clone(), saved["planned"].clone()
        simulator.arcs.start, simulator.arcs.et = saved["arc_start"].clone(), saved["et"].clone()
    flown, planned = _matching_arcs(simulator, saved)
    arcs, eclipses = simulator.arcs, simulator.eclipses
    arcs.flown[rows], arcs.planned[rows] = flown[rows], planned[rows]
    pairs = [(arcs.start, "arc_start"), (arcs.et, "et"), (eclipses.sampled, "sampled"), (eclipses.known, "known")]
    for tensor, name in [*pairs, (simulator.ticks, "ticks"), (simulator.mode, "mode")]:
        tensor[rows] = saved[name][rows]
    simulator.pack[:, rows], simulator.own[:, rows] = saved["pack"][rows].mT, saved["own"][rows].mT
    for name, value in saved["arguments"].items():
        if name not in simulator.drawn:
            simulator.drawn[name] = torch.zeros_like(value)
        simulator.drawn[name][rows] = value[rows]
    eclipses.refresh(simulator.all_rows)
    if simulator.access is not None:
        simulator.access.until[rows] = saved["windows_until"][rows]
        windows = Windows(*(saved[f"windows_{name}"][rows] for name in Windows._fields))
        simulator.access.store(rows, windows)
