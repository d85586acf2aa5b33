"""Many satellites per episode, N episodes at once."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Categorical, Composite, MultiCategorical, Unbounded

from bsk_torch.act.base import ActionBuilder, Decision
from bsk_torch.comm import CommunicationMethod
from bsk_torch.data.base import GlobalReward
from bsk_torch.env import messages
from bsk_torch.env.action_forms import action_spec, acts, form, mask_size, mask_spec, read
from bsk_torch.env.agents import AGENTS, Group, agents_of, make_groups
from bsk_torch.env.base import StepResult, Tasking
from bsk_torch.env.native import NativeImages
from bsk_torch.env.options import ConstellationOptions, parse, takes
from bsk_torch.env.satellite_group import SatelliteGroup, cancel
from bsk_torch.formations import Formation
from bsk_torch.obs.base import ObservationBuilder, Values
from bsk_torch.sats.satellite import Satellite
from bsk_torch.scene.base import Scenario

logger = logging.getLogger(__name__)


class Command(NamedTuple):
    """Actions of one member of each agent of a group."""

    within: Tensor  # indices of the members within their type, [A]
    whole: bool  # whether they are all satellites of their type, in order
    chosen: Tensor  # their actions, [N, A, ...]
    new: Tensor  # whether these are new tasks, [N, A]


@takes(ConstellationOptions)
class ConstellationTasking(Tasking):
    """N independent episodes with S satellites each.

    A step lasts until the first satellite finishes its task; the others continue theirs. Agents with the same spaces form a
    group, called ``"agents"`` if there is only one; ``group_map`` names them. Each group holds ``observation``, ``action``,
    ``action_mask``, ``reward`` [N, A, 1], ``mask`` [N, A] (False for agents that are not present or have left),
    ``requires_retasking`` and ``duration`` [N, A, 1]; ``done``, ``terminated``, ``truncated`` and ``duration`` are at the root.

    The last action of a discrete space continues the task, as does a continuous action filled with ``NO_ACTION``. Continuous
    actions have no ``action_mask``. With ``joint=True`` and continuous actions, ``action`` has an entry for each satellite by
    name. By ``action_mask``, busy and dead satellites may only continue. Another action for a busy satellite nevertheless
    replaces its task at once, and one for a dead satellite is ignored.

    A dead satellite receives the penalty and a last observation, and leaves: its tasks no longer end steps, ``mask`` is False,
    and its observations and rewards are zero. The episode ends when all agents are dead, or at the time limit.

    With ``population=(low, high)``, or a scenario that draws the present satellites, some satellites are absent from some
    episodes; see :attr:`present` [N, S]. Absent satellites look like removed ones, but are not dead, and run no ticks.
    """

    options: ConstellationOptions
    _warned = False

    def __init__(
        self,
        satellites: Sequence[Satellite] | Satellite,
        scenario: Scenario | None = None,
        rewarder: GlobalReward | Iterable[GlobalReward] | None = None,
        communicator: CommunicationMethod | None = None,
        sat_arg_randomizer: Formation | Callable[[list[Satellite]], Mapping[Any, Any]] | None = None,
        **options: Any,
    ) -> None:
        """Build the environment and check its arguments; nothing is simulated before the first reset.

        Args:
            satellites: The satellites, each with a unique name. Satellites that differ only in their names and arguments form one
                type and are simulated together.
            scenario: Task of the satellites, or None.
            rewarder: Value of their data, or several rewarders to sum; None for zero.
            communicator: Exchange of data between satellites (default: none).
            sat_arg_randomizer: Draws arguments of all satellites together: a formation of :mod:`bsk_torch.formations`, or a
                function of the list of satellites, called for each episode, that returns ``{satellite: {argument: value}}``.
            **options: See :class:`bsk_torch.env.options.ConstellationOptions`.
        """
        parsed = parse(ConstellationOptions, options)
        listed = [satellites] if isinstance(satellites, Satellite) else list(satellites)
        self._build(listed, scenario, rewarder, communicator, sat_arg_randomizer, parsed)
        parts = {"satellites": satellites, "scenario": scenario, "rewarder": rewarder, "communicator": communicator}
        self._arguments = {**parts, "sat_arg_randomizer": sat_arg_randomizer, **options}

    @functools.cached_property
    def joint(self) -> bool:
        """Whether one agent commands all satellites."""
        return self.options.joint

    # -- agents -------------------------------------------------------------------------------------------------------

    def _make_agents(self) -> None:
        if self.joint:
            self.agents = {AGENTS: list(self.names)}
        else:
            self.agents = agents_of(self.names, self.options.meta_agent_groupings)
        titles = [type(satellite).__name__ for satellite in self.satellites]
        groups = make_groups(self.agents, self.names, self.builder.types, titles, self.options.group_map)
        self.groups = [group.to(self.device) for group in groups]
        self.group_map = {group.name: list(group.agents) for group in self.groups}
        for group in self.groups:
            unfit = [sat.name for sat in (self.satellites[t] for t in group.types) if sat.obs_type is dict]
            real = [sat.name for sat in (self.satellites[t] for t in group.types) if form(sat) is not None]
            if group.is_meta and real and not self.joint:
                raise ValueError(
                    f"agent {group.agents[0]!r} commands several satellites, and the actions of {real[0]} are real numbers; "
                    "such a satellite must be a separate agent, or one of all satellites under joint=True"
                )
            if group.is_meta and unfit:
                raise ValueError(
                    f"agent {group.agents[0]!r} commands several satellites, so {unfit[0]} needs obs_type=torch.Tensor"
                )

    # -- specs --------------------------------------------------------------------------------------------------------

    def _make_specs(self, trial: list[Values]) -> None:
        self._make_agents()
        for satellites, values in zip(self.satellites, trial, strict=True):
            satellites.observation_description = ObservationBuilder.describe(values)
        observed, acted, paid = (Composite(shape=self.batch_size) for _ in range(3))
        for group in self.groups:
            shape = (*self.batch_size, *self._agents_shape(group))
            for spec, parts in (
                (observed, self._observed(group, trial, shape)),
                (acted, {"action": self._acted(group, shape)}),
                (paid, {"reward": Unbounded((*shape, 1), dtype=self.dtype)}),
            ):
                target = spec if self.joint else Composite(shape=shape)
                for name, leaf in parts.items():
                    target[name] = leaf
                if not self.joint:
                    spec[group.name] = target
        n = self.fleet.size
        observed["duration"] = Unbounded((*self.batch_size, 1), dtype=self.dtype)
        if counts := self.counts():
            shape = (*self.batch_size, n)
            observed["counts"] = Composite({k: Unbounded(shape, dtype=torch.int64) for k in counts}, shape=self.batch_size)
        self.observation_spec, self.full_action_spec = observed.to(self.device), acted.to(self.device)
        self.full_reward_spec, self.full_done_spec = paid.to(self.device), self._ends_spec()

    def _agents_shape(self, group: Group) -> tuple[int, ...]:
        return () if self.joint else (len(group.agents),)

    def _sizes(self, group: Group) -> list[int]:
        """Return the number of actions of each member, including the one that continues the task; 0 for continuous actions."""
        return [mask_size(self.satellites[t], 1) for t in group.types]

    def _observed(self, group: Group, trial: list[Values], shape: tuple[int, ...]) -> dict[str, object]:
        first = group.types[0]
        if self.satellites[first].obs_type is dict and not group.is_meta:
            observation: object = self._tree(trial[first], shape)
        else:
            width = sum(ObservationBuilder.vector(trial[t], self.dtype).shape[-1] for t in group.types)
            observation = Unbounded((*shape, width), dtype=self.dtype)
        sizes = sum(self._sizes(group))
        flag = {"dtype": torch.bool}
        parts: dict[str, object] = {
            "observation": observation,
            **({"action_mask": mask_spec(sizes, shape)} if sizes else {}),
            "requires_retasking": Categorical(2, shape=(*shape, 1), **flag),
        }
        if group.is_meta or self.joint:
            members = (*shape, len(group.types))
            parts["members_require_retasking"] = Binary(members[-1], shape=members, **flag)
        if not self.joint:
            parts["mask"] = Categorical(2, shape=shape, **flag)
            parts["duration"] = Unbounded((*shape, 1), dtype=self.dtype)
        return parts

    def _acted(self, group: Group, shape: tuple[int, ...]) -> object:
        members, sizes = [self.satellites[t] for t in group.types], self._sizes(group)
        if self._by_name(group):
            pairs = zip(self._names_of(group), members, strict=True)
            parts = {name: action_spec(satellite, shape, self.dtype, 1) for name, satellite in pairs}
            return Composite(parts, shape=torch.Size(shape))
        if not (group.is_meta or self.joint):
            return action_spec(members[0], shape, self.dtype, 1)
        return MultiCategorical(sizes, shape=(*shape, len(sizes)), dtype=torch.int64)

    def _by_name(self, group: Group) -> bool:
        """Whether the action of a joint agent has an entry for each satellite by name, because some actions are continuous."""
        return self.joint and any(form(self.satellites[t]) is not None for t in group.types)

    def _names_of(self, group: Group) -> list[str]:
        return [self.names[k] for k in group.members[0].tolist()]

    # -- step ---------------------------------------------------------------------------------------------------------

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        partial = tensordict.get("_step", None)
        moves = torch.ones_like(self.state.removed[:, 0]) if partial is None else partial.reshape(-1)
        keys = [("action",) if self.joint else (group.name, "action") for group in self.groups]
        actions = [messages.given_action(tensordict, *key) for key in keys]
        return self.play(actions, moves)

    def play(self, commands: Sequence[object], moves: Tensor) -> TensorDict:
        """Execute the actions of each group where ``moves`` [N] is true; return the entries of ``next``."""
        with self.guard:
            self.guard.check_begun("step()")
            actions, executed = self._decoded(commands, moves)
            result = self._advance(actions, executed, moves)
            return self._proven(self._outputs(result, **self._ends(result)))

    @property
    def agents_stay(self) -> bool:
        """Whether agents terminated by the rewarder stay in the continuing episode."""
        return self.simulator.type.compat and not self.joint

    def _all_agents_ended(self, ended: Tensor) -> Tensor:
        """Return the episodes whose agents have all lost a satellite of ``ended`` [N, S], or the joint agent any, [N]."""
        if self.joint:
            return ended.any(1)
        present = self.fleet.present
        over = [self._by_agent(group, ended) for group in self.groups]
        if present is not None:
            over = [gone | ~self._by_agent(group, present) for group, gone in zip(self.groups, over, strict=True)]
        return torch.stack([gone.all(1) for gone in over], 1).all(1)

    def _by_agent(self, group: Group, flags: Tensor) -> Tensor:
        """Return the agents [N, A] with at least one member whose flag [N, S] is set."""
        return flags if group.alone else flags[:, group.members].any(-1)

    def _remove(self, duration: Tensor) -> None:
        """Remove the agents that have lost a satellite; their tasks no longer end steps.

        Under ``compat``, agents that die in a step of zero ``duration`` [N] s stay for another step.
        """
        dead, removed = self.dead, self.state.removed
        if self.simulator.type.compat:
            dead = dead & (duration > 0.0).unsqueeze(1)
        for group in self.groups:
            if group.alone:
                removed = removed | dead
                continue
            gone = self._by_agent(group, dead).unsqueeze(-1).expand(-1, *group.members.shape)
            removed = removed.index_copy(1, group.members.flatten(), (group.of_members(removed) | gone).flatten(1))
        leaving = removed & ~self.state.removed
        if not bool(leaving.any()):  # values read from the satellites at this time stay valid
            return
        self.state.removed = removed
        for k, satellite in enumerate(self.satellites):
            cancel(satellite, self.fleet.rows_of(k, leaving))

    def _decoded(self, commands: Sequence[object], moves: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """Return the actions [N * count, ...] of each type, and masks of the actions that take effect."""
        idle = self.requires_retasking
        members: list[list[Command]] = [[] for _ in self.satellites]
        for group, action in zip(self.groups, commands, strict=True):
            for m, (t, within, chosen) in enumerate(zip(group.types, group.within, self._checked(group, action), strict=True)):
                counts = acts(chosen, self.satellites[t], True)
                if self.options.only_retask_idle_meta_agent_members and group.is_meta:
                    counts = counts & idle[:, group.members[:, m]]
                members[t].append(Command(within, group.whole[m], chosen, counts))
        present = moves.unsqueeze(-1) & ~self.state.removed
        checked, rows = [], []
        for k, (satellites, parts) in enumerate(zip(self.satellites, members, strict=True)):
            action, counts = self._of_type(k, parts)
            rows.append(counts.flatten() & self.fleet.rows_of(k, present))
            checked.append(satellites.actions.checked(action.flatten(0, 1), rows[-1]))
        self._warn_of_idle(rows, moves)
        return checked, rows

    @functools.cached_property
    def images(self) -> list[NativeImages | None]:
        """See :attr:`Tasking.images`; None where the action in progress may be chosen again."""
        return [None] * len(self.satellites) if self.options.continue_repeated else super().images

    def _begins(self, satellites: SatelliteGroup, acts: Tensor, decision: Decision) -> Tensor:
        if not self.options.continue_repeated or not isinstance(satellites.actions, ActionBuilder):
            return acts
        task = satellites.task
        return acts & ((decision.key != task.previous_action) | task.requires_retasking)

    def _of_type(self, k: int, parts: Sequence[Command]) -> tuple[Tensor, Tensor]:
        """Return the actions [N, count, ...] of a type, and which of them are new tasks, from the actions of its satellites."""
        if parts[0].whole:
            return parts[0].chosen, parts[0].new
        n, count, first = self.fleet.num_envs, self.fleet.simulators[k].count, parts[0].chosen
        dtype = functools.reduce(torch.promote_types, [part.chosen.dtype for part in parts])
        action = torch.zeros(n, count, *first.shape[2:], dtype=dtype, device=self.device)
        counts = torch.zeros(n, count, dtype=torch.bool, device=self.device)
        for within, _, chosen, new in parts:
            action[:, within], counts[:, within] = chosen.to(dtype), new
        return action, counts

    def _checked(self, group: Group, action: Any) -> list[Tensor]:
        what = "action" if self.joint else f"({group.name!r}, 'action')"
        members, shape = [self.satellites[t] for t in group.types], (*self.batch_size, *self._agents_shape(group))
        if self._by_name(group):
            names = self._names_of(group)
            keys = set(action.keys()) if hasattr(action, "keys") else set()
            if keys != set(names):
                raise TypeError(f"{what} is {action!r}; it must be a tensordict with an entry for each satellite: {names}")
            pairs = zip(names, members, strict=True)
            return [read(f"{what}[{name!r}]", action[name], satellite, shape).unsqueeze(1) for name, satellite in pairs]
        if group.is_meta or self.joint:
            action = read(what, action, members[0], (*shape, len(members)))
            return list(action.view(self.fleet.num_envs, len(group.agents), len(members)).unbind(-1))
        return [read(what, action, members[0], shape)]

    def _warn_of_idle(self, acts: Sequence[Tensor], moves: Tensor) -> None:
        """Log once that satellites without a task received no action; their last mode continues."""
        if self._warned:
            return
        asked = moves.unsqueeze(-1) & ~self.state.removed
        for k, (satellites, executed) in enumerate(zip(self.satellites, acts, strict=True)):
            task = satellites.task
            idle = task.requires_retasking & ~executed & ~task.dead & self.fleet.rows_of(k, asked)
            if bool(idle.any()):
                row = int(torch.nonzero(idle)[0])
                logger.warning("%s requires retasking but received no task; its mode continues", satellites.title(row))
                self._warned = True
                return

    # -- outputs ------------------------------------------------------------------------------------------------------

    def _outputs(self, result: StepResult | None, **parts: Tensor) -> TensorDict:
        duration = torch.zeros_like(self.fleet.sim_time) if result is None else result.duration
        duration = duration.to(self.dtype).unsqueeze(-1)
        hidden = self.state.removed if result is None else result.removed
        outputs: dict[str, object] = {**parts, "duration": duration}
        observations = [
            satellite.observations.get_dict() if satellite.obs_type is dict else satellite.observations.get_vector(self.dtype)
            for satellite in self.satellites
        ]
        if result is not None and not self.joint:
            # only now: look-ahead is not extended for agents that have left, but they receive a last observation
            self._remove(result.duration)
        legal = [satellite.action_mask() for satellite in self.satellites]
        for group in self.groups:
            leaves = self._group_outputs(group, observations, legal, hidden)
            if self.joint:
                outputs |= {name: leaf.squeeze(1) for name, leaf in leaves.items()}
                if result is not None:
                    outputs["reward"] = result.reward.sum(1, keepdim=True).to(self.dtype)
                continue
            leaves["duration"] = duration.unsqueeze(1).expand(-1, len(group.agents), 1)
            if result is not None:
                leaves["reward"] = group.of_members(result.reward).sum(-1, keepdim=True).to(self.dtype)
            outputs[group.name] = TensorDict(leaves, (*self.batch_size, len(group.agents)), device=self.device)
        if counts := self.counts():
            outputs["counts"] = TensorDict(counts, self.batch_size, device=self.device)
        return TensorDict(outputs, self.batch_size, device=self.device)

    def _group_outputs(self, group: Group, observations: list[Any], legal: list[Tensor], removed: Tensor) -> dict[str, Any]:
        """Return the outputs of the agents of a group by name, [N, A, ...] each."""
        idle = self.requires_retasking
        wanted = group.of_members(idle & ~self.state.removed)
        observation = self._observation(group, observations, self._hidden(group, group.of_members(idle), removed))
        masks = []
        for m, (t, within, size) in enumerate(zip(group.types, group.within, self._sizes(group), strict=True)):
            if not size:
                continue
            free = wanted[..., m : m + 1]
            mask = self._members(legal[t], within, group.whole[m])
            may = free if self.options.mask_busy else ~self.state.removed[:, group.members[:, m : m + 1]]
            masks.append(torch.cat([mask & may.expand(mask.shape).contiguous(), ~free], -1))  # five times as fast as broadcasts
        leaves: dict[str, object] = {"observation": observation, **({"action_mask": torch.cat(masks, -1)} if masks else {})}
        leaves["requires_retasking"] = wanted.any(-1, keepdim=True) if group.is_meta else wanted
        if group.is_meta or self.joint:
            leaves["members_require_retasking"] = wanted
        if not self.joint:
            leaves["mask"] = self._by_agent(group, ~self.state.removed)
        return leaves

    def _hidden(self, group: Group, wanted: Tensor, removed: Tensor) -> Tensor:
        """Return the members that are not observed, [N, A, M]; ``wanted`` [N, A, M] need a task, or died without one."""
        if self.joint:
            absent = torch.zeros_like(wanted) if self.fleet.present is None else ~group.of_members(self.fleet.present)
            return absent | ~wanted if self.options.generate_obs_retasking_only else absent
        hidden = group.of_members(removed)
        return hidden | ~wanted.any(-1, keepdim=True) if self.options.generate_obs_retasking_only else hidden

    def _members(self, rows: Tensor, within: Tensor, whole: bool) -> Tensor:
        """Return the rows [N * count, ...] of one type for one member of each agent, [N, A, ...]."""
        table = rows.view(self.fleet.num_envs, -1, *rows.shape[1:])
        return table if whole else table[:, within]

    def _observation(self, group: Group, observations: list[Any], hidden: Tensor) -> object:
        """Return the observations [N, A, O], zero for members that are ``hidden`` [N, A, M]."""
        if isinstance(observations[group.types[0]], dict):
            shape = (self.fleet.num_envs, self.fleet.simulators[group.types[0]].count)
            tree = self._cast(observations[group.types[0]], shape)[:, group.within[0]]
            return tree.apply(lambda leaf: _blank(leaf, hidden[..., 0]))
        triples = zip(group.types, group.within, group.whole, hidden.unbind(-1), strict=True)
        parts = [_blank(self._members(observations[t], within, whole), gone) for t, within, whole, gone in triples]
        return parts[0] if len(parts) == 1 else torch.cat(parts, -1)


def _blank(leaf: Tensor, hidden: Tensor) -> Tensor:
    """Return the leaf [N, A, ...] with zeros where ``hidden`` [N, A] is true."""
    return leaf.masked_fill(hidden.view(*hidden.shape, *[1] * (leaf.ndim - 2)), 0)


@takes(ConstellationOptions)
class GeneralSatelliteTasking(ConstellationTasking):
    """A :class:`ConstellationTasking` with one agent for all satellites (``joint=True``).

    This is the batched TorchRL environment. ``gymnasium.make("bsk_torch/GeneralSatelliteTasking-v1", satellites=...)`` gives one
    episode with tuples of observations and actions (:class:`bsk_torch.wrappers.GymJointEnv`).
    """

    def __init__(
        self,
        satellites: Sequence[Satellite] | Satellite,
        scenario: Scenario | None = None,
        rewarder: GlobalReward | Iterable[GlobalReward] | None = None,
        communicator: CommunicationMethod | None = None,
        sat_arg_randomizer: Formation | Callable[[list[Satellite]], Mapping[Satellite, Mapping[str, object]]] | None = None,
        **options: Any,
    ) -> None:
        """See :class:`ConstellationTasking`; ValueError for ``joint=False``."""
        if not options.setdefault("joint", True):
            raise ValueError("GeneralSatelliteTasking has one agent for all satellites; joint=False is a ConstellationTasking")
        super().__init__(satellites, scenario, rewarder, communicator, sat_arg_randomizer, **options)
