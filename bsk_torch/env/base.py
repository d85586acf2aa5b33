"""What all environments share: episodes of one or many satellites, drawn, stepped, saved and restored in batches."""

from __future__ import annotations

import copy
import functools
import logging
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from bsk_torch.comm import CommunicationMethod, NoCommunication
from bsk_torch.data.base import GlobalReward, NoReward
from bsk_torch.data.composed import ComposedReward
from bsk_torch.env.machine import check_memory
from bsk_torch.env.pool import SMALLEST, EpisodePool
from bsk_torch.env.randomizer import Randomizer, make_randomizer
from bsk_torch.env.squad import KEPT, Squad
from bsk_torch.env.state import by_env, by_row, fleet_state, restore_fleet
from bsk_torch.env.types import check_names, check_world, grouped, world_arguments, world_components
from bsk_torch.obs.base import Values
from bsk_torch.rand import Distribution, Key, first_key
from bsk_torch.sats.satellite import ArgumentTable, Satellite
from bsk_torch.scene.base import Scenario
from bsk_torch.sim.component import Arg
from bsk_torch.sim.fleet import Drawn, Fleet, share
from bsk_torch.sim.params import convert
from bsk_torch.sim.simulator import Simulator, whole_nanoseconds

logger = logging.getLogger(__name__)

TimeLimit = float | Distribution | Callable[[], float]

ENDLESS = 2**31
"""Seconds after which Basilisk's clock stops an episode without limit."""

LIMIT = Arg("time_limit", float("inf"), "s", "time after which an episode is truncated", low=0.0)

SAMPLE = 1024
"""Random time limits that are drawn to see how long arcs will be, before a batch is built."""

EXTRA_STATE = ("episode", "limit_ticks", "seed_rows", "time_limit", "returns")


class Played(NamedTuple):
    """What a step of N episodes with S satellites each has brought.

    Attributes:
        duration: How long it took, [N] s.
        reward: What satellites have earned, [N, S]; zero where the step did not take place.
    """

    duration: Tensor
    reward: Tensor


class Tasking(EnvBase):
    """N independent episodes with S satellites each. Subclasses say how agents see and command them."""

    _supports_set_state = True
    _has_frame_skip = True

    returns: Tensor
    """Sum of the rewards of each episode so far, of all satellites, [N] float64."""

    links: Tensor | None = None
    """Who has told whom after the last step, [N, S, S]; None where satellites never talk."""

    def _build(
        self,
        satellites: Sequence[Satellite],
        scenario: Scenario | None,
        rewarder: GlobalReward | Iterable[GlobalReward] | None,
        communicator: CommunicationMethod | None = None,
        sat_arg_randomizer: Any = None,
        *,
        num_envs: int,
        world_args: Mapping[str, Any] | None,
        sim_rate: float,
        max_step_duration: float,
        failure_penalty: float,
        time_limit: TimeLimit,
        terminate_on_time_limit: bool,
        device: torch.device | str,
        seed: int | None,
        env_ids: Sequence[int] | Tensor | None,
        dtype: torch.dtype,
        sim_dtype: torch.dtype,
        orbit: str | None,
        backend: str,
        log_level: int | str | None,
    ) -> None:
        """Build everything from checked arguments; see the subclasses for them."""
        if log_level is not None:
            logging.getLogger("bsk_torch").setLevel(log_level)
        if failure_penalty > 0.0:
            logger.warning("failure_penalty=%g rewards failure; it should not be positive", failure_penalty)
        self.dtype, self.failure_penalty = dtype, float(failure_penalty)
        self.terminate_on_time_limit, self.time_limit_generator = terminate_on_time_limit, time_limit
        self.max_step_duration = float(max_step_duration)
        self.scenario, self.rewarder = copy.copy(scenario or Scenario()), composed(rewarder)
        self.communicator = copy.copy(communicator or NoCommunication())
        self.originals, self.names = list(satellites), check_names(satellites)
        self.types = grouped(self.originals)
        self.randomizer: Randomizer | None = make_randomizer(sat_arg_randomizer, self.originals)
        self._options: dict[str, Any] = {"sim_rate": sim_rate, "dtype": sim_dtype, "orbit": orbit, "backend": backend}
        self._world_args = dict(world_args or {})
        trial = self._trial()
        self.fleet = self._make_fleet(num_envs)
        self.pool = EpisodePool(self._make_fleet(num_envs)) if self._pool_pays(self.fleet) else None
        self._make_buffers(num_envs, env_ids)
        self.squads = [Squad(part) for part in self._bound(self.fleet)]
        self._link(self.fleet, self.scenario, self.rewarder)
        self.communicator.link(self.fleet)
        if self.pool is not None:
            for mine, theirs in zip(self.fleet.simulators, self.pool.fleet.simulators, strict=True):
                if mine.access is not None and theirs.access is not None:
                    theirs.access.ahead = mine.access.ahead
        self._make_specs(trial)
        self.longest_ticks = math.ceil(whole_nanoseconds(min(self.max_step_duration, ENDLESS)) / self.simulator.h_ns)
        self.set_seed(seed)

    # -- construction -------------------------------------------------------------------------------------------------

    def _make_fleet(self, n: int, trial: bool = False) -> Fleet:
        """Simulations of ``n`` episodes; of one satellite of each type only, if on ``trial``."""
        # the trial's arcs shall be as long as those of the batch: see check_memory
        sample = isinstance(self.time_limit_generator, Distribution) and n < self.batch_size[0]
        limit = self._draw_limit(first_key(min(SAMPLE, self.batch_size[0]) if sample else n))
        finite = limit[torch.isfinite(limit)]
        types = [columns[:1] for columns in self.types] if trial else self.types
        simulators: list[Simulator] = []
        known = [set(world_arguments(self.originals[columns[0]])) for columns in types]
        check_world(self._world_args, known)
        for columns, names in zip(types, known, strict=True):
            satellite = self.originals[columns[0]]
            given = [self.originals[k].sat_args_generator for k in columns]
            simulators.append(
                Simulator(
                    satellite.dyn_type,
                    satellite.fsw_type,
                    given[0] if all(args is given[0] for args in given) else given,
                    {name: value for name, value in self._world_args.items() if name in names},
                    num_envs=n,
                    device=torch.device(self.device),
                    horizon=float(satellite.generation(limit).max()),
                    segment=satellite.segment,
                    max_time=float(finite.max()) if len(finite) else 0.0,
                    scene=self.scenario.draw,
                    stops=satellite.variable_interval,
                    columns=columns,
                    tables=simulators[0].tables if simulators else None,
                    randomize=self._share_of(columns),
                    **self._options,
                )
            )
        chosen = [column for columns in types for column in columns]
        return Fleet(simulators, [self.names[k] for k in sorted(chosen)])

    def _share_of(self, columns: Sequence[int]) -> Callable[[Key], Any]:
        if self.randomizer is None:
            return lambda key: {}
        return lambda key: share(self.randomizer(key), columns)  # type: ignore[misc]

    def _bound(self, fleet: Fleet, limit: Tensor | None = None) -> tuple[Satellite, ...]:
        """The satellites of each type, living in ``fleet``."""
        limits = self.time_limit if limit is None else limit
        fleet.parts = tuple(
            self.originals[simulator.columns[0]].bind(
                simulator, simulator.of_env(limits).clone(), [self.names[k] for k in simulator.columns]
            )
            for simulator in fleet.simulators
        )
        return fleet.parts

    @staticmethod
    def _link(fleet: Fleet, scenario: Scenario, rewarder: GlobalReward) -> None:
        """Make satellites, scenario and rewarder known to each other."""
        scenario.link(fleet)
        for part in fleet.parts:
            part.scenario = scenario
        rewarder.link(scenario, fleet)

    def _pool_pays(self, fleet: Fleet) -> bool:
        """Whether the batch is large, and no user's callable says what comes next: it is asked only when needed."""
        given = [value for part in fleet.simulators for args in (part.sat_args, part.world_args) for value in args.all_given]
        given.append(self.time_limit_generator)
        asks = self.scenario.calls_user or any(callable(value) and not isinstance(value, Distribution) for value in given)
        asks = asks or (self.randomizer is not None and self.randomizer.calls_user)
        return self.batch_size[0] * len(self.names) >= SMALLEST and not asks

    def _trial(self) -> list[Values]:
        """Observations of a trial episode, for each type: their shapes make the specs, and every property has been read once."""
        fleet = self._make_fleet(1, trial=True)
        drawn, limit = self._drawn(fleet, first_key(1))
        parts = self._bound(fleet, limit)
        each = sum(s.bytes_per_env * len(columns) for s, columns in zip(fleet.simulators, self.types, strict=True))
        each += sum(table.nbytes for table in fleet.tables.values())
        check_memory(fleet.device, self.batch_size[0], each * (2 if self._pool_pays(fleet) else 1))
        scenario = copy.copy(self.scenario)
        self._link(fleet, scenario, copy.copy(self.rewarder))
        self._start(fleet, fleet.all_envs, drawn, limit)
        scenario.reset(fleet.all_envs)
        for part in parts:
            part.is_alive()
        return [part.observations.get_dict() for part in parts]

    def _draw_limit(self, key: Key) -> Tensor:
        """Time limits [n] s of the key's environments, whole ticks still to be made of them."""
        value = self.time_limit_generator
        if isinstance(value, Distribution):
            return convert(LIMIT, value.draw(key.named("time_limit")), len(key))
        values = [value() for _ in range(len(key))] if callable(value) else [value] * len(key)
        return convert(LIMIT, values, len(key))

    def _make_buffers(self, n: int, env_ids: Sequence[int] | Tensor | None) -> None:
        ids = torch.arange(n) if env_ids is None else torch.as_tensor(env_ids, dtype=torch.int64)
        if ids.shape != (n,) or bool((ids < 0).any()):
            raise ValueError(f"env_ids has shape {list(ids.shape)}; it needs {n} indices that are not negative")
        self.env_ids = ids.to(self.device)
        counter = torch.zeros(n, dtype=torch.int64, device=self.device)
        self.episode, self.seed_rows = counter - 1, counter.clone()
        self.limit_ticks, self.time_limit, self.returns = counter.clone(), counter.double(), counter.double()

    def _make_specs(self, trial: list[Values]) -> None:
        raise NotImplementedError(f"{type(self).__name__} must implement _make_specs(trial)")

    def _tree(self, values: Values, shape: Sequence[int]) -> Composite:
        """Spec of named observations [1, ...], with ``shape`` in front."""
        parts = {n: self._tree(v, shape) if isinstance(v, dict) else self._leaf(v, shape) for n, v in values.items()}
        return Composite(parts, shape=shape, device=self.device)

    def _leaf(self, value: Tensor, shape: Sequence[int]) -> Unbounded:
        return Unbounded((*shape, *value.shape[1:]), dtype=self.dtype, device=self.device)

    def _ends_spec(self) -> Composite:
        b, on = self.batch_size, {"device": self.device}
        flags = {name: Categorical(2, shape=(*b, 1), dtype=torch.bool, **on) for name in ("done", "terminated", "truncated")}
        return Composite(flags, shape=b, **on)

    @property
    def simulator(self) -> Simulator:
        """The simulation of the first type of satellites."""
        return self.fleet.simulators[0]

    # -- reset --------------------------------------------------------------------------------------------------------

    def _set_seed(self, seed: int | None) -> None:
        value = int(torch.empty((), dtype=torch.int64).random_()) if seed is None else int(seed)
        self.seed_rows = torch.full_like(self.seed_rows, value)
        self.episode = torch.full_like(self.episode, -1)

    def _reset(self, tensordict: TensorDictBase | None = None, *, set_state: bool = False, **_: Any) -> TensorDict:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        rows = self.fleet.all_envs if mask is None else torch.nonzero(mask.reshape(-1)).squeeze(-1)
        if set_state and tensordict is not None and "state" in tensordict:
            self._restore(tensordict["state"], rows)
        elif len(rows):
            self._begin(rows)
        false = torch.zeros(*self.batch_size, 1, dtype=torch.bool, device=self.device)
        return self._outputs(None, done=false, terminated=false.clone(), truncated=false.clone())

    def _drawn(self, fleet: Fleet, key: Key) -> tuple[Drawn, Tensor]:
        """What the episodes of the key's environments start from, and their time limits, [n] s."""
        return fleet.draw(key, self.randomizer), self._draw_limit(key).to(self.device)

    def _start(self, fleet: Fleet, rows: Tensor, drawn: Drawn, limit: Tensor) -> None:
        """Start the episodes ``rows`` [n] of a fleet."""
        fleet.reset(rows, drawn, [self.originals[part.columns[0]].generation(limit) for part in fleet.simulators])

    def _new_episodes(self, rows: Tensor) -> Tensor:
        """Put the next episodes of ``rows`` into the simulation; their time limits, [n] s."""
        if self.pool is not None:
            self.pool.fill(rows, self.seed_rows, self.env_ids, self.episode + 1, self._drawn, self._start)
            self.fleet.adopt(rows, self.pool.fleet)
            return self.pool.limit[rows]
        drawn, limit = self._drawn(
            self.fleet, Key(self.seed_rows[rows].cpu(), self.env_ids[rows].cpu(), self.episode[rows].cpu() + 1)
        )
        self._start(self.fleet, rows, drawn, limit)
        return limit

    @torch.no_grad()
    def _begin(self, rows: Tensor) -> None:
        """Start new episodes in ``rows``; everything is drawn and checked before anything changes."""
        limit = self._new_episodes(rows)
        self.episode[rows] += 1
        seconds = torch.where(torch.isfinite(limit), limit, torch.full_like(limit, ENDLESS))
        ticks = torch.ceil(torch.floor(seconds * 1e9 + 0.5) / self.simulator.h_ns)
        self.limit_ticks[rows] = ticks.long()
        self.time_limit[rows] = torch.where(torch.isfinite(limit), ticks * self.simulator.h, limit)
        self.fleet.inert[rows] = False
        self.returns[rows] = 0.0
        for k, squad in enumerate(self.squads):
            squad.begin(self.fleet.rows(k, rows))
        self._renew(rows)
        for k, squad in enumerate(self.squads):
            mine = self.fleet.rows(k, rows)
            squad.dead = squad.dead.index_copy(0, mine, ~squad.satellite.is_alive()[mine])

    def _renew(self, rows: Tensor) -> None:
        """Tell everybody that the episodes ``rows`` [n] are others now."""
        for k, squad in enumerate(self.squads):
            squad.satellite.time_limit.copy_(squad.simulator.of_env(self.time_limit))
            squad.satellite.absent = self.fleet.rows_of(k, self.fleet.inert) if self.fleet.size > 1 else None
        self.scenario.reset(rows)

    # -- step ---------------------------------------------------------------------------------------------------------

    @torch.no_grad()
    def _play(self, actions: Sequence[Tensor], acts: Sequence[Tensor], moves: Tensor, all_act: bool = False) -> Played:
        """Do the ``actions`` of each type where they ``act``; simulate the episodes ``moves`` [N] to the end of their step."""
        fleet = self.fleet
        start = fleet.since = fleet.ticks
        before = self.rewarder.read_log()
        for squad, action, mine in zip(self.squads, actions, acts, strict=True):
            squad.command(action, mine, all_act)
        self._fly(moves)
        reward = self.rewarder.calculate_reward(before, self.rewarder.read_log())
        self.scenario.after_step(fleet.sim_time)
        if not isinstance(self.communicator, NoCommunication):
            self.links = self.communicator.communicate(moves)
            self.rewarder.share(self.links)
        for simulator in fleet.simulators:
            simulator.memory.touch()
        for squad in self.squads:
            squad.dead = squad.dead | ~squad.satellite.is_alive()
        return Played((fleet.ticks - start) * fleet.h, reward * moves.unsqueeze(-1))

    def _fly(self, moves: Tensor) -> None:
        """Simulate the episodes ``moves`` [N] to the first end of a task, of the step, or of the episode."""
        fleet = self.fleet
        now = fleet.ticks
        left = (self.limit_ticks - now).clamp(min=0)
        ends = now + self.longest_ticks
        for squad in self.squads:
            if squad.satellite.variable_interval:
                ends = torch.minimum(ends, self._soonest(squad, squad.ends))
        ticks = torch.minimum((ends - now).clamp(min=0), left) * moves
        orders = [
            torch.minimum(part.of_env(self._soonest(squad, squad.expected) - now), part.of_env(ticks)) if part.stops else None
            for part, squad in zip(fleet.simulators, self.squads, strict=True)
        ]
        events = fleet.run(ticks, left, orders)
        last = moves & (fleet.ticks >= self.limit_ticks)
        for squad, event in zip(self.squads, events, strict=True):
            squad.settle(event, squad.simulator.of_env(moves), squad.simulator.of_env(last))

    def _soonest(self, squad: Squad, ticks: Tensor) -> Tensor:
        """The first of the ticks [N * count] of each episode, [N]."""
        return ticks if squad.simulator.count == 1 else ticks.view(self.fleet.num_envs, -1).amin(1)

    @property
    def truncated_by_time(self) -> Tensor:
        """Episodes whose time is up, [N]."""
        return self.fleet.ticks >= self.limit_ticks

    def _outputs(self, played: Played | None, **parts: Tensor) -> TensorDict:
        raise NotImplementedError(f"{type(self).__name__} must implement _outputs(played, **parts)")

    def counts(self) -> dict[str, Tensor]:
        """What is counted in each episode for each satellite, [N, S] each, by name."""
        names = dict.fromkeys(name for squad in self.squads for name in squad.satellite.counts())
        counted = {name: self.fleet.each(functools.partial(_counted, name)) for name in names}
        return counted | self.rewarder.counts()

    def _cast(self, values: Values, shape: Sequence[int]) -> TensorDict:
        """Named observations of rows, [*shape, ...] each."""
        parts = {
            name: self._cast(v, shape) if isinstance(v, dict) else v.to(self.dtype).view(*shape, *v.shape[1:])
            for name, v in values.items()
        }
        return TensorDict(parts, shape, device=self.device)

    # -- state --------------------------------------------------------------------------------------------------------

    def get_state(self) -> TensorDict:
        """Everything that the future depends on; give it back with ``reset(TensorDict({"state": ...}), set_state=True)``."""
        state = fleet_state(self.fleet)
        for k, squad in enumerate(self.squads):
            kept = TensorDict({name: getattr(squad, name) for name in KEPT}, [squad.simulator.size])
            state[f"squad_{k}"] = by_env(kept.clone(), squad.simulator.count)
        for name in EXTRA_STATE:
            state[name] = getattr(self, name).clone()
        return state

    @torch.no_grad()
    def _restore(self, state: TensorDictBase, rows: Tensor) -> None:
        restore_fleet(self.fleet, state, rows)
        for k, squad in enumerate(self.squads):
            saved, mine = by_row(state[f"squad_{k}"], squad.simulator.count), self.fleet.rows(k, rows)
            for name in KEPT:
                setattr(squad, name, getattr(squad, name).index_copy(0, mine, saved[name][mine]))
        for name in EXTRA_STATE:
            getattr(self, name)[rows] = state[name][rows]
        self._renew(rows)

    def get_extra_state(self) -> TensorDict | None:
        """Part of ``state_dict``: see :meth:`get_state`; None before the first reset."""
        return self.get_state() if bool((self.episode >= 0).any()) else None

    def set_extra_state(self, state: TensorDict | None) -> None:
        """Part of ``load_state_dict``."""
        if state is not None:
            self._restore(state, self.fleet.all_envs)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments and the state, not the compiled tick."""
        return _rebuild, (type(self), self._arguments, self.seed_rows, self.episode, self.get_extra_state())

    # -- pictures -----------------------------------------------------------------------------------------------------

    def render(self, rows: int | Sequence[int] | None = None, height: int = 480) -> Tensor:
        """Pictures of the present: the Earth, the satellites and what they do; nothing that comes next changes.

        TorchRL's ``PixelRenderTransform`` calls it, with ``rows=0`` for a video of one environment of many. It resets the
        environment to learn the shape of pictures: read ``env.observation_spec`` before a rollout.

        Args:
            rows: Environment to draw, or several; None for all, if they are 16 at most.
            height: Pixels from top to bottom, an even number from 120 on; there are 4/3 as many from left to right.

        Returns:
            Pixels [len(rows), height, width, 3], or [height, width, 3] of a single environment; uint8.

        Raises:
            ModuleNotFoundError: Without the extra ``viz``.
            RuntimeError: Before the first reset.
            ValueError: For a wrong argument.
        """
        return pictures().frames(self, rows, height)

    # -- help ---------------------------------------------------------------------------------------------------------

    def default_sat_args(self) -> ArgumentTable:
        """Every argument that ``sat_args`` accepts, with default, unit and meaning; print it to read it."""
        return self.originals[0].default_sat_args()

    def default_world_args(self) -> ArgumentTable:
        """Every argument that ``world_args`` accepts, with default, unit and meaning; print it to read it."""
        return ArgumentTable([part for columns in self.types for part in world_components(self.originals[columns[0]])])

    @property
    def bytes_per_env(self) -> int:
        """Bytes that the tensors of one environment take, its prepared next episode included; the windows found add a little."""
        return self.fleet.bytes_per_env + (self.pool.fleet.bytes_per_env if self.pool else 0)

    def check_finite(self) -> None:
        """FloatingPointError that names environment, field and tick, if any state is not a finite number."""
        for squad in self.squads:
            simulator = squad.simulator
            for name in simulator.tick.state.fields:
                value = simulator.read(name).reshape(simulator.size, -1)
                bad = torch.nonzero(~torch.isfinite(value).all(-1)).squeeze(-1).tolist()
                if bad:
                    row = bad[0]
                    raise FloatingPointError(
                        f"{name!r} of {squad.satellite.title(row)} is {value[row].tolist()} at tick {int(simulator.ticks[row])} "
                        f"({len(bad)} of them in all)"
                    )


def _rebuild(kind: type[Tasking], arguments: dict[str, Any], seeds: Tensor, episode: Tensor, state: TensorDict | None) -> Tasking:
    env = kind(**arguments)
    env.seed_rows, env.episode = seeds, episode
    env.set_extra_state(state)
    return env


def pictures() -> Any:
    """The module that draws; ModuleNotFoundError without the extra ``viz``."""
    try:
        return import_module("bsk_torch.viz.frames")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"render() needs {error.name}: pip install 'bsk_torch[viz]'", name=error.name) from error


def composed(rewarder: GlobalReward | Iterable[GlobalReward] | None) -> GlobalReward:
    """The rewarder, or the sum of several, as a copy."""
    if rewarder is None:
        return NoReward()
    return copy.copy(rewarder) if isinstance(rewarder, GlobalReward) else ComposedReward(*map(copy.copy, rewarder))


def _counted(name: str, part: Satellite) -> Tensor:
    counts = part.counts()
    if name not in counts:
        raise AttributeError(f"{part.name} does not count {name!r}")
    return counts[name]
