"""One satellite per episode, N episodes at once."""

from __future__ import annotations

import copy
import logging
import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from bsk_torch.data.base import GlobalReward, Log, NoReward
from bsk_torch.env.machine import check_memory, existing_device
from bsk_torch.env.pool import SMALLEST, EpisodePool
from bsk_torch.env.state import restore_simulation, simulation_state
from bsk_torch.obs.base import ObservationBuilder, Values
from bsk_torch.rand import Distribution, Key, first_key
from bsk_torch.sats.satellite import ArgumentTable, Satellite
from bsk_torch.scene.base import Scenario
from bsk_torch.sim.component import Arg, collect
from bsk_torch.sim.params import convert
from bsk_torch.sim.simulator import Simulator, whole_nanoseconds

logger = logging.getLogger(__name__)

TimeLimit = float | Distribution | Callable[[], float]

ENDLESS = 2**31
"""Seconds after which Basilisk's clock stops an episode without limit."""

LIMIT = Arg("time_limit", float("inf"), "s", "time after which an episode is truncated", low=0.0)

SAMPLE = 1024
"""Random time limits that are drawn to see how long arcs will be, before a batch is built."""

EXTRA_STATE = ("previous_action", "episode", "dead", "limit_ticks", "seed_rows", "requires_retasking")


class SatelliteTasking(EnvBase):
    """N independent episodes of one satellite type, as bsk_rl's ``SatelliteTasking`` plays one.

    Keys: ``observation``, ``action``, ``action_mask``, ``reward``, ``done``, ``terminated``, ``truncated`` and ``duration``, the
    seconds that a step took.
    """

    _supports_set_state = True
    _has_frame_skip = True

    def __init__(
        self,
        satellite: Satellite,
        scenario: Scenario | None = None,
        rewarder: GlobalReward | None = None,
        *,
        num_envs: int = 1,
        world_args: dict[str, Any] | None = None,
        sim_rate: float = 1.0,
        max_step_duration: float = 1e9,
        failure_penalty: float = -1.0,
        time_limit: TimeLimit = float("inf"),
        terminate_on_time_limit: bool = False,
        device: torch.device | str = "cpu",
        seed: int | None = None,
        env_ids: Sequence[int] | Tensor | None = None,
        dtype: torch.dtype = torch.float32,
        sim_dtype: torch.dtype = torch.float64,
        orbit: str | None = None,
        backend: str = "compiled",
        log_level: int | str | None = None,
    ) -> None:
        """Build the environment and check its arguments; nothing is simulated before the first reset.

        Args:
            satellite: The satellite; the environment works on a copy.
            scenario: What is asked of it; None for nothing.
            rewarder: What its data are worth; None for nothing.
            num_envs: Number of episodes N.
            world_args: Arguments of the world, like ``sat_args``; see :meth:`default_world_args`.
            sim_rate: Length of a tick, s.
            max_step_duration: Longest step, s.
            failure_penalty: Added to the reward of a step at whose end the satellite is dead.
            time_limit: Seconds after which an episode is truncated, rounded up to whole ticks; a number, a distribution or a
                callable without arguments.
            terminate_on_time_limit: Whether the time limit also terminates.
            device: Where the simulation runs.
            seed: Seed of all draws; None for a random one.
            env_ids: Index of each episode in the draws, 0 to N - 1 unless given.
            dtype: Type of observations, rewards and durations.
            sim_dtype: float64 for parity with Basilisk; float32 for mixed precision: attitude, wheels and flight software in
                float32, orbit, time and accumulators in float64.
            orbit: ``"arc"`` (in advance), ``"integrated"`` (in every tick, with drag), or None for what the model says.
            backend: ``"compiled"``, or ``"eager"`` for debugging.
            log_level: Level of the package's logger; None leaves it.
        """
        if num_envs < 1:
            raise ValueError(f"num_envs={num_envs} must be at least 1")
        super().__init__(device=existing_device(device), batch_size=[num_envs])
        self._arguments = {k: v for k, v in locals().items() if k not in ("self", "__class__")}
        if log_level is not None:
            logging.getLogger("bsk_torch").setLevel(log_level)
        if failure_penalty > 0.0:
            logger.warning("failure_penalty=%g rewards failure; it should not be positive", failure_penalty)
        self.dtype, self.failure_penalty = dtype, float(failure_penalty)
        self.terminate_on_time_limit, self.time_limit_generator = terminate_on_time_limit, time_limit
        self.max_step_duration = float(max_step_duration)
        self.scenario, self.rewarder = copy.copy(scenario or Scenario()), copy.copy(rewarder or NoReward())
        options = {"sim_rate": sim_rate, "dtype": sim_dtype, "orbit": orbit, "world_args": world_args or {}}
        trial = self._trial(satellite, backend, options)
        self.simulator = self._simulator(satellite, num_envs, backend, options)
        self.pool = self._make_pool(satellite, num_envs, backend, options)
        self._make_buffers(num_envs, env_ids)
        self.satellite = satellite.bind(self.simulator, self.time_limit)
        self._link(self.satellite, self.scenario, self.rewarder)
        if self.pool is not None and self.pool.simulator.access is not None and self.simulator.access is not None:
            self.pool.simulator.access.ahead = self.simulator.access.ahead
        self._make_specs(trial)
        self.longest_ticks = math.ceil(whole_nanoseconds(min(self.max_step_duration, ENDLESS)) / self.simulator.h_ns)
        self.set_seed(seed)

    # -- construction -------------------------------------------------------------------------------------------------

    def _simulator(self, satellite: Satellite, n: int, backend: str, options: dict[str, Any]) -> Simulator:
        # the trial's arcs shall be as long as those of the batch: see check_memory
        sample = isinstance(self.time_limit_generator, Distribution) and n < self.batch_size[0]
        limit = self._draw_limit(first_key(min(SAMPLE, self.batch_size[0]) if sample else n))
        finite = limit[torch.isfinite(limit)]
        return Simulator(
            satellite.dyn_type,
            satellite.fsw_type,
            satellite.sat_args_generator,
            num_envs=n,
            device=torch.device(self.device),
            horizon=float(satellite.generation(limit).max()),
            backend=backend,
            segment=satellite.segment,
            max_time=float(finite.max()) if len(finite) else 0.0,
            scene=self.scenario.draw,
            stops=satellite.variable_interval,
            **options,
        )

    @staticmethod
    def _link(satellite: Satellite, scenario: Scenario, rewarder: GlobalReward) -> None:
        """Make satellite, scenario and rewarder known to each other."""
        scenario.link_satellite(satellite)
        satellite.scenario = scenario
        rewarder.link(scenario, satellite)

    def _make_pool(self, satellite: Satellite, n: int, backend: str, options: dict[str, Any]) -> EpisodePool | None:
        pays = self._pool_pays(self.simulator)
        return EpisodePool(self._simulator(satellite, n, backend, options)) if pays else None

    def _pool_pays(self, simulator: Simulator) -> bool:
        """Whether the batch is large, and no user's callable says what comes next: it is asked only when needed."""
        given = (*simulator.sat_args.given.values(), *simulator.world_args.given.values(), self.time_limit_generator)
        asks = self.scenario.calls_user or any(callable(value) and not isinstance(value, Distribution) for value in given)
        return self.batch_size[0] >= SMALLEST and not asks

    def _trial(self, satellite: Satellite, backend: str, options: dict[str, Any]) -> Values:
        """Observations of one trial episode: their shapes make the specs, and every property has been read once."""
        simulator = self._simulator(satellite, 1, backend, options)
        check_memory(simulator.device, self.batch_size[0], simulator.bytes_per_env * (2 if self._pool_pays(simulator) else 1))
        key = first_key(1)
        limit = self._draw_limit(key).to(simulator.device)
        bound = satellite.bind(simulator, limit)
        self._link(bound, copy.copy(self.scenario), copy.copy(self.rewarder))
        simulator.reset(simulator.all_rows, simulator.draw(key), bound.generation(limit))
        bound.scenario.reset(simulator.all_rows)
        bound.is_alive()
        return bound.observations.get_dict()

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
        self.previous_action, self.episode, self.seed_rows = counter - 1, counter - 1, counter.clone()
        self.limit_ticks, self.time_limit = counter.clone(), counter.double()
        self.dead = torch.zeros(n, dtype=torch.bool, device=self.device)
        self.requires_retasking = torch.ones_like(self.dead)

    def _make_specs(self, trial: Values) -> None:
        b, on = self.batch_size, {"device": self.device}
        n_actions = self.satellite.actions.n_actions

        def leaf(value: Tensor) -> Unbounded:
            return Unbounded((*b, *value.shape[1:]), dtype=self.dtype, **on)

        def tree(values: Values) -> Composite:
            parts = {name: tree(v) if isinstance(v, dict) else leaf(v) for name, v in values.items()}
            return Composite(parts, shape=b, **on)

        vector = ObservationBuilder.vector(trial, self.dtype)
        self.satellite.observation_description = ObservationBuilder.describe(trial)
        observed = tree(trial) if self.satellite.obs_type is dict else leaf(vector)
        self.observation_spec = Composite(
            observation=observed,
            action_mask=Binary(n_actions, shape=(*b, n_actions), dtype=torch.bool, **on),
            duration=Unbounded((*b, 1), dtype=self.dtype, **on),
            shape=b,
            **on,
        )
        counts = {name: Unbounded((*b, 1), dtype=torch.int64, **on) for name in self.satellite.counts() | self.rewarder.counts()}
        if counts:
            self.observation_spec["counts"] = Composite(counts, shape=b, **on)
        self.action_spec = Categorical(n_actions, shape=b, dtype=torch.int64, **on)
        self.reward_spec = Unbounded((*b, 1), dtype=self.dtype, **on)
        flags = {name: Categorical(2, shape=(*b, 1), dtype=torch.bool, **on) for name in ("done", "terminated", "truncated")}
        self.full_done_spec = Composite(flags, shape=b, **on)

    # -- reset --------------------------------------------------------------------------------------------------------

    def _set_seed(self, seed: int | None) -> None:
        value = int(torch.empty((), dtype=torch.int64).random_()) if seed is None else int(seed)
        self.seed_rows = torch.full_like(self.seed_rows, value)
        self.episode = torch.full_like(self.episode, -1)

    def _reset(self, tensordict: TensorDictBase | None = None, *, set_state: bool = False, **_: Any) -> TensorDict:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        rows = self.simulator.all_rows if mask is None else torch.nonzero(mask.reshape(-1)).squeeze(-1)
        if set_state and tensordict is not None and "state" in tensordict:
            self._restore(tensordict["state"], rows)
        elif len(rows):
            self._begin(rows)
        false = torch.zeros(*self.batch_size, 1, dtype=torch.bool, device=self.device)
        zero = torch.zeros(*self.batch_size, 1, dtype=self.dtype, device=self.device)
        return self._outputs(duration=zero, done=false, terminated=false.clone(), truncated=false.clone())

    def _new_episodes(self, rows: Tensor) -> Tensor:
        """Put the next episodes of ``rows`` into the simulation; their time limits, [n] s."""
        if self.pool is not None:
            self.pool.fill(rows, self.seed_rows, self.env_ids, self.episode + 1, self._draw_limit, self.satellite.generation)
            self.simulator.adopt(rows, self.pool.simulator)
            return self.pool.limit[rows]
        key = Key(self.seed_rows[rows].cpu(), self.env_ids[rows].cpu(), self.episode[rows].cpu() + 1)
        values, limit = self.simulator.draw(key), self._draw_limit(key).to(self.device)
        self.simulator.reset(rows, values, self.satellite.generation(limit))
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
        self.previous_action[rows], self.requires_retasking[rows] = -1, True
        self.scenario.reset(rows)
        self.dead[rows] = ~self.satellite.is_alive()[rows]

    # -- step ---------------------------------------------------------------------------------------------------------

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        partial = tensordict.get("_step", None)
        return self.play(tensordict.get("action"), None if partial is None else partial.reshape(-1))

    @torch.no_grad()
    def play(self, action: Tensor, moves: Tensor | None = None) -> TensorDict:
        """Do ``action`` [N] where ``moves`` [N] is true, everywhere if None; what ``step`` puts under ``next``."""
        action = self._checked(action)
        moves = torch.ones_like(self.dead) if moves is None else moves
        before, start = self.rewarder.read_log(), self.simulator.ticks
        self._command(action, moves)
        reward = self._reward(before, moves)
        self.scenario.after_step(self.simulator.sim_time)
        self.simulator.memory.touch()
        terminated, truncated = self._ends()
        return self._outputs(
            duration=((self.simulator.ticks - start) * self.simulator.h).to(self.dtype).unsqueeze(-1),
            reward=reward.to(self.dtype).unsqueeze(-1),
            terminated=terminated.unsqueeze(-1),
            truncated=truncated.unsqueeze(-1),
            done=(terminated | truncated).unsqueeze(-1),
        )

    def _checked(self, action: Tensor) -> Tensor:
        n = self.satellite.actions.n_actions
        if action.dtype.is_floating_point or action.dtype == torch.bool:
            raise TypeError(f"action has dtype {action.dtype}; it must be an integer tensor, such as torch.int64")
        if action.shape != self.batch_size:
            raise ValueError(f"action has shape {list(action.shape)}; it must be {list(self.batch_size)}, one per environment")
        action = action.long()
        explicit = self.satellite.actions.explicit
        wrong = (action < -explicit) | (action >= n)
        if bool(wrong.any()):
            row = int(torch.nonzero(wrong)[0])
            names = ", ".join(f"{k}: {name}" for k, name in enumerate(self.satellite.action_description))
            more = f", and -1 to {-explicit} for a target by its index" if explicit else ""
            raise ValueError(f"action {int(action[row])} of environment {row} is out of range; legal are {names}{more}")
        return action

    def _command(self, action: Tensor, moves: Tensor) -> None:
        """Give the satellites their commands and simulate to the end of their steps."""
        simulator, actions = self.simulator, self.satellite.actions
        decision = actions.decide(action, self.previous_action)
        simulator.command(decision.retask & moves, decision.mode)
        actions.begin(action, moves, decision)
        self.previous_action = torch.where(moves, decision.key, self.previous_action)
        wanted = self._ticks(decision.duration)
        longest = torch.full_like(wanted, self.longest_ticks)
        ends = torch.minimum(wanted, longest) if self.satellite.variable_interval else longest
        left = (self.limit_ticks - simulator.ticks).clamp(min=0)
        ticks = torch.minimum(ends, left) * moves
        events = simulator.events
        flown = simulator.run(ticks, torch.minimum(self._ticks(decision.expected), ticks))
        # the time limit stops the clock before an event of the same instant is looked at
        event = (simulator.events > events) & (flown < left)
        ended = (wanted <= flown) & (flown < left) & moves
        self.requires_retasking = torch.where(moves, ended | event, self.requires_retasking)
        self.satellite.note_events(event)
        actions.end(action, ended, decision, event)

    def _ticks(self, duration: Tensor) -> Tensor:
        """Ticks after which a duration [N] s has passed: an event fires at the first tick at or after its time."""
        return torch.ceil(torch.floor(duration * 1e9 + 0.5) / self.simulator.h_ns).long()

    def _reward(self, before: Log, moves: Tensor) -> Tensor:
        reward = self.rewarder.calculate_reward(before, self.rewarder.read_log())
        self.dead = self.dead | ~self.satellite.is_alive()
        return (reward + self.failure_penalty * self.dead) * moves

    def _ends(self) -> tuple[Tensor, Tensor]:
        truncated = (self.simulator.ticks >= self.limit_ticks) | self.rewarder.is_truncated()
        terminated = self.dead | self.rewarder.is_terminated()
        return terminated | truncated if self.terminate_on_time_limit else terminated, truncated

    @torch.no_grad()
    def _outputs(self, **parts: Tensor) -> TensorDict:
        observations = self.satellite.observations
        in_parts = self.satellite.obs_type is dict
        observation: Any = self._cast(observations.get_dict()) if in_parts else observations.get_vector(self.dtype)
        parts |= {"observation": observation, "action_mask": self.satellite.action_mask()}
        counts = self.satellite.counts() | self.rewarder.counts()
        if counts:
            shown = {name: count.unsqueeze(-1) for name, count in counts.items()}
            parts["counts"] = TensorDict(shown, self.batch_size, device=self.device)
        return TensorDict(parts, self.batch_size, device=self.device)

    def _cast(self, values: Values) -> TensorDict:
        parts = {name: self._cast(v) if isinstance(v, dict) else v.to(self.dtype) for name, v in values.items()}
        return TensorDict(parts, self.batch_size, device=self.device)

    # -- state --------------------------------------------------------------------------------------------------------

    def get_state(self) -> TensorDict:
        """Everything that the future depends on; give it back with ``reset(TensorDict({"state": ...}), set_state=True)``."""
        state = simulation_state(self.simulator)
        for name in (*EXTRA_STATE, "time_limit"):
            state[name] = getattr(self, name).clone()
        return state

    @torch.no_grad()
    def _restore(self, state: TensorDictBase, rows: Tensor) -> None:
        restore_simulation(self.simulator, state, rows)
        for name in (*EXTRA_STATE, "time_limit"):
            getattr(self, name)[rows] = state[name][rows]
        self.scenario.reset(rows)

    def get_extra_state(self) -> TensorDict | None:
        """Part of ``state_dict``: see :meth:`get_state`; None before the first reset."""
        return self.get_state() if bool((self.episode >= 0).any()) else None

    def set_extra_state(self, state: TensorDict | None) -> None:
        """Part of ``load_state_dict``."""
        if state is not None:
            self._restore(state, self.simulator.all_rows)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments and the state, not the compiled tick."""
        return _rebuild, (self._arguments, self.seed_rows, self.episode, self.get_extra_state())

    # -- help ---------------------------------------------------------------------------------------------------------

    def default_sat_args(self) -> ArgumentTable:
        """Every argument that ``sat_args`` accepts, with default, unit and meaning; print it to read it."""
        return self.satellite.default_sat_args()

    def default_world_args(self) -> ArgumentTable:
        """Every argument that ``world_args`` accepts, with default, unit and meaning; print it to read it."""
        return ArgumentTable(collect(reversed(self.satellite.dyn_type.__mro__), "world_components"))

    @property
    def bytes_per_env(self) -> int:
        """Bytes that the tensors of one environment take, its prepared next episode included; the windows found add a little."""
        return self.simulator.bytes_per_env + (self.pool.simulator.bytes_per_env if self.pool else 0)

    def check_finite(self) -> None:
        """FloatingPointError that names environment, field and tick, if any state is not a finite number."""
        layout = self.simulator.tick.state
        for name in layout.fields:
            value = self.simulator.read(name).reshape(self.simulator.num_envs, -1)
            bad = torch.nonzero(~torch.isfinite(value).all(-1)).squeeze(-1).tolist()
            if bad:
                row = bad[0]
                raise FloatingPointError(
                    f"{name!r} of environment {row} is {value[row].tolist()} at tick {int(self.simulator.ticks[row])} "
                    f"({len(bad)} environments in all)"
                )


def _rebuild(arguments: dict[str, Any], seeds: Tensor, episode: Tensor, state: TensorDict | None) -> SatelliteTasking:
    env = SatelliteTasking(**arguments)
    env.seed_rows, env.episode = seeds, episode
    env.set_extra_state(state)
    return env
