"""Whether a saved state, or the state of another environment, fits an environment."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from bsk_torch.sim.fleet import Fleet
from bsk_torch.sim.state import StateTable

FORMAT = 2
"""Format of saved states; release 0.1 wrote another one, without a number."""

MADE_BY = "made_by"
"""Key of a saved state under which :func:`fingerprint` stands, for each episode."""

MEANING = ("format of the state", "length of a tick, ns", "satellites, world or back end")


def fingerprint(fleet: Fleet) -> Tensor:
    """Return the numbers that must agree where states are exchanged: see :data:`MEANING`, [3] int64."""
    digest = hashlib.blake2b(digest_size=7)
    for simulator in fleet.simulators:
        tick, lookahead = simulator.tick, simulator.lookahead
        structure = [list(layout.fields) for layout in (tick.state, tick.shared, tick.own)], simulator.mode_names, simulator.count
        digest.update(repr((structure, simulator.state.constants, lookahead.arcs.tail.shape[1])).encode())
        digest.update(simulator.uniform.cpu().numpy().tobytes())
    return torch.tensor([FORMAT, fleet.simulators[0].h_ns, int.from_bytes(digest.digest(), "big")])


def check_compatible(fleet: Fleet, mine: Tensor, state: Mapping[str, Any]) -> StateTable:
    """Return the tables of a saved state for a fleet whose fingerprint is ``mine``.

    Raises:
        KeyError, ValueError: For the state of another make of environment.
    """
    names = set(state.keys())
    if MADE_BY not in names:
        raise ValueError(
            "state was not saved by this release: it lacks the fingerprint of its environment. States of release 0.1 cannot be "
            "restored; begin the episodes anew"
        )
    check_fingerprint(mine, torch.as_tensor(state[MADE_BY]).reshape(-1, len(MEANING)).unique(dim=0).cpu())
    saved = fleet.state.over({name: state[name] for name in names - {MADE_BY}})
    for k, simulator in enumerate(fleet.simulators):
        mode, modes = saved.tables[f"satellites_{k}"]["mode"], len(simulator.mode_names)
        if bool(((mode < 0) | (mode >= modes)).any()):
            raise ValueError(f"mode of the saved state has values outside of 0 to {modes - 1}")
    return saved


def check_fingerprint(mine: Tensor, theirs: Tensor) -> None:
    """Raise ValueError that names the difference of two environments; ``theirs`` is [n, 3]."""
    for part, meaning in enumerate(MEANING):
        other = [int(value) for value in theirs[:, part] if value != mine[part]]
        if other:
            how = f": {other[0]}, not {int(mine[part])}" if part < len(MEANING) - 1 else ""
            raise ValueError(f"state was saved by another make of environment; they differ in the {meaning}{how}")
