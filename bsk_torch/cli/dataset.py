"""``bsk-torch dataset``: episodes of several behaviors, with the returns of all actions at a sample of decisions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from bsk_torch.cli.names import PREFIX, PRETRAINED
from bsk_torch.cli.planned import NamedActor, NamedPlanner, named_planner
from bsk_torch.cli.policies import named_policy
from bsk_torch.cli.shared import environment, environment_options, preset_options, seed_range
from bsk_torch.cli.terminal import activity, echo, fail, for_shell, working
from bsk_torch.env import Tasking
from bsk_torch.lab.offline import Behavior, Recipe, write_dataset
from bsk_torch.lab.offline.behaviors import slug
from bsk_torch.lab.offline.layout import MINARI
from bsk_torch.lab.offline.minari_format import check_minari, minari_id
from bsk_torch.lab.offline.writing import check_folder
from bsk_torch.lab.planners.base_policies import USUAL
from bsk_torch.rl.policies.pretrained import makings
from bsk_torch.rl.policies.shared_policy import shared_baselines
from bsk_torch.tables import print_table

RANDOM, SHARE = "random", "random="
"""Name of the random policy, and the option of a behavior with the probability of random actions."""


@dataclass(frozen=True)
class Named:
    """A behavior on the command line: its text, the policy (None for random actions), and the probability of random actions."""

    text: str
    policy: NamedActor | None
    share: float

    def behavior(self, env: Tasking, device: str) -> Behavior:
        """Return the behavior in an environment; ends the program if the policy does not fit."""
        return Behavior(self.text, None if self.policy is None else self.policy.actor(env, device), self.share)


def dataset(
    preset: str,
    out: Path,
    behavior: list[str] | None,
    target: list[str] | None,
    option: list[str] | None,
    seeds: str,
    share: float,
    gamma: float,
    futures: int | None,
    minari: bool,
    num_envs: int,
    threads: int,
    backend: str,
    device: str,
    time_limit: float | None,
) -> None:
    """Write a dataset, and print what it contains; see :mod:`bsk_torch.cli.main`."""
    torch.set_num_threads(threads)
    episodes, given = seed_range(seeds), preset_options(option)
    try:
        check_folder(out)
        if minari:
            check_minari()
    except (ValueError, ImportError) as error:
        fail(str(error))
    usual = [PRETRAINED] if preset in makings() else []
    acting = None if behavior is None else [named_behavior(text, preset) for text in behavior]
    judged = {slug(text): named_policy(text, preset) for text in (usual if target is None else target)}
    every = [one.policy for one in acting or ()] + [*judged.values()]
    if acting is None:
        every += [named_policy(name, preset) for name in usual]
    options = trained_options(every) | given | ({} if time_limit is None else {"time_limit": time_limit})
    size = min(len(episodes), num_envs)
    made = options | environment_options(backend, device, None) | {"env_ids": [0] * size}
    env = environment(preset, size, made)
    if acting is None:
        acting = [named_behavior(text, preset) for text in (RANDOM, *usual_rule(env), *usual)]
    try:
        recipe = Recipe(
            preset=preset,
            behaviors=[one.behavior(env, device) for one in acting],
            seeds=episodes,
            targets={name: one.actor(env, device) for name, one in judged.items()},
            share=share,
            gamma=gamma,
            futures=futures,
            options=options,
            minari=minari,
        )
        with working("checking the recipe") as show:
            card = write_dataset(out, env, recipe, show)
    except (ValueError, ImportError) as error:
        fail(str(error))
    activity.report()
    print_dataset(card, out, minari)


def named_behavior(text: str, preset: str) -> Named:
    """Return the behavior ``NAME[,random=P][,OPTION=VALUE...]``; ends the program for anything else."""
    name, *rest = text.split(",")
    shares = [part for part in rest if part.startswith(SHARE)]
    others = [part for part in rest if not part.startswith(SHARE)]
    try:
        share = float(shares[-1].removeprefix(SHARE)) if shares else 0.0
    except ValueError:
        fail(f"--behavior {text!r}: {shares[-1]!r} must be a probability, such as random=0.2")
    if name == RANDOM:
        if rest:
            fail(f"--behavior {text!r}: random actions have no options")
        return Named(text, None, 1.0)
    if name.startswith(PREFIX):
        return Named(text, named_planner(name, preset, others), share)
    if others:
        fail(f"--behavior {text!r}: {others[0]!r} is not an option of a policy; give random=P, or a planner such as plan:rollout")
    return Named(text, named_policy(name, preset), share)


def trained_options(policies: Sequence[NamedActor | None]) -> dict[str, Any]:
    """Return the options of the environment with which the policies were trained; ends the program if they contradict."""
    found: dict[str, Any] = {}
    for policy in policies:
        known = policy.base if isinstance(policy, NamedPlanner) else policy
        for name, value in ({} if known is None else known.options({})).items():
            if found.setdefault(name, value) != value:
                fail(f"the policies were trained with different options: {name}={found[name]!r} and {name}={value!r}")
    return found


def usual_rule(env: Tasking) -> list[str]:
    """Return the name of the best rule that fits, if there is one."""
    fitting = shared_baselines(env)
    return [name for name in USUAL if name in fitting and name != RANDOM][:1]


def print_dataset(card: dict[str, Any], folder: Path, minari: bool) -> None:
    """Print the behaviors of a dataset, its size, and how to read it."""
    rows = [
        {
            "behavior": name,
            "episodes": f"{one['episodes']:,}",
            "decisions": f"{one['decisions']:,}",
            "with all actions": f"{one['counterfactuals']:,}",
            "mean return": f"{one['mean_return']:.4f}",
        }
        for name, one in card["behaviors"].items()
    ]
    print_table(rows, f"{card['preset']}; targets: {', '.join(card['targets']) or 'none'}", left=("behavior",))
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    echo(f"{for_shell(folder)}: {size / 1e6:,.1f} MB; read it by bsk_torch.lab.offline.open_dataset({str(folder)!r})")
    if minari:
        names = ", ".join(minari_id(card["preset"], name) for name in card["behaviors"])
        echo(f"in Minari, with MINARI_DATASETS_PATH={for_shell(folder / MINARI)}: {names}")
