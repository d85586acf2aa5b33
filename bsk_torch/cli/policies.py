"""Policies that the command line names: folders and files of runs, pretrained policies, baselines, the user's functions."""

from __future__ import annotations

import inspect
import logging
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from tensordict.nn import TensorDictModuleBase
from torch import nn
from typing_extensions import override

from bsk_torch._listed import PLANNERS
from bsk_torch.cli.names import FIRST, PREFIX, PRETRAINED, check_policy, resolved
from bsk_torch.cli.shared import environment, made
from bsk_torch.cli.terminal import Failure, fail, refusing
from bsk_torch.env import Tasking
from bsk_torch.rl.evaluation.results import TRAINED
from bsk_torch.rl.policies.files import build_policy, check_fits, read_card
from bsk_torch.rl.policies.pretrained import pretrained_file
from bsk_torch.rl.policies.shared_policy import RULES, as_policy, baseline, shared, shared_baselines
from bsk_torch.sim.names import nearest
from bsk_torch.wrappers.policies import Actor, Model

logger = logging.getLogger(__name__)

Enter = Callable[[str, Callable[..., Tasking]], Any]
"""Enters a policy: a function of the name of a preset and of a function that makes its environment. It is to return this
environment and a policy; what a user's function returns may be anything."""

OBSERVED = ("observation", "obs")
"""Names of the first argument of functions that are policies themselves."""


@dataclass
class NamedPolicy:
    """A policy for one satellite, or for one of each group, and the environment that it is meant for.

    Attributes:
        name: As given on the command line.
        preset: Name of the environment.
        card: Contents of the policy's file; empty for what has none.
    """

    name: str
    preset: str
    card: Mapping[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Name in results."""
        return self.name if self.name in (*RULES, PRETRAINED) else TRAINED

    def options(self, changes: Mapping[str, object]) -> dict[str, object]:
        """Return the arguments of the environment: those with which the policy was trained, with ``changes``."""
        return {**self.card.get("options", {}), **changes}

    def environment(self, num_envs: int, options: Mapping[str, object]) -> Tasking:
        """Return environments that play the episodes of seeds, made as for the policy; ends the program if that fails."""
        trained = self.card.get("options", {})
        why = (
            f"the policy was trained for {self.card['preset']} with {trained}; {self.preset} cannot be made so: "
            if trained
            else ""
        )
        return environment(self.preset, num_envs, self.options(options) | {"env_ids": [0] * num_envs}, why)

    def build(self, env: Tasking, device: str = "cpu") -> TensorDictModuleBase:
        """Return the policy for one satellite of ``env``, or of each group; ends the program if it does not fit."""
        if self.name in RULES:
            try:
                return baseline(self.name, env)
            except (KeyError, ValueError) as error:
                fitting = ", ".join(shared_baselines(env))
                fail(f"the policy {self.name!r} does not fit {self.preset}: {error.args[0]}. Baselines that fit: {fitting}")
        with refusing():
            check_fits(self.card, env, self.preset)
            return build_policy(self.card, device)

    def actor(self, env: Tasking, device: str = "cpu") -> TensorDictModuleBase:
        """Return the policy for all agents of ``env``; ends the program if it does not fit."""
        return shared(self.build(env, device), env)


@dataclass
class NamedFunction(NamedPolicy):
    """A policy of the user's, ``package.module:name``; see :func:`entrant_of_user`.

    Attributes:
        enter: Enters the policy.
        entered: The environment that was made last, and the policy for it.
    """

    enter: Enter = field(kw_only=True)
    entered: tuple[Tasking, Actor] | None = None

    @property
    @override
    def label(self) -> str:
        return self.name.rpartition(":")[2]

    @override
    def environment(self, num_envs: int, options: Mapping[str, object]) -> Tasking:
        usual = {**options, "env_ids": [0] * num_envs}
        self.entered = self._enter(lambda **views: made(self.preset, num_envs, usual | views))
        return self.entered[0]

    def _enter(self, make: Callable[..., Tasking]) -> tuple[Tasking, Actor]:
        """Return what the user's function returns; ends the program for anything else."""
        entered = self.enter(self.preset, make)
        if not isinstance(entered, tuple) or len(entered) != 2 or not isinstance(entered[0], Tasking):
            what = "nothing" if entered is None else f"a {type(entered).__name__}"
            fail(f"{self.name} returns {what} for {self.preset}; it must return (env, policy)")
        return entered

    @override
    def build(self, env: Tasking, device: str = "cpu") -> TensorDictModuleBase:
        if self.entered is None or self.entered[0] is not env:
            self.entered = self._enter(lambda **views: env)
        with refusing(TypeError, ValueError, why=f"{self.name}: "):
            return as_policy(self.entered[1], env)

    actor = build  # which is for all agents


def named_policy(name: str, preset: str | None) -> NamedPolicy:
    """Return the policy of that name, for ``preset`` if that is given; ends the program if there is none."""
    check_policy(name, preset)
    plain, *texts = name.split(",")
    if plain.startswith(PREFIX):
        fail(f"{name!r} is a planner; this is for policies")
    if plain in RULES:
        return NamedPolicy(plain, preset or FIRST)
    if ":" in plain and not Path(name).exists():
        return NamedFunction(name, preset or FIRST, enter=entrant_of_user(plain, texts))
    with refusing(FileNotFoundError, ValueError):
        card = read_card(pretrained_file(preset or FIRST) if name == PRETRAINED else name)
    return NamedPolicy(name, preset or card["preset"], card)


def flown(
    name: str, preset: str | None, num_envs: int, options: Mapping[str, object]
) -> tuple[NamedPolicy, Tasking, TensorDictModuleBase]:
    """Return a policy, environments for it, and the policy for all of their agents; ends the program if that fails."""
    named = named_policy(name, preset)
    env = named.environment(num_envs, options)
    return named, env, named.actor(env, str(env.device))


def named_actor(name: str, preset: str | None, plan: Sequence[str] | None) -> NamedPolicy:
    """Return the planner or policy of that name; ends the program for options ``plan`` of what is not a planner."""
    if name.startswith(PREFIX):
        check_policy(name, preset)
        planner: NamedPolicy = resolved(name, PLANNERS[name.removeprefix(PREFIX)])(name, preset, plan or ())
        return planner
    if plan:
        fail(f"--plan {plan[0]!r} is for planners, such as plan:rollout; the policy is {name!r}")
    return named_policy(name, preset)


# -- functions of the user's -----------------------------------------------------------------------------------------------------


def entrant_of_user(name: str, texts: Sequence[str] = ()) -> Enter:
    """Return what enters the object ``package.module:name`` of the user's; ends the program if there is none.

    A torch module, a model of Stable-Baselines3, and a function whose first argument is called ``observation`` or ``obs`` are
    policies. Any other function is called with the name of the preset, a function that makes its environment, and ``texts``, and
    returns this environment and a policy.
    """
    named = imported(*name.split(":", 1))
    if isinstance(named, nn.Module | Model) or first_argument(named) in OBSERVED:
        return lambda preset, make: (make(), named)
    check_takes(named, name, texts)
    return lambda preset, make: named(preset, make, *texts)


def first_argument(function: Callable[..., object]) -> str | None:
    """Return the name of the first argument of a function; None if there is none, or no signature."""
    try:
        return next(iter(inspect.signature(function).parameters), None)
    except ValueError:  # of a function that is not written in Python
        return None


def message_of(error: BaseException) -> str:
    """Return the message of an error; its type precedes it unless the message is this package's, or tells what is wrong."""
    return (
        str(error) if isinstance(error, (TypeError, ValueError, Failure)) and str(error) else f"{type(error).__name__}: {error}"
    )


def imported(module: str, function: str) -> Any:
    """Return a function, module or model of the user's; ends the program if it cannot be imported."""
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))  # where a user's module is, as python -m would find it
    try:
        named = getattr(loaded := import_module(module), function, None)
    except Exception as error:  # a user's module may raise anything
        logger.debug("%s cannot be imported", module, exc_info=error)
        hint = f"; write {module.removesuffix('.py')}:{function}" if module.endswith(".py") else ""
        fail(f"{module}:{function} cannot be imported: {message_of(error)}{hint}")
    if named is None:
        names = [name for name, value in vars(loaded).items() if getattr(value, "__module__", None) == loaded.__name__]
        fail(f"{module}:{function} cannot be imported: {module} has no {function!r}; {nearest(function, names)}")
    if not callable(named) and not isinstance(named, Model):
        fail(f"{module}:{function} is neither a policy nor a function of a preset's name and make")
    return named


def check_takes(function: Callable[..., object], title: str, texts: Sequence[str]) -> None:
    """End the program for a function that cannot be called with the name of a preset, ``make`` and further ``texts``."""
    try:
        signature = inspect.signature(function)
    except ValueError:  # of a function that is not written in Python
        return
    try:
        signature.bind("preset", "make", *texts)
    except TypeError as error:
        further = f", and the {len(texts)} texts after its commas" if texts else ""
        fail(f"{title} takes {signature}; it must take the name of a preset and make, (preset, make){further}: {error}")
