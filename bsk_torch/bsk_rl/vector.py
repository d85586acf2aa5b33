"""Vector forms of bsk_rl's environments: N episodes of one program, under Gymnasium's vector interface or by agent.

``SatelliteTasking(..., num_envs=N)`` returns a :class:`~bsk_torch.bsk_rl.batch.BatchedVectorEnv` of one simulation if the program
has no custom classes, else :class:`EpisodesVectorEnv`; ``ConstellationTasking(..., num_envs=N)`` likewise returns a
:class:`~bsk_torch.bsk_rl.batch_agents.BatchedAgentsVectorEnv`, else :class:`AgentsVectorEnv`. The other two classes step N
environments of :mod:`bsk_torch.bsk_rl.gym` one after another.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array, iterate
from typing_extensions import override

from bsk_torch._checks import whole
from bsk_torch.bsk_rl.batch import BatchedVectorEnv, NotBatchedError, batched_core
from bsk_torch.bsk_rl.batch_agents import AgentsVector, BatchedAgentsVectorEnv, ByAgent
from bsk_torch.bsk_rl.gym import ConstellationTasking, GeneralSatelliteTasking
from bsk_torch.bsk_rl.utils.logging_config import ContextFilter, say
from bsk_torch.env import ConstellationTasking as Constellation
from bsk_torch.wrappers.gymnasium.vector import parse_mode

logger = logging.getLogger(__name__)

FASTER = "docs/migration_fast.md lists what to change for one simulation of all"

FORMS = ("auto", "batched", "episodes")
"""Ways to simulate several episodes."""


def vector_form(
    make: type[GeneralSatelliteTasking[object, object]],
    num_envs: int,
    vectorize: str,
    autoreset_mode: AutoresetMode | str | None,
    args: Sequence[Any],
    kwargs: Mapping[str, Any],
) -> EpisodesVectorEnv | AgentsVectorEnv | BatchedVectorEnv | BatchedAgentsVectorEnv:
    """Return N environments of a class, made of the same arguments, as one; a log record describes how they are simulated.

    With ``vectorize="batched"``, one simulation of all runs custom rewarders and custom targets, too; NotBatchedError for other
    custom classes. With ``"auto"``, programs without custom classes are batched.
    """
    if vectorize not in FORMS:
        raise ValueError(f"vectorize={vectorize!r} must be one of {list(FORMS)}")
    count = whole("num_envs", num_envs, 1)
    mode = AutoresetMode.NEXT_STEP if autoreset_mode is None else parse_mode(autoreset_mode)
    first: Any = make(*args, **kwargs)
    why = "vectorize='episodes'"
    if vectorize != "episodes":
        try:
            core = batched_core(first, args, kwargs, count, adapt=vectorize == "batched")
        except NotBatchedError as error:
            if vectorize == "batched":
                raise
            why = str(error)
        else:
            logger.info("%s: %d episodes in one simulation, with draws of bsk_torch", make.__name__, count)
            if isinstance(core, Constellation):
                return BatchedAgentsVectorEnv(core, mode)
            return BatchedVectorEnv(core, autoreset_mode=mode)
    envs: list[Any] = [first, *(make(*args, **kwargs) for _ in range(count - 1))]
    if count > 1:
        say(logger, "%s: %d simulations side by side, which is slow: %s. %s", make.__name__, count, why, FASTER)
    vector = AgentsVectorEnv if issubclass(make, ConstellationTasking) else EpisodesVectorEnv
    return vector(envs, autoreset_mode=mode)


def reject_agents(num_envs: int, **_: object) -> NoReturn:
    """Raise Error for ``gymnasium.make_vec`` of agents, which Gymnasium's vector interface does not have."""
    raise gymnasium.error.Error(
        "ConstellationTasking has several agents, which gymnasium.make_vec cannot return. Arrays by agent are "
        f"bsk_torch.bsk_rl.ConstellationTasking(satellites=[...], ..., num_envs={num_envs})"
    )


class Alone(gymnasium.Wrapper[object, object, object, object]):
    """One of several environments in a process, with separate draws of NumPy's global generator.

    An environment seeds the generator at reset and draws from it during the episode. Here every environment has the generator's
    state to itself, and the caller's state is left as it was.
    """

    env: Any
    """The environment, of :mod:`bsk_torch.bsk_rl.gym`."""

    def __init__(self, env: GeneralSatelliteTasking[object, object]) -> None:
        """Wrap an environment, and reset it once to know its spaces."""
        super().__init__(env)
        self._draws = np.random.get_state()
        with self.alone():
            _ = env.observation_space if not isinstance(env, ConstellationTasking) else env.observation_spaces

    @contextmanager
    def alone(self) -> Iterator[Any]:
        """Let this environment have NumPy's global generator and the clock of the log; yield the environment."""
        before = np.random.get_state()
        np.random.set_state(self._draws)
        for handler in logging.getLogger(GeneralSatelliteTasking.__module__.rpartition(".")[0]).handlers:
            for context in (each for each in handler.filters if isinstance(each, ContextFilter)):
                context.env = self.unwrapped
        try:
            yield self.env
        finally:
            self._draws = np.random.get_state()
            np.random.set_state(before)

    def reset(self, *, seed: int | None = None, options: object = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: Seed of the episode; None draws it from Gymnasium's generator of the environment, which the last given seed has
                seeded.
            options: Not used, as in bsk_rl.
        """
        drawn = int(self.unwrapped.np_random.integers(2**32)) if seed is None else seed
        with self.alone() as env:
            return env.reset(seed=drawn, options=options)

    @override
    def step(self, action: object) -> Any:
        with self.alone() as env:
            return env.step(action)


class EpisodesVectorEnv(SyncVectorEnv):
    """N environments side by side, as ``gymnasium.vector.VectorEnv``.

    With ``reset(seed=s)``, environment i plays the episode of a single environment with seed ``s + i``, to the last bit; later
    episodes draw their seeds from ``env.np_random``, so that the first seed decides all of them. ``envs`` are in :class:`Alone`.
    """

    def __init__(
        self,
        envs: Sequence[GeneralSatelliteTasking[object, object]],
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        alone = [Alone(env) for env in envs]
        super().__init__([lambda one=one: one for one in alone], autoreset_mode=parse_mode(autoreset_mode))  # type: ignore[misc]

    def call(self, name: str, *args: object, **kwargs: object) -> tuple[object, ...]:
        """Return an attribute of every environment, or the results of a method."""
        return called(self.envs, name, *args, **kwargs)


def called(envs: Sequence[Any], name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
    """Return an attribute of every environment, or the results of a method; each has its own draws."""
    values = []
    for one in envs:
        with one.alone() as env:
            value = getattr(env, name)
            values.append(value(*args, **kwargs) if callable(value) else value)
    return tuple(values)


# -- agents ----------------------------------------------------------------------------------------------------------------------


class AgentsVectorEnv(AgentsVector):
    """N constellations side by side.

    With ``reset(seed=s)``, environment i plays the episode of a single environment with seed ``s + i``. ``envs`` are in
    :class:`Alone`.
    """

    def __init__(
        self, envs: Sequence[ConstellationTasking[object, object]], autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP
    ) -> None:
        self.envs = [Alone(env) for env in envs]
        first = self.envs[0].env
        spaces_of = first.observation_space, first.action_space
        super().__init__(len(self.envs), autoreset_mode, *({a: of(a) for a in first.possible_agents} for of in spaces_of))
        self._over: np.ndarray = np.zeros(self.num_envs, dtype=bool)
        self._last: list[ByAgent] = [{}] * self.num_envs

    @property
    def agents(self) -> list[list[Any]]:
        """Remaining agents of each environment."""
        return [one.env.agents for one in self.envs]

    def call(self, name: str, *args: object, **kwargs: object) -> tuple[object, ...]:
        """Return an attribute of every environment, or the results of a method."""
        return called(self.envs, name, *args, **kwargs)

    get_attr = call

    def set_attr(self, name: str, values: object) -> None:
        """Set an attribute: to one value everywhere, or to those of a list [N]; ValueError for a list of another length."""
        each = values if isinstance(values, list | tuple) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise ValueError(f"values has {len(each)} entries; it must have {self.num_envs}, one per environment")
        for one, value in zip(self.envs, each, strict=True):
            setattr(one.env, name, value)

    def close(self) -> None:
        """Close every environment."""
        for one in self.envs:
            one.close()

    # -- reset and step -----------------------------------------------------------------------------------------------

    def reset(
        self, seed: int | Sequence[int | None] | None = None, options: dict[str, object] | None = None
    ) -> tuple[ByAgent, ByAgent]:
        """Start episodes; return observations and infos.

        Args:
            seed: Seed s of environment 0, with s + i for environment i; or a seed for each. None draws seeds.
            options: ``{"reset_mask": mask}`` with booleans [N] leaves the other environments unchanged.
        """
        mask = self._reset_rows(options)
        first = None if seed is None else [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else list(seed)
        if first is not None and len(first) != self.num_envs:
            raise ValueError(f"seed has {len(first)} entries; it must have {self.num_envs}, one per environment")
        results = list(self._last)
        for k in np.flatnonzero(mask).tolist():
            results[k] = self._begin(k, None if first is None else first[k])
        observations, *_, infos = self._outputs(results)
        return observations, infos

    def _begin(self, k: int, seed: int | None = None) -> ByAgent:
        observations, infos = self.envs[k].reset(seed=seed)
        self._over[k] = False
        return {agent: (observations[agent], 0.0, False, False, infos[agent]) for agent in observations}

    def step(self, actions: Mapping[Any, Any]) -> tuple[ByAgent, ByAgent, ByAgent, ByAgent, ByAgent]:
        """See :class:`AgentsVector`."""
        self._check_step(actions)
        return self._outputs([
            self._begin(k) if self._over[k] else self._move(k, {agent: each[k] for agent, each in actions.items()})
            for k in range(self.num_envs)
        ])  # fmt: skip

    def _move(self, k: int, actions: ByAgent) -> ByAgent:
        one = self.envs[k]
        before = one.env.agents
        results = one.step({agent: action for agent, action in actions.items() if agent in before})
        by_agent = {agent: tuple(part[agent] for part in results) for agent in before}
        self._over[k] = not one.env.agents or all(by_agent[agent][2] or by_agent[agent][3] for agent in one.env.agents)
        return by_agent

    def _outputs(self, environments: list[ByAgent]) -> tuple[ByAgent, ByAgent, ByAgent, ByAgent, ByAgent]:
        self._last, self._started = environments, True
        observations, infos = {}, {}
        columns: list[ByAgent] = [{}, {}, {}]
        for agent, space in self.single_observation_spaces.items():
            each = [results.get(agent) for results in environments]
            none = next(iter(iterate(batch_space(space, 1), create_empty_array(space, 1))))
            rows: Any = create_empty_array(space, self.num_envs)
            observations[agent] = concatenate(space, [none if one is None else one[0] for one in each], rows)
            for column, kind, place in zip(columns, (float, bool, bool), (1, 2, 3), strict=True):
                column[agent] = np.array([0 if one is None else one[place] for one in each], dtype=kind)
            present = {"present": np.array([one is not None for one in each])}
            infos[agent] = stacked([{} if one is None else one[4] for one in each]) | present
        return observations, columns[0], columns[1], columns[2], infos


def stacked(infos: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return infos of environments as arrays [N] by name, zero where one is missing; nested ones as nested dictionaries."""
    arrays: dict[str, object] = {}
    for name in dict.fromkeys(name for info in infos for name in info):
        values = [info.get(name) for info in infos]
        if any(isinstance(value, Mapping) for value in values):
            arrays[name] = stacked([value or {} for value in values])
        else:
            some = next(value for value in values if value is not None)
            arrays[name] = np.array([type(some)() if value is None else value for value in values])
    return arrays
