"""Gymnasium's two interfaces, one episode and a vector of them, over the batched environment."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any, ClassVar, TypeVar

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from bsk_torch.env import NO_ACTION, ConstellationTasking, SatelliteTasking
from bsk_torch.env.base import Tasking
from bsk_torch.presets import make
from bsk_torch.sats.satellite import Satellite

Core = SatelliteTasking | str | Callable[..., SatelliteTasking]
"""An environment, the name of a preset, or a function that returns an environment."""

Kind = TypeVar("Kind", bound=Tasking)

OUTPUTS = ("numpy", "torch")

SEED_LIMIT = 2**63

RENDERING: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}
"""What views tell of their pictures; steps last minutes, so videos are slow enough at ten of them in a second."""

SEEN = ("observation", "action_mask", "duration", "counts")


# -- all views --------------------------------------------------------------------------------------------------------


def build(core: Kind | str | Callable[..., Kind], options: dict[str, Any], kind: type[Kind]) -> Kind:
    """The environment behind a view, of the ``kind`` that it shows; ``options`` are arguments of the preset or function."""
    if isinstance(core, Tasking):
        if options:
            raise TypeError(f"options {sorted(options)} come with a ready environment; give them to the environment instead")
        env: Any = core
    else:
        env = make(core, **options) if isinstance(core, str) else core(**options)
    if not isinstance(env, kind):
        named = f"core={core!r} makes" if isinstance(core, str) else "core is or makes"
        raise TypeError(f"{named} a {type(env).__name__}; this view needs a {kind.__name__}")
    return env


def observation_space(spec: Any, batch_dims: int = 1) -> spaces.Space[Any]:
    """Space of one environment's observation, or of one agent's: a Box, or a Dict of them for a Composite spec."""
    if hasattr(spec, "items"):
        return spaces.Dict({name: observation_space(part, batch_dims) for name, part in spec.items()})
    return unbounded(tuple(spec.shape[batch_dims:]), spec.dtype)


def unbounded(shape: tuple[int, ...], dtype: torch.dtype) -> spaces.Box:
    """Space of all arrays of a shape."""
    return spaces.Box(-np.inf, np.inf, shape, torch.empty((), dtype=dtype).numpy().dtype.type)


def action_space(core: SatelliteTasking) -> spaces.Discrete:
    """Space of one environment's action."""
    return spaces.Discrete(core.satellite.actions.n_actions)


def as_numpy(value: Tensor) -> np.ndarray:
    """A copy that nobody else holds."""
    return value.cpu().numpy().copy()


def map_leaves(value: Any, function: Callable[[Tensor], Any]) -> Any:
    """``function`` of an observation, or of every part of a named one, as nested dictionaries."""
    if isinstance(value, Tensor):
        return function(value)
    return {name: map_leaves(part, function) for name, part in value.items()}


def counts(seen: TensorDictBase) -> dict[str, Tensor]:
    """What an environment counts, such as images, [N, 1] each, by name."""
    return dict(seen["counts"].items()) if "counts" in seen.keys() else {}  # noqa: SIM118  - a tensordict


def read_actions(core: SatelliteTasking, action: Any) -> Tensor:
    """Actions [N] on the core's device; the core checks their type and range."""
    tensor = torch.as_tensor(action, device=core.device)
    if tensor.shape != core.batch_size:
        raise ValueError(f"action has shape {list(tensor.shape)}; it must be {list(core.batch_size)}, one per environment")
    return tensor


def check_options(options: dict[str, Any] | None, allowed: Collection[str]) -> dict[str, Any]:
    """The options of a reset; ValueError for an unknown one."""
    options = options or {}
    unknown = sorted(set(options) - set(allowed))
    if unknown:
        raise ValueError(f"options has unknown keys {unknown}; allowed are {sorted(allowed)}")
    return options


def check_seeds(seed: int | Sequence[int | None], count: int) -> list[int | None]:
    """One seed for each of ``count`` environments: the same for all, or those of a list, where None keeps the present one."""
    seeds: list[int | None] = [seed] * count if isinstance(seed, int | np.integer) else list(seed)
    if len(seeds) != count:
        raise ValueError(f"seed has {len(seeds)} entries; it must be an integer or have {count}, one per environment")
    for value in seeds:
        if value is not None and not (isinstance(value, int | np.integer) and 0 <= value < SEED_LIMIT):
            raise ValueError(f"seed={value!r} must be an integer from 0 to 2**63 - 1")
    return seeds


def reseed(core: Tasking, seed: int | Sequence[int | None], rows: Tensor) -> None:
    """Let the environments ``rows`` [N] start their first episode of ``seed`` at the next reset."""
    seeds = check_seeds(seed, len(rows))
    given = rows & torch.tensor([value is not None for value in seeds], device=rows.device)
    values = torch.tensor([value or 0 for value in seeds], dtype=torch.int64, device=rows.device)
    core.seed_rows = torch.where(given, values, core.seed_rows)
    core.episode = core.episode.masked_fill(given, -1)


def parse_render_mode(mode: str | None) -> str | None:
    """The render mode; ValueError for one that no view has."""
    if mode is not None and mode not in RENDERING["render_modes"]:
        raise ValueError(f"render_mode={mode!r} must be one of {RENDERING['render_modes']}, or None")
    return mode


def snapshots(core: Tasking, mode: str | None) -> tuple[np.ndarray, ...] | None:
    """A picture [480, 640, 3] uint8 of each environment; None, with a warning, where there is no render mode."""
    if mode is None:
        gymnasium.logger.warn("render() draws nothing without a render mode; make the environment with render_mode='rgb_array'")
        return None
    if bool((core.episode < 0).any()):
        raise ResetNeeded("render() needs an episode; call reset() first")
    return tuple(core.render(rows=range(core.batch_size[0])).cpu().numpy())


def begin(core: Tasking, rows: Tensor, seen: TensorDictBase | None = None, state: TensorDictBase | None = None) -> TensorDictBase:
    """Start new episodes in ``rows`` [N], or put a state of ``core.get_state()`` back; what all environments see then.

    ``seen`` is what they saw last: TorchRL's reset returns zeros for the other rows without it, and writes into what it is given.
    """
    call = TensorDict({}, core.batch_size, device=core.device) if seen is None else seen.select(*SEEN, strict=False).clone()
    call["_reset"] = rows.unsqueeze(-1)
    if state is not None:
        call["state"] = state.clone()
    return core.reset(call, set_state=state is not None)


# -- views of constellations ------------------------------------------------------------------------------------------


def read_task(where: str, value: Any, satellite: Satellite, extra: int = 0) -> int:
    """A satellite's action; None for going on. ``extra`` actions beyond its own, with which it also goes on, are legal."""
    n, explicit = satellite.actions.n_actions, satellite.actions.explicit
    if value is None:
        return NO_ACTION
    if isinstance(value, np.ndarray | Tensor) and value.ndim == 0:
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise TypeError(f"{where} is {value!r}; it must be an integer, or None to go on with the task")
    if value != NO_ACTION and not -explicit <= value < n + extra:
        names = [f"{k}: {name}" for k, name in enumerate(satellite.action_description)]
        names += [f"-1 to {-explicit}: a target by its index"] if explicit else []
        names += [f"{n} or None: go on" if extra else "None: go on"]
        raise ValueError(f"{where} is {value}; it must be one of {', '.join(names)}")
    return int(value)


def legal_tasks(core: ConstellationTasking) -> list[np.ndarray]:
    """Which actions are legal as new tasks, [count, n] int8 for each type of satellites."""
    return [as_numpy(part.action_mask()).astype(np.int8) for part in core.satellites]


def satellite_infos(core: ConstellationTasking, seen: TensorDictBase) -> list[dict[str, Any]]:
    """Whether each satellite needs a task, and what is counted of it."""
    counted = {name: count[0].tolist() for name, count in counts(seen).items()}
    idle = core.requires_retasking[0].tolist()
    return [{"requires_retasking": idle[k], **{name: count[k] for name, count in counted.items()}} for k in range(len(idle))]


# -- one episode ------------------------------------------------------------------------------------------------------


class GymEnv(gymnasium.Env[Any, Any]):
    """One episode at a time, as ``gymnasium.Env``.

    ``info`` has ``action_mask`` (int8, 1 where an action is legal), ``duration`` (seconds that the step took; also under bsk_rl's
    name ``d_ts``), ``requires_retasking`` and, of imaging satellites, ``imaged``, ``missed`` and what the rewarder counts. The
    simulation is :attr:`core`.

    Example:
        >>> env = GymEnv("NadirScan-v1", backend="eager", time_limit=600.0)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample(info["action_mask"]))
    """

    metadata: ClassVar[dict[str, Any]] = RENDERING  # type: ignore[misc]

    def __init__(self, core: Core, *, render_mode: str | None = None, **options: Any) -> None:
        """Wrap one environment.

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
        self.action_space = action_space(self.core)
        self._running = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: The episodes that follow are those of this seed; None for the next episode of the present one.
            options: ``{"state": state}`` starts from a state of ``core.get_state()`` instead.
        """
        options = check_options(options, ("state",))
        super().reset(seed=seed)
        every = torch.ones_like(self.core.dead)
        if seed is not None:
            reseed(self.core, seed, every)
        seen = begin(self.core, every, state=options.get("state"))
        self._running = True
        return self._observation(seen), self._info(seen)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Do ``action`` until the step ends by itself; ValueError or TypeError for an action outside the space."""
        if not self._running:
            raise ResetNeeded("step() needs a running episode; call reset() first")
        actions = read_actions(self.core, torch.as_tensor(action).reshape(-1))
        seen = self.core.play(actions)
        terminated, truncated = bool(seen["terminated"]), bool(seen["truncated"])
        self._running = not (terminated or truncated)
        return self._observation(seen), float(seen["reward"]), terminated, truncated, self._info(seen)

    def render(self) -> np.ndarray | None:
        """A picture of the present, [480, 640, 3] uint8; see :meth:`bsk_torch.env.base.Tasking.render`."""
        pictures = snapshots(self.core, self.render_mode)
        return pictures[0] if pictures else None

    def action_masks(self) -> np.ndarray:
        """Legal actions now, [n] booleans; the name that sb3-contrib asks for."""
        return as_numpy(self.core.satellite.action_mask()[0])

    def _observation(self, seen: TensorDictBase) -> Any:
        return map_leaves(seen["observation"][0], as_numpy)

    def _info(self, seen: TensorDictBase) -> dict[str, Any]:
        duration = float(seen["duration"])
        return {
            "action_mask": as_numpy(seen["action_mask"][0]).astype(np.int8),
            "duration": duration,
            "d_ts": duration,
            "requires_retasking": bool(self.core.requires_retasking[0]),
            **{name: int(count) for name, count in counts(seen).items()},
        }


# -- many episodes ----------------------------------------------------------------------------------------------------


def parse_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """The autoreset mode of a name such as ``"SameStep"``."""
    names = [member.value for member in AutoresetMode]
    if not isinstance(mode, AutoresetMode) and mode not in names:
        raise ValueError(f"autoreset_mode={mode!r} must be a gymnasium.vector.AutoresetMode or one of {names}")
    return AutoresetMode(mode)


class GymVectorEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """N episodes in one simulation, as ``gymnasium.vector.VectorEnv``.

    Environment i plays what ``GymEnv(..., env_ids=[i])`` plays, to rounding. ``info`` has the entries of :class:`GymEnv` as
    arrays, valid for every environment after every call, each with its boolean companion (``_duration``).
    """

    metadata: ClassVar[dict[str, Any]] = RENDERING | {"autoreset_mode": AutoresetMode.NEXT_STEP}  # type: ignore[misc]

    def __init__(
        self,
        core: Core,
        num_envs: int | None = None,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        output: str = "numpy",
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        """Wrap a batch of environments.

        Args:
            core: A :class:`~bsk_torch.env.SatelliteTasking`, the name of a preset, or a function that returns an environment.
            num_envs: Number of environments; None for what ``core`` says.
            autoreset_mode: Environments whose episode has ended start anew in the next step, which ignores their action and
                rewards them with 0 (``NEXT_STEP``); at once, with what they saw last in ``info["final_obs"]`` and
                ``info["final_info"]`` (``SAME_STEP``); or in ``reset(options={"reset_mask": ended})`` (``DISABLED``).
            output: ``"numpy"``, or ``"torch"`` for tensors on the core's device and in its dtype; ``final_obs`` is then batched.
            render_mode: ``"rgb_array"`` for pictures by :meth:`render`, which need the extra ``viz``.
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
        self._seen: Any = None

    def _make_spaces(self) -> None:
        self.single_observation_space = observation_space(self.core.observation_spec["observation"])
        self.single_action_space = action_space(self.core)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    # -- reset --------------------------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start episodes.

        Args:
            seed: One seed for the batch, whose environments differ by their index, or one for each environment, where None keeps
                the present seed; None for the next episode of the present seeds.
            options: ``{"reset_mask": mask}`` with booleans [N] leaves the other environments as they are; ``{"state": state}``
                starts from a state of ``core.get_state()``.
        """
        options = check_options(options, ("reset_mask", "state"))
        rows = self._rows(options.get("reset_mask"))
        super().reset(seed=seed if isinstance(seed, int) else None)
        if seed is not None:
            reseed(self.core, seed, rows)
        self._seen = begin(self.core, rows, self._seen, options.get("state"))
        self._over = self._over & ~rows
        return self._observation(self._seen), self._info(self._seen, self._every)

    def _rows(self, mask: Any) -> Tensor:
        """Environments to reset, [N]."""
        if mask is None:
            return self._every
        rows = torch.as_tensor(mask, device=self._every.device)
        if rows.dtype != torch.bool or rows.shape != self._every.shape or not bool(rows.any()):
            raise ValueError(
                f"options['reset_mask'] has dtype {rows.dtype}, shape {list(rows.shape)} and {int(rows.sum())} entries that are "
                f"true; it must have dtype bool, shape [{self.num_envs}] and at least one"
            )
        if self._seen is None and not bool(rows.all()):
            raise ResetNeeded("the first reset() must start all environments; leave out options['reset_mask']")
        return rows

    # -- step ---------------------------------------------------------------------------------------------------------

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Do ``actions`` [N]; ValueError or TypeError for actions outside the space, before anything moves."""
        self._check_ready()
        same = self.autoreset_mode is AutoresetMode.SAME_STEP
        waiting = self._over
        seen = self._move(read_actions(self.core, actions), waiting)
        ended = (seen["terminated"] | seen["truncated"]).squeeze(-1)
        anew = ended if same else waiting
        self._over = torch.zeros_like(ended) if same else ended
        results = [self._number(seen["reward"]), *(self._export(seen[name].squeeze(-1)) for name in ("terminated", "truncated"))]
        info = {}
        if bool(anew.any()):
            info = self._final(seen, ended) if same else {}
            seen = begin(self.core, anew, seen)
        self._seen = seen
        return self._observation(seen), results[0], results[1], results[2], info | self._info(seen, self._every)

    def _check_ready(self) -> None:
        if self._seen is None:
            raise ResetNeeded("step() needs running episodes; call reset() first")
        if self.autoreset_mode is AutoresetMode.DISABLED and bool(self._over.any()):
            rows = torch.nonzero(self._over).squeeze(-1).tolist()
            raise ResetNeeded(
                f"episodes of environments {rows[:5]} ({len(rows)} in all) have ended; call reset(options={{'reset_mask': mask}})"
            )

    def _move(self, action: Tensor, waiting: Tensor) -> TensorDictBase:
        """Results of a step of the environments that do not wait for a reset; zero reward and flags for the others."""
        if not bool(waiting.any()):
            return self.core.step(TensorDict({"action": action}, self.core.batch_size, device=self.core.device))["next"]
        call = self._seen.select(*SEEN, strict=False)  # which TorchRL returns where nobody moves
        call["action"], call["_step"] = action.masked_fill(waiting, 0), ~waiting
        seen = self.core.step(call)["next"]
        for name in ("reward", "terminated", "truncated"):
            seen[name] = seen[name].masked_fill(waiting.unsqueeze(-1), 0)
        return seen

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture of every environment, [480, 640, 3] uint8 each; ``core.render(rows=0)`` draws one of many."""
        return snapshots(self.core, self.render_mode)

    def action_masks(self) -> Any:
        """Legal actions now, [N, n] booleans."""
        return self._export(self.core.satellite.action_mask())

    # -- output -------------------------------------------------------------------------------------------------------

    def _export(self, value: Tensor) -> Any:
        return value.clone() if self.output == "torch" else as_numpy(value)

    def _number(self, value: Tensor) -> Any:
        """Numbers [N] of a column [N, 1]; Gymnasium's arrays of rewards are float64."""
        return self._export(value.squeeze(-1) if self.output == "torch" else value.squeeze(-1).double())

    def _observation(self, seen: TensorDictBase) -> Any:
        return map_leaves(seen["observation"], self._export)

    def _info(self, seen: TensorDictBase, rows: Tensor) -> dict[str, Any]:
        """Info of ``rows`` [N] with companions; zero elsewhere."""
        others = ~rows.unsqueeze(-1)
        duration = seen["duration"].masked_fill(others, 0)
        values = {
            "action_mask": self._export(seen["action_mask"].to(torch.int8).masked_fill(others, 0)),
            "duration": self._number(duration),
            "d_ts": self._number(duration),
            "requires_retasking": self._export(self.core.requires_retasking & rows),
            **{name: self._export(count.squeeze(-1).masked_fill(~rows, 0)) for name, count in counts(seen).items()},
        }
        return values | {f"_{name}": self._export(rows) for name in values}

    def _final(self, seen: TensorDictBase, ended: Tensor) -> dict[str, Any]:
        """What the environments ``ended`` [N] saw last."""
        values = {"final_obs": self._last_observation(seen["observation"], ended), "final_info": self._info(seen, ended)}
        return values | {f"_{name}": self._export(ended) for name in values}

    def _last_observation(self, observation: Any, ended: Tensor) -> Any:
        if self.output == "torch":
            return map_leaves(observation, torch.clone)
        rows, on_host = np.full(self.num_envs, None, dtype=object), observation.cpu()
        for row in torch.nonzero(ended).squeeze(-1).tolist():
            rows[row] = map_leaves(on_host[row], as_numpy)
        return rows
