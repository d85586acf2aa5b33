"""What a dataset contains: the settings with which it was made, checked before any episode is played."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from tensordict.nn import TensorDictModuleBase

from bsk_torch._checks import number, whole
from bsk_torch.env import SatelliteTasking, Tasking
from bsk_torch.env.action_forms import form
from bsk_torch.env.seeds import episode_seed
from bsk_torch.lab.offline.behaviors import Behavior, slug
from bsk_torch.lab.offline.layout import MINARI, STARTS
from bsk_torch.lab.planners.planner import Planner
from bsk_torch.rl.rules.baselines import LOT


@dataclass(frozen=True)
class Recipe:
    """Settings of a dataset.

    Attributes:
        preset: Name of the preset, for the descriptions of the dataset.
        behaviors: The policies that act; each plays the episodes of all seeds.
        seeds: Seeds of the episodes: those that ``gymnasium.make("bsk_torch/PRESET").reset(seed=...)`` starts.
        targets: Policies of one satellite by name; the return of an action is that of the action followed by one of them.
        share: Probability that a decision is sampled for the returns of all actions.
        gamma: Discount of these returns per second.
        futures: Number of futures drawn for each sampled decision; None for the true one.
        options: Options of the preset.
        minari: Whether the dataset is written in Minari's format as well.
    """

    preset: str
    behaviors: Sequence[Behavior]
    seeds: Sequence[int]
    targets: Mapping[str, TensorDictModuleBase] = field(default_factory=dict)
    share: float = 0.01
    gamma: float = 1.0
    futures: int | None = None
    options: Mapping[str, object] = field(default_factory=dict)
    minari: bool = False

    def __post_init__(self) -> None:
        number("share", self.share, 0.0, 1.0)
        number("gamma", self.gamma, 0.0, 1.0, above=True)
        if self.futures is not None:
            whole("futures", self.futures, 1)
        if not self.behaviors or not len(self.seeds):
            raise ValueError("a dataset needs one behavior and one seed at least")
        short = [slug(one.name) for one in self.behaviors]
        if len(set(short)) < len(short) or STARTS in short or MINARI in short:
            raise ValueError(f"behaviors need different names, also as names of folders; they are {short}")
        for seed in self.seeds:
            episode_seed(seed)
        for name, target in self.targets.items():
            _check_target(name, target)

    def checked(self, env: Tasking) -> SatelliteTasking:
        """Return ``env``; ValueError unless it has one satellite with numbered actions, whose observations the targets read."""
        if not isinstance(env, SatelliteTasking):
            raise ValueError(
                f"{self.preset} has several agents; a dataset needs one satellite with numbered actions, as in NadirScan-v1"
            )
        if form(env.satellite) is not None:
            raise ValueError(
                f"the actions of {self.preset} are real numbers; a dataset needs numbered ones, all of which can be tried"
            )
        if bool(env.env_ids.any()):
            raise ValueError("seeds name episodes of environment 0; make the environment with env_ids=[0] * num_envs")
        observed = set(env.observation_spec.keys(True, True))
        for name, target in self.targets.items():
            memory = [key for key in target.in_keys if key not in observed]
            if memory:
                raise ValueError(
                    f"target {name!r} reads {memory[0]!r}, a memory, which a state of another policy's episode does not have"
                )
        return env


def _check_target(name: str, target: TensorDictModuleBase) -> None:
    if name != slug(name):
        raise ValueError(f"target {name!r} must be named by letters, digits and dashes, such as {slug(name)!r}")
    if isinstance(target, Planner):
        raise ValueError(f"target {name!r} is a planner, which cannot continue in copies; name a rule or a trained policy")
    if LOT in target.in_keys:
        raise ValueError(f"target {name!r} draws its actions: one flight is not its value; name a rule or a trained policy")
