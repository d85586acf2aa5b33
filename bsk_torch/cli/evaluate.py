"""``bsk-torch eval``: returns, survival and causes of death of policies in the same episodes."""

from __future__ import annotations

import sys
from pathlib import Path

import torch
from tensordict.nn import TensorDictModuleBase

from bsk_torch.cli.planned import PREFIX, NamedPlanner, named_planner
from bsk_torch.cli.policies import NamedPolicy, named_policy
from bsk_torch.cli.shared import check_writable, environment_options, preset_options, seed_range
from bsk_torch.cli.terminal import activity, fail, working
from bsk_torch.env import Tasking
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.evaluation.results import print_results, save_episodes, save_results
from bsk_torch.rl.marl.runs import is_constellation
from bsk_torch.rl.policies.shared_policy import for_each_group, shared, shared_baselines
from bsk_torch.rl.rules.shield import find_rule, shielded

MOST = 4096
"""Episodes at once, so that any number of them fits into memory."""

MOST_TEAMS = 256
"""Episodes of constellations at once."""

MOST_PLANNED = 64
"""Episodes of planners at once: each of them has copies."""


def evaluate_policy(
    policy: str,
    preset: str | None,
    option: list[str] | None,
    seeds: str,
    shield: str | None,
    plan: list[str] | None,
    baselines: bool,
    out: Path | None,
    episodes_out: Path | None,
    threads: int,
    backend: str,
    device: str,
    time_limit: float | None,
) -> None:
    """Play the episodes of given seeds, the same for every policy, and compare; see :mod:`bsk_torch.cli.main`."""
    torch.set_num_threads(threads)
    episodes = seed_range(seeds)
    for path in (out, episodes_out):
        check_writable(path)
    if out is not None and episodes_out is not None and out.absolute() == episodes_out.absolute():
        fail(f"--out and --episodes-out are the same file, {str(out)!r}")
    named: NamedPolicy | NamedPlanner
    if policy.startswith(PREFIX):
        if shield is not None:
            fail(f"--shield cannot stand before {policy!r}: the branches would not know of it")
        named, most = named_planner(policy, preset, plan or ()), MOST_PLANNED
    else:
        if plan:
            fail(f"--plan {plan[0]!r} is for planners, such as plan:rollout; the policy is {policy!r}")
        named = named_policy(policy, preset)
        most = MOST_TEAMS if is_constellation(named.preset) else MOST
    size = min(len(episodes), most)
    env = named.environment(size, preset_options(option) | environment_options(backend, device, time_limit))
    label, actor = named.label, named.build(env, device)
    guarded = {} if shield is None else {f"{label} + {shield}": _guarded(actor, shield, env)}
    planned = isinstance(named, NamedPlanner)
    actors = {name: one if planned else shared(one, env) for name, one in (guarded | {label: actor}).items()}
    chosen = next(iter(actors))
    actors |= {name: rule for name, rule in shared_baselines(env).items() if baselines and name != policy}
    results = {}
    for k, (other, one) in enumerate(actors.items(), 1):
        with working(f"evaluating {other}, policy {k} of {len(actors)}"):
            results[other] = evaluate(one, env, seeds=episodes)
    activity.report()
    print_results(results, f"{named.preset}, {len(episodes)} episodes, seeds {seeds}", chosen if len(results) > 1 else None)
    if out is not None:
        save_results(results, out, chosen)
    if episodes_out is not None:
        save_episodes(results, episodes, episodes_out)


def _guarded(policy: TensorDictModuleBase, shield: str, env: Tasking) -> TensorDictModuleBase:
    """Return a policy for one satellite, or for one of each group, behind a shield; ends the program if that fails."""
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))  # where a user's module is, as python -m would find it
    try:
        rule = find_rule(shield)
        return for_each_group(lambda one, view: shielded(one, rule, view), policy, env)
    except KeyError as error:
        fail(f"the shield {shield!r} does not fit: {error.args[0]}")
    except ValueError as error:
        fail(str(error))
