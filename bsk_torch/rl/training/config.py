"""Settings of trainings, which come from recipes, files and the command line."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from bsk_torch.env import SatelliteTasking
from bsk_torch.presets import make
from bsk_torch.rl.networks.plans import check_network
from bsk_torch.sim.params import nearest

LEAST = 0.05
"""Fraction of learning rate and entropy weight that is left at the end of a schedule."""

SCHEDULES: dict[str, Callable[[float], float]] = {
    "constant": lambda used: 1.0,
    "linear": lambda used: max(LEAST, 1.0 - used),
    "cosine": lambda used: LEAST + (1.0 - LEAST) * 0.5 * (1.0 + math.cos(math.pi * used)),
}
"""Fraction of a setting that is left, by the used fraction of the budget."""

CONFIG = "config.yaml"
"""File of the configuration in the folder of a run."""

REWARD_TIMES = ("end", "start")
LOGGERS = ("csv", "tensorboard", "wandb")
COLLECTORS = ("single", "multi", "ray")


@dataclass(frozen=True)
class PPOConfig:
    """Settings of a training.

    Args:
        preset: Name of the environment; see :func:`bsk_torch.make`.
        network: ``"mlp"`` for observation vectors, ``"gru"`` for the same with a memory, ``"attention"`` for targets observed as
            a set.
        seconds: Training time after compilation, s; None for no limit.
        frames: Number of decisions; None for no limit. One of the two limits is needed.
        num_envs: Episodes at once.
        rollout: Decisions of each between two updates.
        seed: Seed of networks, actions and episodes.
        hidden: Width of every hidden layer, or of every block of attention.
        learning_rate: Adam's step at the start.
        learning_rate_schedule: How it falls: ``"constant"``, ``"linear"`` or ``"cosine"``, to :data:`LEAST` of that.
        gamma: Discount per second.
        reward_time: ``"end"``: rewards are discounted over the interval that they were earned in, as bsk_rl does; ``"start"``:
            they count in full, as TorchRL does.
        lmbda: Decay of the advantage estimator, per decision.
        clip: Largest change of an action's probability, as a ratio's distance from one.
        entropy: Weight of the entropy at the start.
        entropy_schedule: How it falls, as the learning rate does.
        epochs: Passes over a batch.
        minibatch: Decisions in a gradient step.
        gradient_norm: Gradients are scaled down to this norm.
        stagger: Whether the first episodes are cut at random, so that batches mix early and late decisions from the start.
        evaluate_every: Decisions between two evaluations on fresh episodes; 0 for none before the end.
        evaluate_episodes: Episodes of each.
        patience: Evaluations without a better return after which training stops; None for never.
        checkpoint_every: Decisions between two checkpoints; 0 for one at the end only.
        loggers: ``"csv"`` (always), ``"tensorboard"``, ``"wandb"``.
        collector: ``"single"`` process, ``"multi"`` for TorchRL's MultiSyncCollector on this machine, ``"ray"`` for its
            RayCollector on a cluster.
        workers: Processes of the last two; episodes and decisions are shared out among them.
        options: Arguments of the environment that differ from the preset's.
    """

    preset: str = "NadirScan-v1"
    network: str = "mlp"
    seconds: float | None = 180.0
    frames: int | None = None
    num_envs: int = 1024
    rollout: int = 16
    seed: int = 0
    hidden: tuple[int, ...] = (64, 64)
    learning_rate: float = 2.5e-3
    learning_rate_schedule: str = "linear"
    gamma: float = 0.99999
    reward_time: str = "end"
    lmbda: float = 0.95
    clip: float = 0.2
    entropy: float = 0.01
    entropy_schedule: str = "linear"
    epochs: int = 8
    minibatch: int = 2048
    gradient_norm: float = 0.5
    stagger: bool = True
    evaluate_every: int = 0
    evaluate_episodes: int = 256
    patience: int | None = None
    checkpoint_every: int = 250_000
    loggers: tuple[str, ...] = ("csv",)
    collector: str = "single"
    workers: int = 2
    options: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse invalid settings before anything is built."""
        for name in ("hidden", "loggers"):  # files and command lines bring lists
            object.__setattr__(self, name, tuple(getattr(self, name)))
        check_network(self.network)
        limits = [limit for limit in (self.seconds, self.frames) if limit is not None]
        if not limits or min(limits) <= 0:
            raise ValueError(f"seconds={self.seconds} and frames={self.frames}: training needs a limit, and a positive one")
        if not 0.0 < self.gamma <= 1.0:
            raise ValueError(f"gamma={self.gamma} per second must lie in (0, 1]")
        for name in ("num_envs", "rollout", "epochs", "minibatch", "workers", "evaluate_episodes"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}={getattr(self, name)} must be at least 1")
        for name in ("evaluate_every", "checkpoint_every"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name}={getattr(self, name)} must not be negative")
        self._check_names()
        if self.collector != "single" and self.num_envs % self.workers:
            raise ValueError(f"num_envs={self.num_envs} cannot be shared out evenly among workers={self.workers}")
        if self.patience is not None and (self.patience < 1 or not self.evaluate_every):
            raise ValueError(f"patience={self.patience} must be at least 1, and needs evaluate_every")

    def _check_names(self) -> None:
        allowed: dict[str, Iterable[str]] = {
            "learning_rate_schedule": SCHEDULES,
            "entropy_schedule": SCHEDULES,
            "reward_time": REWARD_TIMES,
            "collector": COLLECTORS,
        }
        chosen = [(name, getattr(self, name)) for name in allowed] + [("loggers", name) for name in self.loggers]
        for name, value in chosen:
            names = list(allowed.get(name, LOGGERS))
            if value not in names:
                raise ValueError(f"{name}={value!r} must be one of {names}; {nearest(value, names)}")

    @property
    def batch(self) -> int:
        """Decisions between two updates."""
        return self.num_envs * self.rollout

    def make_env(self, first: int = 0, count: int | None = None) -> SatelliteTasking:
        """The environment to train in, or ``count`` of its episodes from number ``first`` on."""
        n = self.num_envs if count is None else count
        return make(self.preset, num_envs=n, seed=self.seed, env_ids=range(first, first + n), **self.options)


Config = TypeVar("Config", bound=PPOConfig)


def override(config: Config, changes: Iterable[str]) -> Config:
    """The configuration with ``changes`` such as ``"learning_rate=1e-3"``, ``"hidden=[128,128]"`` or ``"options.as_set=true"``.

    Raises:
        ValueError: For a field that does not exist, a value of the wrong type, or one that the configuration refuses.
    """
    changes = list(changes)
    for change in changes:
        name = change.split("=")[0].split(".")[0]
        known = [field.name for field in dataclasses.fields(config)]
        if "=" not in change:
            raise ValueError(f"{change!r} must read name=value, such as learning_rate=1e-3; {nearest(name, known)}")
        if name not in known:
            raise ValueError(f"{name!r} is no setting of the training; {nearest(name, known)}; all: {', '.join(known)}")
    try:
        return _to_object(OmegaConf.merge(OmegaConf.structured(config), OmegaConf.from_dotlist(changes)))
    except OmegaConfBaseException as error:
        raise ValueError(f"{' '.join(changes)}: {str(error).splitlines()[0]}") from error


def _to_object(node: Any) -> Any:
    try:
        return OmegaConf.to_object(node)
    except OmegaConfBaseException as error:
        if isinstance(error.__cause__, ValueError):
            raise error.__cause__ from None
        raise


def save_config(config: PPOConfig, path: Path) -> None:
    """Write a configuration as YAML; options that are objects are only noted, by their ``repr``."""
    kept = dataclasses.replace(config, options={name: _plain(value) for name, value in config.options.items()})
    OmegaConf.save(OmegaConf.structured(kept), path)


def _plain(value: Any) -> Any:
    try:
        OmegaConf.create({"value": value})
    except OmegaConfBaseException:
        return repr(value)
    return value


def load_config(path: Path, kind: type[Config]) -> Config:
    """The configuration of a file that :func:`save_config` has written; ValueError if it does not fit ``kind``."""
    read = OmegaConf.load(path)
    try:
        assert isinstance(read, DictConfig)
        return _to_object(OmegaConf.merge(OmegaConf.structured(kind), read))
    except OmegaConfBaseException as error:
        raise ValueError(f"{path} is no configuration of this version: {str(error).splitlines()[0]}") from error
