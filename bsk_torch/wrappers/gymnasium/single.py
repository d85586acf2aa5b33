"""Gymnasium's interface to one episode of one satellite."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
from gymnasium.error import ResetNeeded
from tensordict import TensorDictBase

from bsk_torch.env import SatelliteTasking
from bsk_torch.env.action_forms import form
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.wrappers.core import (
    RENDERING,
    as_action,
    as_numpy,
    begin,
    build,
    check_begun,
    check_options,
    counts,
    parse_render_mode,
    read_actions,
    read_values,
    snapshots,
)
from bsk_torch.wrappers.episode import EpisodeView
from bsk_torch.wrappers.spaces import action_space, map_leaves, observation_space

Core = SatelliteTasking | str | Callable[..., SatelliteTasking]
"""An environment, the name of a preset, or a function that returns an environment."""


class GymEnv(EpisodeView, gymnasium.Env[Any, Any]):
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

    metadata: ClassVar[dict[str, Any]] = RENDERING  # type: ignore[misc]

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
        self._running = False

    core: SatelliteTasking

    @property
    def satellite(self) -> BoundSatellite:
        """The satellite, whose properties are tensors [1, ...]."""
        return self.core.satellite

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: Begin with the first episode of this seed; None for the next episode of the present seed.
            options: ``{"state": state}`` starts from a state of ``core.get_state()`` instead.
        """
        options = check_options(options, ("state",))
        super().reset(seed=seed)
        if seed is not None:
            self.core.reseed(seed)
        seen = begin(self.core, torch.ones_like(self.core.dead), state=options.get("state"))
        self._running = True
        return self._observation(seen), self._info(seen)

    def step(self, action: object) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Execute ``action`` until it ends, or an event, the time limit or ``max_step_duration`` ends the step.

        Raises:
            ResetNeeded: If no episode is running.
            ValueError: For an action out of range, of another shape, or that is not finite.
            TypeError: For an action of another type than those of the space.
        """
        if not self._running:
            raise ResetNeeded("step() needs a running episode; call reset() first")
        if form(self.core.satellite) is None:
            actions = read_actions(self.core, as_action(self.core, action).reshape(-1))
        else:
            actions = read_values("action", action, self.core.satellite).unsqueeze(0).to(self.core.device)
        seen = self.core.played(actions)
        terminated, truncated = bool(seen["terminated"]), bool(seen["truncated"])
        self._running = not (terminated or truncated)
        return self._observation(seen), float(seen["reward"]), terminated, truncated, self._info(seen)

    def render(self) -> np.ndarray | None:
        """Return a picture of the current state, [480, 640, 3] uint8; see :meth:`bsk_torch.env.base.Tasking.render`."""
        pictures = snapshots(self.core, self.render_mode)
        return pictures[0] if pictures else None

    def action_masks(self) -> np.ndarray:
        """Return which actions are legal now, [n] bool; sb3-contrib calls a method of this name."""
        check_begun(self.core, "action_masks()")
        return as_numpy(self.core.satellite.action_mask()[0])

    def _observation(self, seen: Mapping[str, Any] | TensorDictBase) -> Any:
        return map_leaves(seen["observation"][0], as_numpy)

    def _info(self, seen: Mapping[str, Any] | TensorDictBase) -> dict[str, Any]:
        duration = self.latest_step_duration = float(seen["duration"])
        legal = {"action_mask": as_numpy(seen["action_mask"][0]).astype(np.int8)} if "action_mask" in seen.keys() else {}  # noqa: SIM118
        return {
            **legal,
            "duration": duration,
            "d_ts": duration,
            "requires_retasking": bool(self.core.requires_retasking[0]),
            **{name: int(count) for name, count in counts(seen).items()},
        }
