"""Planners that the command line names: ``plan:NAME``, with options ``--plan NAME=VALUE``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from tensordict.nn import TensorDictModuleBase

from bsk_torch.cli.names import FIRST, PREFIX, PRETRAINED, check_policy
from bsk_torch.cli.policies import NamedFunction, NamedPolicy, named_policy
from bsk_torch.cli.terminal import fail
from bsk_torch.env import Tasking
from bsk_torch.lab.planners.names import options_of, planner
from bsk_torch.rl.rules.baselines import BASELINES
from bsk_torch.sim.arguments.values import nearest

BY_HAND = ("value", "redraw", "prior")
"""Options that are modules or functions, which the command line cannot name."""


@dataclass(frozen=True)
class NamedPlanner:
    """A planner, and the environment that its base policy is meant for.

    Attributes:
        name: As given on the command line.
        options: Arguments of the planner, without the base policy.
        base: The base policy; None for the planner's choice.
        preset: Name of the environment.
    """

    name: str
    options: Mapping[str, Any]
    base: NamedPolicy | NamedFunction | None
    preset: str

    @property
    def label(self) -> str:
        """Name in results."""
        return self.name

    def environment(self, num_envs: int, options: Mapping[str, object]) -> Tasking:
        """Return environments as :meth:`NamedPolicy.environment` does."""
        return (self.base or NamedPolicy("random", self.preset)).environment(num_envs, options)

    def actor(self, env: Tasking, device: str = "cpu") -> TensorDictModuleBase:
        """Return the planner, which acts for all agents of ``env``; ends the program if it does not fit."""
        base = {} if self.base is None else {"base": self.base.actor(env, device)}
        try:
            return planner(self.name.removeprefix(PREFIX), env, **self.options, **base)
        except (KeyError, TypeError, ValueError) as error:
            fail(str(error.args[0]))


NamedActor: TypeAlias = NamedPolicy | NamedFunction | NamedPlanner
"""A policy or planner of the command line."""


def named_actor(name: str, preset: str | None, plan: Sequence[str]) -> NamedActor:
    """Return the planner or policy of that name; ends the program for options ``plan`` of what is not a planner."""
    if name.startswith(PREFIX):
        return named_planner(name, preset, plan)
    if plan:
        fail(f"--plan {plan[0]!r} is for planners, such as plan:rollout; the policy is {name!r}")
    return named_policy(name, preset)


def named_planner(name: str, preset: str | None, given: Sequence[str]) -> NamedPlanner:
    """Return the planner ``plan:NAME`` with the options NAME=VALUE; ends the program for wrong ones."""
    check_policy(name, preset)
    short = name.removeprefix(PREFIX)
    options = dict(_pair(text, short) for text in given)
    base = options.pop("base", None)
    if base is None:
        return NamedPlanner(name, options, None, preset or FIRST)
    if base not in (*BASELINES, PRETRAINED) and not isinstance(base, str):
        fail(f"--plan base={base} must be a rule, 'pretrained', or the folder of a run")
    policy = named_policy(str(base), preset)
    return NamedPlanner(name, options, policy, policy.preset)


def _pair(text: str, planner_name: str) -> tuple[str, Any]:
    """Return an option and its value; ends the program for unknown ones."""
    name, equals, value = text.partition("=")
    known = [option for option in options_of(planner_name) if option not in BY_HAND]
    if not equals or not value:
        fail(f"--plan {text!r} must be NAME=VALUE, such as horizon=240")
    if name in BY_HAND:
        fail(f"--plan {text!r}: {name!r} is a module or a function; give it in Python, to bsk_torch.lab.planners.planner")
    if name not in known:
        fail(f"--plan {text!r}: plan:{planner_name} has no option {name!r}; {nearest(name, known)}")
    for kind in (int, float):
        try:
            return name, kind(value)
        except ValueError:
            continue
    return name, None if value == "none" else value
