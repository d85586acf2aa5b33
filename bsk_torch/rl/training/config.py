"""Settings of training runs, from recipes, files and the command line."""

from __future__ import annotations

import dataclasses
import logging
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml
from omegaconf import MISSING, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from bsk_torch._checks import number, whole
from bsk_torch.env import SatelliteTasking
from bsk_torch.env.seeds import episode_seed
from bsk_torch.files import write_file
from bsk_torch.presets import make
from bsk_torch.presets.own import enter_named
from bsk_torch.rl.evaluation.evaluate import FRESH
from bsk_torch.rl.networks.plans import check_layers, check_network
from bsk_torch.rl.networks.precision import FLOAT32, PRECISIONS
from bsk_torch.rl.policies.files import LOGS
from bsk_torch.rl.training.imitation import check_teacher, enter_teacher
from bsk_torch.sim.arguments.values import nearest
from bsk_torch.untrusted import plain, read_bytes, read_yaml

logger = logging.getLogger(__name__)

TIMES = {"minutes": "60 * minutes", "hours": "3600 * hours"}
"""Units of time that settings are not in."""

SECONDS = 180.0
"""Training time of a training without a limit, s."""

LEAST = 0.05
"""Fraction of learning rate and entropy weight left at the end of a schedule."""

SCHEDULES: dict[str, Callable[[float], float]] = {
    "constant": lambda fraction: 1.0,
    "linear": lambda fraction: max(LEAST, 1.0 - fraction),
    "cosine": lambda fraction: LEAST + (1.0 - LEAST) * 0.5 * (1.0 + math.cos(math.pi * fraction)),
}
"""Remaining fraction of a setting, by the used fraction of the budget."""

EVALUATE_EVERY, LEAST_INTERVAL = 250_000, 5_000
"""Decisions between two evaluations unless a training says otherwise, and the least number of them."""

CONFIG = "config.yaml"
"""File of the configuration in the folder of a run."""

REWARD_TIMES = ("end", "start")
LOGGERS = ("csv", "tensorboard", "wandb")
COLLECTORS = ("single", "multi", "ray")

AUTO = "auto"
"""Value of ``workers`` for as many processes as suit the machine."""

LEAST_NUMBERS = {
    "frames": 1,
    "num_envs": 1,
    "rollout": 1,
    "seed": 0,
    "epochs": 1,
    "minibatch": 1,
    "evaluate_every": 0,
    "evaluate_episodes": 1,
    "patience": 1,
    "checkpoint_every": 0,
    "tuning_runs": 0,
}
"""Integer settings, and their minimum values."""

MOST = 2**62
"""Largest whole number of a setting, so that those computed from it fit into 64 bits."""

LIMITS = {
    "seconds": (0.0, math.inf, True),
    "learning_rate": (0.0, 1.0, False),
    "gamma": (0.0, 1.0, True),
    "lmbda": (0.0, 1.0, False),
    "clip": (0.0, 1.0, True),
    "entropy": (0.0, math.inf, False),
    "gradient_norm": (0.0, math.inf, True),
    "imitation": (0.0, 1.0, True),
    "imitation_temperature": (0.0, math.inf, False),
}
"""Real-valued settings, their least and largest values, and whether the least is excluded."""

WIDEST = 65_536
"""Maximum width of a hidden layer."""

LONGEST, MOST_VALUES = 1_000_000, 10_000
"""Maximum number of bytes and of values in settings files."""

RESERVED = {"num_envs": "num_envs", "seed": "seed", "env_ids": "num_envs"}
"""Arguments of the environment that are not options, and the settings that determine them."""


@dataclass(frozen=True)
class PPOConfig:
    """Settings of a training.

    Args:
        preset: Name of the environment; see :func:`bsk_torch.make`.
        network: ``"mlp"`` for observation vectors, ``"gru"`` for the same with a memory, ``"attention"`` for targets observed as
            a set.
        seconds: Training time after compilation, s; None for no limit if there are ``frames``, else :data:`SECONDS`. Such a
            training depends on the clock: learning rate and entropy fall with the time used.
        frames: Number of decisions; None for no limit. The limit reached first counts.
        num_envs: Episodes at once.
        rollout: Decisions of each between two updates.
        seed: Seed of networks, actions and episodes.
        hidden: Width of every hidden layer, or of every block of attention.
        learning_rate: Adam's step at the start.
        learning_rate_schedule: How it falls: ``"constant"``, ``"linear"`` or ``"cosine"``, to :data:`LEAST` of that.
        gamma: Discount per second.
        reward_time: ``"end"``: rewards are discounted over the interval that they were earned in; ``"start"``:
            they count in full, as TorchRL does.
        lmbda: Decay of the advantage estimator, per decision.
        beyond_limit: Whether an episode that is truncated counts as one that continues: the value of its last state is added to
            its return, and the policy prepares for what follows the limit. Choose ``gamma`` such that 1 / (1 - gamma), in
            seconds, is shorter than the limit, and do not observe the time. False: returns end with the episode, as reported.
        clip: Largest change of an action's probability, as a ratio's distance from one.
        entropy: Weight of the entropy at the start.
        entropy_schedule: How it falls, as the learning rate does.
        epochs: Passes over a batch.
        minibatch: Decisions in a gradient step.
        gradient_norm: Gradients of the actor, and those of the critic, are scaled down to this norm.
        precision: Type in which networks compute in gradient steps: ``"float32"``, or ``"bfloat16"`` on devices that have it.
            Policies decide in float32.
        imitate: Rule that the policy learns to imitate first: a name, such as ``"hasty"``, your own function or module (see
            :func:`~bsk_torch.wrappers.policies.policy_of_one`), or its name, ``"module:name"`` or ``"file.py:name"``. None for
            none.
        imitation: Part of the budget in which it does; 1 for a training without reinforcement learning and critic.
        imitation_temperature: The rule teaches probabilities proportional to exp(worth / (temperature * best)), with the largest
            worth of an image in the same decision; the worth of an image is about its discounted priority. For the imaging rules
            ``"greedy"``, ``"hasty"``, ``"farsighted"`` and ``"cooperative"`` only. 0: the rule teaches its actions.
        stagger: Whether the first episodes are cut at random, so that batches mix early and late decisions from the start.
        evaluate_every: Decisions between two evaluations on unseen episodes, by which the best policy is kept; 0 for none before
            the end. None for the least of :data:`EVALUATE_EVERY` and an eighth of ``frames``, or for 0 if that would be less than
            :data:`LEAST_INTERVAL`.
        evaluate_episodes: Episodes of each.
        patience: Evaluations without a better return after which training stops; None for never.
        checkpoint_every: Decisions between two checkpoints; 0 for one at the end only.
        loggers: ``"csv"`` (always), ``"tensorboard"``, ``"wandb"``.
        collector: ``"single"`` process, ``"multi"`` for TorchRL's MultiSyncCollector on this machine, ``"ray"`` for its
            RayCollector on a cluster.
        workers: Processes of the last two; episodes and decisions are shared out among them. ``"auto"`` chooses the collector and
            as many processes as suit the available cores and ``num_envs``; the configuration of the run has the number.
        ahead: Whether these collect the next batch while one is learned from, so that no core waits. Every batch is then by a
            policy that is exactly one update old; results do not depend on speed, and resume bit for bit.
        tuning_runs: Number of trainings by which these settings were chosen, as you declare it; the file of the policy records it
            with the decisions and core-seconds of this training.
        options: Arguments of the environment that differ from the preset's.
    """

    preset: str = "NadirScan-v1"
    network: str = "mlp"
    seconds: float | None = None
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
    beyond_limit: bool = False
    clip: float = 0.2
    entropy: float = 0.01
    entropy_schedule: str = "linear"
    epochs: int = 8
    minibatch: int = 2048
    gradient_norm: float = 0.5
    precision: str = FLOAT32
    imitate: str | None = None
    imitation: float = 0.25
    imitation_temperature: float = 0.0
    stagger: bool = True
    evaluate_every: int | None = None
    evaluate_episodes: int = 256
    patience: int | None = None
    checkpoint_every: int = 250_000
    loggers: tuple[str, ...] = ("csv",)
    collector: str = "single"
    workers: int | str = 2
    ahead: bool = False
    tuning_runs: int = 0
    options: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("hidden", "loggers"):  # files and command lines bring lists
            value = getattr(self, name)
            if isinstance(value, str) or not isinstance(value, Iterable):
                raise ValueError(f"{name}={value!r} must be a list")
            object.__setattr__(self, name, tuple(value))
        if self.evaluate_every is None:
            object.__setattr__(self, "evaluate_every", self._default_interval())
        check_network(str(self.network))
        for name, least in LEAST_NUMBERS.items():
            if getattr(self, name) is not None or name not in ("frames", "patience"):
                object.__setattr__(self, name, whole(name, getattr(self, name), least, MOST))
        for name, (low, high, above) in LIMITS.items():
            if getattr(self, name) is not None or name != "seconds":
                object.__setattr__(self, name, number(name, getattr(self, name), low, high, above=above))
        if callable(self.imitate):  # a rule of the user's; it has a name from here on
            object.__setattr__(self, "imitate", enter_teacher(self.imitate))
        if self.imitate is not None:
            check_teacher(self.imitate, self.imitation_temperature)
        check_layers(self.hidden)
        for width in self.hidden:
            whole("hidden", width, 1, WIDEST)
        for name in ("stagger", "beyond_limit", "ahead"):
            if not isinstance(getattr(self, name), bool):
                raise ValueError(f"{name}={getattr(self, name)!r} must be True or False")
        for seed in (self.seed, self.seed + FRESH):
            episode_seed(seed)
        self._check_options()
        self._check_names()
        if self.workers != AUTO:
            self._check_workers()
        if self.patience is not None and not self.evaluate_every:
            raise ValueError(f"patience={self.patience} needs evaluate_every")

    def _default_interval(self) -> int:
        """Decisions between two evaluations where ``evaluate_every`` is None."""
        if not isinstance(self.frames, int):
            return EVALUATE_EVERY
        interval = min(EVALUATE_EVERY, self.frames // 8)
        return interval if interval >= LEAST_INTERVAL else 0

    def _check_workers(self) -> None:
        if isinstance(self.workers, str):
            raise ValueError(f"workers={self.workers!r} must be a whole number or {AUTO!r}")
        whole("workers", self.workers, 1, MOST)
        if self.ahead and self.collector == "single":
            raise ValueError("ahead=True collects in other processes: it needs collector='multi' or 'ray'")
        if self.num_envs % self.processes:
            even = [count for count in range(1, self.processes) if self.num_envs % count == 0]
            raise ValueError(
                f"workers={self.workers}: num_envs={self.num_envs} episodes cannot be shared out evenly among {self.workers} "
                f"processes; the nearest number is workers={even[-1]}"
            )

    def _check_options(self) -> None:
        if not isinstance(self.options, Mapping):
            raise ValueError(f"options={self.options!r} must be a dictionary of arguments of the environment")
        for name in self.options:
            if name in RESERVED:
                raise ValueError(f"options.{name} is no option of a training: the setting {RESERVED[name]!r} decides that")

    def _check_names(self) -> None:
        allowed: dict[str, Iterable[str]] = {
            "learning_rate_schedule": SCHEDULES,
            "entropy_schedule": SCHEDULES,
            "reward_time": REWARD_TIMES,
            "precision": PRECISIONS,
            "collector": COLLECTORS,
        }
        choices = [(name, getattr(self, name)) for name in allowed] + [("loggers", name) for name in self.loggers]
        for name, value in choices:
            names = list(allowed.get(name, LOGGERS))
            if value not in names:
                raise ValueError(f"{name}={value!r} must be one of {names}; {nearest(str(value), names)}")

    @property
    def processes(self) -> int:
        """Number of processes that collect; ValueError as long as it is ``"auto"``."""
        if isinstance(self.workers, str):
            raise ValueError(f"workers={self.workers!r} has no number yet: with_workers(config) chooses one")
        return 1 if self.collector == "single" else self.workers

    @property
    def clock(self) -> float | None:
        """Training time after which the training ends, s; None where decisions alone limit it."""
        return SECONDS if self.seconds is None and self.frames is None else self.seconds

    def annealed(self, fraction: float) -> tuple[float, float]:
        """Return learning rate and weight of the entropy at a used ``fraction`` of the budget."""
        rate, entropy = SCHEDULES[self.learning_rate_schedule], SCHEDULES[self.entropy_schedule]
        return self.learning_rate * rate(fraction), self.entropy * entropy(fraction)

    @property
    def batch(self) -> int:
        """Decisions between two updates."""
        return self.num_envs * self.rollout

    def make_env(self, first: int = 0, count: int | None = None) -> SatelliteTasking:
        """The environment to train in, or ``count`` of its episodes from number ``first`` on."""
        n = self.num_envs if count is None else count
        return make(self.preset, num_envs=n, seed=self.seed, env_ids=range(first, first + n), **self.options)


Config = TypeVar("Config", bound=PPOConfig)


def check_setting(name: str, kind: type[PPOConfig]) -> None:
    """Raise ValueError, with the nearest name, unless ``name`` is a field of ``kind``; options of environments are named so."""
    names = [field.name for field in dataclasses.fields(kind)]
    if name in names:
        return
    hint = nearest(name, names)
    if name in TIMES:
        hint = f"seconds={TIMES[name]} limits the training"
    elif name.isidentifier() and not hint.startswith("did you mean"):
        hint = f"an option of the environment is written as options.{name}, in Python options={{{name!r}: ...}}"
    raise ValueError(f"unknown setting {name!r}; {hint}")


def override(config: Config, changes: Iterable[str]) -> Config:
    """The configuration with ``changes`` such as ``"learning_rate=1e-3"``, ``"hidden=[128,128]"`` or ``"options.as_set=true"``.

    With ``frames`` but not ``seconds`` among them, decisions alone limit the training, as in :class:`PPOConfig`.

    Raises:
        ValueError: For a field that does not exist, a value of the wrong type, an interpolation (``${...}``), or a value that
            the configuration rejects.
    """
    changes = list(changes)
    for change in changes:
        setting, _, value = change.partition("=")
        name = setting.split(".")[0]
        if "=" not in change:
            names = [field.name for field in dataclasses.fields(config)]
            raise ValueError(f"{change!r} must read name=value, such as learning_rate=1e-3; {nearest(name, names)}")
        check_setting(name, type(config))
        _check_literal(setting, value)
        if setting == "imitate":
            enter_teacher(value)
        elif setting == "preset" and ":" in value:
            enter_named(value)
    settings = {change.partition("=")[0] for change in changes}
    if "frames" in settings and "seconds" not in settings:
        changes.append("seconds=null")
    try:
        return _to_object(OmegaConf.merge(OmegaConf.structured(config), OmegaConf.from_dotlist(changes)))
    except (OmegaConfBaseException, yaml.YAMLError) as error:
        name = re.split(r"[.\[]", str(getattr(error, "full_key", "")))[0]
        kinds = {entry.name: entry.type for entry in dataclasses.fields(config)}
        wrong = next((change for change in changes if change.startswith(f"{name}=")), " ".join(changes))
        form = f"; {name} is of type {kinds[name]}, in this configuration {getattr(config, name)}" if name in kinds else ""
        raise ValueError(f"{wrong}: {str(error).splitlines()[0]}{form}") from error


def _to_object(node: object) -> Any:
    try:
        return OmegaConf.to_object(node)
    except OmegaConfBaseException as error:
        if isinstance(error.__cause__, ValueError):
            raise error.__cause__ from None
        raise


def save_config(config: PPOConfig, path: Path) -> None:
    """Write a configuration as YAML.

    Options that are objects are only noted, by their ``repr``; :data:`~bsk_torch.rl.policies.files.LOGS` are left out. OSError if
    the file cannot be written.
    """
    options = {name: _plain(value) for name, value in config.options.items() if name not in LOGS}
    write_file(path, OmegaConf.to_yaml(OmegaConf.structured(dataclasses.replace(config, options=options))))


def _plain(value: object) -> object:
    try:
        OmegaConf.create({"value": value})
    except OmegaConfBaseException:
        return repr(value)
    return value


def read_settings(path: Path) -> dict[str, Any]:
    """Return the settings in a file of :func:`save_config`, as they are written there.

    The file may come from others. Nothing in it is executed or looked up: ``${...}``, which OmegaConf would replace by variables
    of the environment and the like, is rejected, and so are YAML aliases and options that write files.

    ValueError for a file without settings, or with additional content; the message names it.
    """
    try:
        settings = plain(read_yaml(read_bytes(path, LONGEST), most=MOST_VALUES))
        if not isinstance(settings, dict) or not settings:
            raise ValueError("it holds no settings by name")
        for name, value in _leaves("", settings):
            if isinstance(value, str):
                _check_literal(name, value)
        options = settings.get("options")
        for name in set(LOGS) & set(options) if isinstance(options, dict) else ():
            raise ValueError(f"options.{name} is not read from files; give it on the command line")
    except ValueError as error:
        raise ValueError(f"{path} is no configuration: {error}") from error
    return settings


def _check_literal(name: str, text: str) -> None:
    """Raise ValueError for text that OmegaConf would replace by another setting, a variable of the environment, or the like."""
    if "${" in text or text == MISSING:
        raise ValueError(
            f"{name}={text!r} would be replaced; settings are literal values: numbers, true, false, null, text without ${{, and "
            "lists or dictionaries of these"
        )


def _leaves(name: str, value: object) -> Iterator[tuple[str, object]]:
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _leaves(f"{name}.{key}".lstrip("."), part)
    elif isinstance(value, list):
        for part in value:
            yield from _leaves(name, part)
    else:
        yield name, value


def load_config(path: Path, kind: type[Config]) -> Config:
    """The configuration of a file that :func:`save_config` has written; ValueError if it does not fit ``kind``."""
    settings = read_settings(path)
    missing = [field.name for field in dataclasses.fields(kind) if field.name not in settings]
    if missing:
        logger.warning("%s does not say %s; the default applies", path, ", ".join(missing))
    try:
        complete = isinstance(settings.get("options"), dict)  # then defaults add no option
        defaults = OmegaConf.structured(kind(options={}) if complete else kind)
        return _to_object(OmegaConf.merge(defaults, settings))
    except OmegaConfBaseException as error:
        raise ValueError(f"{path} is no configuration of this version: {str(error).splitlines()[0]}") from error
    except ValueError as error:
        raise ValueError(f"{path} is no configuration: {error}") from error
