"""Gymnasium's interface to one episode of a constellation with one agent for all satellites."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from gymnasium import spaces

from bsk_torch.env import ConstellationTasking
from bsk_torch.env.action_forms import form
from bsk_torch.wrappers.core import Results, as_numpy, build, parse_render_mode
from bsk_torch.wrappers.episode import GymEpisode
from bsk_torch.wrappers.spaces import action_space, unbounded
from bsk_torch.wrappers.tasks import legal_tasks, read_one, read_task, satellite_infos

Core = ConstellationTasking | str | Callable[..., ConstellationTasking]
"""An environment with ``joint=True``, the name of a preset, or a function that returns an environment."""


class GymJointEnv(GymEpisode):
    """One episode at a time, as ``gymnasium.Env``, with tuples of observations and actions.

    Observations and actions are tuples with an entry for each satellite; ``None`` or ``NO_ACTION`` continues the satellite's
    task. The reward is the sum over all satellites. ``info`` has, under the name of each satellite, ``requires_retasking`` and
    its counters; and ``d_ts`` (duration of the step, s) and ``action_mask`` (a mask for each satellite, int8, 1 for actions that
    are legal as new tasks). The batched environment is :attr:`core`.

    Example:
        >>> env = GymJointEnv("Constellation-v1", n_satellites=3, n_targets=100, backend="eager", time_limit=60.0)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step((0, None, 5))
    """

    def __init__(self, core: Core, *, render_mode: str | None = None, **options: object) -> None:
        """Wrap one environment.

        Args:
            core: A :class:`~bsk_torch.ConstellationTasking` with ``num_envs=1`` and ``joint=True``, a function that returns one,
                or the name of a preset.
            render_mode: ``"rgb_array"`` for pictures by :meth:`render`, which need the extra ``viz``.
            **options: Arguments for the preset or function, such as ``time_limit=600.0``.
        """
        self.render_mode = parse_render_mode(render_mode)
        joint = {"joint": True} if isinstance(core, str) else {}
        self.core = build(core, joint | options, ConstellationTasking)
        if self.core.batch_size != (1,):
            raise ValueError(f"core has num_envs={self.core.batch_size[0]}; GymJointEnv needs 1")
        if not self.core.joint:
            raise ValueError("core has joint=False, an agent for each satellite; PettingZooEnv is the view of it")
        group = self.core.groups[0]
        self._parts = [self.core.satellites[t] for t in group.types]
        self._rows = [(t, int(within)) for t, within in zip(group.types, group.within, strict=True)]
        self._widths = [len(part.observation_description) for part in self._parts]
        self.observation_space = spaces.Tuple([unbounded((width,), self.core.dtype) for width in self._widths])
        self.action_space = spaces.Tuple([action_space(part) for part in self._parts])
        self._every = torch.ones(1, dtype=torch.bool, device=self.core.device)

    core: ConstellationTasking

    def step(self, action: Sequence[object]) -> tuple[tuple[Any, ...], float, bool, bool, dict[str, Any]]:
        """Carry out the actions until the first satellite has finished its task.

        Raises:
            ResetNeeded: If no episode is running.
            ValueError: For a wrong number of actions, or one out of range; no state has changed then.
            TypeError: For an action that is not an integer.
        """
        self._check_running()
        return self._ended(self.core.play([self._decoded(action)], self._every))

    def _decoded(self, action: Sequence[object]) -> object:
        """Return the actions [1, S], or by the names of the satellites where some are real numbers."""
        if len(action) != len(self._parts):
            raise ValueError(f"action has {len(action)} entries; it must have {len(self._parts)}, one per satellite")
        triples = list(zip(self.core.names, action, self._parts, strict=True))
        device = self.core.device
        if all(form(part) is None for part in self._parts):
            values = [read_task(f"action of {name!r}", value, part) for name, value, part in triples]
            return torch.tensor([values], dtype=torch.int64, device=device)
        return {name: read_one(f"action of {name!r}", value, part).unsqueeze(0).to(device) for name, value, part in triples}

    def _observation(self, results: Results) -> tuple[object, ...]:
        return tuple(as_numpy(part) for part in results["observation"][0].split(self._widths))

    def _info(self, results: Results) -> dict[str, Any]:
        legal, infos = legal_tasks(self.core), satellite_infos(self.core, results)
        masks = tuple(None if (mask := legal[t]) is None else mask[row].copy() for t, row in self._rows)
        self.latest_step_duration = float(results["duration"])
        return dict(zip(self.core.names, infos, strict=True)) | {"d_ts": self.latest_step_duration, "action_mask": masks}
