"""A constellation in which one satellite alone chooses among actions, as an environment of one satellite."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite

from bsk_torch.env import NO_ACTION, ConstellationTasking
from bsk_torch.env.action_forms import form, mask_size
from bsk_torch.env.satellite_group import SatelliteGroup

Columns = dict[str, object]
"""Results of a step or reset by name, [N, ...] each."""


def deciding(env: ConstellationTasking) -> list[int]:
    """Return the columns of the satellites that have more than one action."""
    group = env.groups[0]
    parts = [env.satellites[t] for t in group.types] if env.joint else []
    return [k for k, part in enumerate(parts) if form(part) is not None or part.actions.n_actions > 1]


class SoloTasking:
    """What views of one satellite read of a constellation with ``joint=True``, in which only one satellite decides.

    All other satellites begin their only action when they need a task. Observation, mask and counters are those of the deciding
    satellite; as in :class:`~bsk_torch.wrappers.GymJointEnv`, the reward is the sum over all satellites, and an episode ends with
    the first death. All other attributes are those of the constellation, :attr:`team`.
    """

    def __init__(self, team: ConstellationTasking) -> None:
        """View ``team``, of which :func:`deciding` returns one satellite."""
        self.team, (self._column,) = team, deciding(team)
        group = team.groups[0]
        parts = [team.satellites[t] for t in group.types]
        self.satellite: SatelliteGroup = parts[self._column]
        widths = [len(part.observation_description) for part in parts]
        begin = sum(widths[: self._column])
        self._slice = slice(begin, begin + widths[self._column])
        self._all_numbered = all(form(part) is None for part in parts)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # methods with which Python copies and pickles are not those of the constellation
            raise AttributeError(name)
        return getattr(self.team, name)

    def __reduce__(self) -> tuple[type[SoloTasking], tuple[ConstellationTasking]]:
        """Copy and pickle the constellation alone, which builds its satellites again."""
        return SoloTasking, (self.team,)

    @property
    def observation_spec(self) -> Composite:
        """Spec of the observation of the deciding satellite."""
        spec = self.team.observation_spec["observation"][..., self._slice]
        return Composite({"observation": spec}, shape=self.team.batch_size, device=self.team.device)

    @property
    def dead(self) -> Tensor:
        """Whether the deciding satellite is dead, [N]."""
        return self.team.dead[:, self._column]

    @property
    def requires_retasking(self) -> Tensor:
        """Whether the deciding satellite needs a task, [N]."""
        return self.team.requires_retasking[:, self._column]

    def reset(self, call: TensorDictBase, **options: object) -> TensorDict:
        """Start the episodes ``_reset`` [N, 1] of ``call``; the others keep its other entries."""
        starts = call["_reset"].squeeze(-1)
        ask = TensorDict({name: call[name] for name in ("_reset", "state") if name in call.keys()}, call.batch_size)  # noqa: SIM118
        return self._merged(self._columns(self.team.reset(ask, **options)), call, starts)

    def step(self, call: TensorDictBase) -> TensorDict:
        """Execute the actions of ``call`` in the episodes ``_step`` [N]; results are under ``next``, those of the others kept."""
        moves = call.get("_step", torch.ones_like(self.dead))
        return TensorDict({"next": self._merged(self._play(call["action"], moves), call, moves)}, call.batch_size)

    def played(self, action: Tensor) -> Columns:
        """Execute ``action`` [N, ...]; return the results."""
        return self._play(action, torch.ones_like(self.dead))

    def _play(self, action: Tensor, moves: Tensor) -> Columns:
        tasks = torch.where(self.team.requires_retasking, 0, NO_ACTION)
        if self._all_numbered:
            tasks[:, self._column] = action
            actions: object = tasks
        else:
            actions = {name: tasks[:, k] for k, name in enumerate(self.team.names)} | {self.team.names[self._column]: action}
        return self._columns(self.team.play([actions], moves))

    def _columns(self, results: TensorDictBase) -> Columns:
        """Return the results of the deciding satellite among those of the constellation."""
        columns = {"observation": results["observation"][:, self._slice]}
        columns |= {name: results[name] for name in ("reward", "terminated", "truncated", "duration") if name in results.keys()}  # noqa: SIM118
        if mask_size(self.satellite):
            columns["action_mask"] = self.satellite.action_mask()
        if "counts" in results.keys():  # noqa: SIM118
            columns["counts"] = {name: count[:, [self._column]] for name, count in results["counts"].items()}
        return columns

    @staticmethod
    def _merged(new: Columns, call: TensorDictBase, rows: Tensor) -> TensorDict:
        """Return ``new`` results in ``rows`` [N], and those of ``call`` in the others, where it has them."""
        merged = TensorDict(new, call.batch_size, device=rows.device)
        earlier = call.select(*new, strict=False)
        for name in earlier.keys(include_nested=True, leaves_only=True):
            merged[name] = merged[name].clone()
            merged[name][~rows] = earlier[name][~rows]
        return merged
