"""``bsk-torch eval``: returns, survival and causes of death of policies in the same episodes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bsk_torch._listed import PREFIX
from bsk_torch.cli.declaration import (
    EnvironmentOptions,
    JsonFile,
    OfPreset,
    Options,
    Plan,
    PoliciesOrPlanners,
    Seeds,
    Trust,
    flag,
)
from bsk_torch.cli.shared import check_writable, preset_options, seed_range
from bsk_torch.cli.terminal import activity, fail, refusing, working

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase

    from bsk_torch.env import Tasking

MOST = 4096
"""Episodes at once, so that any number of them fits into memory."""

MOST_TEAMS = 256
"""Episodes of constellations at once."""

MOST_PLANNED = 64
"""Episodes of planners at once: each of them has copies."""


def evaluate_policy(
    policies: PoliciesOrPlanners,
    preset: OfPreset = None,
    option: Options = None,
    seeds: Seeds = "0:1000",
    shield: Annotated[
        str | None, flag("NAME", "Shield that removes dangerous actions: 'safe', 'imager', or package.module:function.")
    ] = None,
    plan: Plan = None,
    baselines: Annotated[bool, typer.Option(help="Compare with all applicable baselines.")] = True,
    out: JsonFile = None,
    episodes_out: Annotated[Path | None, flag("FILE", "CSV file with a row for each episode.")] = None,
    trust: Trust = False,
    *,
    options: EnvironmentOptions,
) -> None:
    """Compare policies in the same episodes: returns, survival, causes of death, and measures of the task.

    The episode of seed 7 is the one that gymnasium.make("bsk_torch/PRESET").reset(seed=7) starts.

    Examples:
        bsk-torch eval runs/scan
        bsk-torch eval runs/a runs/b my_package.policies:mine --seeds 0:256
        bsk-torch eval pretrained --preset AEOS-v1 --seeds 0:256
        bsk-torch eval runs/scan --shield safe --out results.json
        bsk-torch eval plan:rollout --plan base=rule --plan horizon=1500 --seeds 0:8
        bsk-torch eval nearest_task --preset AEOSBench-v1 --option sensor=on
    """
    from bsk_torch.cli.policies import TRAINED, named_actor
    from bsk_torch.rl.evaluation.evaluate import evaluate
    from bsk_torch.rl.evaluation.results import print_results, save_episodes, save_results
    from bsk_torch.rl.marl.runs import is_constellation
    from bsk_torch.rl.policies.shared_policy import shared, shared_baselines

    episodes = seed_range(seeds)
    check_writable(out, episodes_out)
    guard = None if shield is None else _guard(shield)
    if out is not None and episodes_out is not None and out.absolute() == episodes_out.absolute():
        fail(f"--out and --episodes-out are the same file, {str(out)!r}")
    if shield is not None and (planner := next((name for name in policies if name.startswith(PREFIX)), None)):
        fail(f"--shield cannot stand before {planner!r}: the branches would not know of it")
    if len(set(policies)) < len(policies):
        fail(f"policies {' '.join(policies)}: name each once")
    plans = {name: plan if name.startswith(PREFIX) or len(policies) == 1 else None for name in policies}
    named = [named_actor(name, preset, own, trust) for name, own in plans.items()]
    of_presets = {one.name: one.preset for one in named}
    if len(set(of_presets.values())) > 1:
        fail(f"the policies are for different presets: {', '.join(f'{k}: {v}' for k, v in of_presets.items())}; give --preset")
    title, most = named[0].preset, MOST_TEAMS if is_constellation(named[0].preset) else MOST
    size = min(len(episodes), MOST_PLANNED if any(name.startswith(PREFIX) for name in policies) else most)
    options = preset_options(option) | options
    actors: dict[str, tuple[TensorDictModuleBase, Tasking]] = {}
    for policy in named:
        env = policy.environment(size, options)
        label = policy.label if len(named) == 1 or policy.label != TRAINED else policy.name
        if guard is not None:
            actors[f"{label} + {shield}"] = shared(guard(policy.build(env), env), env), env
        actors[label] = policy.actor(env), env
    chosen, (_, env) = next(iter(actors.items()))
    if baselines:
        actors |= {name: (rule, env) for name, rule in shared_baselines(env).items() if name not in policies}
    results = {}
    for k, (other, (actor, env)) in enumerate(actors.items(), 1):
        with working(f"evaluating {other}, policy {k} of {len(actors)}"):
            results[other] = evaluate(actor, env, seeds=episodes)
    activity.report()
    print_results(results, f"{title}, {len(episodes)} episodes, seeds {seeds}", chosen if len(results) > 1 else None)
    if out is not None:
        save_results(results, out, chosen)
    if episodes_out is not None:
        save_episodes(results, episodes, episodes_out)


def _guard(shield: str) -> Callable[[TensorDictModuleBase, Tasking], TensorDictModuleBase]:
    """Return a function that puts a policy for one satellite, or for one of each group, behind a shield.

    Ends the program if there is no such shield; so does the function if the shield does not fit the environment.
    """
    from bsk_torch.rl.policies.shared_policy import for_each_group
    from bsk_torch.rl.rules.shield import find_rule, shielded

    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))  # where a user's module is, as python -m would find it
    with refusing():
        rule = find_rule(shield)

    def guarded(policy: TensorDictModuleBase, env: Tasking) -> TensorDictModuleBase:
        with refusing(KeyError, why=f"the shield {shield!r} does not fit: "), refusing():
            return for_each_group(lambda one, view: shielded(one, rule, view), policy, env)

    return guarded
