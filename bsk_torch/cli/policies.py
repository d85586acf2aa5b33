"""Policies that the command line names: folders and files of runs, pretrained policies, baselines."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tensordict.nn import TensorDictModuleBase
from typing_extensions import override

from bsk_torch._listed import PLANNERS
from bsk_torch.cli.functions import Enter, entrant_of_user
from bsk_torch.cli.names import FIRST, PREFIX, PRETRAINED, check_policy, resolved
from bsk_torch.cli.shared import environment, made
from bsk_torch.cli.terminal import fail, refusing
from bsk_torch.env import Tasking
from bsk_torch.rl.policies.files import build_policy, check_fits, read_card
from bsk_torch.rl.policies.pretrained import pretrained_file
from bsk_torch.rl.policies.shared_policy import RULES, as_policy, baseline, shared, shared_baselines
from bsk_torch.wrappers.policies import Actor

TRAINED = "trained"
"""Name, in results, of the policy of a file."""


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

    def options(self, given: Mapping[str, object]) -> dict[str, object]:
        """Return the arguments of the environment: those with which the policy was trained, and those that are ``given``."""
        return {**self.card.get("options", {}), **given}

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
    """A policy of the user's, ``package.module:name``; see :func:`~bsk_torch.cli.functions.entrant_of_user`.

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
