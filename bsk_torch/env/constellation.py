"""Many satellites per episode, N episodes at once."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Categorical, Composite, MultiCategorical, Unbounded
from torchrl.envs import EnvBase

from bsk_torch.comm import CommunicationMethod
from bsk_torch.data.base import GlobalReward
from bsk_torch.env.base import Played, Tasking, TimeLimit
from bsk_torch.env.groups import AGENTS, Group, agents_of, make_groups
from bsk_torch.env.machine import existing_device
from bsk_torch.formations import Formation
from bsk_torch.obs.base import ObservationBuilder, Values
from bsk_torch.sats.satellite import Satellite
from bsk_torch.scene.base import Scenario

logger = logging.getLogger(__name__)

NO_ACTION = 2**31 - 1
"""Action of a satellite that goes on with its task, as bsk_rl's; the last action of every space means the same."""


OWN = (
    "joint",
    "meta_agent_groupings",
    "only_retask_idle_meta_agent_members",
    "group_map",
    "generate_obs_retasking_only",
    "mask_busy",
)
"""Arguments that only concern what agents see."""


class ConstellationTasking(Tasking):
    """N independent episodes with S satellites each, as bsk_rl's ``ConstellationTasking`` plays one.

    A step lasts until the first satellite has finished its task; the others go on with theirs. Agents that are alike form a
    group, ``"agents"`` where there is only one; ``group_map`` names them. Each group holds ``observation``, ``action``,
    ``action_mask``, ``reward`` [N, A, 1], ``mask`` [N, A] (which agents live), ``requires_retasking`` and ``duration`` [N, A, 1];
    ``done``, ``terminated``, ``truncated`` and ``duration`` are at the root.

    The last action of a space goes on with the task. ``action_mask`` allows nothing else to the busy and the dead; an action that
    a busy satellite is given all the same becomes its task at once, one that a dead satellite is given is not looked at.

    A dead satellite gets the penalty and a last observation, and leaves: its tasks end no step any more, ``mask`` is False, its
    observations and rewards are zero. The episode ends when all agents are dead, or with the time limit.
    """

    def __init__(
        self,
        satellites: Sequence[Satellite],
        scenario: Scenario | None = None,
        rewarder: GlobalReward | Iterable[GlobalReward] | None = None,
        communicator: CommunicationMethod | None = None,
        sat_arg_randomizer: Formation | Callable[[list[Satellite]], Mapping[Any, Any]] | None = None,
        *,
        num_envs: int = 1,
        joint: bool = False,
        meta_agent_groupings: Mapping[str, Sequence[str]] | None = None,
        only_retask_idle_meta_agent_members: bool = False,
        group_map: Mapping[str, Sequence[str]] | None = None,
        generate_obs_retasking_only: bool = False,
        mask_busy: bool = True,
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

        Args not listed are those of :class:`bsk_torch.SatelliteTasking`.

        Args:
            satellites: The satellites, each with a name of its own. Those that differ in nothing but their names and arguments
                are of one type and are simulated together.
            scenario: What is asked of them.
            rewarder: What their data are worth; the sum of several, if there are several.
            communicator: Who tells whom what he knows; nobody unless given.
            sat_arg_randomizer: Draws arguments of all satellites together: a formation of :mod:`bsk_torch.formations`, or a
                function of the list of satellites, called for each episode, that returns ``{satellite: {argument: value}}``.
            num_envs: Number of episodes N.
            joint: Whether one agent commands all satellites and gets one reward, as in bsk_rl's ``GeneralSatelliteTasking``. Its
                keys are at the root: ``observation`` [N, O], ``action`` [N, S], ``action_mask``, ``reward`` [N, 1],
                ``requires_retasking`` [N, S]. The episode ends when any satellite dies.
            meta_agent_groupings: Names of the satellites of agents that command several; their actions are [N, A, M].
            only_retask_idle_meta_agent_members: Whether such agents' actions for busy satellites are not looked at.
            group_map: Names of the agents of each group; by types of satellites unless given.
            generate_obs_retasking_only: Whether agents that need no task observe zeros.
            mask_busy: Whether ``action_mask`` allows the busy to go on only.
            world_args: Arguments of the world.
            sim_rate: Length of a tick, s.
            max_step_duration: Longest step, s.
            failure_penalty: Added to the reward of the step in which a satellite dies.
            time_limit: Seconds after which an episode is truncated.
            terminate_on_time_limit: Whether the time limit also terminates.
            device: Where the simulation runs.
            seed: Seed of all draws; None for a random one.
            env_ids: Index of each episode in the draws.
            dtype: Type of observations, rewards and durations.
            sim_dtype: float64, or float32 for mixed precision.
            orbit: ``"arc"``, ``"integrated"``, or None for what the models say.
            backend: ``"compiled"`` or ``"eager"``.
            log_level: Level of the package's logger; None leaves it.
        """
        if num_envs < 1:
            raise ValueError(f"num_envs={num_envs} must be at least 1")
        EnvBase.__init__(self, device=existing_device(device), batch_size=[num_envs])
        self._arguments = {k: v for k, v in locals().items() if k not in ("self", "__class__")}
        given = {k: v for k, v in self._arguments.items() if k not in OWN}
        if joint and (meta_agent_groupings or group_map):
            raise ValueError("joint=True puts all satellites under one agent; leave meta_agent_groupings and group_map out")
        self.joint, self.only_retask_idle = joint, only_retask_idle_meta_agent_members
        self.only_obs_retasking, self.mask_busy = generate_obs_retasking_only, mask_busy
        self._groupings, self._given_map, self._warned = meta_agent_groupings, group_map, False
        given["satellites"] = [satellites] if isinstance(satellites, Satellite) else list(satellites)
        self._build(**given)

    # -- agents -------------------------------------------------------------------------------------------------------

    def _make_agents(self) -> None:
        if self.joint:
            self.agents = {AGENTS: list(self.names)}
        else:
            self.agents = agents_of(self.names, self._groupings)
        titles = [type(part).__name__ for part in self.fleet.parts]
        groups = make_groups(self.agents, self.names, self.types, titles, self._given_map)
        self.groups = [group.to(self.device) for group in groups]
        self.group_map = {group.name: list(group.agents) for group in self.groups}
        for group in self.groups:
            unfit = [part.name for part in (self.fleet.parts[t] for t in group.types) if part.obs_type is dict]
            if group.is_meta and unfit:
                raise ValueError(
                    f"agent {group.agents[0]!r} commands several satellites, so {unfit[0]} needs obs_type=torch.Tensor"
                )

    @property
    def satellites(self) -> tuple[Satellite, ...]:
        """The satellites of each type, as they live in the environment."""
        return self.fleet.parts

    @property
    def dead(self) -> Tensor:
        """Which satellites have died, [N, S]."""
        return self.fleet.joined([squad.dead for squad in self.squads])

    @property
    def requires_retasking(self) -> Tensor:
        """Which satellites have nothing left to do, [N, S]."""
        return self.fleet.joined([squad.requires_retasking for squad in self.squads])

    # -- specs --------------------------------------------------------------------------------------------------------

    def _make_specs(self, trial: list[Values]) -> None:
        self._make_agents()
        for part, values in zip(self.fleet.parts, trial, strict=True):
            part.observation_description = ObservationBuilder.describe(values)
        observed, acted, paid = (
            Composite(shape=self.batch_size),
            Composite(shape=self.batch_size),
            Composite(shape=self.batch_size),
        )
        for group in self.groups:
            shape = (*self.batch_size, *self._agents_shape(group))
            where = () if self.joint else (group.name,)
            for spec, parts in (
                (observed, self._observed(group, trial, shape)),
                (acted, {"action": self._acted(group, shape)}),
                (paid, {"reward": Unbounded((*shape, 1), dtype=self.dtype)}),
            ):
                target = spec if self.joint else Composite(shape=shape)
                for name, leaf in parts.items():
                    target[name] = leaf
                if where:
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
        """Actions of each member, going on included."""
        return [self.fleet.parts[t].actions.n_actions + 1 for t in group.types]

    def _observed(self, group: Group, trial: list[Values], shape: tuple[int, ...]) -> dict[str, Any]:
        first = group.types[0]
        if self.fleet.parts[first].obs_type is dict and not group.is_meta:
            observation: Any = self._tree(trial[first], shape)
        else:
            width = sum(ObservationBuilder.vector(trial[t], self.dtype).shape[-1] for t in group.types)
            observation = Unbounded((*shape, width), dtype=self.dtype)
        sizes = sum(self._sizes(group))
        flag = {"dtype": torch.bool}
        parts: dict[str, Any] = {
            "observation": observation,
            "action_mask": Binary(sizes, shape=(*shape, sizes), **flag),
            "requires_retasking": Categorical(2, shape=(*shape, 1), **flag),
        }
        if group.is_meta or self.joint:
            members = (*shape, len(group.types))
            parts["members_require_retasking"] = Binary(members[-1], shape=members, **flag)
        if not self.joint:
            parts["mask"] = Categorical(2, shape=shape, **flag)
            parts["duration"] = Unbounded((*shape, 1), dtype=self.dtype)
        return parts

    def _acted(self, group: Group, shape: tuple[int, ...]) -> Any:
        sizes = self._sizes(group)
        if group.is_meta or self.joint:
            return MultiCategorical(sizes, shape=(*shape, len(sizes)), dtype=torch.int64)
        return Categorical(sizes[0], shape=shape, dtype=torch.int64)

    # -- step ---------------------------------------------------------------------------------------------------------

    @torch.no_grad()
    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        partial = tensordict.get("_step", None)
        moves = torch.ones_like(self.fleet.inert[:, 0]) if partial is None else partial.reshape(-1)
        given = [tensordict.get("action") if self.joint else tensordict.get((group.name, "action")) for group in self.groups]
        return self.play(given, moves)

    @torch.no_grad()
    def play(self, given: Sequence[Tensor], moves: Tensor) -> TensorDict:
        """Do the actions of each group where ``moves`` [N] is true; what ``step`` puts under ``next``."""
        actions, acts = self._decoded(given, moves)
        absent = self.fleet.inert
        played = self._play(actions, acts, moves)
        lost = self.dead & moves.unsqueeze(-1)
        reward = played.reward + self.failure_penalty * lost
        ended, cut = self.dead | self.rewarder.is_terminated(), self.rewarder.is_truncated().any(1)
        if self.joint:
            reward, terminated = reward.sum(1, keepdim=True), ended.any(1)
        else:
            reward = torch.where(absent, 0.0, reward)
            terminated = torch.stack([self._by_agent(group, ended).all(1) for group in self.groups], 1).all(1)
            self._dismiss()
        self.returns = self.returns + reward.sum(1)
        truncated = self.truncated_by_time | cut
        if self.terminate_on_time_limit:
            terminated = terminated | truncated
        return self._outputs(
            played,
            absent,
            reward=reward,
            terminated=terminated.unsqueeze(-1),
            truncated=truncated.unsqueeze(-1),
            done=(terminated | truncated).unsqueeze(-1),
        )

    def _by_agent(self, group: Group, flags: Tensor) -> Tensor:
        """Which agents have a member with a flag [N, S], [N, A]."""
        return flags[:, group.members].any(-1)

    def _dismiss(self) -> None:
        """Let the agents go that have lost a satellite; their tasks end no step any more."""
        dead, inert = self.dead, self.fleet.inert.clone()
        for group in self.groups:
            gone = self._by_agent(group, dead).unsqueeze(-1).expand(-1, *group.members.shape)
            inert[:, group.members.flatten()] = gone.flatten(1)
        self.fleet.inert = inert
        for k, squad in enumerate(self.squads):
            rows = self.fleet.rows_of(k, inert)
            squad.dismiss(rows)
            squad.satellite.absent = rows

    def _decoded(self, given: Sequence[Tensor], moves: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """Actions [N * count] of each type, and which of them count."""
        n = self.fleet.num_envs
        actions = [torch.zeros(n, squad.simulator.count, dtype=torch.int64, device=self.device) for squad in self.squads]
        acts = [torch.zeros_like(action, dtype=torch.bool) for action in actions]
        idle = self.requires_retasking
        for group, action in zip(self.groups, given, strict=True):
            action = self._checked(group, action).view(n, len(group.agents), len(group.types))
            for m, (t, within, size) in enumerate(zip(group.types, group.within, self._sizes(group), strict=True)):
                mine = action[..., m]
                counts = (mine != size - 1) & (mine != NO_ACTION)
                if self.only_retask_idle and group.is_meta:
                    counts = counts & idle[:, group.members[:, m]]
                actions[t][:, within] = torch.where(counts, mine, 0)
                acts[t][:, within] = counts
        present = moves.unsqueeze(-1) & ~self.fleet.inert
        rows = [part.flatten() & self.fleet.rows_of(k, present) for k, part in enumerate(acts)]
        checked = [squad.checked(a.flatten(), r) for squad, a, r in zip(self.squads, actions, rows, strict=True)]
        self._warn_of_idle(rows, moves)
        return checked, rows

    def _checked(self, group: Group, action: Tensor) -> Tensor:
        what = "action" if self.joint else f"({group.name!r}, 'action')"
        if action.dtype.is_floating_point or action.dtype == torch.bool:
            raise TypeError(f"{what} has dtype {action.dtype}; it must be an integer tensor, such as torch.int64")
        members = (len(group.types),) if group.is_meta or self.joint else ()
        wanted = (*self.batch_size, *self._agents_shape(group), *members)
        if tuple(action.shape) != wanted:
            raise ValueError(f"{what} has shape {list(action.shape)}; it must be {list(wanted)}")
        return action.long()

    def _warn_of_idle(self, acts: Sequence[Tensor], moves: Tensor) -> None:
        """Say once that satellites without a task were given none, as bsk_rl does; their last mode goes on."""
        if self._warned:
            return
        for squad, mine in zip(self.squads, acts, strict=True):
            idle = squad.requires_retasking & ~mine & ~squad.dead & squad.simulator.of_env(moves)
            if bool(idle.any()):
                row = int(torch.nonzero(idle)[0])
                logger.warning("%s requires retasking but received no task; its mode goes on", squad.satellite.title(row))
                self._warned = True
                return

    # -- what agents see ----------------------------------------------------------------------------------------------

    @torch.no_grad()
    def _outputs(self, played: Played | None, absent: Tensor | None = None, **parts: Tensor) -> TensorDict:
        duration = torch.zeros_like(self.fleet.sim_time) if played is None else played.duration
        duration = duration.to(self.dtype).unsqueeze(-1)
        if absent is None:
            absent = self.fleet.inert
        reward = parts.pop("reward", None)
        outputs: dict[str, Any] = {**parts, "duration": duration}
        seen = [
            part.observations.get_dict() if part.obs_type is dict else part.observations.get_vector(self.dtype)
            for part in self.fleet.parts
        ]
        legal = [part.action_mask() for part in self.fleet.parts]
        for group in self.groups:
            leaves = self._group_outputs(group, seen, legal, absent)
            if self.joint:
                outputs |= {name: leaf.squeeze(1) for name, leaf in leaves.items()}
                if reward is not None:
                    outputs["reward"] = reward.to(self.dtype)
                continue
            leaves["duration"] = duration.unsqueeze(1).expand(-1, len(group.agents), 1)
            if reward is not None:
                leaves["reward"] = reward[:, group.members].sum(-1, keepdim=True).to(self.dtype)
            outputs[group.name] = TensorDict(leaves, (*self.batch_size, len(group.agents)), device=self.device)
        if counts := self.counts():
            outputs["counts"] = TensorDict(counts, self.batch_size, device=self.device)
        return TensorDict(outputs, self.batch_size, device=self.device)

    def _group_outputs(self, group: Group, seen: list[Any], legal: list[Tensor], absent: Tensor) -> dict[str, Any]:
        """What the agents of a group see, [N, A, ...] each."""
        wants = self.requires_retasking & ~self.fleet.inert
        wanted = wants[:, group.members]
        observation = self._observation(group, seen, self._hidden(group, wanted, absent))
        masks = []
        for m, (t, within) in enumerate(zip(group.types, group.within, strict=True)):
            free = wanted[..., m : m + 1]
            mask = self._members(legal[t], within, group.whole[m])
            may = free if self.mask_busy else ~self.fleet.inert[:, group.members[:, m : m + 1]]
            masks.append(torch.cat([mask & may, ~free], -1))
        leaves: dict[str, Any] = {"observation": observation, "action_mask": torch.cat(masks, -1)}
        leaves["requires_retasking"] = wanted.any(-1, keepdim=True)
        if group.is_meta or self.joint:
            leaves["members_require_retasking"] = wanted
        if not self.joint:
            leaves["mask"] = ~self.fleet.inert[:, group.members[:, 0]]
        return leaves

    def _hidden(self, group: Group, wanted: Tensor, absent: Tensor) -> Tensor:
        """Members that are not observed, [N, A, M]; ``wanted`` [N, A, M] need a task, ``absent`` [N, S] had left before."""
        if self.joint:
            return ~wanted if self.only_obs_retasking else torch.zeros_like(wanted)
        hidden = absent[:, group.members]
        return hidden | ~wanted.any(-1, keepdim=True) if self.only_obs_retasking else hidden

    def _members(self, rows: Tensor, within: Tensor, whole: bool) -> Tensor:
        """Rows [N * count, ...] of one type for one member of each agent, [N, A, ...]."""
        table = rows.view(self.fleet.num_envs, -1, *rows.shape[1:])
        return table if whole else table[:, within]

    def _observation(self, group: Group, seen: list[Any], hidden: Tensor) -> Any:
        """Observations [N, A, O], zero for members that are ``hidden`` [N, A, M]."""
        if isinstance(seen[group.types[0]], dict):
            shape = (self.fleet.num_envs, self.squads[group.types[0]].simulator.count)
            tree = self._cast(seen[group.types[0]], shape)[:, group.within[0]]
            return tree.apply(lambda leaf: _blank(leaf, hidden[..., 0]))
        triples = zip(group.types, group.within, group.whole, hidden.unbind(-1), strict=True)
        parts = [_blank(self._members(seen[t], within, whole), gone) for t, within, whole, gone in triples]
        return parts[0] if len(parts) == 1 else torch.cat(parts, -1)


def _blank(leaf: Tensor, hidden: Tensor) -> Tensor:
    """The leaf [N, A, ...] with zeros where it is ``hidden`` [N, A]."""
    return torch.where(hidden.view(*hidden.shape, *[1] * (leaf.ndim - 2)), torch.zeros_like(leaf), leaf)
