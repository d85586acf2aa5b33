"""Base of all environments: episodes of one or many satellites, drawn, stepped, saved and restored in batches."""

from __future__ import annotations

import contextlib
import copy
import functools
import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from bsk_torch._checks import whole
from bsk_torch._deprecated import deprecated_attributes
from bsk_torch.comm import CommunicationMethod, NoCommunication
from bsk_torch.data import checked, totals
from bsk_torch.data.base import GlobalReward, NoReward
from bsk_torch.data.composed import ComposedReward
from bsk_torch.data.mapped import for_batch
from bsk_torch.env import hints
from bsk_torch.env.arguments import ChangingArguments
from bsk_torch.env.build import FleetBuilder, link
from bsk_torch.env.changes import Change
from bsk_torch.env.exclusive import Exclusive
from bsk_torch.env.log import StepLog, configure
from bsk_torch.env.machine import existing_device
from bsk_torch.env.options import TaskingOptions, TimeLimit
from bsk_torch.env.pool import EpisodePool
from bsk_torch.env.randomizer import make_randomizer
from bsk_torch.env.satellite_group import groups_of
from bsk_torch.env.state import (
    ENDLESS,
    MADE_BY,
    check_fingerprint,
    check_values,
    fingerprint,
    lookahead_of,
    over_saved,
    rows_of,
    whole_limit,
)
from bsk_torch.env.trial import try_out
from bsk_torch.obs.base import Values
from bsk_torch.rand import Key
from bsk_torch.sats.dtypes import common_dtype
from bsk_torch.sats.satellite import Satellite
from bsk_torch.scene.base import Scenario
from bsk_torch.sim.argument_table import ArgumentTable
from bsk_torch.sim.fleet import Fleet, FleetState
from bsk_torch.sim.simulator import Simulator, whole_nanoseconds
from bsk_torch.sim.state import FINITE, SHOWN, StateTable

__all__ = ["StepResult", "Tasking", "TimeLimit"]

logger = logging.getLogger(__name__)


SEED_LIMIT = 2**63
"""Seeds are below it."""


class ResetNeededError(RuntimeError):
    """A call needs running episodes, and there are none."""


class StepResult(NamedTuple):
    """Outcome of a step of N episodes with S satellites each.

    Attributes:
        duration: How long it took, [N] s.
        reward: Rewards of the satellites, failure penalties included, [N, S]; zero where the step did not take place.
        terminated: Episodes that have ended, [N].
        truncated: Episodes that were cut, [N].
        removed: Satellites that had left before the step, [N, S].
    """

    duration: Tensor
    reward: Tensor
    terminated: Tensor
    truncated: Tensor
    removed: Tensor


class EpisodeState(FleetState):
    """State of N episodes in an environment.

    Attributes:
        episode: Number of the episode, -1 before the first, [N].
        seed: Seed of its draws, [N].
        limit_ticks: Tick at which it is truncated, [N].
        returns: Sum of the rewards of all satellites so far, [N].
        begun: Episodes that can be stepped: not before the first reset, nor after a call that did not come to its end, [N].
    """

    episode: Tensor
    seed: Tensor
    limit_ticks: Tensor
    returns: Tensor
    begun: Tensor


@deprecated_attributes
class Tasking(ChangingArguments, EnvBase):
    """N independent episodes with S satellites each. Subclasses define agents: their actions, observations and rewards."""

    _supports_set_state = True
    _has_frame_skip = True

    links: Tensor | None = None
    """Communication after the last step by sender and receiver, [N, S, S]; None where satellites never communicate."""

    def _build(
        self,
        satellites: Sequence[Satellite],
        scenario: Scenario | None,
        rewarder: GlobalReward | Iterable[GlobalReward] | None,
        communicator: CommunicationMethod | None,
        sat_arg_randomizer: Any,
        options: TaskingOptions,
    ) -> None:
        """Build everything; nothing is simulated before the first reset."""
        EnvBase.__init__(self, device=existing_device(options.device), batch_size=(options.num_envs,))
        for name, value, kind in (("scenario", scenario, Scenario), ("communicator", communicator, CommunicationMethod)):
            if value is not None and not isinstance(value, kind):
                raise TypeError(f"{name}={value!r} must be a {kind.__name__}, made with parentheses")
        self.options = options
        configure(options.log_level, options.log_dir)
        if options.failure_penalty > 0.0:
            logger.warning("failure_penalty=%g rewards failure; it should not be positive", options.failure_penalty)
        self.failure_penalty, self.max_step_duration = options.failure_penalty, options.max_step_duration
        self.terminate_on_time_limit = options.terminate_on_time_limit
        self.scenario, self.rewarder = copy.copy(scenario or Scenario()), composed(rewarder)
        self.scenario.validate_satellite_names(satellites)
        self.communicator = copy.copy(communicator or NoCommunication())
        randomizer = make_randomizer(sat_arg_randomizer, satellites)
        self.builder = FleetBuilder(satellites, self.scenario, options, randomizer, torch.device(self.device))
        self.names, self.dtype = self.builder.names, common_dtype(options.dtype, self.builder.satellites)
        trial = try_out(self.builder, self.rewarder)
        n = options.num_envs
        self.fleet = self.builder.make_fleet(n)
        self.pool = EpisodePool(self.builder.make_fleet(n), self._start) if self.builder.pool_pays else None
        self._declare_state(options.env_ids)
        groups_of(self.builder.satellites, self.fleet)
        link(self.fleet, self.scenario, self.rewarder)
        totals.declare(self.rewarder, self.fleet)
        self.communicator.attach(self.fleet)
        if self.pool is not None:
            self._share_search_range(self.pool.fleet)
        recorded = options.log_level is not None or options.log_dir is not None
        self.log = StepLog(self.fleet, self.scenario, options.log_envs) if recorded else None
        trial.decide(self.fleet.groups)  # type: ignore[arg-type]
        self._make_specs(trial.values)
        self.longest_ticks = math.ceil(whole_nanoseconds(min(self.max_step_duration, ENDLESS)) / self.simulator.h_ns)
        self.fingerprint = fingerprint(self.fleet)
        self._changes: list[Change] = []
        self._exclusive = Exclusive(self._leave)
        self._all_begun = self._broke_off = self._unproven = self._restored = False
        self._changing: Tensor | None = None
        self._show_arguments()
        self.set_seed(options.seed)

    # -- construction -------------------------------------------------------------------------------------------------

    def _declare_state(self, env_ids: Sequence[int] | Tensor | None) -> None:
        n = self.num_envs
        self.env_ids = self.fleet.env_ids = read_env_ids(env_ids, n).to(self.device)
        for name, low in (("episode", -1), ("seed", None), ("limit_ticks", 0)):
            self.state.declare(name, None, dtype=torch.int64, low=low)
        self.state.episode = self.state.episode - 1
        self.state.declare("returns", 0.0, low=-FINITE, high=FINITE)
        self.state.declare("begun", False)

    def _share_search_range(self, other: Fleet) -> None:
        """Let the pool search as far ahead for windows as actions and observations need."""
        for mine, theirs in zip(self.fleet.simulators, other.simulators, strict=True):
            if mine.lookahead.access is not None and theirs.lookahead.access is not None:
                theirs.lookahead.access.ahead = mine.lookahead.access.ahead

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

    # -- reading ------------------------------------------------------------------------------------------------------

    def __getattr__(self, name: str) -> Any:
        """Look up what a module of torch registers; AttributeError with advice for names of Gymnasium's environments."""
        if name in hints.ATTRIBUTES:
            raise hints.no_attribute(type(self).__name__, name)
        return super().__getattr__(name)

    @property
    def num_envs(self) -> int:
        """Number of episodes N."""
        return int(self.batch_size[0])

    @property
    def state(self) -> EpisodeState:
        """Everything that belongs to the present episodes, as live tables; :meth:`get_state` returns a copy."""
        return self.fleet.state  # type: ignore[return-value]

    @property
    def simulator(self) -> Simulator:
        """Simulation of the first type of satellites."""
        return self.fleet.simulators[0]

    @property
    def satellites(self) -> tuple[Satellite, ...]:
        """The satellite of each type that is bound to the environment."""
        return tuple(group.satellite for group in self.fleet.groups)

    @property
    def dead(self) -> Tensor:
        """Satellites that have died, [N, S] bool."""
        return self.fleet.joined([group.task.dead for group in self.fleet.groups])

    @property
    def requires_retasking(self) -> Tensor:
        """Satellites that have no task left, [N, S] bool."""
        return self.fleet.joined([group.task.requires_retasking for group in self.fleet.groups])

    @property
    def episode(self) -> Tensor:
        """Number of the present episode, -1 before the first, [N]."""
        return self.state.episode

    @property
    def time_limit(self) -> Tensor:
        """Time limits of the present episodes, whole ticks, [N] s."""
        return self.state.time_limit

    @property
    def returns(self) -> Tensor:
        """Sum of the rewards of each episode so far, of all satellites, [N] float64."""
        return self.state.returns

    @property
    def truncated_by_time(self) -> Tensor:
        """Episodes whose time is up, [N]."""
        return self.fleet.ticks >= self.state.limit_ticks

    def counts(self) -> dict[str, Tensor]:
        """Return the counters of satellites and rewarder, [N, S] each, by name."""
        names = dict.fromkeys(name for group in self.fleet.groups for name in group.satellite.counts())
        counted = {name: self.fleet.each(functools.partial(_counted, name)) for name in names}
        return counted | checked.counts(self.rewarder, counted)

    # -- reset --------------------------------------------------------------------------------------------------------

    def _set_seed(self, seed: int | None) -> None:
        value = int(torch.empty((), dtype=torch.int64).random_()) if seed is None else whole("seed", seed, 0, SEED_LIMIT - 1)
        self.state.seed = torch.full_like(self.state.seed, value)
        self.state.episode = torch.full_like(self.episode, -1)

    def reseed(self, seeds: int | Sequence[int | None], mask: Tensor | None = None) -> None:
        """Let episodes begin with the first ones of other seeds at their next reset; the present ones are left alone.

        Args:
            seeds: Seed of all environments, or one for each of the N, where None keeps the present seed.
            mask: Environments to seed, [N] bool; all unless given.

        Raises:
            ValueError: For a seed that is no integer from 0 to 2**63 - 1, or a wrong number of them.
        """
        count = self.num_envs
        several = isinstance(seeds, Sequence | Tensor | np.ndarray) and not isinstance(seeds, str)
        given: list[Any] = list(seeds) if several else [seeds] * count  # type: ignore[arg-type]
        if len(given) != count:
            raise ValueError(f"seed has {len(given)} entries; it must be an integer or have {count}, one per environment")
        given = [seed.item() if isinstance(seed, Tensor) and seed.ndim == 0 else seed for seed in given]
        given = [None if seed is None else whole("seed", seed, 0, SEED_LIMIT - 1) for seed in given]
        rows = torch.tensor([seed is not None for seed in given], device=self.device)
        rows = rows if mask is None else rows & mask
        values = torch.tensor([seed or 0 for seed in given], dtype=torch.int64, device=self.device)
        self.state.seed = torch.where(rows, values, self.state.seed)
        self.state.episode = self.episode.masked_fill(rows, -1)

    def _assert_tensordict_shape(self, tensordict: TensorDictBase) -> None:
        """Check the argument of ``step`` and ``reset``."""
        hints.check_call(type(self).__name__, self._action_name, tensordict)
        super()._assert_tensordict_shape(tensordict)

    @property
    def _action_name(self) -> str:
        """Key of the action, as one writes it."""
        return "'action'"

    def _reset(self, tensordict: TensorDictBase | None = None, *, set_state: bool = False, **unknown: Any) -> TensorDict:
        if unknown:
            hints.check_reset(type(self).__name__, unknown)
        mask = None if tensordict is None else tensordict.get("_reset", None)
        envs = self.fleet.all_envs if mask is None else torch.nonzero(mask.reshape(-1)).squeeze(-1)
        with self._exclusive:
            if not self._all_begun:
                self.check_begun("reset() of some environments", torch.ones_like(self.state.begun).index_fill(0, envs, False))
            if set_state and tensordict is not None and "state" in tensordict:
                self.restore(tensordict["state"], envs)
                # TorchRL keeps the entry and writes into it at partial resets, which must not reach what the caller has saved
                tensordict["state"] = tensordict["state"].clone()
            elif len(envs):
                self._begin(envs)
            false = torch.zeros(*self.batch_size, 1, dtype=torch.bool, device=self.device)
            return self._outputs(None, done=false, terminated=false.clone(), truncated=false.clone())

    def _start(self, fleet: Fleet, envs: Tensor, key: Key) -> None:
        """Start the key's episodes in ``envs`` [n] of a fleet; everything is drawn and checked before anything changes."""
        drawn, limit = self.builder.draw(fleet, key)
        self.builder.start(fleet, envs, drawn, limit)

    @torch.no_grad()
    def _begin(self, envs: Tensor) -> None:
        """Start new episodes in ``envs`` [n]."""
        state = self.state
        seeds, episodes, begun = state.seed, state.episode + 1, state.begun
        self._changing, self._all_begun = torch.zeros_like(begun), False
        if self.pool is not None and not self.fleet.calls_user:
            self.pool.fill(envs, seeds, self.env_ids, episodes)
            state.copy_rows(envs, self.pool.fleet.state, envs)
        else:
            self._start(self.fleet, envs, Key(seeds[envs].cpu(), self.env_ids[envs].cpu(), episodes[envs].cpu()))
        state.seed, state.episode = seeds, state.episode.index_copy(0, envs, episodes[envs])
        et = self.simulator.arcs.et.view(self.num_envs, -1)[envs, 0]
        ticks, whole = whole_limit(state.time_limit[envs], et, self.simulator.h_ns)
        state.limit_ticks = state.limit_ticks.index_copy(0, envs, ticks)
        state.time_limit = state.time_limit.index_copy(0, envs, whole)
        self.scenario.begin_episodes(envs)
        for begin in self.fleet.beginnings:
            begin(envs)
        for group in self.fleet.groups:
            rows = group.task.rows_of(envs)
            group.task.dead = group.task.dead.index_copy(0, rows, ~group.satellite.is_alive()[rows])
        if self.log is not None and self.log.shows():
            self.log.began(envs, state.seed, state.episode)
        self._have_begun(envs, begun)

    def _have_begun(self, envs: Tensor, others: Tensor) -> None:
        """Note that the episodes ``envs`` [n] can be stepped, beside those that could before, ``others`` [N]."""
        self.state.begun = others.index_fill(0, envs, True)
        self._all_begun = bool(self.state.begun.all())
        self._broke_off = self._broke_off and not self._all_begun

    def check_begun(self, call: str, envs: Tensor | None = None) -> None:
        """Check that episodes have begun; ``call`` is what the user called, for the message.

        Args:
            call: Name of the method.
            envs: Mask [N] of the episodes that it is about; all unless given.

        Raises:
            ResetNeededError: For episodes that have not begun, or whose last step was interrupted.
        """
        if self._all_begun:
            return
        missing = ~self.state.begun if envs is None else envs & ~self.state.begun
        rows = torch.nonzero(missing).squeeze(-1).tolist()
        if rows:
            which = "" if len(rows) == self.num_envs else f" of environments {rows[:SHOWN]} ({len(rows)} in all)"
            why = "a step was broken off, which leaves its episodes half done" if self._broke_off else "these have not begun"
            raise ResetNeededError(f"{call} needs running episodes{which}, and {why}; call reset() first")

    # -- step ---------------------------------------------------------------------------------------------------------

    @torch.no_grad()
    def _advance(self, actions: Sequence[Tensor], acts: Sequence[Tensor], moves: Tensor, all_act: bool = False) -> StepResult:
        """One decision of every episode: command, fly, score, communicate, judge.

        Args:
            actions: Actions of each type, [N * count].
            acts: Where they count, [N * count]; other satellites continue their tasks.
            moves: Episodes that take part, [N].
            all_act: Whether all actions count.
        """
        fleet, removed = self.fleet, self.state.removed
        start = fleet.since = fleet.ticks
        before = checked.log(self.rewarder)
        decisions = [group.decide(action, mine) for group, action, mine in zip(fleet.groups, actions, acts, strict=True)]
        self._changing = moves
        for group, action, mine, decision in zip(fleet.groups, actions, acts, decisions, strict=True):
            group.command(action, mine, decision, all_act)
        log = self.log if self.log is not None and self.log.shows(logging.WARNING) else None
        if log is not None:
            log.decided(acts)
            known = log.before()
        fleet.run(moves, self.state.limit_ticks, self.longest_ticks)
        reward = checked.reward(self.rewarder, before, checked.log(self.rewarder)) * moves.unsqueeze(-1)
        totals.add(self.rewarder, reward, moves)
        self.scenario.finish_step(fleet.sim_time)
        if not self.communicator.is_silent:
            self.links = self.communicator.exchange(moves)
            checked.share(self.rewarder, self.links)
        for group in fleet.groups:
            group.simulator.state.memory.touch()
            group.task.dead = group.task.dead | ~group.satellite.is_alive()
        result = self._judge((fleet.ticks - start) * fleet.h, reward, moves, removed)
        if log is not None:
            log.after(known, result, moves)
        return result

    def _proven(self, outputs: TensorDict) -> TensorDict:
        """Return the outputs of a step; FloatingPointError if it is the first of a restored state, and numbers are not finite.

        Each number of a state can be right by itself, and no satellite fly with all of them.
        """
        if self._unproven:
            self.check_finite()
            for key, leaf in outputs.items(True, True):
                rows = torch.nonzero(torch.isnan(leaf).reshape(self.num_envs, -1).any(1)).squeeze(-1).tolist()
                if rows:
                    raise FloatingPointError(
                        f"{key!r} of environments {rows[:SHOWN]} is NaN after the step from a restored state"
                    )
            self._unproven = False
        return outputs

    def _leave(self, error: BaseException | None) -> None:
        """End a call; episodes that an ``error`` has left half changed must begin anew."""
        changing, self._changing = self._changing, None
        if error is None or changing is None:
            return
        # an error concerns the episodes of the call; Ctrl-C may come while tables of all episodes are rearranged
        half = changing if isinstance(error, Exception) else torch.ones_like(changing)
        self.state.begun = self.state.begun & ~half
        self._all_begun, self._broke_off = False, self._broke_off or bool(half.any())
        if isinstance(error, IndexError) and self._restored:
            raise FloatingPointError(f"no satellite can fly with the numbers of a state that was restored: {error}") from error

    def _judge(self, duration: Tensor, reward: Tensor, moves: Tensor, removed: Tensor) -> StepResult:
        """Return the outcome of a step: adds failure penalties [N, S], and says which episodes have ended."""
        dead = self.fleet.joined([group.task.dead for group in self.fleet.groups])
        reward = reward + self.failure_penalty * (dead & moves.unsqueeze(-1))
        if self.fleet.size > 1:
            reward = torch.where(removed, 0.0, reward)
        terminated, truncated = self._over(dead)
        self.state.returns = self.state.returns + reward.sum(1)
        return StepResult(duration, reward, terminated, truncated, removed)

    def _over(self, dead: Tensor) -> tuple[Tensor, Tensor]:
        """Return which episodes have ended, and which were cut, [N] each, by who has died, [N, S]."""
        ended = dead if self.agents_stay else dead | checked.terminated(self.rewarder)
        terminated = self._all_agents_ended(ended)
        truncated = self.truncated_by_time | checked.truncated(self.rewarder).any(1)
        return terminated | truncated if self.terminate_on_time_limit else terminated, truncated

    @property
    def agents_stay(self) -> bool:
        """Whether agents that the rewarder terminates stay in the episode, which goes on."""
        return False

    def _all_agents_ended(self, ended: Tensor) -> Tensor:
        """Return the episodes that end when the satellites ``ended`` [N, S] have, [N]; where any has, unless overridden."""
        return ended.any(1)

    def _outputs(self, result: StepResult | None, **parts: Tensor) -> TensorDict:
        raise NotImplementedError(f"{type(self).__name__} must implement _outputs(result, **parts)")

    @staticmethod
    def _ends(result: StepResult) -> dict[str, Tensor]:
        """Return ``done``, ``terminated`` and ``truncated``, [N, 1] each."""
        terminated, truncated = result.terminated.unsqueeze(-1), result.truncated.unsqueeze(-1)
        return {"terminated": terminated, "truncated": truncated, "done": terminated | truncated}

    def _cast(self, values: Values, shape: Sequence[int]) -> TensorDict:
        """Named observations of rows, [*shape, ...] each."""
        parts = {
            name: self._cast(v, shape) if isinstance(v, dict) else v.to(self.dtype).view(*shape, *v.shape[1:])
            for name, v in values.items()
        }
        return TensorDict(parts, shape, device=self.device)

    # -- state --------------------------------------------------------------------------------------------------------

    def get_state(self) -> TensorDict:
        """Return a copy of everything that the future depends on, [N, ...]; see :meth:`restore`.

        Raises:
            ResetNeededError: For an episode that has not begun.
        """
        with self._exclusive:
            self.check_begun("get_state()")
            return self._saved()

    def _saved(self) -> TensorDict:
        state = self.state.to_tensordict()
        state[MADE_BY] = self.fingerprint.to(self.device).expand(self.num_envs, -1).clone()
        return state

    @torch.no_grad()
    def restore(
        self,
        state: TensorDictBase | Mapping[str, Any] | Tasking,
        envs: Tensor | Sequence[int] | None = None,
        source: Tensor | Sequence[int] | None = None,
    ) -> None:
        """Put the episodes ``source`` of a state into the episodes ``envs``; nothing changes if the state does not fit.

        Args:
            state: A state of :meth:`get_state`, also as nested dictionaries (``state.to_dict()``), or an environment of the same
                make, whose present episodes are copied directly. Batch sizes may differ. Of a state, which may come from a file
                that somebody else has written, every number that is used is checked.
            envs: Episodes of this environment to be replaced, [n] indices; all unless given.
            source: Episodes of the state, [n] indices, which may repeat; the same as ``envs`` unless given.

        Raises:
            KeyError, TypeError, ValueError: For something that is no state, that another make of environment has saved, or with
                values that no environment has.
            IndexError: For indices out of range, or of different numbers.
            ResetNeededError: For episodes of another environment that have not begun.
        """
        with self._exclusive, state._exclusive if isinstance(state, Tasking) else contextlib.nullcontext():
            other, envs, source = self._fitting(state, envs, source)
            begun = self.state.begun
            self._changing, self._all_begun = torch.zeros_like(begun), False
            for k, simulator in enumerate(self.fleet.simulators):
                mine, theirs = simulator.lookahead, lookahead_of(other, k)
                mine.grow_to(theirs.arcs.length)
                try:
                    theirs.grow_to(mine.arcs.length)
                except (FloatingPointError, IndexError) as error:
                    raise ValueError(
                        f"'satellites_{k}.lookahead.arcs' of the saved state cannot be continued: {error}"
                    ) from error
            self.state.begun = begun.index_fill(0, envs, False)
            self.state.copy_rows(envs, other, source)
            self.scenario.begin_episodes(envs)
            self._have_begun(envs, begun)
            if not isinstance(state, Tasking):
                self._unproven = self._restored = True

    def _fitting(self, state: Any, envs: Any, source: Any) -> tuple[FleetState, Tensor, Tensor]:
        """Return the checked tables of a state, and the indices [n] of episodes to be replaced and of those that replace them."""
        other: Any
        if isinstance(state, Tasking):
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
        if isinstance(state, Tasking):
            state.check_begun("restore(state)", torch.zeros_like(state.state.begun).index_fill(0, source, True))
            return other, envs, source
        rows = torch.arange(len(source), device=self.device)
        used = other if torch.equal(source, other.all_rows) and not self._longer_than(other) else other.taken(source)
        check_values(self.fleet, used)
        return used, envs, rows

    def _longer_than(self, other: StateTable) -> bool:
        """Whether arcs of a saved state must grow, which writes into its tensors."""
        lengths = ((s.lookahead.arcs.length, lookahead_of(other, k).arcs.length) for k, s in enumerate(self.fleet.simulators))
        return any(mine > theirs for mine, theirs in lengths)

    def like(self, num_envs: int, env_ids: Sequence[int] | Tensor | None = None) -> Tasking:
        """Return another environment of the same make, with other episodes, under seed 0 and without logs.

        Episodes can be copied from one to the other by :meth:`restore`. Nothing is compiled anew.

        Args:
            num_envs: Number of its episodes.
            env_ids: Their indices in draws; 0 to ``num_envs`` - 1 unless given.

        Raises:
            ValueError: For a wrong argument, and where arguments of :func:`bsk_torch.rand.per_env` have too few rows.
            MemoryError: If so many do not fit into memory.
        """
        kept = {name: value for name, value in self._arguments.items() if name not in ("log_level", "log_dir", "log_envs")}
        other = type(self)(**{**kept, "num_envs": num_envs, "env_ids": env_ids, "seed": 0})
        if self._changes:
            other._change(self._changes)
        return other

    def observe(self) -> TensorDict:
        """Return what the present episodes show, as ``reset`` does; rewards and durations of a step are not repeated.

        Raises:
            ResetNeededError: For an episode that has not begun.
        """
        with self._exclusive:
            self.check_begun("observe()")
            dead = self.fleet.joined([group.task.dead for group in self.fleet.groups])
            terminated, truncated = (ended.unsqueeze(-1) for ended in self._over(dead))
            return self._outputs(None, done=terminated | truncated, terminated=terminated, truncated=truncated)

    def get_extra_state(self) -> TensorDict | None:
        """Part of ``state_dict``: see :meth:`get_state`; None before the first reset."""
        return self._saved() if bool(self.state.begun.any()) else None

    def set_extra_state(self, state: TensorDict | None) -> None:
        """Part of ``load_state_dict``: restores the episodes that had begun."""
        if state is not None:
            begun = state.get("begun", None)
            self.restore(state, None if begun is None else torch.nonzero(begun.reshape(-1)).squeeze(-1))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments and the state, not the compiled tick."""
        state = self.state.seed, self.episode, self.get_extra_state()
        return _rebuild, (type(self), self._arguments, *state, self._changes)

    # -- pictures -----------------------------------------------------------------------------------------------------

    def render(self, rows: int | Sequence[int] | None = None, height: int = 480) -> Tensor:
        """Draw the present: the Earth, the satellites and their tasks; the future of the episodes is not changed.

        TorchRL's ``PixelRenderTransform`` calls it, with ``rows=0`` for a video of one environment of many. It resets the
        environment to learn the shape of pictures: read ``env.observation_spec`` before a rollout.

        Args:
            rows: Environment to draw, or several; None for all, if they are 16 at most.
            height: Pixels from top to bottom, an even number from 120 on; there are 4/3 as many from left to right.

        Returns:
            Pixels [len(rows), height, width, 3], or [height, width, 3] of a single environment; uint8.

        Raises:
            ModuleNotFoundError: Without the extra ``viz``.
            ResetNeededError: For episodes that have not begun.
            ValueError: For a wrong argument.
        """
        with self._exclusive:
            return pictures().frames(self, rows, height)

    # -- help ---------------------------------------------------------------------------------------------------------

    def default_sat_args(self) -> ArgumentTable:
        """Return every argument that ``sat_args`` accepts, with default, unit and meaning; print it to read it."""
        return self.builder.satellites[0].default_sat_args()

    def default_world_args(self) -> ArgumentTable:
        """Return every argument that ``world_args`` accepts, with default, unit and meaning; print it to read it."""
        return self.builder.default_world_args()

    @property
    def bytes_per_env(self) -> int:
        """Bytes of one environment's state, its prepared next episode included; the windows found add a little."""
        return (self.state.nbytes + (self.pool.fleet.state.nbytes if self.pool else 0)) // self.num_envs

    def check_finite(self) -> None:
        """Check the fields of all satellites; FloatingPointError that names environment, field and tick."""
        for group in self.fleet.groups:
            state = group.simulator.state
            for name in state.layout.fields:
                value = state.read(name).reshape(state.rows, -1)
                bad = torch.nonzero(~torch.isfinite(value).all(-1)).squeeze(-1).tolist()
                if bad:
                    row = bad[0]
                    raise FloatingPointError(
                        f"{name!r} of {group.satellite.title(row)} is {value[row].tolist()} at tick {int(state.ticks[row])} "
                        f"({len(bad)} of them in all)"
                    )


def _rebuild(
    kind: type[Tasking],
    arguments: dict[str, Any],
    seeds: Tensor,
    episode: Tensor,
    state: TensorDict | None,
    changes: Sequence[Change] = (),
) -> Tasking:
    env = kind(**arguments)
    if changes:
        env._change(changes)
    env.state.seed, env.state.episode = seeds, episode
    env.set_extra_state(state)
    return env


def pictures() -> Any:
    """Return the module that draws; ModuleNotFoundError without the extra ``viz``."""
    try:
        return import_module("bsk_torch.viz.render.frames")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"render() needs {error.name}: pip install 'bsk_torch[viz]'", name=error.name) from error


def read_env_ids(given: Any, n: int) -> Tensor:
    """Return the index of each episode in draws, [n] int64, 0 to n - 1 unless given; ValueError for what are no such indices."""
    if given is None:
        return torch.arange(n)
    table = given if isinstance(given, Tensor) else np.asarray(given) if isinstance(given, np.ndarray | Sequence) else None
    if table is None or isinstance(given, str) or tuple(table.shape) != (n,):
        shape = "" if table is None else f" has shape {list(table.shape)};"
        raise ValueError(f"env_ids={given!r}:{shape} it needs {n} whole numbers, one for each environment")
    return torch.tensor([whole("env_ids", number, 0, SEED_LIMIT - 1) for number in table.tolist()])


def composed(rewarder: GlobalReward | Iterable[GlobalReward] | None) -> GlobalReward:
    """Return a copy of the rewarder, or of the sum of several; TypeError for anything else."""
    if rewarder is None:
        return NoReward()
    several = isinstance(rewarder, Iterable) and not isinstance(rewarder, type | str)
    listed: list[Any] = list(rewarder) if several else [rewarder]  # type: ignore[arg-type]
    for part in listed:
        if not isinstance(part, GlobalReward):
            raise TypeError(f"rewarder={part!r} must be a rewarder, made with parentheses, such as data.UniqueImageReward()")
    return ComposedReward(*map(copy.copy, listed)) if several else for_batch(listed[0])


def _counted(name: str, satellite: Satellite) -> Tensor:
    counts = satellite.counts()
    if name not in counts:
        raise AttributeError(f"{satellite.name} does not count {name!r}")
    return counts[name]
