"""N constellations of bsk_rl with arrays by agent, and these as one batched simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from tensordict import TensorDictBase
from torch import Tensor

from bsk_torch.bsk_rl.obs.observations import LARGEST
from bsk_torch.bsk_rl.per_episode.views import satellites_of
from bsk_torch.env import NO_ACTION
from bsk_torch.env import ConstellationTasking as Constellation
from bsk_torch.wrappers.core import as_numpy, begin
from bsk_torch.wrappers.gymnasium.vector import parse_mode
from bsk_torch.wrappers.tasks import ends

ByAgent = dict[Any, Any]
"""Arrays [N, ...] by agent."""


class Seat(NamedTuple):
    """Place of an agent: its group and its number there, and the number of its satellite among all."""

    group: str
    number: int
    column: int


AGENT_MODES = (AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED)
"""Autoreset modes of agents."""


class AgentsVector:
    """N constellations: PettingZoo's parallel interface, with arrays of all environments by agent.

    An environment starts its next episode in the step after the end, which ignores its actions (``NEXT_STEP``), or in
    ``reset(options={"reset_mask": ended})`` (``DISABLED``).
    Actions, observations, rewards, terminations, truncations and infos are dictionaries by agent, of arrays [N, ...]. Entries of
    agents that have left an environment are zero; ``infos[agent]["present"]`` [N] marks the environments in which an agent was
    part of the step. An episode is over when its agents have left, or are all terminated or truncated.

    ``step`` uses no actions of agents that have left. It raises ResetNeeded if no episode is running, or one is over that does
    not start by itself; KeyError for an unknown agent, ValueError for a wrong number of actions, and TypeError for actions that
    are not given by agent.

    Attributes:
        num_envs: Number of environments N.
        possible_agents: All agents.
        observation_spaces, action_spaces: Spaces of all environments by agent.
        single_observation_spaces, single_action_spaces: Spaces of one environment by agent.
    """

    _over: np.ndarray | Tensor
    """Whether an episode is over, [N]."""

    def __init__(
        self,
        num_envs: int,
        autoreset_mode: AutoresetMode | str,
        observation_spaces: Mapping[Any, spaces.Space[Any]],
        action_spaces: Mapping[Any, spaces.Space[Any]],
    ) -> None:
        """Keep the spaces of one environment by agent; ValueError for an autoreset mode that agents do not have."""
        self.num_envs, self.autoreset_mode = num_envs, parse_mode(autoreset_mode)
        if self.autoreset_mode not in AGENT_MODES:
            names = [allowed.value for allowed in AGENT_MODES]
            raise ValueError(f"autoreset_mode={self.autoreset_mode.value!r} must be one of {names} for agents")
        self.metadata = {"autoreset_mode": self.autoreset_mode, "name": "constellation"}
        self.possible_agents: list[object] = list(observation_spaces)
        self.single_observation_spaces, self.single_action_spaces = dict(observation_spaces), dict(action_spaces)
        self.observation_spaces = {agent: batch_space(space, num_envs) for agent, space in observation_spaces.items()}
        self.action_spaces = {agent: batch_space(space, num_envs) for agent, space in action_spaces.items()}
        self._started = False

    def observation_space(self, agent: object) -> spaces.Space[object]:
        """Space of an agent's observations in all environments."""
        return self.observation_spaces[agent]

    def action_space(self, agent: object) -> spaces.Space[object]:
        """Space of an agent's actions in all environments."""
        return self.action_spaces[agent]

    def _reset_rows(self, options: Mapping[str, object] | None) -> np.ndarray:
        """Return which environments ``reset(options=...)`` starts, [N]."""
        mask = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs)), dtype=bool)
        if mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"options['reset_mask'] has shape {list(mask.shape)} and {mask.sum()} entries that are true; it must have shape "
                f"[{self.num_envs}] and at least one"
            )
        if not self._started and not mask.all():
            raise ResetNeeded("the first reset() must start all environments; leave out options['reset_mask']")
        return mask

    def _check_step(self, actions: Mapping[Any, Any]) -> None:
        """Raise an error unless episodes are running and ``actions`` are those of agents."""
        if not self._started or (self.autoreset_mode is AutoresetMode.DISABLED and bool(self._over.any())):
            raise ResetNeeded("step() needs running episodes; call reset(), with options={'reset_mask': ended} for some of them")
        if not isinstance(actions, Mapping):
            raise TypeError(f"actions={actions!r} must be a dictionary of arrays by agent; agents are {self.possible_agents}")
        for agent, each in actions.items():
            if agent not in self.possible_agents:
                raise KeyError(f"{agent!r} is not an agent; agents are {self.possible_agents}")
            if np.ndim(each) == 0:
                raise ValueError(f"actions[{agent!r}]={each!r} must have {self.num_envs} entries, one per environment")
            if len(each) != self.num_envs:
                raise ValueError(f"actions[{agent!r}] has {len(each)} entries; it must have {self.num_envs}, one per environment")


class BatchedAgentsVectorEnv(AgentsVector):
    """N constellations in one simulation.

    Observations, rewards and durations are those of single environments in the same state, to rounding. Draws are those of
    :mod:`bsk_torch`: a seed gives other episodes, of the same distribution.

    Attributes:
        core: The simulation, an environment of :mod:`bsk_torch`.
    """

    def __init__(self, core: Constellation, autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP) -> None:
        self.core = core
        self._seats, observation_spaces, action_spaces = dict[object, Seat](), ByAgent(), ByAgent()
        dtype = torch.empty(0, dtype=core.dtype).numpy().dtype.type
        for group in core.groups:
            shape = tuple(core.observation_spec[group.name, "observation"].shape[2:])
            n_actions = core.satellites[group.types[0]].actions.n_actions
            for number, agent in enumerate(group.agents):
                self._seats[agent] = Seat(group.name, number, int(group.members[number, 0]))
                observation_spaces[agent] = spaces.Box(-LARGEST, LARGEST, shape, dtype)
                action_spaces[agent] = spaces.Discrete(n_actions)
        ordered = ({agent: table[agent] for agent in core.names} for table in (observation_spaces, action_spaces))
        super().__init__(core.batch_size[0], autoreset_mode, *ordered)
        self._present = torch.zeros(self.num_envs, len(self.possible_agents), dtype=torch.bool)
        self._over: Tensor = torch.zeros(self.num_envs, dtype=torch.bool)

    @property
    def agents(self) -> list[list[Any]]:
        """Remaining agents of each environment."""
        return [[a for a in self.possible_agents if row[self._seats[a].column]] for row in self._present.tolist()]

    def get_attr(self, name: str) -> tuple[object, ...]:
        """Return ``satellites`` of every episode, lists of read-only views; AttributeError for other attributes."""
        if name != "satellites":
            raise AttributeError(
                f"{name!r}: episodes in one simulation have 'satellites'. vectorize='episodes' makes environments with all "
                "attributes and methods; env.core has those of all episodes together"
            )
        return tuple(satellites_of(self.core.fleet, env) for env in range(self.num_envs))

    def close(self) -> None:
        """Close the simulation."""
        self.core.close()

    # -- reset and step -----------------------------------------------------------------------------------------------

    def reset(
        self, seed: int | Sequence[int | None] | None = None, options: dict[str, object] | None = None
    ) -> tuple[ByAgent, ByAgent]:
        """Start episodes; return observations and infos.

        Args:
            seed: One seed for the batch, whose environments differ by their index, or one for each environment; None for the next
                episodes of the present seeds.
            options: ``{"reset_mask": mask}`` with booleans [N] leaves the other environments unchanged.
        """
        rows = torch.as_tensor(self._reset_rows(options))
        if seed is not None:
            self.core.reseed(seed, rows)
        self._begin(rows)
        return self._observations(self.core.observe(), self._present), self._infos(
            self._present, torch.zeros(self.num_envs, dtype=torch.float64)
        )

    def _begin(self, rows: Tensor) -> None:
        begin(self.core, rows)
        alive = ~self.core.dead & ~self.core.fleet.state.removed
        self._present, self._over, self._started = torch.where(rows.unsqueeze(-1), alive, self._present), self._over & ~rows, True

    def step(self, actions: Mapping[Any, Any]) -> tuple[ByAgent, ByAgent, ByAgent, ByAgent, ByAgent]:
        """See :class:`AgentsVector`; TypeError for actions that are not integers."""
        self._check_step(actions)
        waiting, before = self._over, self._present
        results = self.core.play(self._tables(actions), ~waiting)
        ended, cut = ends(self.core)
        moved = before & ~waiting.unsqueeze(-1)
        remaining = moved & ~self.core.dead & ~cut.unsqueeze(-1)
        self._present = torch.where(waiting.unsqueeze(-1), before, remaining)
        self._over = ~waiting & (~remaining | ended | cut.unsqueeze(-1)).all(1)
        rewards = torch.zeros(moved.shape, dtype=torch.float64)
        for seat in self._seats.values():
            rewards[:, seat.column] = results[seat.group, "reward"][:, seat.number, 0].double()
        duration = results["duration"].squeeze(-1).double().masked_fill(waiting, 0.0)
        if bool(waiting.any()):
            self._begin(waiting)
            fresh = self.core.observe()
            for group in self.core.groups:
                rows, new = (tree[group.name, "observation"] for tree in (results, fresh))
                results[group.name, "observation"] = torch.where(waiting.view(-1, 1, 1), new, rows)
        present = torch.where(waiting.unsqueeze(-1), self._present, moved)
        columns = (rewards * moved, ended & moved, cut.unsqueeze(-1) & moved)
        return (self._observations(results, present), *map(self._by_agent, columns), self._infos(present, duration))  # type: ignore[return-value]

    def _tables(self, actions: Mapping[object, object]) -> list[Tensor]:
        """Return the actions of each group, [N, A], which continue the tasks of agents without one."""
        tables = {group.name: torch.full((self.num_envs, len(group.agents)), NO_ACTION) for group in self.core.groups}
        for agent, each in actions.items():
            chosen = np.asarray(each)
            if chosen.dtype.kind not in "iu":
                raise TypeError(f"actions[{agent!r}] has dtype {chosen.dtype}; it must be an integer array, such as np.int64")
            seat = self._seats[agent]
            table, acts = tables[seat.group], self._present[:, seat.column] & ~self._over
            table[:, seat.number] = torch.where(acts, torch.as_tensor(chosen), table[:, seat.number])
        return list(tables.values())

    # -- results -------------------------------------------------------------------------------------------------------

    def _by_agent(self, table: Tensor) -> ByAgent:
        return {agent: as_numpy(table[:, seat.column]) for agent, seat in self._seats.items()}

    def _observations(self, results: TensorDictBase, present: Tensor) -> ByAgent:
        """Return the observations of agents that are ``present`` [N, S], zero elsewhere."""
        observations = ByAgent()
        for agent, (group, number, column) in self._seats.items():
            rows = results[group, "observation"][:, number]
            observations[agent] = as_numpy(torch.where(present[:, column].unsqueeze(-1), rows, torch.zeros_like(rows)))
        return observations

    def _infos(self, present: Tensor, duration: Tensor) -> ByAgent:
        idle = self._by_agent(self.core.requires_retasking & present)
        flags, spent = self._by_agent(present), self._by_agent(duration.unsqueeze(-1) * present)
        return {a: {"requires_retasking": idle[a], "d_ts": spent[a], "present": flags[a]} for a in self.possible_agents}
