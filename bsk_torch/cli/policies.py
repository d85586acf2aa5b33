"""Policies that the command line names: folders and files of runs, pretrained policies, baselines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tensordict.nn import TensorDictModuleBase

from bsk_torch.cli.shared import environment
from bsk_torch.cli.terminal import fail
from bsk_torch.env import Tasking
from bsk_torch.presets import PRESETS
from bsk_torch.rl.policies.files import build_policy, check_fits, read_card
from bsk_torch.rl.policies.pretrained import pretrained_file
from bsk_torch.rl.policies.shared_policy import RULES, baseline, shared_baselines
from bsk_torch.sim.arguments.values import nearest

TRAINED, PRETRAINED = "trained", "pretrained"
"""Names, in results, of the policy of a file, and of the one that comes with the package."""

FIRST = next(iter(PRESETS))
"""The environment unless the command line or a run names another."""


@dataclass(frozen=True)
class NamedPolicy:
    """A policy for one satellite, or for one of each group, and the environment that it is meant for.

    Attributes:
        name: As given on the command line.
        preset: Name of the environment.
        card: Contents of the policy's file; empty for baselines.
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
        try:
            check_fits(self.card, env, self.preset)
            return build_policy(self.card, device)
        except ValueError as error:
            fail(str(error))


def named_policy(name: str, preset: str | None) -> NamedPolicy:
    """Return the policy of that name, for ``preset`` if that is given; ends the program if there is none."""
    if name in RULES:
        return NamedPolicy(name, preset or FIRST)
    try:
        card = read_card(pretrained_file(preset or FIRST) if name == PRETRAINED else name)
    except FileNotFoundError:
        preset_hint = "it is a preset: name a policy first, such as pretrained"
        hint = preset_hint if name in PRESETS else nearest(name, (*RULES, PRETRAINED))
        fail(f"{name!r} is not a run folder, policy file or baseline; {hint}")
    except ValueError as error:
        fail(str(error))
    return NamedPolicy(name, preset or card["preset"], card)
