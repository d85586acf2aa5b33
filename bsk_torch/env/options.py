"""Options shared by all environments: one list of names, defaults and meanings, used by the constructors."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor

from bsk_torch._checks import number, switch, whole
from bsk_torch.act.base import SHORTEST
from bsk_torch.codegen.inductor import BACKENDS
from bsk_torch.rand import Distribution
from bsk_torch.sats.satellite import as_dtype
from bsk_torch.sim.assembly.satellite_type import LONGEST_TICK, ORBITS, SHORTEST_TICK
from bsk_torch.sim.names import nearest, one_of
from bsk_torch.sim.world import WorldModel

TimeLimit = float | Distribution | Callable[[], float]

Class = TypeVar("Class", bound=type)

SIM_DTYPES = (torch.float64, torch.float32)

MOST_PENALTY = 1e30
"""Bound of the failure penalty, so that a sum of several stays finite in float32."""

ABSENT = {
    "vizard_dir": "there is no Vizard here; env.render() draws pictures, and 'bsk-torch film' makes films",
    "vizard_settings": "there is no Vizard here; env.render() draws pictures, and 'bsk-torch film' makes films",
    "render_mode": "env.render() returns pixels",
}
"""Options accepted only as None, and their replacements."""


CONTINUOUS = "continuous"

FAILURES = ("step", CONTINUOUS)
"""When it is checked whether satellites have failed."""

COMPATIBLE = (None, "bsk_rl")
"""Simulators whose errors can be reproduced."""


@dataclass(frozen=True, kw_only=True)
class TaskingOptions:
    """Options of :class:`bsk_torch.SatelliteTasking` and :class:`bsk_torch.ConstellationTasking`, given as keyword arguments.

    Attributes:
        num_envs: Number of episodes N.
        world_type: World model, or several, of :mod:`bsk_torch.sim.world`, of which the first takes precedence; None for those
            required by the dynamics models of the satellites.
        world_args: Arguments of the world, like ``sat_args``, also as one callable that returns a dictionary; see
            :meth:`~bsk_torch.env.base.Tasking.default_world_args`.
        sim_rate: Length of a tick, 0.001 to 60 s.
        max_step_duration: Maximum length of a step, s; at least 1 ns.
        failure_penalty: Added to the reward of a step at the end of which the satellite is dead.
        failures: ``"step"``: satellites are checked at the end of each step only, and a battery may be empty before
            that. ``"continuous"``: the first tick at whose end a battery is empty, or a wheel has reached its largest speed, ends
            the step for all satellites. Other checks remain at the end of steps.
        time_limit: Seconds after which an episode is truncated, rounded up to whole ticks; a positive number, a distribution or a
            callable without arguments. If infinite, episodes are truncated at the end of the Sun's ephemeris, in 2060.
        terminate_on_time_limit: Whether the time limit also terminates: True for a task that is over at the limit, False for a
            sample of one that continues. Learners that follow ``terminated``, such as TorchRL's and Stable-Baselines3's, add the
            value of the last state to the return where it is False. No decision is ever made in that state, so choose True for
            them unless the policy must prepare for what follows. PPO and MAPPO of this package learn the return that ends at the
            limit in both cases; see ``beyond_limit`` of :class:`~bsk_torch.rl.training.config.PPOConfig`.
        device: Device of the simulation.
        seed: Seed of all draws, from 0 to 2**63 - 1; None for a random one.
        env_ids: Index of each episode in the draws, from 0 to 2**63 - 1; 0 to N - 1 by default.
        dtype: Type of observations, rewards and durations, of torch or NumPy; None for the type given by the satellites, or
            float32.
        sim_dtype: float64 for parity with Basilisk; float32 for mixed precision: attitude, wheels and flight software in float32,
            orbit, time and accumulators in float64.
        orbit: ``"arc"`` (solved in advance), ``"integrated"`` (integrated in every tick, with drag), ``"free"`` (also integrated,
            for satellites at rest, falling or escaping, without prediction of windows and eclipses), ``"sgp4"`` (sampled from
            SGP4, for satellites from element sets that must be where other tools put them; no maneuvers, no drag), or None for the default of
            the dynamics model.
        backend: ``"compiled"``, or ``"eager"`` for debugging.
        compat: ``"bsk_rl"`` reproduces bsk_rl's errors, listed in ``docs/migration_reference.md``, for comparisons; None for
            correct results.
        replan: Whether windows and eclipses are predicted again after maneuvers; None means True, or False with
            ``compat="bsk_rl"``, whose look-ahead uses the initial orbit of an episode.
        log_level: Level of the package's logger: ``"INFO"`` records satellite events, see :mod:`bsk_torch.env.log`; None leaves
            it unchanged.
        log_dir: Path of a file for the records.
        log_envs: Environments whose satellites are recorded (default: the first one).
    """

    num_envs: int = 1
    world_type: type[WorldModel] | Sequence[type[WorldModel]] | None = None
    world_args: Mapping[str, Any] | Callable[[], Mapping[str, Any]] | None = None
    sim_rate: float = 1.0
    max_step_duration: float = 1e9
    failure_penalty: float = -1.0
    failures: str = "step"
    time_limit: TimeLimit = float("inf")
    terminate_on_time_limit: bool = False
    device: torch.device | str = "cpu"
    seed: int | None = None
    env_ids: Sequence[int] | Tensor | None = None
    dtype: Any = None
    sim_dtype: torch.dtype = torch.float64
    orbit: str | None = None
    backend: str = "compiled"
    compat: str | None = None
    replan: bool | None = None
    log_level: int | str | None = None
    log_dir: str | Path | None = None
    log_envs: Sequence[int] = (0,)

    def __post_init__(self) -> None:
        penalty = number("failure_penalty", self.failure_penalty, -MOST_PENALTY, MOST_PENALTY)
        checked = {
            "num_envs": whole("num_envs", self.num_envs, 1, 2**31 - 1),
            "sim_rate": number("sim_rate", self.sim_rate, SHORTEST_TICK, LONGEST_TICK, unit="s"),
            "max_step_duration": number("max_step_duration", self.max_step_duration, SHORTEST, unit="s", finite=False),
            "failure_penalty": penalty,
            "terminate_on_time_limit": switch("terminate_on_time_limit", self.terminate_on_time_limit),
            "dtype": as_dtype(self.dtype),
            "seed": None if self.seed is None else whole("seed", self.seed, 0, 2**63 - 1),
        }
        for name, allowed in (("sim_dtype", SIM_DTYPES), ("backend", BACKENDS), ("compat", COMPATIBLE)):
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name}={getattr(self, name)!r} must be one of {list(allowed)}")
        if self.orbit not in (None, *ORBITS):
            raise ValueError(f"orbit={self.orbit!r} must be one of {list(ORBITS)}, or None for the model's own")
        one_of("failures", self.failures, FAILURES)
        if self.replan and self.compat is not None:
            raise ValueError(
                f"replan={self.replan!r} with compat={self.compat!r}: its look-ahead follows no maneuver; leave one out"
            )
        checked["replan"] = self.compat is None if self.replan is None else switch("replan", self.replan)
        for name, value in checked.items():
            object.__setattr__(self, name, value)


@dataclass(frozen=True, kw_only=True)
class ConstellationOptions(TaskingOptions):
    """Further options of :class:`bsk_torch.ConstellationTasking`.

    Attributes:
        joint: Whether one agent commands all satellites and gets one reward. Its keys
            are at the root: ``observation`` [N, O], ``action`` [N, S], ``action_mask``, ``reward`` [N, 1],
            ``requires_retasking`` [N, S]. The episode ends when any satellite dies.
        meta_agent_groupings: Names of the satellites of agents that command several; their actions are [N, A, M].
        only_retask_idle_meta_agent_members: Whether such agents' actions for busy satellites are ignored.
        group_map: Names of the agents of each group (default: by types of satellites).
        generate_obs_retasking_only: Whether agents that do not need a task observe zeros.
        mask_busy: Whether ``action_mask`` allows busy satellites only to continue.
        continue_repeated: Whether a busy satellite for which the action in progress is chosen again continues it, with its
            deadline and what it has held; else the action starts over.
        population: Minimum and maximum number of present satellites in an episode. All numbers, and all choices of satellites,
            are equally likely. By default, all are present in all episodes, or the scenario draws the present ones
            (:meth:`bsk_torch.scene.Scenario.present`).
    """

    joint: bool = False
    meta_agent_groupings: Mapping[str, Sequence[str]] | None = None
    only_retask_idle_meta_agent_members: bool = False
    group_map: Mapping[str, Sequence[str]] | None = None
    generate_obs_retasking_only: bool = False
    mask_busy: bool = True
    continue_repeated: bool = False
    population: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        switches = ("joint", "only_retask_idle_meta_agent_members", "generate_obs_retasking_only", "mask_busy")
        for name in (*switches, "continue_repeated"):
            object.__setattr__(self, name, switch(name, getattr(self, name)))
        if self.joint and (self.meta_agent_groupings or self.group_map):
            raise ValueError("joint=True puts all satellites under one agent; leave meta_agent_groupings and group_map out")
        if self.population is not None:
            if not isinstance(self.population, Sequence) or isinstance(self.population, str) or len(self.population) != 2:
                raise ValueError(f"population={self.population!r} must be the minimum and maximum number of satellites")
            low = whole("population[0]", self.population[0], 1)
            object.__setattr__(self, "population", (low, whole("population[1]", self.population[1], low)))


def parse(kind: type[TaskingOptions], options: Mapping[str, Any]) -> Any:
    """Return the options of the class ``kind``; TypeError for an unknown name."""
    names = [option.name for option in fields(kind)]
    options = {name: value for name, value in options.items() if name not in ABSENT or value is not None}
    for name in options:
        if name in ABSENT:
            raise TypeError(f"{name}={options[name]!r} is no option here: {ABSENT[name]}")
        if name not in names:
            raise TypeError(  # TorchRL's GymEnv tries arguments, and recognizes rejected ones by this wording
                f"unexpected keyword argument {name!r}: {name}= is not an option of the environment; {nearest(name, names)}"
            )
    return kind(**options)


def takes(kind: type[TaskingOptions]) -> Callable[[Class], Class]:
    """Return a decorator that lists the options of the class ``kind`` in an environment's signature, instead of ``**options``."""
    keywords = [
        inspect.Parameter(option.name, inspect.Parameter.KEYWORD_ONLY, default=option.default, annotation=option.type)
        for option in fields(kind)
    ]

    def decorate(env: Class) -> Class:
        parameters = [
            p for p in inspect.signature(vars(env)["__init__"]).parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD
        ]
        env.__signature__ = inspect.Signature([*parameters[1:], *keywords])  # type: ignore[attr-defined]
        return env

    return decorate
