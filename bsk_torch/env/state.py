"""Whether a saved state, or the state of another environment, fits an environment."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from bsk_torch.astro.ephemeris import coverage
from bsk_torch.constants import NANO
from bsk_torch.sim.access.lookahead import LookAhead
from bsk_torch.sim.fleet import Fleet
from bsk_torch.sim.satellite_state import SatelliteState
from bsk_torch.sim.state import StateTable

FORMAT = 4
"""Format of saved states: 4 has planned positions every 30 s; 2 and 3 were those of development versions of release 0.2."""

MADE_BY = "made_by"
"""Key of a saved state under which :func:`fingerprint` stands, for each episode."""

ENDLESS = 2**31
"""Seconds after which Basilisk's clock stops an episode without limit; the end of the Sun's ephemeris does so before."""

MEANING = (
    "format of the state",
    "length of a tick, ns",
    "satellites, world or back end",
    "actions, windows, or the type of numbers",
)


def fingerprint(fleet: Fleet) -> Tensor:
    """Return the numbers that must agree where states are exchanged: see :data:`MEANING`, [4] int64."""
    make, use = hashlib.blake2b(digest_size=7), hashlib.blake2b(digest_size=7)
    for simulator, group in zip(fleet.simulators, fleet.groups, strict=True):
        tick, lookahead = simulator.tick, simulator.lookahead
        structure = [list(layout.fields) for layout in (tick.state, tick.shared, tick.own)], simulator.mode_names, simulator.count
        make.update(repr((structure, simulator.state.constants, lookahead.arcs.tail.shape[1])).encode())
        make.update(simulator.uniform.cpu().numpy().tobytes())
        access = None if lookahead.access is None else (lookahead.access.segment, lookahead.access.as_bsk_rl)
        used = [group.actions.description, simulator.dtype, simulator.orbit, tick.stops, access]
        used += [lookahead.follows, lookahead.arcs.restarts] if simulator.has_tank else []
        use.update(repr(tuple(used)).encode())
    digests = (int.from_bytes(digest.digest(), "big") for digest in (make, use))
    return torch.tensor([FORMAT, fleet.simulators[0].h_ns, *digests])


def over_saved(fleet: Fleet, mine: Tensor, state: Mapping[str, Any] | TensorDictBase) -> StateTable:
    """Return the tables of a saved state for a fleet whose fingerprint is ``mine``; :func:`check_values` checks their rows.

    Raises:
        KeyError, TypeError, ValueError: For something that is no state, or that of another make of environment.
    """
    if not isinstance(state, Mapping | TensorDictBase):
        raise TypeError(
            f"state={state!r} must be a state of get_state(), as a TensorDict or nested dictionaries, or an environment"
        )
    names = set(state.keys())
    if MADE_BY not in names:
        raise ValueError(
            "state was not saved by this release: it lacks the fingerprint of its environment. States of release 0.1 cannot be "
            "restored; begin the episodes anew"
        )
    theirs = state[MADE_BY]
    if not isinstance(theirs, Tensor) or theirs.dtype != torch.int64 or theirs.ndim != 2 or theirs.shape[1] < 1:
        raise TypeError(f"{MADE_BY!r} of the saved state is {theirs!r}; it must be an int64 tensor with a row for each episode")
    check_fingerprint(mine, theirs.cpu().unique(dim=0))
    return fleet.state.over({name: state[name] for name in names - {MADE_BY}})


def whole_limit(limit: Tensor, et: Tensor, h_ns: int) -> tuple[Tensor, Tensor]:
    """Return time limits [n] s as numbers of ticks of ``h_ns`` nanoseconds, and as the seconds that these take.

    Episodes without limit, which begin at ET ``et`` [n] s, end with the ephemeris.
    """
    seconds = torch.where(torch.isfinite(limit), limit, torch.clamp(coverage()[1] - et, max=ENDLESS))
    ticks = torch.ceil(torch.floor(seconds * 1e9 + 0.5) / h_ns)
    return ticks.long(), torch.where(torch.isfinite(limit), ticks * (h_ns * NANO), limit)


def check_values(fleet: Fleet, saved: StateTable) -> None:
    """Check all rows of saved tables.

    Raises:
        ValueError: For a value that no environment of this make has, or an episode that has not begun.
    """
    saved.refuse("begun", saved["begun"], ~saved["begun"], "such episodes have nothing to go on with")
    saved.check()
    et = lookahead_of(saved, 0).arcs.et.view(saved.num_envs, -1)[:, 0]
    ticks, limit = whole_limit(saved["time_limit"], et, fleet.simulators[0].h_ns)
    wrong = (ticks != saved["limit_ticks"]) | (limit != saved["time_limit"])
    saved.refuse("limit_ticks", saved["limit_ticks"], wrong, "it must be that of 'time_limit', a whole number of ticks")
    for k, simulator in enumerate(fleet.simulators):
        table = saved.tables[f"satellites_{k}"]
        assert isinstance(table, SatelliteState)
        simulator.check_saved(table, f"satellites_{k}.")


def lookahead_of(state: StateTable, part: int) -> LookAhead:
    """Return the arcs and windows of type number ``part`` in the state of an environment."""
    found = state.tables[f"satellites_{part}"].tables["lookahead"]
    assert isinstance(found, LookAhead)
    return found


def check_fingerprint(mine: Tensor, theirs: Tensor) -> None:
    """Raise ValueError that names the difference of two environments; ``theirs`` is [n, 4], or narrower in old formats."""
    for part, meaning in enumerate(MEANING):
        other = [int(value) for value in theirs[:, part] if value != mine[part]]
        if other:
            how = f": {other[0]}, not {int(mine[part])}" if part < 2 else ""
            raise ValueError(f"state was saved by another make of environment; they differ in the {meaning}{how}")


def rows_of(name: str, rows: Any, count: int, device: torch.device) -> Tensor:
    """Return the indices of episodes that a caller gives as ``name``, [n] int64.

    Raises:
        IndexError: For anything but a list of indices from 0 to ``count`` - 1.
    """
    index = torch.as_tensor(rows, device=device)
    listed = index.ndim == 1 and (not index.numel() or not (index.dtype == torch.bool or index.is_floating_point()))
    if not listed or (len(index) and (int(index.min()) < 0 or int(index.max()) >= count)):
        raise IndexError(f"{name} has indices {index.tolist()!s:.60}; they must be a list of numbers from 0 to {count - 1}")
    return index.long()
