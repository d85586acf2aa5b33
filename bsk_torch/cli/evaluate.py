"""``bsk-torch eval``: returns, survival and causes of death of policies in the same episodes."""

from __future__ import annotations

import sys
from pathlib import Path

import torch
from tensordict.nn import TensorDictModuleBase

from bsk_torch.cli.names import PREFIX
from bsk_torch.cli.planned import NamedPlanner, named_actor
from bsk_torch.cli.policies import TRAINED
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
    policies: list[str],
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
    if shield is not None and (planner := next((name for name in policies if name.startswith(PREFIX)), None)):
        fail(f"--shield cannot stand before {planner!r}: the branches would not know of it")
    if len(set(policies)) < len(policies):
        fail(f"policies {' '.join(policies)}: name each once")
    named = [
        named_actor(name, preset, (plan or ()) if name.startswith(PREFIX) or len(policies) == 1 else ()) for name in policies
    ]
    of_presets = {one.name: one.preset for one in named}
    if len(set(of_presets.values())) > 1:
        fail(f"the policies are for different presets: {', '.join(f'{k}: {v}' for k, v in of_presets.items())}; give --preset")
    title, most = named[0].preset, MOST_TEAMS if is_constellation(named[0].preset) else MOST
    size = min(len(episodes), MOST_PLANNED if any(isinstance(one, NamedPlanner) for one in named) else most)
    options = preset_options(option) | environment_options(backend, device, time_limit)
    actors: dict[str, tuple[TensorDictModuleBase, Tasking]] = {}
    for one in named:
        env = one.environment(size, options)
        label = one.label if len(named) == 1 or one.label != TRAINED else one.name
        if shield is not None and not isinstance(one, NamedPlanner):
            actors[f"{label} + {shield}"] = shared(_guarded(one.build(env, device), shield, env), env), env
        actors[label] = one.actor(env, device), env
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
