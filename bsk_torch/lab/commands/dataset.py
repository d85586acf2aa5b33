"""``bsk-torch dataset``: episodes of several behaviors, with the returns of all actions at a sample of decisions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from bsk_torch._listed import PREFIX, makings
from bsk_torch.cli.declaration import AtOnce, EnvironmentOptions, Options, Preset, Trust, flag
from bsk_torch.cli.names import PRETRAINED
from bsk_torch.cli.shared import environment, preset_options, seed_range
from bsk_torch.cli.terminal import activity, echo, fail, for_shell, refusing, working
from bsk_torch.tables import print_table

if TYPE_CHECKING:
    from bsk_torch.cli.policies import NamedPolicy
    from bsk_torch.env import Tasking

RANDOM, SHARE = "random", "random="
"""Name of the random policy, and the option of a behavior with the probability of random actions."""


class Named(NamedTuple):
    """A behavior on the command line: its text, the policy (None for random actions), and the probability of random actions."""

    text: str
    policy: NamedPolicy | None
    share: float


def dataset(
    preset: Preset,
    out: Annotated[Path, flag("FOLDER", "New folder for the dataset.")],
    behavior: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Policy that acts: 'random', a baseline, 'pretrained', a run folder, a file or function of any library, or a "
            "planner with its options after commas, each with random=P for random actions with probability P; repeatable. "
            "Default: random actions, the best rule, and the pretrained policy.",
        ),
    ] = None,
    target: Annotated[
        list[str] | None,
        flag("NAME", "Policy that follows the tried actions: 'pretrained' (default), or another policy; repeatable."),
    ] = None,
    option: Options = None,
    seeds: Annotated[str, flag("A:B", "Episodes of the seeds A to B - 1, or of a single seed, for each behavior.")] = "0:64",
    share: Annotated[float, flag("P", "Probability that all actions are tried at a decision.", min=0.0, max=1.0)] = 0.01,
    gamma: Annotated[float, flag("G", "Discount per second of the returns of actions.", min=0.0, max=1.0)] = 1.0,
    futures: Annotated[int | None, flag("N", "Futures drawn for each tried action; default: the true one.", min=1)] = None,
    minari: Annotated[
        bool, typer.Option("--minari", help="Write the episodes in Minari's format as well. Needs the extra minari.")
    ] = False,
    num_envs: AtOnce = 64,
    trust: Trust = False,
    *,
    options: EnvironmentOptions,
) -> None:
    """Write episodes of several policies for offline learning, with the returns of all actions at a sample of decisions.

    The transitions are tensordicts in the layout of TorchRL, mapped from files. At each sampled decision, every legal
    action is flown, and each target policy flies on to the end of the episode. These returns are the truth for off-policy
    evaluation.

    Examples:
        bsk-torch dataset NadirScan-v1 --out data/scan --seeds 0:256
        bsk-torch dataset AEOS-v1 --out data/aeos --target hasty --share 0.002
        bsk-torch dataset NadirScan-v1 --out data/b --behavior rule,random=0.2
        bsk-torch dataset NadirScan-v1 --out data/plan --behavior plan:rollout
    """
    from bsk_torch.cli.policies import named_policy
    from bsk_torch.lab.offline import Behavior, Recipe, write_dataset
    from bsk_torch.lab.offline.behaviors import slug
    from bsk_torch.lab.offline.minari_format import check_minari
    from bsk_torch.lab.offline.writing import check_folder

    episodes = seed_range(seeds)
    with refusing(ValueError, ImportError):
        check_folder(out)
        if minari:
            check_minari()
    usual = [PRETRAINED] if preset in makings() else []
    acting = None if behavior is None else [named_behavior(text, preset, trust) for text in behavior]
    judged = {slug(text): named_policy(text, preset, trust) for text in (usual if target is None else target)}
    policies = [one.policy for one in acting or ()] + [*judged.values()]
    if acting is None:
        policies += [named_policy(name, preset) for name in usual]
    backend, device, size = options.pop("backend"), options.pop("device"), min(len(episodes), num_envs)
    options = trained_options(policies) | preset_options(option) | options
    env = environment(preset, size, options | {"backend": backend, "device": device, "env_ids": [0] * size})
    if acting is None:
        acting = [named_behavior(text, preset) for text in (RANDOM, *usual_rule(env), *usual)]
    with refusing(ValueError, ImportError), working("checking the recipe") as show:
        recipe = Recipe(
            preset=preset,
            behaviors=[Behavior(text, acts and acts.actor(env), random) for text, acts, random in acting],
            seeds=episodes,
            targets={name: one.actor(env) for name, one in judged.items()},
            share=share,
            gamma=gamma,
            futures=futures,
            options=options,
            minari=minari,
        )
        card = write_dataset(out, env, recipe, show)
    activity.report()
    print_dataset(card, out, minari)


def named_behavior(text: str, preset: str, trust: bool = False) -> Named:
    """Return the behavior ``NAME[,random=P][,OPTION=VALUE...]``; ends the program for anything else."""
    from bsk_torch.cli.policies import named_actor, named_policy

    name, *parts = text.split(",")
    shares = [part for part in parts if part.startswith(SHARE)]
    extras = [part for part in parts if not part.startswith(SHARE)]
    try:
        share = float(shares[-1].removeprefix(SHARE)) if shares else 0.0
    except ValueError:
        fail(f"--behavior {text!r}: {shares[-1]!r} must be a probability, such as random=0.2")
    if name == RANDOM:
        if parts:
            fail(f"--behavior {text!r}: random actions have no options")
        return Named(text, None, 1.0)
    if name.startswith(PREFIX):
        return Named(text, named_actor(name, preset, extras, trust), share)
    if extras:
        fail(f"--behavior {text!r}: {extras[0]!r} is not an option of a policy; give random=P, or a planner such as plan:rollout")
    return Named(text, named_policy(name, preset, trust), share)


def trained_options(policies: Sequence[NamedPolicy | None]) -> dict[str, object]:
    """Return the options of the environment with which the policies were trained; ends the program if they contradict."""
    options: dict[str, object] = {}
    for policy in policies:
        for name, value in ({} if policy is None else policy.options({})).items():
            if options.setdefault(name, value) != value:
                fail(f"the policies were trained with different options: {name}={options[name]!r} and {name}={value!r}")
    return options


def usual_rule(env: Tasking) -> list[str]:
    """Return the name of the best rule that fits, if there is one."""
    from bsk_torch.lab.planners.base_policies import USUAL
    from bsk_torch.rl.policies.shared_policy import shared_baselines

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
        from bsk_torch.lab.offline.layout import MINARI
        from bsk_torch.lab.offline.minari_format import minari_id

        names = ", ".join(minari_id(card["preset"], name) for name in card["behaviors"])
        echo(f"in Minari, with MINARI_DATASETS_PATH={for_shell(folder / MINARI)}: {names}")
