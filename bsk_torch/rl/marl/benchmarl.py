"""Constellations as tasks of BenchMARL, which trains and compares multi-agent algorithms, and the policies of its experiments.

BenchMARL 1.5 asks pip for an older TorchRL than this package needs, and installs without its dependencies:
``pip install --no-deps benchmarl==1.5.2``.
"""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch
import torchrl.collectors
from torchrl.data import Composite
from torchrl.envs import EnvBase

from bsk_torch.env import ConstellationTasking, Tasking
from bsk_torch.presets import make
from bsk_torch.rl.policies.interface import Loaded
from bsk_torch.wrappers.policies import WholePolicy

__all__ = ["ConstellationClass", "ConstellationTask", "read_experiment"]

RENAMED = not hasattr(torchrl.collectors, "SyncDataCollector")
if RENAMED:  # BenchMARL 1.5 imports TorchRL's collector by the name that it had before 0.12
    torchrl.collectors.SyncDataCollector = torchrl.collectors.Collector
try:
    from benchmarl.environments import Task, TaskClass
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        f"there is no module {error.name!r}; pip install --no-deps benchmarl==1.5.2 (with its dependencies it would ask for an "
        "older TorchRL)"
    ) from error
finally:
    if RENAMED:
        del torchrl.collectors.SyncDataCollector


@dataclass
class TaskConfig:
    """Settings of a task.

    Attributes:
        max_steps: Most decisions in an episode of an evaluation. A decision ends with the first task of any satellite, so
            there are more of them in larger constellations.
        options: Arguments of the preset, such as ``time_limit``.
    """

    max_steps: int = 200
    options: dict[str, Any] = field(default_factory=dict)


class ConstellationClass(TaskClass):
    """A preset with several satellites, as BenchMARL sees it: batched, with masked discrete actions."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: torch.device | str
    ) -> Callable[[], EnvBase]:
        """A function that makes the environment; ValueError if continuous actions are asked for."""
        if continuous_actions:
            raise ValueError(f"continuous_actions=True, but the actions of {PRESET[self.name]} are discrete")
        options = copy.deepcopy(self.config["options"])
        return lambda: make(PRESET[self.name], num_envs=num_envs, seed=seed, device=device, **options)

    def supports_continuous_actions(self) -> bool:
        """No."""
        return False

    def supports_discrete_actions(self) -> bool:
        """Yes."""
        return True

    def has_render(self, env: EnvBase) -> bool:
        """No."""
        return False

    def max_steps(self, env: EnvBase) -> int:
        """Most decisions in an episode of an evaluation."""
        return self.config["max_steps"]

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """Names of the agents of each group."""
        return env.group_map

    def observation_spec(self, env: EnvBase) -> Composite:
        """Return the specs of observations, for each group."""
        return self._only(env, env.full_observation_spec_unbatched, "observation")

    def action_spec(self, env: EnvBase) -> Composite:
        """Return the specs of actions, for each group."""
        return env.full_action_spec_unbatched

    def action_mask_spec(self, env: EnvBase) -> Composite:
        """Return the specs of action masks, for each group."""
        return self._only(env, env.full_observation_spec_unbatched, "action_mask")

    def state_spec(self, env: EnvBase) -> None:
        """None: critics see the observations of all agents."""

    def info_spec(self, env: EnvBase) -> None:
        """None."""

    @staticmethod
    def env_name() -> str:
        """Name under which results are filed."""
        return "bsk_torch"

    def _only(self, env: EnvBase, spec: Composite, name: str) -> Composite:
        groups = {group: Composite({name: spec[group, name]}, shape=spec[group].shape) for group in env.group_map}
        return Composite(groups, shape=spec.shape)


class ConstellationTask(Task):
    """The presets with several satellites."""

    CONSTELLATION = None
    AEOS_CONSTELLATION = None
    RELAY_CONSTELLATION = None

    @staticmethod
    def associated_class() -> type[ConstellationClass]:
        """The class of the tasks."""
        return ConstellationClass

    def get_task(self, config: dict[str, Any] | None = None) -> ConstellationClass:
        """The task; ``config`` has fields of :class:`TaskConfig` that differ from their defaults."""
        return ConstellationClass(self.name, asdict(TaskConfig(**(config or {}))))


PRESET = {
    "CONSTELLATION": "Constellation-v1",
    "AEOS_CONSTELLATION": "AEOSConstellation-v1",
    "RELAY_CONSTELLATION": "RelayConstellation-v1",
}
"""Presets by the names of the tasks."""


def read_experiment(file: Path) -> Loaded:
    """Read the policy of an experiment's checkpoint, ``checkpoints/checkpoint_N.pt`` below its folder, which has ``config.pkl``.

    Unpickles both. ValueError for damaged files. The policy is built for the environment in which it is to act, with the groups
    of the training: for any number of satellites if weights are shared (``share_policy_params``, the default), else for the same.
    """
    try:
        with open(file.parent.parent / "config.pkl", "rb") as stream:
            parts = [pickle.load(stream) for _ in range(8)]  # as Experiment writes them
        state = torch.load(file, map_location="cpu", weights_only=False)
        collector = state["collector"]
        weights = collector.get("worker0", collector)["policy_state_dict"]  # all workers have the same
    except Exception as error:  # unpickling may raise anything
        raise ValueError(f"{str(file)!r} is no experiment of BenchMARL: {type(error).__name__}: {error}") from error
    task, _, algorithm, model, _, config, critic, _ = parts
    title = f"the experiment {str(file)!r}"
    trained = sorted(name.removeprefix("loss_") for name in state if name.startswith("loss_"))

    def fit(env: Tasking, where: str) -> WholePolicy:
        groups = dict(env.group_map) if isinstance(env, ConstellationTasking) else {}
        if sorted(groups) != trained:
            raise ValueError(
                f"{title} acts for the groups {', '.join(trained)}; {where} has {', '.join(groups) or 'one satellite'}"
            )
        for name in ("train_device", "sampling_device", "buffer_device"):
            setattr(config, name, str(env.device))
        experiment = SimpleNamespace(
            config=config,
            model_config=model,
            critic_model_config=critic,
            algorithm_config=algorithm,
            on_policy=algorithm.on_policy(),
            group_map=groups,
            observation_spec=task.observation_spec(env),
            action_spec=task.action_spec(env),
            action_mask_spec=task.action_mask_spec(env),
            state_spec=None,
            task=task,
        )
        policy = algorithm.get_algorithm(experiment=experiment).get_policy_for_collection().requires_grad_(False)
        expected, actual = ({name: list(part.shape) for name, part in state.items()} for state in (weights, policy.state_dict()))
        if expected != actual:
            name = next(name for name in (*expected, *actual) if expected.get(name) != actual.get(name))
            own = "" if config.share_policy_params else "weights of each satellite (share_policy_params=False), another team, "
            team = ", ".join(f"{len(names)} {group}" for group, names in groups.items())
            raise ValueError(
                f"{title} has {own}other observations or actions than {where} with {team}: "
                f"{name} is {expected.get(name)}, here {actual.get(name)}"
            )
        policy.load_state_dict(weights)
        return WholePolicy(policy)

    return Loaded(fit, f"benchmarl {version('benchmarl')}")
