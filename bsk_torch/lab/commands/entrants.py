"""Policies that the command line names, as they enter the tasks of a suite."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bsk_torch import __version__
from bsk_torch._listed import PREFIX, makings
from bsk_torch.cli.names import PRETRAINED
from bsk_torch.cli.policies import NamedPolicy, entrant_of_user, named_policy
from bsk_torch.cli.shared import preset_options
from bsk_torch.cli.terminal import fail, print_message
from bsk_torch.env import Tasking
from bsk_torch.env.rollout import Policy
from bsk_torch.lab.planners.named import named_planner
from bsk_torch.lab.suites.suite import VIEWS, Entrant, Task
from bsk_torch.rl.policies.loading import is_function
from bsk_torch.rl.policies.shared_policy import RULES, baseline, shared
from bsk_torch.sim.names import nearest

UNTRAINED: dict[str, Any] = {"decisions": 0, "core_seconds": 0.0, "tuning_runs": None}
"""What rules and random actions cost; the search for the constants of rules is not recorded."""


@dataclass(frozen=True)
class Named:
    """Enters the policy that the command line names in a task.

    Attributes:
        enter: Returns the environment and the policy; None for a preset that it does not fit.
        library: Library that made the policy, and the version.
        training: Returns what the training for a preset has cost, with the entries
            :data:`~bsk_torch.rl.policies.files.TRAINING`; None where that is not recorded.
    """

    enter: Entrant
    library: str = f"bsk_torch {__version__}"
    training: Callable[[str], Mapping[str, Any] | None] = lambda preset: None

    def __call__(self, preset: str, make: Callable[..., Tasking]) -> tuple[Tasking, Policy] | None:
        """Enter the policy."""
        return self.enter(preset, make)


def entrant_of(name: str, tasks: Sequence[Task] = (), trust: bool = False) -> Named:
    """Return what enters the policy that the command line names in ``tasks``; ends the program if there is none.

    A policy of another library enters the tasks whose observations and actions fit.
    """
    allowed = tuple(dict.fromkeys(view for task in tasks for view in task.views)) or VIEWS
    drawn = tuple(dict.fromkeys(option for task in tasks for option in task.drawn)) or ("time_limit",)
    if name == PRETRAINED:
        return Named(
            lambda preset, make: file_entry(named_policy(name, preset), make, drawn) if preset in makings() else None,
            training=published_training,
        )
    plain, *views = name.split(",")
    if plain.startswith(PREFIX):
        choices = [text for text in views if text.partition("=")[0] in allowed]
        options = [text for text in views if text not in choices]
        named_planner(plain, None, options, trust)  # unknown names and options end the program before anything runs
        chosen = dict(view_of(text, allowed) for text in choices)
        base = dict(text.partition("=")[::2] for text in options).get("base", RULES[0])
        return Named(
            lambda preset, make: planner_entry(plain, options, chosen, preset, make, drawn, trust),
            training=entrant_of(base, tasks, trust).training,
        )
    if plain in RULES:
        usual = {view: value for task in tasks for view, value in task.rules.get(plain, {}).items()}
        settings = usual | dict(view_of(view, allowed) for view in views)
        return Named(lambda preset, make: rule_entry(plain, settings, make), training=lambda preset: UNTRAINED)
    if is_function(name):
        return Named(*entrant_of_user(plain, views))
    policy = named_policy(name, None, trust)
    library = policy.loaded.library
    if not policy.card:
        return Named(lambda preset, make: outside_entry(policy, preset, make), library)
    return Named(
        lambda preset, make: file_entry(policy, make, drawn) if preset == policy.preset else None,
        library,
        lambda preset: policy.card.get("training"),
    )


def published_training(preset: str) -> dict[str, Any]:
    """Return what the training of a pretrained policy has cost, on one thread; how many runs came before it is not recorded."""
    made = makings()[preset]
    return {"decisions": made["frames"], "core_seconds": made["seconds"], "tuning_runs": None}


def file_entry(policy: NamedPolicy, make: Callable[..., Tasking], drawn: Sequence[str]) -> tuple[Tasking, Policy]:
    """Enter a policy of a file, in an environment with the views that it was trained with; see :func:`views_of`.

    The program ends in tasks with other observations or actions than those of its training.
    """
    env = make(**views_of(policy, drawn))
    return env, policy.actor(env)


def outside_entry(policy: NamedPolicy, preset: str, make: Callable[..., Tasking]) -> tuple[Tasking, Policy] | None:
    """Enter a policy of another library; None, with a message, where the observations or actions of the preset do not fit."""
    env = make()
    try:
        return env, shared(policy.loaded.fit(env, preset), env)
    except ValueError as error:
        print_message(f"{policy.name} is not for {preset}: {error}")
        return None


def views_of(policy: NamedPolicy, drawn: Sequence[str]) -> dict[str, object]:
    """Return the options of a policy's training, without those named in ``drawn``, such as the length of its episodes."""
    return {name: value for name, value in policy.card.get("options", {}).items() if name not in drawn}


def rule_entry(name: str, views: Mapping[str, object], make: Callable[..., Tasking]) -> tuple[Tasking, Policy] | None:
    """Enter a baseline; None where the preset has no such view, or the baseline is for other observations or actions."""
    try:
        env = make(**views)
    except TypeError:  # no such option
        return None
    try:
        return env, shared(baseline(name, env), env)
    except (KeyError, ValueError):
        return None


def planner_entry(
    name: str,
    options: list[str],
    views: Mapping[str, object],
    preset: str,
    make: Callable[..., Tasking],
    drawn: Sequence[str],
    trust: bool,
) -> tuple[Tasking, Policy]:
    """Enter a planner, in an environment with ``views`` and those of its base; ends the program where it does not fit."""
    chosen = named_planner(name, preset, options, trust)
    env = make(**(views_of(chosen, drawn) | dict(views)))
    return env, chosen.actor(env)


def view_of(text: str, allowed: Sequence[str]) -> tuple[str, object]:
    """Return name and value of ``NAME=VALUE``; ends the program for other texts and names."""
    name, sign, _ = text.partition("=")
    if not sign or name not in allowed:
        fail(f"{text!r} must be NAME=VALUE with a NAME among {', '.join(allowed)}; {nearest(name, allowed)}")
    return name, preset_options([text])[name]
