"""Saving and restoring everything that an environment's future depends on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from bsk_torch.sim.access import Windows
from bsk_torch.sim.orbit import FIELDS, Arcs
from bsk_torch.sim.ragged import stored

if TYPE_CHECKING:
    from bsk_torch.sim.fleet import Fleet
    from bsk_torch.sim.simulator import Simulator

ECLIPSES = ("sampled", "known", "starts", "ends")


def simulation_state(simulator: Simulator) -> TensorDict:
    """State of a simulation, [num_envs, ...] where there is one satellite of the type, else [num_envs, count, ...]."""
    values: dict[str, Tensor | TensorDict] = {
        "pack": simulator.pack.mT,
        "own": simulator.own.mT,
        "ticks": simulator.ticks,
        "mode": simulator.mode,
        **{f"arcs_{name}": getattr(simulator.arcs, name) for name in FIELDS},
        **{f"eclipses_{name}": getattr(simulator.eclipses, name) for name in ECLIPSES},
    }
    arguments = {name: value for name, value in simulator.drawn.items() if isinstance(value, Tensor)}
    values["arguments"] = TensorDict(arguments, [simulator.size])
    if simulator.access is not None:
        values |= {"windows_until": simulator.access.until, "windows_ready": simulator.access.ready}
        for kind, windows in simulator.access.windows.items():
            values |= {f"{kind}_{name}": table for name, table in windows._asdict().items()}
    values |= {f"memory_{name}": simulator.memory[name] for name in simulator.memory}
    return by_env(TensorDict(values, [simulator.size], device=simulator.device).clone(), simulator.count)


def by_env(rows: TensorDictBase, count: int) -> TensorDict:
    """Rows of ``count`` satellites each, by environment."""
    return rows if count == 1 else rows.view(-1, count)


def by_row(saved: TensorDictBase, count: int) -> TensorDictBase:
    """What :func:`by_env` made, as rows again."""
    return saved if count == 1 else saved.view(-1)


def fleet_state(fleet: Fleet) -> TensorDict:
    """State of all simulations of a fleet, what the scenario has drawn, and what the episodes remember."""
    values: dict[str, Any] = {f"type_{k}": simulation_state(simulator) for k, simulator in enumerate(fleet.simulators)}
    values["tables"] = TensorDict(dict(fleet.tables), [fleet.num_envs]).clone()
    values["memory"] = TensorDict({name: fleet.memory[name] for name in fleet.memory}, [fleet.num_envs]).clone()
    values["inert"] = fleet.inert.clone()
    return TensorDict(values, [fleet.num_envs], device=fleet.device)


def restore_fleet(fleet: Fleet, saved: TensorDictBase, envs: Tensor) -> None:
    """Put the saved state [N] back into the episodes ``envs`` [n] of a fleet."""
    for k, simulator in enumerate(fleet.simulators):
        restore_simulation(simulator, by_row(saved[f"type_{k}"], simulator.count), fleet.rows(k, envs))
    for name, table in saved["tables"].items():
        fleet.tables[name][envs] = table[envs]
    for name in fleet.memory:
        fleet.memory.restore(name, envs, saved["memory"][name])
    fleet.inert[envs] = saved["inert"][envs]


def _restore_arcs(simulator: Simulator, saved: TensorDictBase, rows: Tensor) -> None:
    """Put the saved arcs back; where they are longer than the simulation's, those of all rows are made as long."""
    arcs = simulator.arcs
    if saved["arcs_tail"].shape[1] != arcs.solver.tail:
        raise ValueError("the state was saved under another backend: eager and compiled simulations solve arcs in different ways")
    if not bool(arcs.et.any()):  # never reset: there is nothing to lengthen
        for name in FIELDS:
            setattr(arcs, name, saved[f"arcs_{name}"].clone())
    while arcs.flown.shape[1] < saved["arcs_flown"].shape[1]:
        simulator.grow()
    other = Arcs(len(saved), 1, arcs.solver, arcs.kept)
    for name in FIELDS:
        setattr(other, name, saved[f"arcs_{name}"].clone())
    while other.flown.shape[1] < arcs.flown.shape[1]:
        other.grow()
    arcs.adopt(rows, other)


def restore_simulation(simulator: Simulator, saved: TensorDictBase, rows: Tensor) -> None:
    """Put the saved state [N] back into ``rows`` [n] of a simulation of N satellites."""
    _restore_arcs(simulator, saved, rows)
    eclipses = simulator.eclipses
    for name in ("sampled", "known"):
        getattr(eclipses, name)[rows] = saved[f"eclipses_{name}"][rows]
    for name in ("starts", "ends"):
        setattr(eclipses, name, stored(getattr(eclipses, name), rows, saved[f"eclipses_{name}"][rows]))
    simulator.ticks[rows], simulator.mode[rows] = saved["ticks"][rows], saved["mode"][rows]
    simulator.pack[:, rows], simulator.own[:, rows] = saved["pack"][rows].mT, saved["own"][rows].mT
    for name, value in saved["arguments"].items():
        if name not in simulator.drawn:
            simulator.drawn[name] = torch.zeros_like(value)
        simulator.drawn[name][rows] = value[rows]
    simulator.draws += 1
    for name in simulator.memory:
        simulator.memory.restore(name, rows, saved[f"memory_{name}"])
    if simulator.access is not None:
        simulator.access.until[rows] = saved["windows_until"][rows]
        simulator.access.ready[rows] = saved["windows_ready"][rows]
        for kind in simulator.access.windows:
            simulator.access.store(kind, rows, Windows(*(saved[f"{kind}_{name}"][rows] for name in Windows._fields)))
    simulator.observer.forget()
