"""Operations shared by all wrappers: build the batched environment, check options, start episodes, render."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any, TypeAlias, TypeVar, cast

import gymnasium
import numpy as np
import torch
from gymnasium.error import ResetNeeded
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from bsk_torch.env import NO_ACTION, ConstellationTasking, SatelliteTasking
from bsk_torch.env.action_forms import form, read
from bsk_torch.env.base import ResetNeededError, Tasking
from bsk_torch.env.no_action import is_no_action
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.presets import make
from bsk_torch.wrappers.solo import SoloTasking, deciding

Kind = TypeVar("Kind", bound=Tasking)

RENDERING: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}
"""Metadata of wrappers. A step lasts minutes, so ten frames in a second make a video slow enough."""

FITTING: dict[type[Tasking], str] = {
    SatelliteTasking: "bsk_torch.wrappers.gymnasium.GymEnv or bsk_torch.wrappers.gymnasium.GymVectorEnv",
    ConstellationTasking: "bsk_torch.wrappers.pettingzoo.parallel_env or bsk_torch.wrappers.general.GymJointEnv",
}
"""Views of each kind of environment, named in messages."""

RESULTS = ("observation", "action_mask", "duration", "counts")
"""Results of a step that environments keep while others are reset."""

Results: TypeAlias = "Mapping[str, Any] | TensorDictBase"
"""Results of a reset or step by name."""


def build(core: Kind | str | Callable[..., Kind], options: dict[str, object], kind: type[Kind]) -> Kind:
    """Return the environment of a wrapper.

    Args:
        core: An environment, the name of a preset, or a function that returns an environment.
        options: Arguments of the preset or function.
        kind: Class that the wrapper needs. For views of one satellite, a constellation in which one satellite alone has a choice
            is a :class:`~bsk_torch.wrappers.solo.SoloTasking`; one that has been built needs ``joint=True``.

    Raises:
        TypeError: For an environment of another class, or options that come with an environment that has been built.
    """
    if isinstance(core, Tasking):
        if options:
            raise TypeError(f"options {sorted(options)} come with a ready environment; give them to the environment instead")
        env: Any = core
    else:
        env = make(core, **options) if isinstance(core, str) else core(**options)
        if isinstance(core, str) and kind is SatelliteTasking and isinstance(env, ConstellationTasking) and not env.joint:
            env = make(core, **options, joint=True)
    if kind is SatelliteTasking and isinstance(env, ConstellationTasking) and len(deciding(env)) == 1:
        return cast(Kind, SoloTasking(env))
    if not isinstance(env, kind):
        subject = f"core={core!r} makes" if isinstance(core, str) else "core is or makes"
        needs = f"this view needs a {kind.__name__}"
        fitting = next((f"; use {views}" for cls, views in FITTING.items() if isinstance(env, cls)), "")
        raise TypeError(f"{subject} a {type(env).__name__}; {needs}{fitting}")
    return env


def check_options(options: dict[str, object] | None, allowed: Collection[str]) -> dict[str, object]:
    """Return the options of a reset; ValueError for an unknown one."""
    options = options or {}
    unknown = sorted(set(options) - set(allowed))
    if unknown:
        raise ValueError(f"options has unknown keys {unknown}; allowed are {sorted(allowed)}")
    return options


def begin(
    core: Tasking, mask: Tensor, results: TensorDictBase | None = None, state: TensorDictBase | None = None
) -> TensorDictBase:
    """Start new episodes, or restore a state of ``core.get_state()``.

    Args:
        core: The environment.
        mask: Environments to start, [N] bool.
        results: Last results of all environments. Without it TorchRL's reset returns zeros for those outside ``mask``.
        state: State to restore; None for new episodes.

    Returns:
        Results for all environments; ``results`` itself is left alone.
    """
    call = (
        TensorDict({}, core.batch_size, device=core.device) if results is None else results.select(*RESULTS, strict=False).clone()
    )
    call["_reset"] = mask.unsqueeze(-1)
    if state is not None:
        call["state"] = state.clone()
    return core.reset(call, set_state=state is not None)


def read_values(where: str, action: object, satellite: SatelliteGroup, rows: tuple[int, ...] = ()) -> Tensor:
    """Return continuous actions, [*rows, A], or hybrid actions with the choice last, [*rows, A + 1].

    Args:
        where: Name of the argument, for messages.
        action: Array or tensor, whose type is kept; nested sequences of numbers, which are float64; for hybrid actions also a
            mapping of ``"values"`` and ``"choice"``. None, or ``NO_ACTION`` in all numbers, continues the task, without
            ``rows``.
        satellite: The satellite.
        rows: Leading dimensions.

    Raises:
        TypeError: For another type.
        ValueError: For another shape.
    """
    if not rows and is_no_action(action):
        builder = form(satellite)
        return torch.full((0 if builder is None else builder.width,), float(NO_ACTION), dtype=torch.float64)
    if isinstance(action, Mapping):
        return read(where, {name: _tensor(where, part) for name, part in action.items()}, satellite, rows)
    return read(where, _tensor(where, action, torch.float64), satellite, rows)


def _tensor(where: str, value: object, dtype: torch.dtype | None = None) -> Tensor:
    """Return an array or tensor as a tensor of its type, and numbers in sequences in ``dtype``; TypeError for anything else."""
    try:
        if isinstance(value, np.ndarray | np.generic | Tensor):
            return torch.as_tensor(value)
        return torch.as_tensor(np.asarray(value, dtype=float if dtype is not None else None))
    except (TypeError, ValueError) as error:
        raise TypeError(f"{where} is {value!r}; it must be numeric: {error}") from error


def as_action(core: Tasking, action: object) -> Tensor:
    """Return numbers in any form as a tensor on the core's device; TypeError for anything else."""
    try:
        return torch.as_tensor(action, device=core.device)
    except (TypeError, ValueError, RuntimeError) as error:
        raise TypeError(f"action={action!r} must be numeric: {error}") from error


def read_actions(core: SatelliteTasking, action: object) -> Tensor:
    """Return actions [N, ...] on the core's device, which checks their dtype and range.

    Raises:
        TypeError: If they are not numbers.
        ValueError: For another shape.
    """
    if form(core.satellite) is not None:
        return read_values("action", action, core.satellite, tuple(core.batch_size)).to(core.device)
    tensor = as_action(core, action)
    if tensor.shape != core.batch_size:
        raise ValueError(f"action has shape {list(tensor.shape)}; it must be {list(core.batch_size)}, one per environment")
    return tensor


def as_numpy(value: Tensor) -> np.ndarray:
    """Return a copy as an array."""
    return value.cpu().numpy().copy()


def counts(results: Results) -> dict[str, Tensor]:
    """Return the counters of an environment, such as images, by name; [N, S] int64 each."""
    return dict(results["counts"].items()) if "counts" in results.keys() else {}  # noqa: SIM118  - a tensordict


def parse_render_mode(mode: str | None) -> str | None:
    """Return the render mode; ValueError for an unknown one."""
    if mode is not None and mode not in RENDERING["render_modes"]:
        raise ValueError(f"render_mode={mode!r} must be one of {RENDERING['render_modes']}, or None")
    return mode


def check_begun(core: Tasking, call: str) -> None:
    """Raise ResetNeeded unless the episodes of an environment have begun; ``call`` is what the user called."""
    try:
        core.guard.check_begun(call)
    except ResetNeededError as error:
        raise ResetNeeded(str(error)) from error


def snapshots(core: Tasking, mode: str | None) -> tuple[np.ndarray, ...] | None:
    """Return a picture of each environment, [480, 640, 3] uint8; None, with a warning, without a render mode."""
    if mode is None:
        gymnasium.logger.warn("render() draws nothing without a render mode; make the environment with render_mode='rgb_array'")
        return None
    check_begun(core, "render()")
    return tuple(core.render(rows=range(core.batch_size[0])).cpu().numpy())
