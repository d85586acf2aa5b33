"""One batched simulation for N episodes of a program of bsk_rl whose classes are those of the package.

:func:`batched_core` writes the program for :mod:`bsk_torch`: satellites whose classes only set specifications, and
bsk_rl's own observations, actions, scenarios and rewarders have counterparts there. User functions are called for each
episode, unless they work on tensors. Anything without a counterpart raises :class:`NotBatchedError`.
"""

from __future__ import annotations

import copy
import inspect
from abc import ABC
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from torch import Tensor
from typing_extensions import override

from bsk_torch import act, comm, data, obs, rand, scene
from bsk_torch import sats as core_sats
from bsk_torch.bsk_rl import act as their_act
from bsk_torch.bsk_rl import comm as their_comm
from bsk_torch.bsk_rl import data as their_data
from bsk_torch.bsk_rl import obs as their_obs
from bsk_torch.bsk_rl import sats as their_sats
from bsk_torch.bsk_rl import scene as their_scene
from bsk_torch.bsk_rl.data.composition import ComposedReward
from bsk_torch.bsk_rl.data.resource_data import nothing
from bsk_torch.bsk_rl.data.unique_image_data import whole_priority
from bsk_torch.bsk_rl.defaults import world_defaults
from bsk_torch.bsk_rl.gym import ConstellationTasking, GeneralSatelliteTasking, SatelliteTasking
from bsk_torch.bsk_rl.obs.observations import LARGEST
from bsk_torch.bsk_rl.obs.relative_observations import PRESETS as RELATIVE
from bsk_torch.bsk_rl.per_episode.functions import per_episode
from bsk_torch.bsk_rl.per_episode.rewards import PerEpisodeReward
from bsk_torch.bsk_rl.per_episode.targets import PerEpisodeTargets
from bsk_torch.bsk_rl.per_episode.views import view_of
from bsk_torch.bsk_rl.scene.targets import uniform_priority
from bsk_torch.bsk_rl.sim.models import core_world, for_one_episode_only
from bsk_torch.bsk_rl.utils import orbital
from bsk_torch.env import ConstellationTasking as Constellation
from bsk_torch.env import SatelliteTasking as Core
from bsk_torch.env.base import Tasking
from bsk_torch.sim.places import TARGET_KIND
from bsk_torch.wrappers.gymnasium import GymVectorEnv

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite


class NotBatchedError(TypeError):
    """A program that cannot be one batched simulation; the message states the reason."""


class Stock(NamedTuple):
    """A class of bsk_rl's that has a counterpart in the core."""

    core: Callable[..., object]
    """The counterpart."""
    arguments: dict[str, str]
    """Arguments of both, and the attributes of an object of bsk_rl's class that hold them."""


def stock(theirs: ModuleType, core: ModuleType, **classes: str) -> dict[type, Stock]:
    """Return the counterparts of classes by their names and arguments, ``argument`` or ``argument=attribute``."""
    return {
        getattr(theirs, name): Stock(
            getattr(core, name), {argument: attribute or argument for argument, _, attribute in
                                  (entry.partition("=") for entry in arguments.split())}
        )
        for name, arguments in classes.items()
    }  # fmt: skip


def of_each(function: Callable[[float], float], values: Tensor) -> Tensor:
    """Return the results of a function of one number for each of ``values``."""
    return torch.tensor([float(function(value)) for value in values.flatten().tolist()], dtype=values.dtype).view_as(values)


class NothingHidden(data.UniqueImageReward):
    """Pays for first images, and hides no targets: in bsk_rl, several rewarders together hide none."""

    @override
    def selectable(self) -> Tensor:
        return self.scenario.available.unsqueeze(1).expand_as(self.known)


COMMANDS = ("Charge", "Drift", "NadirPoint", "Desat", "Downlink", "Scan")
COMMUNICATION = ("NoCommunication", "FreeCommunication", "LOSCommunication", "LOSMultiCommunication")
TARGETS = "n_targets=_n_targets priority_distribution radius"

COUNTERPARTS = {
    **stock(their_act, act, **dict.fromkeys(COMMANDS, "name duration"), AttitudeSetpoint="name control_period",
            DiscreteFSWAction="name duration fsw_action reset_task", Image="n_ahead_image=n_actions max_duration name"),
    **stock(their_comm, comm, **dict.fromkeys(COMMUNICATION, "min_period")),
    **stock(their_obs, obs, SatProperties="name", Time="norm name observe_time_remaining=return_time_remaining",
            Eclipse="norm name", ResourceRewardWeight="norm name", OpportunityProperties="n_ahead_observe type name",
            RelativeProperties="chief_name name"),
    **stock(their_scene, scene, Scenario="", UniformNadirScanning="value_per_second", UniformTargets=TARGETS,
            CityTargets=f"{TARGETS} n_select_from location_offset"),
    **stock(their_data, data, NoReward="", ScanningTimeReward="reward_fn=_reward_fn", UniqueImageReward="reward_fn",
            ResourceReward="reward_weight=_reward_weight resource_fn"),
}  # fmt: skip
"""Counterparts of bsk_rl's classes."""

SUMMED = {**COUNTERPARTS, their_data.UniqueImageReward: COUNTERPARTS[their_data.UniqueImageReward]._replace(core=NothingHidden)}
"""Counterparts where there are several rewarders."""

ENTRIES: dict[type, tuple[str, Mapping[Any, Any]]] = {
    their_obs.SatProperties: ("obs_properties", {}),
    their_obs.OpportunityProperties: ("target_properties", their_obs.OpportunityProperties._fn_map),
    their_obs.RelativeProperties: ("rel_properties", RELATIVE),
}
"""Attributes of observations that list their quantities, and the functions of those that the core has, too."""

ADAPTED = ". vectorize='batched' runs custom rewarders and targets for each episode, and begins every episode with copies of them"
"""What to write for custom classes that the core can adapt."""

LINKS = {"satellite", "satellites", "scenario", "backend"}
"""Attributes that an environment sets before its first reset."""

ADAPTERS: dict[str, Callable[[Any], object]] = {
    "reward_fn": lambda function: partial(of_each, function),
    "resource_fn": per_episode,
}
"""Functions for one episode among the arguments, and what lets a batch call them."""

STANDARD = (uniform_priority, whole_priority, nothing)
"""Functions that stand for an argument that is not given: the counterparts have defaults of the same meaning."""

DRAWS: dict[object, object] = {getattr(orbital, name): getattr(rand, name) for name in
                         ("random_orbit", "random_circular_orbit", "random_epoch", "random_unit_vector")}  # fmt: skip
"""Functions of bsk_rl's that draw, and the core's distributions."""

BODY = {"observation_spec", "action_spec", "dyn_type", "fsw_type"}
"""Attributes that a satellite class may set."""

SATELLITES: dict[type, type[core_sats.Satellite]] = {
    their_sats.Satellite: core_sats.Satellite,
    their_sats.AccessSatellite: core_sats.AccessSatellite,
    their_sats.ImagingSatellite: core_sats.ImagingSatellite,
}
"""Classes of satellites."""

GENERATION = ("generation_duration", "initial_generation_duration", "max_generation_duration_beyond_initial")
"""Arguments of access satellites."""

IGNORED = {
    "__abstractmethods__", "__annotate_func__", "__annotations__", "__dict__", "__doc__", "__firstlineno__", "__module__",
    "__orig_bases__", "__parameters__", "__qualname__", "__slotnames__", "__static_attributes__", "__weakref__", "_abc_impl",
}  # fmt: skip
"""Attributes of classes that no user has written."""

CORES: dict[type, Any] = {SatelliteTasking: Core, ConstellationTasking: Constellation}
"""Environments of the core by the classes of bsk_rl that have a batched vector form."""

AGENT_ARGUMENTS = ("meta_agent_groupings", "only_retask_idle_meta_agent_members")
"""Arguments of agents that command several satellites."""

PASSED = (
    "world_type", "sim_rate", "max_step_duration", "failure_penalty", "time_limit", "terminate_on_time_limit",
    "generate_obs_retasking_only", "backend", "orbit", "log_dir", "sat_arg_randomizer",
)  # fmt: skip
"""Arguments of environments passed to the core unchanged."""


def check_attributes(title: str, part: object, untouched: object) -> None:
    """Raise NotBatchedError for attributes that an object of the same class and arguments does not have."""
    if unknown := sorted(vars(part).keys() - vars(untouched).keys() - LINKS):
        raise NotBatchedError(f"{title} has attributes that are not arguments of it: {', '.join(unknown)}")


def counterpart(part: object, *entries: object, table: Mapping[type, Stock] = COUNTERPARTS) -> Any:
    """Return the core's counterpart of an object, made with ``entries`` before its arguments.

    Raises:
        NotBatchedError: For an object of another class, or one with attributes that its class does not know.
    """
    title, stock = type(part).__name__, table.get(type(part))
    if stock is None and type(part).__module__.startswith(their_act.__name__.rpartition(".")[0]):
        raise NotBatchedError(f"{title} is for one episode at a time")
    if stock is None:
        adapted = ADAPTED if isinstance(part, their_data.GlobalReward | their_scene.Scenario) else ""
        raise NotBatchedError(f"{title} is a custom class, for one episode{adapted}")
    values = {name: getattr(part, attribute) for name, attribute in stock.arguments.items()}
    check_attributes(title, part, type(part)(**values))
    return stock.core(*entries, **{
        name: ADAPTERS[name](value) if name in ADAPTERS and value is not None else value
        for name, value in values.items() if not (callable(value) and value in STANDARD)
    })  # fmt: skip


def observed_entries(observation: object) -> list[dict[str, object]]:
    """Return the observed quantities of an observation as the core takes them; functions may be called for each episode."""
    attribute, presets = ENTRIES.get(type(observation), ("", {}))
    entries = []
    for entry in getattr(observation, attribute, ()):
        unused = {"module"} if entry.get("fn") is not presets.get(entry.get("prop")) else {"module", "fn"}
        rest = {name: value for name, value in entry.items() if name not in unused}
        entries.append({**rest, "fn": per_episode(rest["fn"])} if "fn" in rest else rest)
    return entries


def changed_arguments(values: Mapping[str, object], defaults: Mapping[str, object]) -> dict[str, object]:
    """Return the arguments whose values differ from their defaults, as the core takes them."""
    return {name: DRAWS.get(value, value) if callable(value) else value
            for name, value in values.items() if not _same(value, defaults.get(name))}  # fmt: skip


def _same(value: object, default: object) -> bool:
    if value is default:
        return True
    return not callable(value) and type(value) is type(default) and bool(np.all(value == default))


def check_models(*models: type) -> None:
    """Raise NotBatchedError for models with hooks that run for one episode."""
    for model in models:
        if hooks := for_one_episode_only(model):
            raise NotBatchedError(f"{model.__name__} has custom code, for one episode: {', '.join(hooks)}")


def core_satellite(satellite: Satellite) -> core_sats.Satellite:
    """Return the core's counterpart of a satellite; NotBatchedError for one that has none."""
    for kind in type(satellite).__mro__:
        if kind.__module__.startswith("bsk_torch.") or kind in (object, ABC):
            continue
        if added := sorted(vars(kind).keys() - BODY - IGNORED):
            raise NotBatchedError(f"{kind.__name__} has custom code, for one episode: {', '.join(added)}")
    check_models(satellite.dyn_type, satellite.fsw_type)
    untouched, builder = type(satellite)(satellite.name), satellite.observation_builder
    check_attributes(f"satellite {satellite.name}", satellite, untouched)
    if builder.obs_type is not np.ndarray:
        raise NotBatchedError(f"obs_type={builder.obs_type!r}; vectors can be batched")
    if getattr(satellite, "access_filter_functions", ()) or getattr(satellite, "target_types", TARGET_KIND) != TARGET_KIND:
        raise NotBatchedError(f"satellite {satellite.name} has access filters, or looks for other types than {TARGET_KIND!r}")
    sat_args = changed_arguments(satellite.sat_args_generator, untouched.sat_args_generator)
    if "utc_init" in sat_args:
        raise NotBatchedError("utc_init is among sat_args; write it among world_args")
    body = {
        "observation_spec": [counterpart(entry, *observed_entries(entry)) for entry in builder.observation_spec],
        "action_spec": [counterpart(entry) for entry in satellite.action_builder.action_spec],
        "dyn_type": satellite.dyn_type,
        "fsw_type": satellite.fsw_type,
    }
    base = next(kind for kind in type(satellite).__mro__ if kind in SATELLITES)
    made = type(type(satellite).__name__, (SATELLITES[base],), body)
    options = {name: getattr(satellite, name) for name in GENERATION if hasattr(satellite, name)}
    return made(satellite.name, sat_args, variable_interval=bool(satellite.variable_interval), dtype=builder.dtype, **options)


def batched_core(env: Any, args: Sequence[Any], kwargs: Mapping[str, Any], num_envs: int, adapt: bool) -> Tasking:
    """Return the core's environment of N episodes of a program.

    Args:
        env: A single environment of the program, before its first reset.
        args: The arguments that it was made of.
        kwargs: The keyword arguments that it was made of.
        num_envs: Number of episodes N.
        adapt: Whether a custom rewarder, or a scenario with custom targets, is run for each episode. Every episode then begins
            with copies of them, so that what they keep from episode to episode is lost.

    Raises:
        NotBatchedError: For a program that cannot be batched.
    """
    if (make := CORES.get(type(env))) is None:
        raise NotBatchedError(f"{type(env).__name__} has no batched vector form; {[kind.__name__ for kind in CORES]} have")
    if agents := [name for name in AGENT_ARGUMENTS if name in kwargs]:
        raise NotBatchedError(f"{agents[0]}: agents of several satellites have no batched vector form")
    named = {"satellites" if name == "satellite" else name: value for name, value in kwargs.items()}
    arguments = inspect.signature(GeneralSatelliteTasking.__init__).bind_partial(None, *args, **named).arguments
    several = type(env.rewarder) is ComposedReward
    parts = env.rewarder.rewarders if several else [env.rewarder]
    try:
        rewarders = [
            PerEpisodeReward(copy.copy(arguments["rewarder"]))
            if adapt and not several and type(part) not in COUNTERPARTS
            else counterpart(part, table=SUMMED if several else COUNTERPARTS)
            for part in parts
        ]
        satellites = [core_satellite(satellite) for satellite in env.satellites]
        check_models(env.world_type)
        if "world_type" in arguments:
            arguments["world_type"] = core_world(env.world_type)
        custom = adapt and type(env.scenario) not in COUNTERPARTS and hasattr(env.scenario, "regenerate_targets")
        return make(
            satellites if make is Constellation else satellites[0],
            PerEpisodeTargets(copy.copy(arguments["scenario"])) if custom else counterpart(env.scenario),
            rewarders if several else rewarders[0],
            counterpart(env.communicator),
            world_args=changed_arguments(env.world_args_generator, world_defaults(env.world_type)),
            num_envs=num_envs,
            compat="bsk_rl",
            **{name: arguments[name] for name in PASSED if name in arguments},
        )
    except (TypeError, ValueError, AttributeError, KeyError) as error:
        if isinstance(error, NotBatchedError):
            raise
        raise NotBatchedError(f"bsk_torch rejects it: {type(error).__name__}: {error}") from error


class BatchedVectorEnv(GymVectorEnv):
    """N episodes of a program of bsk_rl in one simulation, as ``gymnasium.vector.VectorEnv``.

    Observations, rewards and durations are those of single environments in the same state, to rounding. Draws are those of
    :mod:`bsk_torch`: a seed gives other episodes, of the same distribution. ``info`` also has ``action_mask``.
    """

    def _make_spaces(self) -> None:
        super()._make_spaces()
        one = self.single_observation_space
        self.single_observation_space = spaces.Box(-LARGEST, LARGEST, one.shape, one.dtype)  # type: ignore[arg-type]
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def get_attr(self, name: str) -> tuple[object, ...]:
        """Return an attribute of every episode: ``satellite``, or ``simulator``; read-only views.

        AttributeError for others.
        """
        views = [view_of(self.core.satellite, row) for row in range(self.num_envs)]
        if name == "satellite":
            return tuple(views)
        if name == "simulator":
            return tuple(view.simulator for view in views)
        raise AttributeError(
            f"{name!r}: episodes in one simulation have 'satellite' and 'simulator'. vectorize='episodes' makes environments "
            "with all attributes and methods; env.core has those of all episodes together"
        )
