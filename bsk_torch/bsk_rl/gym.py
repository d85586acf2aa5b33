"""Environments of bsk_rl: one episode at a time, under Gymnasium's and PettingZoo's interfaces."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from time import time_ns
from typing import Any, ClassVar, Generic, TypeVar

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from pettingzoo import ParallelEnv

from bsk_torch._checks import number
from bsk_torch.bsk_rl.comm.communication import CommunicationMethod, NoCommunication
from bsk_torch.bsk_rl.data.base import GlobalReward
from bsk_torch.bsk_rl.data.composition import ComposedReward
from bsk_torch.bsk_rl.data.no_data import NoReward
from bsk_torch.bsk_rl.older import check_arguments
from bsk_torch.bsk_rl.sats.satellite import Satellite
from bsk_torch.bsk_rl.scene.scenario import Scenario
from bsk_torch.bsk_rl.sim.engine import Engine
from bsk_torch.bsk_rl.sim.models import for_one_episode
from bsk_torch.bsk_rl.sim.simulator import Simulator, satellite_named
from bsk_torch.bsk_rl.utils.logging_config import ContextFilter, SimFormatter, say
from bsk_torch.env.no_action import NO_ACTION, is_no_action, no_action_keep_indices, no_action_like
from bsk_torch.sim.assembly.composition import compose
from bsk_torch.sim.assembly.satellite_type import LONGEST_TICK, SHORTEST_TICK
from bsk_torch.sim.component import UserArguments
from bsk_torch.sim.world import WorldModel

__all__ = [
    "NO_ACTION",
    "AgentID",
    "ConstellationTasking",
    "GeneralSatelliteTasking",
    "MultiSatAct",
    "MultiSatObs",
    "SatAct",
    "SatArgRandomizer",
    "SatObs",
    "SatelliteTasking",
    "is_no_action",
    "no_action_keep_indices",
    "no_action_like",
]

logger = logging.getLogger(__name__)

SatObs = TypeVar("SatObs")
SatAct = TypeVar("SatAct")
AgentID = TypeVar("AgentID")
MultiSatObs = tuple[SatObs, ...]
MultiSatAct = Iterable[SatAct]
SatArgRandomizer = Callable[[list[Satellite]], Mapping[Satellite, UserArguments]]

VIZARD = "files for Vizard are not written, the episodes are the same; 'bsk-torch view' shows environments in the browser"


class GeneralSatelliteTasking(gymnasium.Env[Any, Any], Generic[SatObs, SatAct]):
    """Satellites that one agent commands: tuples of observations and actions, and one reward.

    Every reset seeds NumPy's global generator and draws in bsk_rl's order, so the same seed gives the episode that bsk_rl plays.

    Attributes:
        satellites: Copies of the given satellites; they live as long as the environment.
        scenario, rewarder, communicator: Copies of those given, likewise.
        simulator: Simulation of the current episode.
        world_args: Arguments of the world in the current episode.
        time_limit: End of the current episode, s.
        max_step_duration: Longest step, s; a change counts from the next reset on.
        latest_step_duration: Duration of the last step, s.
        reward_dict: Rewards of the last step by satellite, without penalties.
    """

    metadata: ClassVar[dict[str, object]] = {"render_modes": []}  # type: ignore[misc]
    simulator: Simulator
    _vector_form: ClassVar[Callable[..., Any]]
    """:func:`bsk_torch.bsk_rl.vector.vector_form`, set by the package."""

    def __new__(
        cls,
        *args: object,
        num_envs: int | None = None,
        vectorize: str | None = None,
        autoreset_mode: AutoresetMode | str | None = None,
        **kwargs: Any,
    ) -> Any:
        """Return an environment, or with ``num_envs`` the vector form, :mod:`bsk_torch.bsk_rl.vector`."""
        check_arguments(cls, kwargs)
        if num_envs is None:
            for name, value in (("vectorize", vectorize), ("autoreset_mode", autoreset_mode)):
                if value is not None:
                    raise ValueError(f"{name}={value!r} belongs to the vector form; give num_envs, too")
            return super().__new__(cls)
        return cls._vector_form(cls, num_envs, "auto" if vectorize is None else vectorize, autoreset_mode, args, kwargs)

    def __init__(
        self,
        satellites: Satellite | Sequence[Satellite],
        scenario: Scenario | None = None,
        rewarder: GlobalReward | Iterable[GlobalReward] | None = None,
        world_type: type[WorldModel] | Sequence[type[WorldModel]] | None = None,
        world_args: UserArguments | None = None,
        communicator: CommunicationMethod | None = None,
        sat_arg_randomizer: SatArgRandomizer | None = None,
        sim_rate: float = 1.0,
        max_step_duration: float = 1e9,
        failure_penalty: float = -1.0,
        time_limit: float | Callable[[], float] = float("inf"),
        terminate_on_time_limit: bool = False,
        generate_obs_retasking_only: bool = False,
        dtype: Any = None,
        log_level: int | str = logging.WARNING,
        log_dir: str | None = None,
        vizard_dir: str | None = None,
        vizard_settings: Mapping[str, object] | None = None,
        render_mode: str | None = None,
        *,
        backend: str = "compiled",
        orbit: str | None = None,
        num_envs: int | None = None,
        vectorize: str | None = None,
        autoreset_mode: AutoresetMode | str | None = None,
    ) -> None:
        """Put an environment together; nothing is simulated before the first reset.

        Args:
            satellites: The satellites; those of the same name are renamed.
            scenario: Their task.
            rewarder: Value of their data; several are summed.
            world_type: World models; those that the satellites need unless given.
            world_args: Arguments of the world: values, or functions that draw them.
            communicator: How satellites share data.
            sat_arg_randomizer: Function of the satellites that returns arguments by satellite, called at every reset.
            sim_rate: Length of a tick, s.
            max_step_duration: Longest step, s.
            failure_penalty: Reward of each dead satellite in every step.
            time_limit: End of episodes, s, or a function that draws it.
            terminate_on_time_limit: Whether the time limit terminates, too.
            generate_obs_retasking_only: Whether satellites with a task observe zeros.
            dtype: Type of observations; that of each satellite unless given.
            log_level: Level of the log.
            log_dir: File that gets the log, too.
            vizard_dir: Ignored with a warning: no files for Vizard are written.
            vizard_settings: Ignored without ``vizard_dir``, with a warning, as in bsk_rl.
            render_mode: Not used, as in bsk_rl.
            backend: ``"compiled"``, or ``"eager"`` for machines without a compiler; not in bsk_rl.
            orbit: ``"integrated"`` integrates orbits in every tick even where they can be solved in advance; not in bsk_rl.
            num_envs: Number of environments of the vector form; None for a single environment; not in bsk_rl.
            vectorize: How the vector form simulates: ``"batched"`` for all episodes in one simulation, with draws of bsk_torch;
                ``"episodes"`` for N simulations with bsk_rl's draws; None for the first where no class is custom.
            autoreset_mode: When environments of the vector form start their next episode: in the next step (None), or as
                :class:`gymnasium.vector.AutoresetMode` says.
        """
        self.seed: int | None = None
        self._configure_logging(log_level, log_dir)
        if vizard_dir is not None:
            say(logger, "vizard_dir=%r: %s", vizard_dir, VIZARD)
        elif vizard_settings is not None:
            logger.warning("Vizard settings provided but Vizard is not enabled. Ignoring settings.")
        self.vizard_settings = dict(vizard_settings or {})
        listed = [satellites] if isinstance(satellites, Satellite) else list(satellites)
        if scenario is not None:
            scenario.validate_satellite_names(listed)
        self.satellites: list[Satellite] = deepcopy(listed)
        self.dtype = dtype
        _rename_duplicates(self.satellites)
        for satellite in self.satellites:
            satellite.backend = backend
            if dtype is not None:
                satellite.observation_builder.dtype = dtype
        self.sat_arg_randomizer: SatArgRandomizer = sat_arg_randomizer or (lambda satellites: {})
        required = dict.fromkeys(model for satellite in self.satellites for model in satellite.dyn_type.all_required_worlds())
        if world_type is not None:
            logger.warning("Using user-specified world type. Generally, the env-determined world type is sufficient.")
        models = required if world_type is None else (world_type,) if isinstance(world_type, type) else world_type
        self.world_type = compose(tuple(for_one_episode(model) for model in models), WorldModel)
        self.world_args_generator = self.world_type.default_world_args(**(world_args or {}))
        self.scenario = deepcopy(scenario) or Scenario()
        self.scenario.link_satellites(self.satellites)
        copied: Any = deepcopy(list(rewarder) if isinstance(rewarder, Iterable) else rewarder) or NoReward()
        self.rewarder: Any = ComposedReward(*copied) if isinstance(copied, list) else copied
        self.rewarder.link_scenario(self.scenario)
        self.communicator: Any = deepcopy(communicator) or NoCommunication()
        self.communicator.link_satellites(self.satellites)
        self.sim_rate = number("sim_rate", sim_rate, SHORTEST_TICK, LONGEST_TICK, unit="s")
        self.max_step_duration = max_step_duration
        self.failure_penalty = failure_penalty
        if failure_penalty > 0:
            logger.warning("Failure penalty should be nonpositive")
        self.time_limit_generator = time_limit if callable(time_limit) else lambda: time_limit
        self.terminate_on_time_limit, self.generate_obs_retasking_only = terminate_on_time_limit, generate_obs_retasking_only
        self.latest_step_duration, self.render_mode = 0.0, render_mode
        self.reward_dict: dict[str, float] = {}
        self._engine = Engine(backend, orbit)

    def _configure_logging(self, log_level: int | str, log_dir: str | None = None) -> None:
        """Let the log of this environment go to the terminal, and to a file; that of an earlier one in the process ends."""
        root = logging.getLogger(__name__.rpartition(".")[0])
        root.setLevel(log_level.upper() if isinstance(log_level, str) else log_level)
        for handler in [handler for handler in root.handlers if any(isinstance(f, ContextFilter) for f in handler.filters)]:
            root.removeHandler(handler)
            handler.close()
        handlers: list[logging.Handler] = [logging.StreamHandler()]
        if log_dir is not None:
            handlers.append(logging.FileHandler(log_dir))
        for handler in handlers:
            handler.setFormatter(SimFormatter(color_output=not isinstance(handler, logging.FileHandler)))
            handler.addFilter(ContextFilter(env=self, proc_id=os.getpid()))
            root.addHandler(handler)

    def get_satellite(self, name: str) -> Satellite:
        """Return the satellite of a name; ValueError if there is none."""
        return satellite_named(name, self.satellites)

    # -- reset --------------------------------------------------------------------------------------------------------

    def reset(self, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode; the time seeds it unless ``seed`` is given. ``options`` are not used."""
        self.delete_simulator()
        self.seed = time_ns() % 2**32 if seed is None else seed
        logger.info("Resetting environment with seed=%s", self.seed)
        gymnasium.Env.reset(self, seed=self.seed)
        np.random.seed(self.seed)
        self._draw()
        self._prepare()
        self.simulator = Simulator(
            self.satellites,
            self.world_type,
            self.world_args,
            sim_rate=self.sim_rate,
            max_step_duration=self.max_step_duration,
            time_limit=self.time_limit,
            engine=self._engine,
        )
        self._begin()
        observation, info = self._get_obs(), self._get_info()
        logger.info("Environment reset")
        return observation, info

    def _randomize_time_limit(self) -> None:
        self.time_limit = np.ceil(self.time_limit_generator() / self.sim_rate) * self.sim_rate

    def _generate_world_args(self) -> None:
        self.world_args = {name: value() if callable(value) else value for name, value in self.world_args_generator.items()}

    def _draw(self) -> None:
        """Draw the arguments of the episode, in bsk_rl's order, by methods that subclasses may override as there."""
        self._randomize_time_limit()
        for part in (self.scenario, self.rewarder, self.communicator, *self.satellites):
            part.reset_overwrite_previous()
        self.latest_step_duration = 0.0
        self._generate_world_args()
        epoch, overrides = self.world_args["utc_init"], self.sat_arg_randomizer(self.satellites)
        for satellite in self.satellites:
            satellite.generate_sat_args(utc_init=epoch, **overrides.get(satellite, {}))
        self.scenario.utc_init = epoch

    def _prepare(self) -> None:
        for part in (self.scenario, self.rewarder, self.communicator):
            part.reset_pre_sim_init()
        for satellite in self.satellites:
            self.rewarder.create_data_store(satellite)
            self.rewarder.data += satellite.data_store.data
            satellite.reset_pre_sim_init()

    def _begin(self) -> None:
        """Call the hooks while and after the simulation is made."""
        world = self.simulator.world
        for part in (world, self.scenario, self.rewarder, self.communicator):
            part.reset_during_sim_init()
        for satellite in self.satellites:
            for each in (satellite, satellite.dynamics, satellite.fsw):
                each.reset_during_sim_init()
        for part in (world, self.scenario, self.rewarder, self.communicator):
            part.reset_post_sim_init()
        for satellite in self.satellites:
            for each in (satellite, satellite.dynamics, satellite.fsw):
                each.reset_post_sim_init()
            satellite.data_store.update_from_logs()

    def delete_simulator(self) -> None:
        """Forget the simulation of the last episode."""
        self.__dict__.pop("simulator", None)

    # -- what a step gives --------------------------------------------------------------------------------------------

    def _get_obs(self) -> object:
        return tuple(
            satellite.observation_space.low * 0
            if self.generate_obs_retasking_only and not satellite.requires_retasking
            else satellite.get_obs()
            for satellite in self.satellites
        )

    def _get_info(self) -> dict[str, Any]:
        info: dict[str, object] = {s.name: {"requires_retasking": s.requires_retasking} for s in self.satellites}
        info["d_ts"] = self.latest_step_duration
        return info

    def _get_reward(self) -> object:
        deaths = sum(not satellite.is_alive(log_failure=True) for satellite in self.satellites)
        return sum(self.reward_dict.values()) + sum([self.failure_penalty] * deaths)

    def _get_terminated(self) -> object:
        if self.terminate_on_time_limit and self._get_truncated():
            return True
        return not all(satellite.is_alive() and not self.rewarder.is_terminated(satellite) for satellite in self.satellites)

    def _get_truncated(self) -> Any:
        """Return whether the time is up, or the rewarder cuts the episode."""
        late = self.simulator.sim_time >= self.time_limit
        return bool(late) or any(self.rewarder.is_truncated(satellite) for satellite in self.satellites)

    # -- spaces -------------------------------------------------------------------------------------------------------

    @property
    def action_space(self) -> spaces.Space[object]:  # type: ignore[override]
        """Tuple of the satellites' action spaces."""
        return spaces.Tuple(tuple(satellite.action_space for satellite in self.satellites))

    @property
    def observation_space(self) -> spaces.Space[object]:  # type: ignore[override]
        """Tuple of the satellites' observation spaces; reading it before the first reset resets the environment."""
        self._know_observations()
        return spaces.Tuple([satellite.observation_space for satellite in self.satellites])

    def _know_observations(self) -> None:
        if "simulator" not in self.__dict__:
            logger.info("Calling env.reset() to get observation space")
            self.reset(seed=self.seed)

    # -- step ---------------------------------------------------------------------------------------------------------

    def _step(self, actions: Sequence[object]) -> None:
        if len(actions) != len(self.satellites):
            raise ValueError("There must be the same number of actions and satellites")
        for satellite, action in zip(self.satellites, actions, strict=True):
            satellite.info = []
            if not is_no_action(action):
                satellite.requires_retasking = False
                satellite.set_action(action)
            if not satellite.is_alive():
                satellite.requires_retasking = False
            elif satellite.requires_retasking:
                satellite.logger.warning("Requires retasking but received no task.")
        before = self.simulator.sim_time
        self.simulator.run()
        self.latest_step_duration = self.simulator.sim_time - before
        new_data = {satellite.name: satellite.data_store.update_from_logs() for satellite in self.satellites}
        self.reward_dict = self.rewarder.reward(new_data)
        self.scenario.after_step(self.simulator.sim_time)
        self.communicator.communicate()
        for satellite in self.satellites:
            if satellite.requires_retasking:
                satellite.logger.info("Satellite %s requires retasking", satellite.name)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Carry out the actions until the first event that ends the step."""
        logger.info("=== STARTING STEP ===")
        self._step(actions)
        observation, reward = self._get_obs(), self._get_reward()
        terminated, truncated = self._get_terminated(), self._get_truncated()
        logger.info("Step reward: %s", reward)
        level = logging.INFO if terminated or truncated else logging.DEBUG
        logger.log(level, "Episode terminated: %s", terminated)
        logger.log(level, "Episode truncated: %s", truncated)
        return observation, reward, terminated, truncated, self._get_info()

    def render(self) -> None:
        """Draw nothing, as in bsk_rl."""

    def close(self) -> None:
        """Forget the simulation."""
        self.delete_simulator()


def _rename_duplicates(satellites: Sequence[Satellite]) -> None:
    while True:
        names = [satellite.name for satellite in satellites]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is None:
            return
        for k, satellite in enumerate([satellite for satellite in satellites if satellite.name == twice]):
            logger.warning("Renaming satellite %s to %s", twice, f"{twice}_{k}")
            satellite.name = f"{twice}_{k}"


class SatelliteTasking(GeneralSatelliteTasking[SatObs, SatAct]):
    """One satellite: its observation, action, reward and info, without tuples."""

    def __init__(self, satellite: Satellite | Sequence[Satellite], *args: Any, **kwargs: Any) -> None:
        """See :class:`GeneralSatelliteTasking`; ValueError for several satellites."""
        super().__init__(satellite, *args, **kwargs)
        if len(self.satellites) != 1:
            raise ValueError("SatelliteTasking must be initialized with a single satellite.")

    @property
    def satellite(self) -> Satellite:
        """The satellite."""
        return self.satellites[0]

    @property
    def action_space(self) -> spaces.Space[object]:  # type: ignore[override]
        """Action space of the satellite."""
        return self.satellite.action_space

    @property
    def observation_space(self) -> spaces.Space[object]:  # type: ignore[override]
        """Observation space of the satellite; reading it before the first reset resets the environment."""
        self._know_observations()
        return self.satellite.observation_space

    def step(self, action: object) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Carry out an action until an event ends the step."""
        return super().step([action])

    def _get_obs(self) -> object:
        return self.satellite.get_obs()

    def _get_info(self) -> dict[str, Any]:
        info = super()._get_info()
        return {"d_ts": info["d_ts"], **info[self.satellite.name]}


class ConstellationTasking(GeneralSatelliteTasking[SatObs, SatAct], ParallelEnv[object, object, object]):
    """Satellites as agents, under PettingZoo's parallel interface.

    Attributes:
        meta_agent_groupings: Satellites of each agent.
        newly_dead: Agents that have left with the last step.
    """

    def __init__(
        self,
        *args: Any,
        meta_agent_groupings: dict[Any, list[str]] | None = None,
        only_retask_idle_meta_agent_members: bool = False,
        **kwargs: Any,
    ) -> None:
        """See :class:`GeneralSatelliteTasking`.

        Args:
            *args: Arguments of the environment.
            meta_agent_groupings: Names of the satellites of agents that command several.
            only_retask_idle_meta_agent_members: Whether such agents' actions for satellites with a task are ignored.
            **kwargs: Further arguments of the environment.
        """
        super().__init__(*args, **kwargs)
        self.only_retask_idle_meta_agent_members = only_retask_idle_meta_agent_members
        groups = dict(meta_agent_groupings or {})
        grouped = {name for members in groups.values() for name in members}
        for satellite in self.satellites:
            if satellite.name not in grouped:
                groups[satellite.name] = [satellite.name]
        self.meta_agent_groupings = {agent: [self.get_satellite(name) for name in names] for agent, names in groups.items()}
        self.newly_dead: list[object] = []
        self._spaces: dict[tuple[str, object], object] = {}
        self._agents_last_compute_time: float | None = None

    def _validate_meta_agent_groupings(self) -> None:
        for agent, members in self.meta_agent_groupings.items():
            if not members:
                raise ValueError(f"Meta agent '{agent}' has no members.")
            for member in members:
                assert isinstance(member.action_space, type(members[0].action_space)), (
                    f"Meta agent '{agent}' has members with different action space types."
                )
                assert len(members) == 1 or isinstance(member.observation_space, spaces.Box), (
                    f"Only Box observation spaces are supported for meta agents; '{member.name}' has "
                    f"{type(member.observation_space).__name__}"
                )

    def reset(self, seed: int | None = None, options: object = None) -> tuple[dict[Any, Any], dict[Any, Any]]:
        """Start an episode; observations and infos by agent."""
        self.newly_dead, self._agents_last_compute_time = [], None
        return super().reset(seed, options)

    # -- agents -------------------------------------------------------------------------------------------------------

    @property
    def agents(self) -> list[Any]:
        """Agents whose satellites are all alive; none when the time is up."""
        if self._agents_last_compute_time is None or self._agents_last_compute_time != self.simulator.sim_time:
            over = super()._get_truncated()
            alive = {agent: all(s.is_alive() for s in members) for agent, members in self.meta_agent_groupings.items()}
            self._agents_cache = [agent for agent, lives in alive.items() if lives and not over]
            self._agents_last_compute_time = self.simulator.sim_time
        return self._agents_cache

    @property
    def possible_agents(self) -> list[object]:
        """All agents."""
        return list(self.meta_agent_groupings)

    @property
    def previously_dead(self) -> list[object]:
        """Agents that had left before the last step."""
        return [agent for agent in self.possible_agents if agent not in self.agents and agent not in self.newly_dead]

    def _present(self) -> dict[object, list[Satellite]]:
        gone = self.previously_dead
        return {agent: members for agent, members in self.meta_agent_groupings.items() if agent not in gone}

    # -- spaces -------------------------------------------------------------------------------------------------------

    @property
    def observation_spaces(self) -> dict[object, object]:
        """Observation space of each agent."""
        self._know_observations()
        self._validate_meta_agent_groupings()
        return {
            agent: self._joined([s.observation_space for s in members]) for agent, members in self.meta_agent_groupings.items()
        }

    @property
    def action_spaces(self) -> dict[object, object]:
        """Action space of each agent."""
        return {agent: self._joined([s.action_space for s in members]) for agent, members in self.meta_agent_groupings.items()}

    def _joined(self, parts: list[Any]) -> Any:
        if len(parts) == 1:
            return parts[0]
        if isinstance(parts[0], spaces.Discrete):
            return spaces.MultiDiscrete([part.n for part in parts])
        low, high = (np.concatenate([getattr(part, bound) for part in parts]) for bound in ("low", "high"))
        return spaces.Box(low=low, high=high, dtype=self.dtype or parts[0].dtype)

    def observation_space(self, agent: object) -> Any:  # type: ignore[override]
        """Observation space of an agent, the same object in every call."""
        return self._space("observation_spaces", agent)

    def action_space(self, agent: object) -> Any:  # type: ignore[override]
        """Action space of an agent, the same object in every call."""
        return self._space("action_spaces", agent)

    def _space(self, table: str, agent: object) -> object:
        if (table, agent) not in self._spaces:
            self._spaces[table, agent] = getattr(self, table)[agent]
        return self._spaces[table, agent]

    # -- what a step gives --------------------------------------------------------------------------------------------

    def _get_obs(self) -> dict[object, object]:
        observations = {}
        for agent, members in self._present().items():
            if self.generate_obs_retasking_only and not any(member.requires_retasking for member in members):
                parts = [satellite.observation_space.low * 0 for satellite in members]
            else:
                parts = [satellite.get_obs() for satellite in members]
            observations[agent] = parts[0] if len(parts) == 1 else np.concatenate(parts)
        return observations

    def _get_reward(self) -> dict[object, float]:
        rewards = {self.get_satellite(name): reward for name, reward in self.reward_dict.items()}
        for satellite in self.satellites:
            if not satellite.is_alive():
                rewards[satellite] = rewards.get(satellite, 0.0) + self.failure_penalty
        return {agent: sum(rewards.get(satellite, 0.0) for satellite in members) for agent, members in self._present().items()}

    def _get_terminated(self) -> dict[object, bool]:
        late = self.terminate_on_time_limit and super()._get_truncated()
        return {
            agent: late or any(not s.is_alive() or self.rewarder.is_terminated(s) for s in members)
            for agent, members in self._present().items()
        }

    def _get_truncated(self) -> dict[object, bool]:
        late = super()._get_truncated()
        return {
            agent: late or any(self.rewarder.is_truncated(satellite) for satellite in members)
            for agent, members in self._present().items()
        }

    def _get_info(self) -> dict[Any, Any]:
        each = super()._get_info()
        common = {"d_ts": each["d_ts"]}
        info: dict[Any, Any] = {}
        for agent, members in self._present().items():
            info[agent] = {"requires_retasking": any(each[s.name]["requires_retasking"] for s in members)}
            if len(members) > 1:
                info[agent] |= {satellite.name: each[satellite.name] for satellite in members}
            info[agent] |= common
        return info | {"__common__": common}

    # -- step ---------------------------------------------------------------------------------------------------------

    def _decompose_meta_action(self, agent: object, action: object) -> dict[Satellite, object]:
        parts, first = {}, 0
        for satellite in self.meta_agent_groupings[agent]:
            if not isinstance(action, list | tuple | np.ndarray):
                parts[satellite] = action
                continue
            shape = satellite.action_space.shape
            width = shape[0] if shape else 1
            if self.only_retask_idle_meta_agent_members and not satellite.requires_retasking:
                parts[satellite] = None
            else:
                parts[satellite] = action[first] if width == 1 else action[first : first + width]
            first += width
        return parts

    def step(self, actions: Mapping[Any, Any]) -> tuple[Any, Any, Any, Any, dict[Any, Any]]:
        """Carry out the actions of agents, by agent, until the first event that ends the step."""
        logger.info("=== STARTING STEP ===")
        before, chosen = self.agents, dict[Satellite, object]()
        for agent, action in actions.items():
            if len(self.meta_agent_groupings[agent]) > 1:
                logger.info("Decomposing action for meta agent %s", agent)
            chosen |= self._decompose_meta_action(agent, action)
        self._step([chosen.get(satellite) for satellite in self.satellites])
        now = self.agents
        self.newly_dead = [agent for agent in before if agent not in now]
        for satellite in (satellite for agent in self.newly_dead for satellite in self.meta_agent_groupings[agent]):
            for name in ("_timed_terminal_event_name", "_image_event_name"):
                if (event := getattr(satellite, name, None)) in self.simulator.eventMap:
                    self.simulator.delete_event(str(event))
        observation, reward = self._get_obs(), self._get_reward()
        terminated, truncated = self._get_terminated(), self._get_truncated()
        logger.info("Step reward: %s", {agent: value for agent, value in reward.items() if value != 0.0})
        for title, ended in (("terminated", terminated), ("truncated", truncated)):
            if agents := [agent for agent, value in ended.items() if value]:
                logger.info("Episode %s: %s", title, agents)
        return observation, reward, terminated, truncated, self._get_info()
