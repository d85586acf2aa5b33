"""States of environments: saving, restoring, and checks of saved states and of other environments."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from bsk_torch.env.episodes import Episodes
from bsk_torch.env.guard import Origin
from bsk_torch.env.limits import whole_limit
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sim.access.lookahead import LookAhead
from bsk_torch.sim.assembly.saved_rows import check_saved
from bsk_torch.sim.fleet import Fleet, FleetState
from bsk_torch.sim.satellite_state import SatelliteState
from bsk_torch.sim.state import StateTable

FORMAT = 4
"""Format of saved states: 4 has planned positions every 30 s; 2 and 3 were those of development versions of release 0.2."""

MADE_BY = "made_by"
"""Key of the :func:`fingerprint` of each episode in a saved state."""

MEANING = (
    "format of the state",
    "length of a tick, ns",
    "satellites, world or back end",
    "actions, windows, or the type of numbers",
)


class Snapshots(Episodes):
    """Part of an environment: saves its current episodes and replaces them.

    Attributes:
        fingerprint: Numbers that must agree where states are exchanged; see :func:`fingerprint`.
    """

    fingerprint: Tensor

    def get_state(self) -> TensorDict:
        """Return a copy of all that determines the future, [N, ...], for :meth:`restore`; ResetNeededError before a reset."""
        with self.guard:
            self.guard.check_begun("get_state()")
            return self._saved()

    def _saved(self) -> TensorDict:
        state = self.state.to_tensordict()
        state[MADE_BY] = self.fingerprint.to(self.device).expand(self.num_envs, -1).clone()
        return state

    def restore(
        self,
        state: TensorDictBase | Mapping[str, object] | Snapshots,
        envs: Tensor | Sequence[int] | None = None,
        source: Tensor | Sequence[int] | None = None,
    ) -> None:
        """Replace the episodes ``envs`` by the episodes ``source`` of a state; nothing changes if the state does not fit.

        Args:
            state: A state of :meth:`get_state`, also as nested dictionaries (``state.to_dict()``), or an environment of the same
                kind, whose current episodes are copied directly. Batch sizes may differ. Every number used from a state is
                checked, since it may come from an untrusted file.
            envs: Episodes of this environment to replace, [n] indices (default: all).
            source: Episodes of the state, [n] indices, which may repeat (default: the same as ``envs``).

        Raises:
            KeyError, TypeError, ValueError: For an invalid state, one saved by another kind of environment, or values out of
                range.
            IndexError: For indices out of range, or different numbers of indices.
            ResetNeededError: For episodes of another environment that have not begun.
        """
        with self.guard, state.guard if isinstance(state, Snapshots) else contextlib.nullcontext():
            other, envs, source = self._fitting(state, envs, source)
            begun = self.guard.replace()
            for k, simulator in enumerate(self.fleet.simulators):
                lookahead, source_lookahead = simulator.lookahead, lookahead_of(other, k)
                lookahead.grow_to(source_lookahead.arcs.length)
                try:
                    source_lookahead.grow_to(lookahead.arcs.length)
                except (FloatingPointError, IndexError) as error:
                    raise ValueError(
                        f"'satellites_{k}.lookahead.arcs' of the saved state cannot be continued: {error}"
                    ) from error
            self.state.begun = begun.index_fill(0, envs, False)
            self.state.copy_rows(envs, other, source)
            self.scenario.begin_episodes(envs)
            self.guard.begin(envs, begun)
            self._show(envs)
            if not isinstance(state, Snapshots):
                self.guard.origin = Origin.RESTORED

    def _fitting(self, state: object, envs: object, source: object) -> tuple[FleetState, Tensor, Tensor]:
        """Return the checked tables of a state, and the indices [n] of the replaced episodes and of their replacements."""
        other: Any
        if isinstance(state, Snapshots):
            check_fingerprint(self.fingerprint, state.fingerprint.unsqueeze(0))
            other = state.state
        else:
            other = over_saved(self.fleet, self.fingerprint, state)
        envs = rows_of("envs", self.fleet.all_envs if envs is None else envs, self.num_envs, self.device)
        source = rows_of("source", envs if source is None else source, other.num_envs, self.device)
        if len(envs) != len(source):
            raise IndexError(f"envs has {len(envs)} indices, source has {len(source)}; they must have equally many")
        if len(envs.unique()) < len(envs):
            raise IndexError(f"envs has indices {envs.tolist()!s:.60}; each may be there once only")
        if isinstance(state, Snapshots):
            state.guard.check_begun("restore(state)", torch.zeros_like(state.state.begun).index_fill(0, source, True))
            return other, envs, source
        rows = torch.arange(len(source), device=self.device)
        lengths = ((s.lookahead.arcs.length, lookahead_of(other, k).arcs.length) for k, s in enumerate(self.fleet.simulators))
        whole = torch.equal(source, other.all_rows) and all(length <= saved for length, saved in lengths)
        used = other if whole else other.taken(source)  # arcs that must be extended are written into
        check_values(self.fleet, used)
        return used, envs, rows

    def get_extra_state(self) -> TensorDict | None:
        """Part of ``state_dict``: see :meth:`get_state`; None before the first reset."""
        return self._saved() if bool(self.state.begun.any()) else None

    def set_extra_state(self, state: TensorDict | None) -> None:
        """Part of ``load_state_dict``: restores the episodes that had begun."""
        if state is not None:
            begun = state.get("begun", None)
            self.restore(state, None if begun is None else torch.nonzero(begun.reshape(-1)).squeeze(-1))


def fingerprint(fleet: SatelliteFleet) -> Tensor:
    """Return the numbers that must agree to exchange states, [4] int64; see :data:`MEANING`."""
    make, use = hashlib.blake2b(digest_size=7), hashlib.blake2b(digest_size=7)
    for simulator, satellite in zip(fleet.simulators, fleet.satellites, strict=True):
        tick, lookahead = simulator.tick, simulator.lookahead
        structure = [list(layout.fields) for layout in (tick.state, tick.shared, tick.own)], simulator.mode_names, simulator.count
        make.update(repr((structure, simulator.state.constants, lookahead.arcs.tail.shape[1])).encode())
        make.update(simulator.uniform.cpu().numpy().tobytes())
        access = None if lookahead.access is None else (lookahead.access.segment, lookahead.access.compat)
        used = [satellite.action_description, simulator.type.options.dtype, simulator.orbit, tick.stops, access]
        used += [lookahead.follows, lookahead.arcs.restarts] if simulator.has_tank else []
        use.update(repr(tuple(used)).encode())
    digests = (int.from_bytes(digest.digest(), "big") for digest in (make, use))
    return torch.tensor([FORMAT, fleet.simulators[0].h_ns, *digests])


def over_saved(fleet: Fleet, numbers: Tensor, state: Mapping[str, object] | TensorDictBase) -> StateTable:
    """Return the tables of a saved state for a fleet whose fingerprint is ``numbers``; :func:`check_values` checks their rows."""
    if not isinstance(state, Mapping | TensorDictBase):
        raise TypeError(
            f"state={state!r} must be a state of get_state(), as a TensorDict or nested dictionaries, or an environment"
        )
    names = set(state.keys())
    if MADE_BY not in names:
        raise ValueError(
            "state was not saved by this release: it lacks the fingerprint of its environment. States of release 0.1 cannot be "
            "restored; reset the episodes"
        )
    stamp = state[MADE_BY]
    if not isinstance(stamp, Tensor) or stamp.dtype != torch.int64 or stamp.ndim != 2 or stamp.shape[1] < 1:
        raise TypeError(f"{MADE_BY!r} of the saved state is {stamp!r}; it must be an int64 tensor with a row for each episode")
    check_fingerprint(numbers, stamp.cpu().unique(dim=0))
    return fleet.state.over({name: state[name] for name in names - {MADE_BY}})


def check_values(fleet: Fleet, saved: StateTable) -> None:
    """Raise ValueError for saved rows impossible in this kind of environment, and for an episode that has not begun."""
    saved.refuse("begun", saved["begun"], ~saved["begun"], "such episodes cannot continue")
    saved.check()
    et = lookahead_of(saved, 0).arcs.et.view(saved.num_envs, -1)[:, 0]
    ticks, limit = whole_limit(saved["time_limit"], et, fleet.simulators[0].h_ns)
    wrong = (ticks != saved["limit_ticks"]) | (limit != saved["time_limit"])
    saved.refuse("limit_ticks", saved["limit_ticks"], wrong, "it must be that of 'time_limit', a whole number of ticks")
    tables = []
    for k, simulator in enumerate(fleet.simulators):
        table = saved.tables[f"satellites_{k}"]
        assert isinstance(table, SatelliteState)
        check_saved(simulator.type, table, f"satellites_{k}.")
        tables.append(table)
    if fleet.varies:
        present = torch.cat([table["present"].view(saved.num_envs, -1) for table in tables], 1)
        absent = ~present[:, torch.cat(fleet.columns).argsort()]
        saved.refuse("satellites_*.present", present, ~present.any(1), "each episode needs a satellite that is present")
        saved.refuse("removed", saved["removed"], absent & ~saved["removed"], "satellites that are not present are removed")


def lookahead_of(state: StateTable, part: int) -> LookAhead:
    """Return the arcs and windows of type number ``part`` in the state of an environment."""
    lookahead = state.tables[f"satellites_{part}"].tables["lookahead"]
    assert isinstance(lookahead, LookAhead)
    return lookahead


def check_fingerprint(numbers: Tensor, theirs: Tensor) -> None:
    """Raise ValueError naming the difference of two environments; ``theirs`` is [n, 4], or narrower in old formats."""
    for part, meaning in enumerate(MEANING):
        other = [int(value) for value in theirs[:, part] if value != numbers[part]]
        if other:
            how = f": {other[0]}, not {int(numbers[part])}" if part < 2 else ""
            raise ValueError(f"state was saved by another kind of environment; they differ in the {meaning}{how}")


def rows_of(name: str, rows: object, count: int, device: torch.device) -> Tensor:
    """Return the indices of episodes given in the argument ``name``, [n] int64."""
    index = torch.as_tensor(rows, device=device)
    listed = index.ndim == 1 and (not index.numel() or not (index.dtype == torch.bool or index.is_floating_point()))
    if not listed or (len(index) and (int(index.min()) < 0 or int(index.max()) >= count)):
        raise IndexError(f"{name} has indices {index.tolist()!s:.60}; they must be a list of numbers from 0 to {count - 1}")
    return index.long()
