"""Gymnasium's vector interface to N episodes of one satellite in one simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from bsk_torch.env import SatelliteTasking
from bsk_torch.env.base import Tasking
from bsk_torch.sats import Satellite
from bsk_torch.wrappers.core import (
    RENDERING,
    RESULTS,
    as_numpy,
    begin,
    build,
    check_begun,
    check_options,
    counts,
    parse_render_mode,
    read_actions,
    snapshots,
)
from bsk_torch.wrappers.gymnasium.single import Core
from bsk_torch.wrappers.metrics import METRICS, BatchCallback, read_metrics
from bsk_torch.wrappers.spaces import action_space, map_leaves, observation_space

OUTPUTS = ("numpy", "torch")


def parse_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return the autoreset mode of a name such as ``"SameStep"``; ValueError for an unknown name."""
    names = [member.value for member in AutoresetMode]
    if not isinstance(mode, AutoresetMode) and mode not in names:
        raise ValueError(f"autoreset_mode={mode!r} must be a gymnasium.vector.AutoresetMode or one of {names}")
    return AutoresetMode(mode)


class GymVectorEnv(gymnasium.vector.VectorEnv[object, object, object]):
    """N episodes in one simulation, as ``gymnasium.vector.VectorEnv``.

    Episodes of environment i equal those of ``GymEnv(..., env_ids=[i])``, to rounding. ``info`` has the entries of
    :class:`~bsk_torch.wrappers.GymEnv` as arrays, valid for every environment after every call, each with its boolean companion
    (``_duration``).
    """

    metadata: ClassVar[dict[str, object]] = RENDERING | {"autoreset_mode": AutoresetMode.NEXT_STEP}  # type: ignore[misc]

    def __init__(
        self,
        core: Core,
        num_envs: int | None = None,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        output: str = "numpy",
        render_mode: str | None = None,
        metrics: BatchCallback | None = None,
        **options: object,
    ) -> None:
        """Wrap a batch of environments.

        Args:
            core: A :class:`~bsk_torch.env.SatelliteTasking`, the name of a preset, or a function that returns an environment.
            num_envs: Number of environments N; None for that of ``core``.
            autoreset_mode: When environments start their next episode: in the step after the end, which ignores their action and
                gives them the reward 0 (``NEXT_STEP``); in the same step, with the last results in ``info["final_obs"]`` and
                ``info["final_info"]`` (``SAME_STEP``); or in ``reset(options={"reset_mask": ended})`` (``DISABLED``).
            output: ``"numpy"``, or ``"torch"`` for tensors on the core's device and in its dtype; ``final_obs`` is then batched.
            render_mode: ``"rgb_array"`` for pictures by :meth:`render`, which need the extra ``viz``.
            metrics: Function of :attr:`core` that returns numbers [N] by name, called when episodes end: ``info["metrics"]`` has
                those of the episodes that have ended in this step, zeros for the others (marked in ``info["_metrics"]``).
            **options: Arguments for the preset or function, such as ``time_limit=600.0``.
        """
        if output not in OUTPUTS:
            raise ValueError(f"output={output!r} must be one of {list(OUTPUTS)}")
        self.autoreset_mode, self.output = parse_mode(autoreset_mode), output
        self.render_mode = parse_render_mode(render_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}  # type: ignore[misc]
        asks = num_envs is not None and not isinstance(core, Tasking)
        self.core = build(core, options | ({"num_envs": num_envs} if asks else {}), SatelliteTasking)
        self.num_envs = self.core.batch_size[0]
        if num_envs not in (None, self.num_envs):
            raise ValueError(f"num_envs={num_envs}, but core has {self.num_envs}")
        self._make_spaces()
        self._every = torch.ones_like(self.core.dead)
        self._over = ~self._every
        self._results: Any = None
        self._metrics = metrics

    def _make_spaces(self) -> None:
        self.single_observation_space = observation_space(self.core.observation_spec["observation"])
        self.single_action_space = action_space(self.core.satellite)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    @property
    def satellite(self) -> Satellite:
        """The satellite, whose properties are tensors [N, ...] of all episodes."""
        return self.core.satellite

    # -- reset --------------------------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, object] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start episodes.

        Args:
            seed: One seed for the batch, whose environments differ by their index, or one for each environment, where None keeps
                the present seed. None for the next episodes of the present seeds.
            options: ``{"reset_mask": mask}`` with booleans [N] leaves the other environments unchanged; ``{"state": state}``
                starts from a state of ``core.get_state()``.
        """
        options = check_options(options, ("reset_mask", "state"))
        rows = self._rows(options.get("reset_mask"))
        super().reset(seed=seed if isinstance(seed, int) else None)
        if seed is not None:
            self.core.reseed(seed, rows)
        self._results = begin(self.core, rows, self._results, options.get("state"))
        self._over = self._over & ~rows
        return self._observation(self._results), self._info(self._results, self._every)

    def _rows(self, mask: object) -> Tensor:
        """Return which environments to reset, [N] bool."""
        if mask is None:
            return self._every
        rows = torch.as_tensor(mask, device=self._every.device)
        if rows.dtype != torch.bool or rows.shape != self._every.shape or not bool(rows.any()):
            raise ValueError(
                f"options['reset_mask'] has dtype {rows.dtype}, shape {list(rows.shape)} and {int(rows.sum())} entries that are "
                f"true; it must have dtype bool, shape [{self.num_envs}] and at least one"
            )
        if self._results is None and not bool(rows.all()):
            raise ResetNeeded("the first reset() must start all environments; leave out options['reset_mask']")
        return rows

    # -- step ---------------------------------------------------------------------------------------------------------

    def step(self, actions: object) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Carry out ``actions`` [N, ...]; ValueError or TypeError for actions outside the space, before any state changes."""
        self._check_ready()
        same = self.autoreset_mode is AutoresetMode.SAME_STEP
        waiting = self._over
        results = self._move(read_actions(self.core, actions), waiting)
        ended = (results["terminated"] | results["truncated"]).squeeze(-1)
        starting = ended if same else waiting
        self._over = torch.zeros_like(ended) if same else ended
        reward = self._number(results["reward"])
        terminated, truncated = (self._export(results[name].squeeze(-1)) for name in ("terminated", "truncated"))
        info = self._measured(ended & ~waiting) if self._metrics is not None else {}
        if bool(starting.any()):
            if same:
                final = {
                    "final_obs": self._last_observation(results["observation"], ended),
                    "final_info": self._info(results, ended),
                }
                info |= final | {f"_{name}": self._export(ended) for name in final}
            results = begin(self.core, starting, results)
        self._results = results
        return self._observation(results), reward, terminated, truncated, info | self._info(results, self._every)

    def _check_ready(self) -> None:
        if self._results is None:
            raise ResetNeeded("step() needs running episodes; call reset() first")
        if self.autoreset_mode is AutoresetMode.DISABLED and bool(self._over.any()):
            rows = torch.nonzero(self._over).squeeze(-1).tolist()
            raise ResetNeeded(
                f"episodes of environments {rows[:5]} ({len(rows)} in all) have ended; call reset(options={{'reset_mask': mask}})"
            )

    def _move(self, action: Tensor, waiting: Tensor) -> TensorDictBase:
        """Step the environments that are not ``waiting`` [N] for a reset; zero reward and flags for the others."""
        if not bool(waiting.any()):
            return self.core.step(TensorDict({"action": action}, self.core.batch_size, device=self.core.device))["next"]
        call = self._results.select(*RESULTS, strict=False)  # TorchRL returns these for environments that take no step
        call["action"], call["_step"] = action.masked_fill(waiting.view(-1, *[1] * (action.ndim - 1)), 0), ~waiting
        results = self.core.step(call)["next"]
        for name in ("reward", "terminated", "truncated"):
            results[name] = results[name].masked_fill(waiting.unsqueeze(-1), 0)
        return results

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return a picture of every environment, [480, 640, 3] uint8 each; ``core.render(rows=0)`` draws one of many."""
        return snapshots(self.core, self.render_mode)

    def action_masks(self) -> Any:
        """Return which actions are legal now, [N, n] bool."""
        check_begun(self.core, "action_masks()")
        return self._export(self.core.satellite.action_mask())

    # -- output -------------------------------------------------------------------------------------------------------

    def _export(self, value: Tensor) -> object:
        return value.clone() if self.output == "torch" else as_numpy(value)

    def _number(self, value: Tensor) -> object:
        """Return numbers [N] of a column [N, 1]; Gymnasium's arrays of rewards are float64."""
        return self._export(value.squeeze(-1) if self.output == "torch" else value.squeeze(-1).double())

    def _observation(self, results: TensorDictBase) -> object:
        return map_leaves(results["observation"], self._export)

    def _info(self, results: TensorDictBase, rows: Tensor) -> dict[str, object]:
        """Return the info of the environments ``rows`` [N] bool, with companions; zero elsewhere."""
        elsewhere = ~rows.unsqueeze(-1)
        duration = results["duration"].masked_fill(elsewhere, 0)
        legal = results.get("action_mask", None)
        values = {
            **({} if legal is None else {"action_mask": self._export(legal.to(torch.int8).masked_fill(elsewhere, 0))}),
            "duration": self._number(duration),
            "d_ts": self._number(duration),
            "requires_retasking": self._export(self.core.requires_retasking & rows),
            **{name: self._export(count.squeeze(-1).masked_fill(~rows, 0)) for name, count in counts(results).items()},
        }
        return values | {f"_{name}": self._export(rows) for name in values}

    def _measured(self, ended: Tensor) -> dict[str, object]:
        """Return the metrics of the episodes that have ``ended`` [N] bool; nothing where none has."""
        if not bool(ended.any()):
            return {}
        metrics = read_metrics(self._metrics, self.core)  # type: ignore[arg-type]
        return {METRICS: {name: self._export(value.masked_fill(~ended, 0)) for name, value in metrics.items()}} | {
            f"_{METRICS}": self._export(ended)
        }

    def _last_observation(self, observation: Any, ended: Tensor) -> object:
        if self.output == "torch":
            return map_leaves(observation, torch.clone)
        rows, on_host = np.full(self.num_envs, None, dtype=object), observation.cpu()
        for row in torch.nonzero(ended).squeeze(-1).tolist():
            rows[row] = map_leaves(on_host[row], as_numpy)
        return rows
