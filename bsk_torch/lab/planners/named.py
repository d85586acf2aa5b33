"""Planners that the command line names: ``plan:NAME``, with options ``--plan NAME=VALUE``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tensordict.nn import TensorDictModuleBase
from typing_extensions import override

from bsk_torch import __version__
from bsk_torch._listed import PREFIX
from bsk_torch.cli.names import FIRST, check_policy
from bsk_torch.cli.policies import NamedPolicy, named_policy
from bsk_torch.cli.terminal import fail, refusing
from bsk_torch.env import Tasking
from bsk_torch.lab.planners.names import options_in, planner
from bsk_torch.rl.policies.interface import Loaded


@dataclass
class NamedPlanner(NamedPolicy):
    """A planner, and the environment that its base policy is meant for.

    Attributes:
        base: The base policy, which has a card; None for the planner's choice.
    """

    base: NamedPolicy | None = None

    @property
    @override
    def label(self) -> str:
        return self.name

    @override
    def environment(self, num_envs: int, options: Mapping[str, object]) -> Tasking:
        return super().environment(num_envs, options) if self.base is None else self.base.environment(num_envs, options)

    @override
    def actor(self, env: Tasking) -> TensorDictModuleBase:
        with refusing(KeyError, TypeError, ValueError):
            return self.loaded.fit(env, self.preset)


def named_planner(name: str, preset: str | None, texts: Sequence[str], trust: bool = False) -> NamedPlanner:
    """Return the planner ``plan:NAME`` with the options NAME=VALUE; ends the program for wrong ones."""
    check_policy(name, preset)
    short = name.removeprefix(PREFIX)
    with refusing(why="--plan "):
        options = options_in(short, texts)
    base = options.pop("base", None)
    if base is not None and not isinstance(base, str):
        fail(f"--plan base={base} must be a policy, such as a rule, 'pretrained', or the folder of a run")
    policy = None if base is None else named_policy(base, preset, trust)

    def fit(env: Tasking, where: str) -> TensorDictModuleBase:
        return planner(short, env, **options, **({} if policy is None else {"base": policy.actor(env)}))

    loaded = Loaded(fit, f"bsk_torch {__version__}", policy.card if policy else {})
    return NamedPlanner(name, policy.preset if policy else preset or FIRST, loaded, policy)
