"""Policies that the command line names, of any library; see :func:`bsk_torch.load_policy` for their kinds."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tensordict.nn import TensorDictModuleBase
from typing_extensions import override

from bsk_torch._listed import PLANNERS, PREFIX
from bsk_torch.cli.names import FIRST, PRETRAINED, check_policy, resolved
from bsk_torch.cli.shared import environment, made
from bsk_torch.cli.terminal import Failure, fail, refusing
from bsk_torch.env import Tasking
from bsk_torch.rl.evaluation.results import TRAINED
from bsk_torch.rl.policies.files import OBJECTS
from bsk_torch.rl.policies.interface import Loaded
from bsk_torch.rl.policies.loading import (
    check_takes,
    function_named,
    is_function,
    is_policy,
    library_of,
    read_policy,
    rule_named,
)
from bsk_torch.rl.policies.pretrained import pretrained_file
from bsk_torch.rl.policies.shared_policy import RULES, as_policy, shared
from bsk_torch.wrappers.policies import Actor

logger = logging.getLogger(__name__)

Enter = Callable[[str, Callable[..., Tasking]], Any]
"""Enters a policy: a function of the name of a preset and of a function that makes its environment. It is to return this
environment and a policy; what a user's function returns may be anything."""


@dataclass
class NamedPolicy:
    """A policy for one satellite, or for one of each group, and the environment that it is meant for.

    Attributes:
        name: As given on the command line.
        preset: Name of the environment.
        loaded: The policy, for an environment to come.
    """

    name: str
    preset: str
    loaded: Loaded

    @property
    def card(self) -> Mapping[str, Any]:
        """Contents of the policy's file; empty for what has none."""
        return self.loaded.card

    @property
    def label(self) -> str:
        """Name in results."""
        if self.name in (*RULES, PRETRAINED):
            return self.name
        return TRAINED if self.card else Path(self.name).name

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
        warn_of_objects(self.name, self.card, self.preset, options)
        return environment(self.preset, num_envs, self.options(options) | {"env_ids": [0] * num_envs}, why)

    def build(self, env: Tasking) -> Actor:
        """Return the policy for one satellite of ``env``, or of each group; ends the program if it does not fit."""
        with refusing():
            return self.loaded.fit(env, self.preset)

    def actor(self, env: Tasking) -> TensorDictModuleBase:
        """Return the policy for all agents of ``env``; ends the program if it does not fit."""
        return shared(self.build(env), env)


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
    def build(self, env: Tasking) -> TensorDictModuleBase:
        if self.entered is None or self.entered[0] is not env:
            self.entered = self._enter(lambda **views: env)
        with refusing(TypeError, ValueError, why=f"{self.name}: "):
            return as_policy(self.entered[1], env)

    actor = build  # which is for all agents


def warn_of_objects(name: str, card: Mapping[str, Any], preset: str, options: Iterable[str]) -> None:
    """Log a warning if a policy was trained with objects that its file does not keep, and that ``options`` do not replace."""
    lost = [option for option in card.get(OBJECTS, []) if option not in options]
    if lost and preset == card["preset"]:
        logger.warning(
            "%s was trained with its own %s, objects that its file does not keep: these are episodes of %s without them; name a "
            "function that returns the environment, --preset file.py:name",
            *(name, ", ".join(lost), preset),
        )


def named_policy(name: str, preset: str | None, trust: bool = False) -> NamedPolicy:
    """Return the policy of that name, for ``preset`` if that is given; ends the program if there is none."""
    check_policy(name, preset)
    plain, *texts = name.split(",")
    if plain.startswith(PREFIX):
        fail(f"{name!r} is a planner; this is for policies")
    if plain in RULES:
        return NamedPolicy(plain, preset or FIRST, rule_named(plain))
    if is_function(name):
        enter, library = entrant_of_user(plain, texts)
        loaded = Loaded(lambda env, where: enter(where, lambda **views: env)[1], library)
        return NamedFunction(name, preset or FIRST, loaded, enter=enter)
    with refusing(FileNotFoundError, ImportError, ValueError):
        loaded = read_policy(pretrained_file(preset or FIRST) if name == PRETRAINED else name, trust)
    return NamedPolicy(name, preset or loaded.card.get("preset", FIRST), loaded)


def flown(
    name: str, preset: str | None, num_envs: int, options: Mapping[str, object], trust: bool = False
) -> tuple[NamedPolicy, Tasking, TensorDictModuleBase]:
    """Return a policy, environments for it, and the policy for all of their agents; ends the program if that fails."""
    named = named_actor(name, preset, None, trust)
    env = named.environment(num_envs, options)
    return named, env, named.actor(env)


def named_actor(name: str, preset: str | None, plan: Sequence[str] | None, trust: bool = False) -> NamedPolicy:
    """Return the planner or policy of that name; ends the program for options ``plan`` of what is not a planner."""
    if name.startswith(PREFIX):
        plain, *texts = name.split(",")
        check_policy(plain, preset)
        planner: NamedPolicy = resolved(plain, PLANNERS[plain.removeprefix(PREFIX)])(
            plain, preset, [*texts, *(plan or ())], trust
        )
        return planner
    if plan:
        fail(f"--plan {plan[0]!r} is for planners, such as plan:rollout; the policy is {name!r}")
    return named_policy(name, preset, trust)


def entrant_of_user(name: str, texts: Sequence[str] = ()) -> tuple[Enter, str]:
    """Return what enters the object ``package.module:name`` of the user's, and its library; ends the program if there is none.

    A torch module, a model of Stable-Baselines3, and a function whose first argument is called ``observation`` or ``obs`` are
    policies. Any other function is called with the name of the preset, a function that makes its environment, and ``texts``, and
    returns this environment and a policy.
    """
    with refusing(ImportError, TypeError, ValueError):
        named = function_named(name)
        if is_policy(named):
            return (lambda preset, make: (make(), named)), library_of(named)
        check_takes(named, name, texts)
    return (lambda preset, make: named(preset, make, *texts)), library_of(named)


def message_of(error: BaseException) -> str:
    """Return the message of an error; its type precedes it unless the message is this package's, or tells what is wrong."""
    return (
        str(error) if isinstance(error, (TypeError, ValueError, Failure)) and str(error) else f"{type(error).__name__}: {error}"
    )
