"""What the satellites of a constellation were told and paid in an episode, decision by decision."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor

from bsk_torch.env import NO_ACTION, ConstellationTasking
from bsk_torch.env.action_forms import acts, form, read
from bsk_torch.env.agents import Group
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.viz.table import Tasks


class Task(NamedTuple):
    """A task: which satellite began it when, and what it was, by its name."""

    satellite: int
    begin: float
    name: str


class DecisionLog:
    """Notes the decisions and rewards of episode 0 of an environment.

    Attributes:
        tasks: All tasks in the order of time.
        rewards: Rewards of the steps, [S] each: of an agent at its first satellite, nan for all others.
        numbers: Actions of real numbers in the steps, [S, A] each; nan where a satellite has fewer of them, or continues.
    """

    def __init__(self, env: ConstellationTasking) -> None:
        """Note the decisions of ``env``."""
        self.env, self.size = env, env.fleet.size
        self.tasks: list[Task] = []
        self.rewards: list[Tensor] = []
        self.numbers: list[Tensor] = []
        builders = (form(satellite) for satellite in env.satellites)
        self.width = max((builder.width for builder in builders if builder is not None), default=0)

    def note(self, step: TensorDictBase, begin: float, removed: Tensor) -> None:
        """Note a step from ``begin`` on, s; satellites that were ``removed`` [S] before it do nothing."""
        rewards = torch.full((self.size,), torch.nan, dtype=torch.float64)
        numbers = torch.full((self.size, self.width), torch.nan, dtype=torch.float64)
        for group in self.env.groups:
            rewards[group.members[:, 0].cpu()] = step["next", group.name, "reward"][0].flatten().double().cpu()
            first = self.env.satellites[group.types[0]]
            if form(first) is not None:
                self._note_real(group, first, step[group.name, "action"][0], begin, removed, numbers)
            else:
                self._note_chosen(group, step[group.name, "action"][0], begin, removed)
        self.rewards.append(rewards)
        self.numbers.append(numbers)

    def _note_chosen(self, group: Group, action: Tensor, begin: float, removed: Tensor) -> None:
        """Note the tasks of agents that choose among numbered actions."""
        for row, members in zip(action.view(len(group.agents), -1).tolist(), group.members.tolist(), strict=True):
            for number, satellite, kind in zip(row, members, group.types, strict=True):
                actions = self.env.satellites[kind].actions
                if number not in (actions.n_actions, NO_ACTION) and not bool(removed[satellite]):
                    self.tasks.append(Task(satellite, begin, actions.entries[actions.entry_of(number)].name))

    def _note_real(
        self, group: Group, satellite: SatelliteGroup, action: Tensor, begin: float, removed: Tensor, numbers: Tensor
    ) -> None:
        """Note the tasks of agents whose actions are real numbers, and these."""
        given = read("action", action, satellite, (len(group.agents),))
        for number, row, new in zip(group.members[:, 0].tolist(), given, acts(given, satellite, 1).tolist(), strict=True):
            if new and not bool(removed[number]):
                self.tasks.append(Task(number, begin, satellite.actions.entries[0].name))
                numbers[number, : len(row)] = row.double().cpu()

    def tasks_of(self, shown: Sequence[int], last: float) -> Tasks:
        """Return the tasks of the satellites ``shown``, numbered among these, in an episode that ended at ``last``, s.

        A task ends with the satellite's next one.
        """
        number = {satellite: k for k, satellite in enumerate(shown)}
        kept = [task for task in self.tasks if task.satellite in number]
        names = list(dict.fromkeys(task.name for task in kept))
        until, spans = dict.fromkeys(number, last), []
        for task in reversed(kept):
            spans.append([task.begin, until[task.satellite]])
            until[task.satellite] = task.begin
        return Tasks(
            satellite=torch.tensor([number[task.satellite] for task in kept], dtype=torch.int64),
            spans=torch.tensor(spans[::-1], dtype=torch.float64).reshape(-1, 2),
            kind=torch.tensor([names.index(task.name) for task in kept], dtype=torch.int64),
            names=names,
        )
