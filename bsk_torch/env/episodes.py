"""Episodes of an environment: seeds, starts, and the next episodes, prepared in bulk by large batches."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor
from torchrl.envs import EnvBase

from bsk_torch._checks import whole
from bsk_torch.data.base import GlobalReward
from bsk_torch.data.checked import CheckedRewarder
from bsk_torch.env.assembly.fleets import FleetBuilder
from bsk_torch.env.guard import EpisodeGuard
from bsk_torch.env.limits import whole_limit
from bsk_torch.env.log import StepLog
from bsk_torch.env.satellite_group import SatelliteGroup, begin_tasks
from bsk_torch.env.seeds import SEED_LIMIT, episode_seed
from bsk_torch.rand import Key
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.scene.base import Scenario
from bsk_torch.sim.assembly.satellite_type import SatelliteType
from bsk_torch.sim.fleet import Fleet, FleetState
from bsk_torch.sim.simulator import Simulator
from bsk_torch.sim.state import FINITE

DRAWN_BYTES = 1 << 25
"""Bytes of a scenario drawn at once: larger temporary tensors are new memory each time, which costs more than its use."""


class EpisodeState(FleetState):
    """State of N episodes in an environment."""

    episode: Tensor  # number of the episode, -1 before the first, [N]
    seed: Tensor  # seed of its draws, [N]
    limit_ticks: Tensor  # tick at which it is truncated, [N]
    returns: Tensor  # sum of the rewards of all satellites so far, [N]
    begun: Tensor  # episodes that can be stepped: False before the first reset and after an interrupted call, [N]


class EpisodePool:
    """The next episodes of every environment, in a second fleet.

    Solving orbits and windows for a few rows costs as much as for dozens, and in a large batch a few rows end at every step.
    Therefore, when a prepared episode is missing, all used ones are replaced at once. Of small batches, several episodes of each
    environment are prepared, from the second one on: as many as have begun under its seed, so that no more than half are in
    vain. Draws do not depend on when they are made, so episodes are bit-identical with and without a pool.
    """

    def __init__(self, unset: Tensor, make: Callable[[], Fleet], start: Callable[[Fleet, Tensor, Key], None]) -> None:
        """Keep episodes in a fleet returned by ``make``; ``start(fleet, envs, key)`` starts the episodes of a key in it.

        ``unset`` [D, N] stands for seeds and episode numbers before the first episodes are prepared: D for each environment. Row
        ``d N + k`` of the fleet holds the episode of environment k whose number is d modulo D.
        """
        self._make, self.start = make, start
        self.seed, self.episode, self.filled = unset, unset.clone(), torch.zeros_like(unset, dtype=torch.bool)

    @functools.cached_property
    def fleet(self) -> Fleet:
        """Fleet of the prepared episodes, created on first use."""
        return self._make()

    @property
    def nbytes(self) -> int:
        """Bytes of the fleet; 0 for small batches that have not needed it yet."""
        return self.fleet.state.nbytes if len(self.filled) == 1 or "fleet" in self.__dict__ else 0

    def change(self, types: Sequence[SatelliteType], envs: Tensor | None) -> None:
        """Use satellite types with changed arguments; drop the episodes prepared for ``envs`` [n], or all of them."""
        if "fleet" in self.__dict__:
            self.fleet.change(types)
        self.drop(envs)

    def drop(self, envs: Tensor | None = None) -> None:
        """Drop the episodes prepared for ``envs`` [n], or all of them."""
        self.filled[:, slice(None) if envs is None else envs.to(self.filled.device)] = False

    def holds(self, episodes: Tensor) -> bool:
        """Return whether episodes of these numbers are prepared: the first ones under a seed only in large batches."""
        return len(self.filled) == 1 or bool((episodes > 0).all())

    def fill(self, envs: Tensor, seeds: Tensor, env_ids: Tensor, episodes: Tensor) -> Tensor:
        """Prepare ``episodes`` [N] of ``seeds`` [N] in ``envs`` [n]; if any of these is missing, all stale rows are prepared.

        Return the rows [n] of the fleet that hold them.
        """
        depth, n = self.filled.shape
        further = (torch.arange(depth, device=episodes.device).unsqueeze(1) - episodes) % depth
        ahead = further < episodes.clamp(min=1)
        seeds, episodes, env_ids = seeds.expand(depth, n), episodes + further, env_ids.expand(depth, n)
        stale = ahead & (~self.filled | (self.seed != seeds) | (self.episode != episodes))
        rows = (further == 0).long().argmax(0)[envs] * n + envs
        if not bool(stale.view(-1)[rows].any()):
            return rows
        used, filled = torch.nonzero(stale.view(-1)).squeeze(-1), self.filled.view(-1)
        filled[used] = False  # until all is done
        key = Key(*(part.reshape(-1).cpu() for part in (seeds, env_ids, episodes)))  # type: ignore[arg-type]
        for some in used.split(max(1, DRAWN_BYTES // max(1, self.fleet.scenario_state.nbytes // filled.numel()))):
            self.start(self.fleet, some, key.take(some.tolist()))
        filled[used] = True
        self.seed, self.episode = torch.where(stale, seeds, self.seed), torch.where(stale, episodes, self.episode)
        return rows


class Episodes(EnvBase):
    """Part of an environment: N episodes, their seeds, and how they begin."""

    builder: FleetBuilder  # creates fleets and draws episodes
    fleet: SatelliteFleet  # the satellites of the current episodes
    satellites: tuple[SatelliteGroup, ...]  # the satellites of each type
    pool: EpisodePool | None  # the next episodes, prepared in bulk; None where user functions draw them
    names: list[str]  # name of every satellite
    env_ids: Tensor  # index of each episode in the draws, [N]
    scenario: Scenario  # task of the satellites
    rewarder: GlobalReward  # value of their data
    checked: CheckedRewarder  # its hooks, with checks of their results
    guard: EpisodeGuard  # tracks which episodes can be stepped
    log: StepLog | None  # log of satellite events, if enabled

    def _declare_state(self, env_ids: Sequence[int] | Tensor | None) -> None:
        self.env_ids = self.fleet.env_ids = read_env_ids(env_ids, self.num_envs).to(self.device)
        for name, low in (("episode", -1), ("seed", None), ("limit_ticks", 0)):
            self.state.declare(name, None, dtype=torch.int64, low=low)
        self.state.episode = self.state.episode - 1
        self.state.declare("returns", 0.0, low=-FINITE, high=FINITE)
        self.state.declare("begun", False)
        self.guard = EpisodeGuard(self.state)

    @property
    def num_envs(self) -> int:
        """Number of episodes N."""
        return int(self.batch_size[0])

    @property
    def state(self) -> EpisodeState:
        """State of the current episodes, as live tables; :meth:`get_state` returns a copy."""
        return self.fleet.state  # type: ignore[return-value]

    @property
    def simulator(self) -> Simulator:
        """Simulation of the first type of satellites."""
        return self.fleet.simulators[0]

    @property
    def episode(self) -> Tensor:
        """Number of the current episode, -1 before the first, [N]."""
        return self.state.episode

    @property
    def time_limit(self) -> Tensor:
        """Time limits of the current episodes, whole ticks, [N] s."""
        return self.state.time_limit

    @property
    def returns(self) -> Tensor:
        """Sum of the rewards of each episode so far, of all satellites, [N] float64."""
        return self.state.returns

    def _set_seed(self, seed: int | None) -> None:
        value = int(torch.empty((), dtype=torch.int64).random_()) if seed is None else episode_seed(seed)
        self.state.seed = torch.full_like(self.state.seed, value)
        self.state.episode = torch.full_like(self.episode, -1)

    def reseed(self, seeds: int | Sequence[int | None], mask: Tensor | None = None) -> None:
        """Start with the first episodes of other seeds at the next reset; current episodes do not change.

        ``seeds`` is one for all environments, or one for each of the N, None for the current one; only in ``mask`` [N] if given.
        """
        count = self.num_envs
        several = isinstance(seeds, Sequence | Tensor | np.ndarray) and not isinstance(seeds, str)
        numbers: list[object] = list(seeds) if several else [seeds] * count  # type: ignore[arg-type]
        if len(numbers) != count:
            raise ValueError(f"seed has {len(numbers)} entries; it must be an integer or have {count}, one per environment")
        numbers = [seed.item() if isinstance(seed, Tensor) and seed.ndim == 0 else seed for seed in numbers]
        numbers = [None if seed is None else episode_seed(seed) for seed in numbers]
        rows = torch.tensor([seed is not None for seed in numbers], device=self.device)
        rows = rows if mask is None else rows & mask
        values = torch.tensor([seed or 0 for seed in numbers], dtype=torch.int64, device=self.device)
        self.state.seed = torch.where(rows, values, self.state.seed)
        self.state.episode = self.episode.masked_fill(rows, -1)

    @contextmanager
    def numbered(self, env_ids: Tensor) -> Iterator[None]:
        """Begin the episodes of this block with other ``env_ids`` [N]."""
        own = self.env_ids
        self._number(env_ids)
        try:
            yield
        finally:
            self._number(own)

    def _number(self, env_ids: Tensor) -> None:
        if self.pool is not None and not torch.equal(env_ids, self.env_ids):
            self.pool.drop()
        self.env_ids = self.fleet.env_ids = env_ids

    def _begin(self, envs: Tensor) -> None:
        state = self.state
        seeds, episodes, begun = state.seed, state.episode + 1, self.guard.replace()
        if self.pool is not None and not self.fleet.calls_user and self.pool.holds(episodes[envs]):
            state.copy_rows(envs, self.pool.fleet.state, self.pool.fill(envs, seeds, self.env_ids, episodes))
        else:
            key = Key(seeds[envs].cpu(), self.env_ids[envs].cpu(), episodes[envs].cpu())
            self.builder.draw_and_start(self.fleet, envs, key)
        state.seed, state.episode = seeds, state.episode.index_copy(0, envs, episodes[envs])
        et = self.simulator.lookahead.flight.et.view(self.num_envs, -1)[envs, 0]
        ticks, limit = whole_limit(state.time_limit[envs], et, self.simulator.h_ns)
        state.limit_ticks = state.limit_ticks.index_copy(0, envs, ticks)
        state.time_limit = state.time_limit.index_copy(0, envs, limit)
        self.scenario.begin_episodes(envs)
        for begin in self.fleet.beginnings:
            begin(envs)
        for satellite in self.satellites:
            begin_tasks(satellite, envs)
        if self.log is not None and self.log.shows():
            self.log.began(envs, state.seed, state.episode)
        self.guard.begin(envs, begun)
        self._show(envs)

    def _show(self, envs: Tensor) -> None:
        for recording in self.fleet.recordings:
            recording.begin(envs)


def read_env_ids(env_ids: object, n: int) -> Tensor:
    """Return the index of each episode in draws, [n] int64 (default: 0 to n - 1); ValueError for invalid indices."""
    if env_ids is None:
        return torch.arange(n)
    table = (
        env_ids if isinstance(env_ids, Tensor) else np.asarray(env_ids) if isinstance(env_ids, np.ndarray | Sequence) else None
    )
    if table is None or isinstance(env_ids, str) or tuple(table.shape) != (n,):
        shape = "" if table is None else f" has shape {list(table.shape)};"
        raise ValueError(f"env_ids={env_ids!r}:{shape} it needs {n} whole numbers, one for each environment")
    return torch.tensor([whole("env_ids", number, 0, SEED_LIMIT - 1) for number in table.tolist()])
