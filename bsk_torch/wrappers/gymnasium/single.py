"""Gymnasium's interface to one episode of one satellite."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bsk_torch.env import SatelliteTasking
from bsk_torch.env.action_forms import form
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.wrappers.core import (
    Results,
    as_action,
    as_numpy,
    build,
    check_begun,
    counts,
    parse_render_mode,
    read_actions,
    read_values,
)
from bsk_torch.wrappers.episode import GymEpisode
from bsk_torch.wrappers.spaces import action_space, map_leaves, observation_space

Core = SatelliteTasking | str | Callable[..., SatelliteTasking]
"""An environment, the name of a preset, or a function that returns an environment."""


class GymEnv(GymEpisode):
    """One episode at a time, as ``gymnasium.Env``.

    The action space is Discrete, a Box where actions are real numbers, or for hybrid actions a Dict of both, ``values`` and
    ``choice``; of real numbers, None or ``NO_ACTION`` in all of them continues the task, and there is no ``action_mask``.

    ``info`` has ``action_mask`` ([n] int8, 1 for legal actions), ``duration`` (of the step, s; also under bsk_rl's name
    ``d_ts``), ``requires_retasking`` (bool), and the counters of satellite and rewarder, such as ``imaged`` and ``missed`` of
    imaging satellites (int). The batched environment is :attr:`core`; :class:`~bsk_torch.wrappers.episode.EpisodeView` has what
    bsk_rl's environments have, such as ``satellite``, ``simulator.sim_time`` and ``rewarder.cum_reward``.

    Example:
        >>> env = GymEnv("NadirScan-v1", backend="eager", time_limit=600.0)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample(info["action_mask"]))
    """

    def __init__(self, core: Core, *, render_mode: str | None = None, **options: object) -> None:
        """Wrap an environment of one episode.

        Args:
            core: A :class:`~bsk_torch.env.SatelliteTasking` with ``num_envs=1``, the name of a preset, or a function that returns
                such an environment.
            render_mode: ``"rgb_array"`` for pictures by :meth:`render`, which need the extra ``viz``.
            **options: Arguments for the preset or function, such as ``time_limit=600.0``.
        """
        self.render_mode = parse_render_mode(render_mode)
        self.core = build(core, options, SatelliteTasking)
        if self.core.batch_size != (1,):
            raise ValueError(f"core has num_envs={self.core.batch_size[0]}; GymEnv needs 1, GymVectorEnv takes more")
        self.observation_space = observation_space(self.core.observation_spec["observation"])
        self.action_space = action_space(self.core.satellite)

    core: SatelliteTasking

    @property
    def satellite(self) -> BoundSatellite:
        """The satellite, whose properties are tensors [1, ...]."""
        return self.core.satellite

    def step(self, action: object) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Execute ``action`` until it ends, or an event, the time limit or ``max_step_duration`` ends the step.

        Raises:
            ResetNeeded: If no episode is running.
            ValueError: For an action out of range, of another shape, or that is not finite.
            TypeError: For an action of another type than those of the space.
        """
        self._check_running()
        if form(self.core.satellite) is None:
            actions = read_actions(self.core, as_action(self.core, action).reshape(-1))
        else:
            actions = read_values("action", action, self.core.satellite).unsqueeze(0).to(self.core.device)
        return self._ended(self.core.played(actions))

    def action_masks(self) -> np.ndarray:
        """Return which actions are legal now, [n] bool; sb3-contrib calls a method of this name."""
        check_begun(self.core, "action_masks()")
        return as_numpy(self.core.satellite.action_mask()[0])

    def _observation(self, results: Results) -> object:
        return map_leaves(results["observation"][0], as_numpy)

    def _info(self, results: Results) -> dict[str, Any]:
        duration = self.latest_step_duration = float(results["duration"])
        legal = {"action_mask": as_numpy(results["action_mask"][0]).astype(np.int8)} if "action_mask" in results.keys() else {}  # noqa: SIM118
        return {
            **legal,
            "duration": duration,
            "d_ts": duration,
            "requires_retasking": bool(self.core.requires_retasking[0]),
            **{name: int(count) for name, count in counts(results).items()},
        }
