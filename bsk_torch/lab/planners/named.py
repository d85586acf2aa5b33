"""Planners that the command line names: ``plan:NAME``, with options ``--plan NAME=VALUE``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from tensordict.nn import TensorDictModuleBase
from typing_extensions import override

from bsk_torch.cli.names import FIRST, PREFIX, PRETRAINED, check_policy
from bsk_torch.cli.policies import NamedPolicy, named_policy
from bsk_torch.cli.terminal import fail, refusing
from bsk_torch.env import Tasking
from bsk_torch.lab.planners.names import options_of, planner
from bsk_torch.rl.rules.baselines import BASELINES
from bsk_torch.sim.names import nearest

BY_HAND = ("value", "price", "prior")
"""Options that are modules or functions, which the command line cannot name."""


@dataclass
class NamedPlanner(NamedPolicy):
    """A planner, and the environment that its base policy is meant for.

    Attributes:
        settings: Arguments of the planner, without the base policy.
        base: The base policy, which has a card; None for the planner's choice.
    """

    settings: Mapping[str, object] = field(kw_only=True)
    base: NamedPolicy | None = None

    @property
    @override
    def label(self) -> str:
        return self.name

    @override
    def environment(self, num_envs: int, options: Mapping[str, object]) -> Tasking:
        return super().environment(num_envs, options) if self.base is None else self.base.environment(num_envs, options)

    @override
    def actor(self, env: Tasking, device: str = "cpu") -> TensorDictModuleBase:
        base = {} if self.base is None else {"base": self.base.actor(env, device)}
        with refusing(KeyError, TypeError, ValueError):
            return planner(self.name.removeprefix(PREFIX), env, **self.settings, **base)


def named_planner(name: str, preset: str | None, texts: Sequence[str]) -> NamedPlanner:
    """Return the planner ``plan:NAME`` with the options NAME=VALUE; ends the program for wrong ones."""
    check_policy(name, preset)
    short = name.removeprefix(PREFIX)
    options = dict(_pair(text, short) for text in texts)
    base = options.pop("base", None)
    if base is None:
        return NamedPlanner(name, preset or FIRST, settings=options)
    if base not in (*BASELINES, PRETRAINED) and not isinstance(base, str):
        fail(f"--plan base={base} must be a rule, 'pretrained', or the folder of a run")
    policy = named_policy(str(base), preset)
    return NamedPlanner(name, policy.preset, policy.card, settings=options, base=policy)


def _pair(text: str, planner_name: str) -> tuple[str, object]:
    """Return an option and its value; ends the program for unknown ones."""
    name, equals, value = text.partition("=")
    names = [option for option in options_of(planner_name) if option not in BY_HAND]
    if not equals or not value:
        fail(f"--plan {text!r} must be NAME=VALUE, such as horizon=240")
    if name in BY_HAND:
        fail(f"--plan {text!r}: {name!r} is a module or a function; give it in Python, to bsk_torch.lab.planners.planner")
    if name not in names:
        fail(f"--plan {text!r}: plan:{planner_name} has no option {name!r}; {nearest(name, names)}")
    for kind in (int, float):
        try:
            return name, kind(value)
        except ValueError:
            continue
    return name, None if value == "none" else value
