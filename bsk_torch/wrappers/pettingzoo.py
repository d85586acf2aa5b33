"""PettingZoo's parallel interface to one episode of a constellation."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from pettingzoo import ParallelEnv
from tensordict import TensorDictBase
from torch import Tensor

from bsk_torch.env import ConstellationTasking
from bsk_torch.env.action_forms import form, mask_size
from bsk_torch.env.agents import Group
from bsk_torch.env.no_action import is_no_action
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.sim.arguments.values import nearest
from bsk_torch.wrappers.core import RENDERING, as_numpy, begin, build, parse_render_mode
from bsk_torch.wrappers.episode import EpisodeView
from bsk_torch.wrappers.spaces import action_space, map_leaves, observation_space, unbounded
from bsk_torch.wrappers.tasks import ends, legal_tasks, read_one, read_task, satellite_infos

__all__ = ["PettingZooEnv", "parallel_env"]

logger = logging.getLogger(__name__)

Core = ConstellationTasking | str | Callable[..., ConstellationTasking]
"""An environment, the name of a preset, or a function that returns an environment."""

Steps = tuple[dict[str, object], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, object]]]
"""Observations, rewards, terminations, truncations and infos by agent."""

COMMON = "__common__"
"""Key of the info shared by all agents."""


class Seat(NamedTuple):
    """Place of an agent in the environment: its group, its number there, and the numbers and types of its satellites."""

    group: Group
    number: int
    members: list[int]
    parts: tuple[SatelliteGroup, ...]


class PettingZooEnv(EpisodeView, ParallelEnv[str, object, object]):
    """One episode at a time, as ``pettingzoo.ParallelEnv``, with an agent for each satellite.

    An agent that is missing in the actions, or whose action is ``None`` or ``NO_ACTION``, continues its task; an agent that
    commands several satellites acts with one such entry for each, or with one for all. Actions of real numbers are a Box, hybrid
    ones a Dict of ``values`` and ``choice``; for these, ``NO_ACTION`` in all numbers continues, and a Box has no ``action_mask``.
    After a reset, ``agents`` lists those whose satellites are present in the episode.
    The step that terminates or truncates an agent removes it from ``agents``; later actions for it are ignored, with a warning.
    Under ``compat="bsk_rl"``, agents that the rewarder terminates stay, as there.

    The info of an agent has ``requires_retasking``, ``d_ts`` (duration of the step, s), ``action_mask`` (int8, 1 for actions that
    are legal as new tasks) and the counters of its satellite. An agent that commands several satellites has a tuple of masks, and
    an entry for each satellite by name. The batched environment is :attr:`core`.

    Example:
        >>> env = PettingZooEnv("Constellation-v1", n_satellites=3, n_targets=100, backend="eager", time_limit=60.0)
        >>> observations, infos = env.reset(seed=0)
        >>> actions = {agent: env.action_space(agent).sample(infos[agent]["action_mask"]) for agent in env.agents}
        >>> observations, rewards, terminations, truncations, infos = env.step(actions)
    """

    metadata: ClassVar[dict[str, object]] = RENDERING | {"name": "constellation", "is_parallelizable": True}
    core: ConstellationTasking

    def __init__(
        self,
        core: Core,
        *,
        continue_action: bool = False,
        common_info: bool = False,
        render_mode: str | None = None,
        **options: object,
    ) -> None:
        """Wrap one environment.

        Args:
            core: A :class:`~bsk_torch.ConstellationTasking` with ``num_envs=1``, the name of a preset, or a function that returns
                such an environment.
            continue_action: Whether spaces and masks have a last action that continues the task, and masks allow only that one to
                agents with a task in progress, unless the core has ``mask_busy=False``; for policies that act in every step.
            common_info: Whether infos have an entry ``"__common__"`` with ``d_ts``.
            render_mode: ``"rgb_array"`` for pictures by :meth:`render`, which need the extra ``viz``.
            **options: Arguments for the preset or function, such as ``time_limit=600.0``.
        """
        self.render_mode = parse_render_mode(render_mode)
        self.core = build(core, options, ConstellationTasking)
        if self.core.batch_size != (1,):
            raise ValueError(f"core has num_envs={self.core.batch_size[0]}; PettingZooEnv needs 1")
        if self.core.joint:
            raise ValueError("core has joint=True, one agent for all satellites; GymJointEnv is the view of it")
        if isinstance(core, str):
            self.metadata = self.metadata | {"name": core}  # type: ignore[misc]
        self._continues, self._common = continue_action, common_info
        self._seats: dict[str, Seat] = {}
        for group in self.core.groups:
            parts = tuple(self.core.satellites[t] for t in group.types)
            self._seats |= {agent: Seat(group, k, group.members[k].tolist(), parts) for k, agent in enumerate(group.agents)}
        self.possible_agents: list[str] = list(self.core.agents)
        self.agents: list[str] = []
        self._make_spaces()
        self._results: TensorDictBase | None = None

    # -- spaces -------------------------------------------------------------------------------------------------------

    def _make_spaces(self) -> None:
        specs = self.core.observation_spec
        observed = {group.name: specs[group.name, "observation"] for group in self.core.groups}
        self.observation_spaces = {a: observation_space(observed[self._seats[a].group.name], 2) for a in self.possible_agents}
        self.action_spaces: dict[str, spaces.Space[object]] = {}
        for agent in self.possible_agents:
            group, _, _, parts = self._seats[agent]
            if group.is_meta:
                self.action_spaces[agent] = spaces.MultiDiscrete([self._size(part) for part in parts])
            else:
                self.action_spaces[agent] = action_space(parts[0], self._continues)
        width = sum(spaces.flatdim(space) for space in self.observation_spaces.values())
        self.state_space = unbounded((width,), self.core.dtype)

    def _size(self, part: SatelliteGroup) -> int:
        return part.actions.n_actions + self._continues

    def observation_space(self, agent: str) -> spaces.Space[object]:
        """Space of an agent's observations, the same object in every call."""
        return self.observation_spaces[self._checked_agent(agent, "agent")]

    def action_space(self, agent: str) -> spaces.Space[object]:
        """Space of an agent's actions, the same object in every call."""
        return self.action_spaces[self._checked_agent(agent, "agent")]

    def _checked_agent(self, agent: str, what: str) -> str:
        if agent not in self._seats:
            raise ValueError(f"{what} {agent!r} is not in possible_agents; {nearest(str(agent), self._seats)}")
        return agent

    # -- reset and step -----------------------------------------------------------------------------------------------

    def reset(
        self, seed: int | None = None, options: Mapping[str, object] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Start an episode.

        Args:
            seed: Begin with the first episode of this seed; None for the next episode of the present seed.
            options: ``{"state": state}`` starts from a state of ``core.get_state()`` instead; other keys are ignored, as in
                PettingZoo's own environments.
        """
        every = torch.ones(1, dtype=torch.bool, device=self.core.device)
        if seed is not None:
            self.core.reseed(seed)
        results = self._results = begin(self.core, every, state=(options or {}).get("state"))
        dead, stays = self._by_agent(self.core.dead), self._by_agent(~self.core.fleet.state.removed)
        self.agents = [agent for agent in self.possible_agents if stays[agent] and not dead[agent]]
        self._warned = False
        return {agent: self._observation(results, agent) for agent in self.agents}, self._infos(results, self.agents)

    def step(self, actions: Mapping[str, object]) -> Steps:
        """Execute ``actions`` until the first satellite finishes its task.

        Raises:
            ResetNeeded: Before the first reset.
            ValueError: For an unknown agent, or an action out of range; no state has changed then.
            TypeError: For an action that is not an integer, or actions that are not given by agent.
        """
        if self._results is None:
            raise ResetNeeded("step() needs a running episode; call reset() first")
        tables = self._decoded(actions)
        live = self.agents
        if not live:
            return {}, {}, {}, {}, {COMMON: {"d_ts": 0.0}} if self._common else {}
        results = self._results = self.core.play(tables, torch.ones(1, dtype=torch.bool, device=self.core.device))
        ended, cut = ends(self.core)
        terminated, truncated = self._by_agent(ended), bool(cut)
        removed = self._by_agent(self.core.dead) if self.core.agents_stay else terminated
        self.agents = [agent for agent in live if not (removed[agent] or truncated)]
        return (
            {agent: self._observation(results, agent) for agent in live},
            {agent: float(self._of(results, agent, "reward")) for agent in live},
            {agent: terminated[agent] for agent in live},
            dict.fromkeys(live, truncated),
            self._infos(results, live),
        )

    def _by_agent(self, flags: Tensor) -> dict[str, bool]:
        """Return which agents have a satellite with a flag [1, S]."""
        table = flags[0].tolist()
        return {agent: any(table[k] for k in seat.members) for agent, seat in self._seats.items()}

    # -- actions ------------------------------------------------------------------------------------------------------

    def _decoded(self, actions: Mapping[str, object]) -> list[Tensor]:
        """Return the actions of each group, [1, A] or [1, A, M], or [1, A, width] of real numbers."""
        if not isinstance(actions, Mapping):
            raise TypeError(f"actions={actions!r} must be a dictionary of actions by agent; agents are {self.possible_agents}")
        for agent in actions:
            self._checked_agent(agent, "actions: agent")
        live = set(self.agents)
        if self.agents and (late := [agent for agent in actions if agent not in live]) and not self._warned:
            self._warned = True  # once in an episode: some trainers send actions for everybody
            logger.warning("actions of %s are ignored: they have left the episode", late)
        tables = []
        for group in self.core.groups:
            part = self.core.satellites[group.types[0]]
            if form(part) is not None:
                pairs = [(agent, actions.get(agent) if agent in live else None) for agent in group.agents]
                values = [read_one(f"actions[{agent!r}]", action, part, self._continues) for agent, action in pairs]
                tables.append(torch.stack(promoted(values)).unsqueeze(0).to(self.core.device))
                continue
            rows = [self._row(agent, actions.get(agent) if agent in live else None) for agent in group.agents]
            table = torch.tensor([rows], dtype=torch.int64, device=self.core.device)
            tables.append(table if group.is_meta else table.squeeze(-1))
        return tables

    def _row(self, agent: str, action: object) -> list[int]:
        seat = self._seats[agent]
        if isinstance(action, np.ndarray | Tensor):
            action = action.tolist()
        if not isinstance(action, list | tuple):
            action = [action] * len(seat.parts)
        if len(action) != len(seat.parts):
            raise ValueError(f"actions[{agent!r}] has {len(action)} entries; it must have {len(seat.parts)}, one per satellite")
        where = f"actions[{agent!r}]"
        return [read_task(where, value, part, self._continues) for value, part in zip(action, seat.parts, strict=True)]

    # -- results -------------------------------------------------------------------------------------------------------

    def _of(self, results: TensorDictBase, agent: str, name: str) -> Any:
        group, number, *_ = self._seats[agent]
        return results[group.name, name][0, number]

    def _observation(self, results: TensorDictBase, agent: str) -> object:
        return map_leaves(self._of(results, agent, "observation"), as_numpy)

    def _infos(self, results: TensorDictBase, agents: Sequence[str]) -> dict[str, dict[str, object]]:
        self.latest_step_duration = float(results["duration"])
        step = {"d_ts": self.latest_step_duration}
        by_satellite, legal = satellite_infos(self.core, results), legal_tasks(self.core)
        infos = {agent: self._info(agent, by_satellite, self._masks(results, agent, legal)) | step for agent in agents}
        return infos | ({COMMON: step} if self._common else {})

    def _info(
        self, agent: str, by_satellite: Sequence[dict[str, object]], masks: tuple[np.ndarray | None, ...]
    ) -> dict[str, Any]:
        group, _, members, _ = self._seats[agent]
        if not group.is_meta:
            return by_satellite[members[0]] | ({} if masks[0] is None else {"action_mask": masks[0]})
        info = {"requires_retasking": any(by_satellite[k]["requires_retasking"] for k in members), "action_mask": masks}
        return info | {self.core.names[k]: by_satellite[k] for k in members}

    def _masks(self, results: TensorDictBase, agent: str, legal: Sequence[np.ndarray | None]) -> tuple[np.ndarray | None, ...]:
        """Return the legal actions of each satellite of an agent; None of real numbers."""
        group, number, _, parts = self._seats[agent]
        if not mask_size(parts[0]):
            return (None,)
        if self._continues:
            flags = self._of(results, agent, "action_mask").split([self._size(part) for part in parts])
            return tuple(as_numpy(flag).astype(np.int8) for flag in flags)
        pairs = zip(group.types, group.within, strict=True)
        return tuple(None if (mask := legal[t]) is None else mask[int(within[number])].copy() for t, within in pairs)

    def state(self) -> np.ndarray:
        """Return the observations of all agents side by side, in the order of ``possible_agents``; zeros for removed agents."""
        if self._results is None:
            raise ResetNeeded("state() needs an episode; call reset() first")
        observed = [(self.observation_spaces[a], self._observation(self._results, a)) for a in self.possible_agents]
        return np.concatenate([spaces.flatten(space, value) for space, value in observed])


def promoted(values: Sequence[Tensor]) -> list[Tensor]:
    """Return tensors in the narrowest type that holds all of them; ``NO_ACTION`` takes that of the others."""
    dtypes = [value.dtype for value in values if not is_no_action(value)]
    dtype = functools.reduce(torch.promote_types, dtypes) if dtypes else torch.float64
    return [value.to(dtype) for value in values]


def parallel_env(core: Core, **options: Any) -> PettingZooEnv:
    """Return a :class:`PettingZooEnv`, as ``parallel_env("Constellation-v1")``: PettingZoo's name for such a function."""
    return PettingZooEnv(core, **options)
