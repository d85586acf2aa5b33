"""Stable-Baselines3's vectorized environment over the batched one: N episodes in one simulation, without subprocesses."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import Wrapper, spaces
from gymnasium.vector import AutoresetMode

from bsk_torch.env.action_forms import form
from bsk_torch.sim.arguments.values import nearest
from bsk_torch.wrappers.core import check_options
from bsk_torch.wrappers.gymnasium.single import Core
from bsk_torch.wrappers.gymnasium.vector import GymVectorEnv
from bsk_torch.wrappers.metrics import METRICS, BatchCallback
from bsk_torch.wrappers.spaces import flat, flat_rows

__all__ = ["MetricsCallback", "SB3VecEnv"]

try:
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvStepReturn
except ImportError as error:
    raise ImportError("SB3VecEnv is an environment of Stable-Baselines3: pip install 'bsk_torch[sb3]'") from error


def flat_space(space: spaces.Space[object]) -> spaces.Space[object]:
    """Return a Box unchanged, and for nested observations a Dict of one level, such as ``sat_props/storage_level_fraction``."""
    if not isinstance(space, spaces.Dict):
        return space
    boxes = flat(space.spaces)  # Stable-Baselines3 flattens from the second dimension on, which a batch of scalars has not
    return spaces.Dict({name: b if b.shape else spaces.Box(-np.inf, np.inf, (1,), b.dtype) for name, b in boxes.items()})


def by_row(columns: Mapping[str, Any], rows: Sequence[int] | slice = slice(None)) -> list[dict[str, Any]]:
    """Return a vector environment's info [N, ...] as a dictionary for each of ``rows``, without the boolean companions."""
    entries = {name: column[rows] for name, column in columns.items() if not name.startswith(("_", "final_"))}
    values = [column.tolist() if column.ndim == 1 else list(column) for column in entries.values()]
    return [dict(zip(entries, row, strict=True)) for row in zip(*values, strict=True)]


logger = logging.getLogger(__name__)

MASK = "action_mask"
"""Entry of infos with the legal actions."""


class SB3VecEnv(VecEnv):
    """N episodes in one simulation, as Stable-Baselines3's ``VecEnv``; episodes that end restart at once.

    ``infos`` has for each episode the entries of :class:`~bsk_torch.wrappers.GymEnv`, ``TimeLimit.truncated``, and at an end
    ``terminal_observation``. ``reset_infos`` are the infos with which new episodes begin. Named observations have one level
    of names, such as ``sat_props/storage_level_fraction``. sb3-contrib's MaskablePPO calls :meth:`action_masks`; other algorithms
    ignore masks, of which the log warns once, when an action is chosen that a mask forbids.
    Stable-Baselines3 discounts per decision, however long it took: ``infos[k]["duration"]``, s;
    :mod:`bsk_torch.rl.stable_baselines3` changes that. The batched environment is :attr:`core`.

    Example:
        >>> from sb3_contrib import MaskablePPO
        >>> env = SB3VecEnv("NadirScan-v1", num_envs=64)
        >>> MaskablePPO("MlpPolicy", env, n_steps=32).learn(100_000)
    """

    _warned = False

    def __init__(
        self,
        core: Core,
        num_envs: int | None = None,
        *,
        render_mode: str | None = None,
        metrics: BatchCallback | None = None,
        **options: Any,
    ) -> None:
        """Wrap a batch of environments.

        Args:
            core: A :class:`~bsk_torch.SatelliteTasking`, the name of a preset, or a function that returns an environment.
            num_envs: Number of environments; None for what ``core`` says.
            render_mode: ``"rgb_array"`` for pictures by :meth:`render`, tiled, which need the extra ``viz``.
            metrics: Function of :attr:`core` that returns numbers [N] by name: ``infos[k]["metrics"]`` has those of an episode
                that ends, and :class:`MetricsCallback` logs their means.
            **options: Arguments for the preset or function, such as ``time_limit=600.0``.

        Raises:
            TypeError: If ``core`` is a constellation, which has several agents.
            ValueError: For arguments that the environment does not take, or hybrid actions.
        """
        fixed: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_mode": render_mode, "metrics": metrics}
        self.vector = GymVectorEnv(core, num_envs, **fixed, **options)
        self.core = self.vector.core
        self._actions: np.ndarray | None = None
        self._begin_with: dict[str, object] = {}
        self._legal: np.ndarray | None = None
        builder = form(self.core.satellite)
        if builder is not None and builder.is_hybrid:
            raise ValueError(
                f"action {builder.entry.name!r} has real numbers and a choice, and Stable-Baselines3 knows no actions of several "
                "parts; write an act.ContinuousAction whose last number is the choice"
            )
        space = flat_space(self.vector.single_observation_space)
        super().__init__(self.vector.num_envs, space, self.vector.single_action_space)
        self.metadata = self.vector.metadata

    # -- episodes -----------------------------------------------------------------------------------------------------

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Start with the first episodes of ``seed`` at the next reset (random if None); they differ by their index."""
        self._seeds = [super().seed(seed)[0]] * self.num_envs
        return self._seeds

    def set_options(self, options: list[dict[str, object]] | dict[str, object] | None = None) -> None:
        """Begin at the next reset with ``{"state": state}`` of ``core.get_state()``; ValueError for other options."""
        if isinstance(options, list):
            raise ValueError(
                f"options is a list of {len(options)}; the episodes share one simulation, which takes one dictionary"
            )
        self._begin_with = check_options(options, ("state",))

    def reset(self) -> Any:
        """Start the next episodes, or those of :meth:`seed` or :meth:`set_options`; return their observations, [N, ...]."""
        observation, info = self.vector.reset(seed=self._seeds, options=self._begin_with)
        self._reset_seeds()
        self._begin_with, self._actions = {}, None
        self._legal = None if self._warned else info.get(MASK)
        self.reset_infos = by_row(info)
        return self._observed(observation)

    def step_async(self, actions: np.ndarray) -> None:
        """Store the ``actions`` [N] of the next step."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Execute the stored actions; ValueError or TypeError for actions outside the space, before any state changes."""
        if self._actions is None:
            raise RuntimeError("step_wait() needs actions; call step_async(actions) first, or step(actions)")
        actions, self._actions = self._actions, None
        self._warn_of_masks(actions)
        observation, reward, terminated, truncated, info = self.vector.step(actions)
        self._legal = None if self._warned else info.get(MASK)
        cut, ended = {"TimeLimit.truncated": truncated & ~terminated}, terminated | truncated
        measured = info.pop(METRICS, {})
        infos = by_row(info | cut)
        if ended.any():
            self._replace(infos, info, cut, np.flatnonzero(ended).tolist())
        if measured:
            for row in np.flatnonzero(ended).tolist():
                infos[row][METRICS] = {name: float(values[row]) for name, values in measured.items()}
        return self._observed(observation), reward.astype(np.float32), ended, infos

    def _warn_of_masks(self, actions: np.ndarray) -> None:
        """Warn once about masked actions [N], which are executed nevertheless."""
        if self._legal is None or np.shape(actions) != (self.num_envs,):
            return
        rows, choices = np.arange(self.num_envs), np.asarray(actions)
        inside = (choices >= 0) & (choices < self._legal.shape[1])
        if not self._legal[rows[inside], choices[inside].astype(np.int64)].all():
            self._warned, self._legal = True, None
            logger.warning(
                "the policy chooses actions that the mask forbids: Stable-Baselines3's own algorithms ignore masks; train with "
                "MaskablePPO of sb3-contrib, which asks env.action_masks()"
            )

    def _replace(self, infos: list[dict[str, Any]], info: dict[str, Any], cut: dict[str, Any], rows: list[int]) -> None:
        """Put the last infos of the episodes ``rows`` in the place of those that the next ones begin with."""
        for row, final in zip(rows, by_row(info["final_info"] | cut, rows), strict=True):
            self.reset_infos[row] = {name: value for name, value in infos[row].items() if name not in cut}
            infos[row] = final | {"terminal_observation": self._observed(info["final_obs"][row], 0)}

    def _observed(self, observation: object, batch_dims: int = 1) -> Any:
        return flat_rows(observation, batch_dims) if isinstance(observation, Mapping) else observation

    def close(self) -> None:
        """Close the views; nothing else needs closing."""
        self.vector.close()

    # -- calls of single environments ---------------------------------------------------------------------------------

    def action_masks(self) -> np.ndarray:
        """Return which actions are legal now, [N, n] bool; sb3-contrib calls a method of this name."""
        return self.vector.action_masks()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return a picture of the current state of each episode, [480, 640, 3] uint8; None without render mode."""
        return self.vector.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[object]:
        """Return an attribute of the vector environment or of :attr:`core` for each episode; AttributeError if none has it."""
        for owner in (self.vector, self.core):
            if hasattr(owner, attr_name):
                return [getattr(owner, attr_name) for _ in self._get_indices(indices)]
        raise AttributeError(f"attr_name={attr_name!r} is an attribute neither of GymVectorEnv nor of {type(self.core).__name__}")

    def set_attr(self, attr_name: str, value: object, indices: VecEnvIndices = None) -> None:
        """NotImplementedError: there are no single environments to set it in."""
        raise NotImplementedError(f"the episodes share one simulation; set {attr_name!r} in its attribute core, for all of them")

    def env_method(
        self, method_name: str, *method_args: object, indices: VecEnvIndices = None, **method_kwargs: object
    ) -> list[object]:
        """Return results of ``action_masks()`` or ``render()`` for each episode; AttributeError for other methods."""
        methods: dict[str, Callable[..., Any]] = {"action_masks": self.action_masks, "render": self.get_images}
        if method_name not in methods:
            raise AttributeError(
                f"method_name={method_name!r} cannot be called in single episodes; {nearest(method_name, methods)}"
            )
        results = methods[method_name](*method_args, **method_kwargs)
        return [results[row] for row in self._get_indices(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[Wrapper[object, object, object, object]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """False for each episode: single environments are not wrapped, ``VecEnvWrapper`` is for the batch."""
        return [False for _ in self._get_indices(indices)]


class MetricsCallback(BaseCallback):
    """Logs the means of the metrics of the episodes that have ended since the last log, as ``episode/<name>``.

    Example:
        >>> env = SB3VecEnv("NadirScan-v1", num_envs=64, metrics=lambda env: {"reward": sum(env.rewarder.cum_reward.values())})
        >>> PPO("MlpPolicy", env).learn(100_000, callback=MetricsCallback())
    """

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            for name, value in info.get(METRICS, {}).items():
                self.logger.record_mean(f"episode/{name}", value)
        return True
