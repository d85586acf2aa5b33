"""Base of all environments: construction, specs, reset and step."""

from __future__ import annotations

import copy
import functools
import logging
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from bsk_torch.act.base import Decision
from bsk_torch.comm import CommunicationMethod, NoCommunication
from bsk_torch.data.base import GlobalReward, NoReward
from bsk_torch.data.composed import ComposedReward, add_totals, declare_totals
from bsk_torch.env import messages
from bsk_torch.env.arguments import MadeOfArguments
from bsk_torch.env.assembly.devices import existing_device
from bsk_torch.env.assembly.fleets import FleetBuilder, link
from bsk_torch.env.assembly.randomizer import make_randomizer
from bsk_torch.env.assembly.trial import check_room, taken_over, try_out
from bsk_torch.env.episodes import EpisodePool
from bsk_torch.env.guard import Origin, ResetNeededError, check_numbers
from bsk_torch.env.limits import ENDLESS
from bsk_torch.env.log import StepLog, configure
from bsk_torch.env.native import NativeImages
from bsk_torch.env.options import TaskingOptions, TimeLimit
from bsk_torch.env.present import Present
from bsk_torch.env.satellite_group import SatelliteGroup, command, died, first_task_end, groups_of, settle, soonest
from bsk_torch.env.snapshots import fingerprint
from bsk_torch.obs.base import Values
from bsk_torch.sats.satellite import Satellite, common_dtype
from bsk_torch.scene.base import Scenario
from bsk_torch.sim.assembly.satellite_type import whole_nanoseconds
from bsk_torch.sim.fleet import Fleet
from bsk_torch.sim.state import outside_inference

__all__ = ["ResetNeededError", "StepResult", "Tasking", "TimeLimit"]

logger = logging.getLogger(__name__)


class StepResult(NamedTuple):
    """Outcome of a step of N episodes with S satellites each."""

    duration: Tensor  # length of the step, [N] s
    reward: Tensor  # rewards of the satellites, including failure penalties, [N, S]; zero for episodes without a step
    terminated: Tensor  # episodes that have ended, [N]
    truncated: Tensor  # truncated episodes, [N]
    removed: Tensor  # satellites absent or removed before the step, [N, S]


class Tasking(Present, MadeOfArguments):
    """N independent episodes with S satellites each. Subclasses define the agents and their actions, observations and rewards."""

    _supports_set_state = True
    _has_frame_skip = True

    links: Tensor | None = None
    """Communication after the last step by sender and receiver, [N, S, S]; None if satellites never communicate."""

    @outside_inference
    def _build(
        self,
        satellites: Sequence[Satellite],
        scenario: Scenario | None,
        rewarder: GlobalReward | Iterable[GlobalReward] | None,
        communicator: CommunicationMethod | None,
        sat_arg_randomizer: object,
        options: TaskingOptions,
    ) -> None:
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
        made, device = taken_over(), torch.device(self.device)
        self.builder = FleetBuilder(satellites, self.scenario, self.rewarder, options, randomizer, device, made and made.types)
        self.names, self.dtype = self.builder.names, common_dtype(options.dtype, self.builder.satellites)
        if made is None or made.trial is None:
            trial = try_out(self.builder, self.rewarder, self.communicator)
        else:
            trial = made.trial
            check_room(self.builder, trial.nbytes)
        n = options.num_envs
        self.fleet = self.builder.make_fleet(n)
        unset, start = self.fleet.all_envs.new_full((self.builder.prepared, n), -1), self.builder.draw_and_start
        self.pool = EpisodePool(unset, self._next_fleet, start) if self.builder.prepared else None
        self._declare_state(options.env_ids)
        for simulator in self.fleet.simulators:
            simulator.type.arguments.check_per_env(self.env_ids)
        self.satellites = groups_of(self.builder.satellites, self.fleet)
        self.checked = link(self.fleet, self.scenario, self.rewarder)
        declare_totals(self.rewarder, self.fleet)
        self.communicator.attach(self.fleet)
        recorded = options.log_level is not None or options.log_dir is not None
        self.log = StepLog(self.fleet, self.satellites, self.scenario, options.log_envs) if recorded else None
        for satellite, read in zip(self.satellites, trial.read, strict=True):
            satellite.simulator.observer.want(read)
            satellite.observations.trace()
        self._make_specs(trial.values)
        self._trial = None if trial.calls_user else trial
        self.longest_ticks = math.ceil(whole_nanoseconds(min(self.max_step_duration, ENDLESS)) / self.simulator.h_ns)
        self.fingerprint = fingerprint(self.fleet)
        self._changes = []
        self._show_arguments()
        self.set_seed(options.seed)

    def __repr__(self) -> str:
        if "satellites" not in self.__dict__:  # in an error while it is built
            return f"{type(self).__name__}()"
        lines = [f"{type(self).__name__}: {self.num_envs} environments on {self.device}, scenario {type(self.scenario).__name__}"]
        for satellite in self.satellites:
            names = ", ".join(satellite.names[:3]) + (f" and {len(satellite.names) - 3} more" if len(satellite.names) > 3 else "")
            observed, actions = satellite.observation_description, satellite.action_description
            shown = ", ".join(actions[:6]) + (", ..." if len(actions) > 6 else "")
            lines.append(f"  {names} ({type(satellite).__name__}): {len(observed)} observed, {len(actions)} actions ({shown})")
        return "\n".join(lines)

    def to(self, device: torch.device | str) -> Tasking:  # type: ignore[override]
        """Return the environment, which stays on the device that its kernels and tables are made for; ValueError for others."""
        other, present = existing_device(device), torch.device(self.device)
        if other.type != present.type or (other.index or 0) != (present.index or 0):
            raise ValueError(
                f"device={str(device)!r}: an environment stays on {str(present)!r}; make one with device={str(other)!r}"
            )
        return self

    def _next_fleet(self) -> Fleet:
        """Return a fleet for the next episodes, with windows as far ahead as actions and observations need."""
        n = self.num_envs * self.builder.prepared
        fleet = self.builder.make_fleet(n, [simulator.type for simulator in self.fleet.simulators])
        for simulator, present in zip(fleet.simulators, self.fleet.simulators, strict=True):
            if simulator.lookahead.access is not None and present.lookahead.access is not None:
                simulator.lookahead.access.ahead = present.lookahead.access.ahead
        return fleet

    def _make_specs(self, trial: list[Values]) -> None:
        raise NotImplementedError(f"{type(self).__name__} must implement _make_specs(trial)")

    def _tree(self, values: Values, shape: Sequence[int]) -> Composite:
        parts = {n: self._tree(v, shape) if isinstance(v, dict) else self._leaf(v, shape) for n, v in values.items()}
        return Composite(parts, shape=shape, device=self.device)

    def _leaf(self, value: Tensor, shape: Sequence[int]) -> Unbounded:
        return Unbounded((*shape, *value.shape[1:]), dtype=self.dtype, device=self.device)

    def _ends_spec(self) -> Composite:
        b, on = self.batch_size, {"device": self.device}
        flags = {name: Categorical(2, shape=(*b, 1), dtype=torch.bool, **on) for name in ("done", "terminated", "truncated")}
        return Composite(flags, shape=b, **on)

    def _assert_tensordict_shape(self, tensordict: TensorDictBase) -> None:
        if not isinstance(tensordict, TensorDictBase) or tensordict.batch_size != self.batch_size:
            name = "'action'" if isinstance(self.action_keys[0], str) else f"{self.action_keys[0][0]!r}, 'action'"
            shape = list(self.full_action_spec[self.action_keys[0]].shape)
            messages.reject_call(type(self).__name__, name, tensordict, list(self.batch_size), shape)

    def _step_proc_data(self, next_tensordict_out: TensorDictBase) -> TensorDictBase:
        """Return the entries of a step, which are complete: TorchRL looks for missing ends and for rewards of other shapes."""
        return super()._step_proc_data(next_tensordict_out) if self.run_type_checks else next_tensordict_out

    def _reset(self, tensordict: TensorDictBase | None = None, *, set_state: bool = False, **unknown: object) -> TensorDict:
        if unknown:
            messages.check_reset(type(self).__name__, unknown)
        mask = None if tensordict is None else tensordict.get("_reset", None)
        envs = self.fleet.all_envs if mask is None else torch.nonzero(mask.reshape(-1)).squeeze(-1)
        with self.guard:
            others = torch.ones_like(self.state.begun).index_fill(0, envs, False)
            self.guard.check_begun("reset() of some environments", others)
            if set_state and tensordict is not None and "state" in tensordict:
                self.restore(tensordict["state"], envs)
                # TorchRL keeps the entry and writes into it at partial resets, which must not change the caller's saved state
                tensordict["state"] = tensordict["state"].clone()
            elif len(envs):
                self._begin(envs)
            false = torch.zeros(*self.batch_size, 1, dtype=torch.bool, device=self.device)
            return self._outputs(None, done=false, terminated=false.clone(), truncated=false.clone())

    def _advance(self, actions: Sequence[Tensor], acts: Sequence[Tensor], moves: Tensor, all_act: bool = False) -> StepResult:
        """Execute one decision in every episode: command, run, reward, communicate, determine the outcome.

        Args:
            actions: Actions of each type, [N * count].
            acts: Satellites that execute them, [N * count]; others continue their tasks.
            moves: Episodes that take part, [N].
            all_act: Whether all satellites of all episodes execute their actions.
        """
        fleet, state, removed = self.fleet, self.state, self.state.removed
        start = fleet.since = fleet.ticks
        before = self.checked.log()
        begins = [self._decided(*each) for each in zip(self.satellites, self.images, actions, acts, strict=True)]
        self.guard.change(moves)
        for satellite, begin in zip(self.satellites, begins, strict=True):
            begin(satellite.simulator.state.of_env(moves), all_act)
        log = self.log if self.log is not None and self.log.shows(logging.WARNING) else None
        if log is not None:
            log.decided(acts)
            counters = log.before()
        until = first_task_end(self.satellites, start + self.longest_ticks)
        expected = [soonest(satellite.task.expected, satellite.simulator.count) for satellite in self.satellites]
        result = fleet.run(moves, state.limit_ticks, until, expected)
        last = fleet.ticks >= state.limit_ticks
        for satellite, images, event in zip(self.satellites, self.images, result.events, strict=True):
            of_env = satellite.simulator.state.of_env
            if images is None or event is None:
                settle(satellite, event, of_env(moves), of_env(moves & last))
            else:
                images.settle(event, of_env(moves), of_env(moves & last))
        reward = self.checked.reward(before, self.checked.log())
        if not all_act:
            reward = reward * moves.unsqueeze(-1)
        add_totals(self.rewarder, reward, moves)
        self.scenario.finish_step(fleet.sim_time)
        if not self.communicator.is_silent:
            self.links = self.communicator.exchange(moves)
            self.checked.share(self.links)
        for satellite in self.satellites:
            satellite.memory.touch()
            satellite.task.dead = satellite.task.dead | died(satellite)
        outcome = self._judge(result.ticks.double() * fleet.h, reward, moves, removed, last)
        if log is not None:
            log.after(counters, outcome, moves)
        return outcome

    @functools.cached_property
    def images(self) -> list[NativeImages | None]:
        """Kernels that decide and command the satellites of each type; None where that is done on tensors."""
        return [NativeImages.of(satellite) for satellite in self.satellites]

    def _begin(self, envs: Tensor) -> None:
        _ = self.images  # before the first step, so that no step waits for the compiler
        super()._begin(envs)

    def _decided(
        self, satellites: SatelliteGroup, images: NativeImages | None, action: Tensor, acts: Tensor
    ) -> Callable[[Tensor, bool], None]:
        """Return the function that begins the ``action`` [N] of a type where ``acts`` [N] holds; it takes the rows that move."""
        begin = None if images is None else images.prepared(action, acts)
        if begin is not None:
            return begin
        decision = satellites.actions.decide(action, satellites.task.previous_action, acts)
        return functools.partial(command, satellites, action, self._begins(satellites, acts, decision), decision)

    def _begins(self, satellites: SatelliteGroup, acts: Tensor, decision: Decision) -> Tensor:
        """Return which satellites of a type begin a task, [N * count], of those that execute an action (default: all of them)."""
        return acts

    def _proven(self, outputs: TensorDict) -> TensorDict:
        """Return the outputs of a step; FloatingPointError for NaN or infinity in the first step of a restored state."""
        if self.guard.origin is Origin.RESTORED:
            self.check_finite()
            check_numbers(outputs)
            self.guard.origin = Origin.RESTORED_AND_STEPPED
        return outputs

    def _judge(self, duration: Tensor, reward: Tensor, moves: Tensor, removed: Tensor, last: Tensor) -> StepResult:
        """Return the outcome of a step with failure penalties, in which the episodes ``last`` [N] reached their time limit."""
        state = self.state
        dead = self.fleet.joined([satellite.task.dead for satellite in self.satellites])
        reward = reward + self.failure_penalty * (dead & moves.unsqueeze(-1)).to(reward.dtype)
        if self.fleet.size > 1:
            reward = torch.where(removed, 0.0, reward)
        terminated, truncated = self._over(dead, last)
        state.returns = state.returns + reward.sum(1)
        return StepResult(duration, reward, terminated, truncated, removed)

    def _over(self, dead: Tensor, last: Tensor) -> tuple[Tensor, Tensor]:
        """Return which episodes ended, given ``dead`` satellites [N, S], and which were truncated, ``last`` by time, [N] each."""
        ended, truncated, present = dead, last, self.fleet.present
        if self.checked.terminates and not self.agents_stay:
            ended = dead | self.checked.terminated()
        if self.checked.truncates:
            cut = self.checked.truncated()
            truncated = truncated | (cut if present is None else cut & present).any(1)
        terminated = self._all_agents_ended(ended if present is None else ended & present)
        return terminated | truncated if self.terminate_on_time_limit else terminated, truncated

    @property
    def agents_stay(self) -> bool:
        """Whether agents terminated by the rewarder stay in the continuing episode."""
        return False

    def _all_agents_ended(self, ended: Tensor) -> Tensor:
        """Return the episodes that end with the satellites ``ended`` [N, S], [N] (default: if any has ended)."""
        return ended.any(1)

    def _outputs(self, result: StepResult | None, **parts: Tensor) -> TensorDict:
        raise NotImplementedError(f"{type(self).__name__} must implement _outputs(result, **parts)")

    @staticmethod
    def _ends(result: StepResult) -> dict[str, Tensor]:
        terminated, truncated = result.terminated.unsqueeze(-1), result.truncated.unsqueeze(-1)
        return {"terminated": terminated, "truncated": truncated, "done": terminated | truncated}

    def _cast(self, values: Values, shape: Sequence[int]) -> TensorDict:
        parts = {
            name: self._cast(v, shape) if isinstance(v, dict) else v.to(self.dtype, copy=True).view(*shape, *v.shape[1:])
            for name, v in values.items()
        }
        return TensorDict(parts, shape, device=self.device)

    def observe(self) -> TensorDict:
        """Return the observations of the current episodes, as ``reset`` does; ResetNeededError if one has not begun."""
        with self.guard:
            self.guard.check_begun("observe()")
            dead = self.fleet.joined([satellite.task.dead for satellite in self.satellites])
            terminated, truncated = (ended.unsqueeze(-1) for ended in self._over(dead, self.truncated_by_time))
            return self._outputs(None, done=terminated | truncated, terminated=terminated, truncated=truncated)


def composed(rewarder: GlobalReward | Iterable[GlobalReward] | None) -> GlobalReward:
    """Return a copy of the rewarder, or of a sum of several; TypeError for anything else."""
    if rewarder is None:
        return NoReward()
    several = isinstance(rewarder, Iterable) and not isinstance(rewarder, type | str)
    listed: list[Any] = list(rewarder) if several else [rewarder]  # type: ignore[arg-type]
    for part in listed:
        if not isinstance(part, GlobalReward):
            raise TypeError(f"rewarder={part!r} must be a rewarder, made with parentheses, such as data.UniqueImageReward()")
    return ComposedReward(*map(copy.copy, listed)) if several else copy.copy(listed[0])
