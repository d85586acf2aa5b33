"""What rules, and trained policies, reach in the presets of inspection: completion, time, fuel and deaths over fresh episodes.

Usage:
    python benchmarks/inspection_rules.py [--preset RSOInspection-v1] [--episodes 256] [--batch 256] [--seed 1000010]
        [--policies drift circumnavigate survey ...] [--time-limit 57000] [--out FILE.json]

``--policies`` are rules, folders of runs, or files of policies. Rules act by changes of velocity, the surveys also by waypoints
(``actions="waypoints"``), as trained policies do. All play the same episodes. ``gain`` is the mean difference of the returns to
those of survey by waypoints, where that is among the policies.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import harness
import torch
from tensordict.nn import TensorDictModuleBase

import bsk_torch
from bsk_torch.env import ConstellationTasking
from bsk_torch.rl.evaluation.evaluate import Evaluation, evaluate
from bsk_torch.rl.evaluation.statistics import confidence, wilson
from bsk_torch.rl.policies import policy_of_file
from bsk_torch.rl.policies.shared_policy import shared
from bsk_torch.rl.training.log import LOG, read_log

HOUR = 3600.0

RULES = {
    "drift": ("thrust",),
    "circumnavigate": ("thrust",),
    "survey": ("thrust", "waypoints"),
    "hurried_survey": ("thrust", "waypoints"),
}
"""Rules, and the actions by which they act."""

REFERENCE = "survey", "waypoints"
"""Policy to which others are compared, and its actions."""

COLUMNS = {
    "preset": "{preset}",
    "policy": "{policy}",
    "actions": "{actions}",
    "complete": "{complete:.1%}",
    "hours": "{hours:.2f}",
    "fuel, m/s": "{fuel:.2f}",
    "inspected": "{inspected:.1f}",
    "lit": "{lit:.1f}",
    "inspectors died": "{died:.1%}",
    "collisions": "{collisions}",
    "return": "{value:.3f} +- {half:.3f}",
    "gain": "{gain:+.3f} +- {gain_half:.3f}",
}


def players(names: list[str]) -> Iterator[tuple[str, str]]:
    """Yield policies and the actions by which they act."""
    for name in names:
        for actions in RULES.get(name, ("waypoints",)):
            yield name, actions


def make_policy(name: str, env: ConstellationTasking) -> TensorDictModuleBase:
    """Return a rule, or a policy from a file, for an environment."""
    return bsk_torch.rule(name, env) if name in RULES else shared(policy_of_file(name), env)


def training(name: str) -> dict[str, float]:
    """Return decisions and seconds of the training of a policy; nothing for one that is no run."""
    log = Path(name) / LOG
    if name in RULES or not log.is_file():
        return {}
    read = read_log(log)
    return {"frames": int(read["frames"][-1]), "seconds": read["seconds"][-1]}


def fuel(env: ConstellationTasking) -> torch.Tensor:
    """What the tanks of all inspectors are good for, m/s [N]."""
    return env.fleet.each(lambda part: part.fsw.dv_available)[:, env.scenario.inspector_columns].sum(1)


def fly(env: ConstellationTasking, policy: TensorDictModuleBase, seed: int) -> tuple[Evaluation, dict[str, torch.Tensor]]:
    """Play an episode in every row; the results, and what became of the inspection, [N] each."""
    env.set_seed(seed)
    env.reset()
    full = fuel(env)
    result = evaluate(policy, env, seed=seed)
    rewarder = env.rewarder
    return result, {
        "complete": rewarder.bonus_reward_yielded.clone(),
        "hours": rewarder.bonus_reward_time / HOUR,
        "fuel": full - fuel(env),
        "inspected": rewarder.inspected.sum(1),
        "lit": rewarder.illuminated.sum(1),
        "died": env.dead[:, env.scenario.inspector_columns].sum(1),
    }


def play(name: str, actions: str, options: Any) -> tuple[Evaluation, dict[str, torch.Tensor]]:
    """Play all episodes, a batch at a time; results do not depend on the batch."""
    parts = []
    for first in range(0, options.episodes, options.batch):
        rows = range(first, min(first + options.batch, options.episodes))
        world = dict(time_limit=options.time_limit, backend=options.backend, actions=actions)
        env = bsk_torch.make(options.preset, num_envs=len(rows), env_ids=rows, **world)
        parts.append(fly(env, make_policy(name, env), options.seed))
    kept = {key: torch.cat([part[key] for _, part in parts]) for key in parts[0][1]}
    return Evaluation.joined([result for result, _ in parts]), kept


def summary(result: Evaluation, kept: dict[str, torch.Tensor], inspectors: int, returns: torch.Tensor | None) -> dict[str, Any]:
    """Return means; time is that of complete inspections, fuel that of all inspectors together.

    ``returns`` are those of the policy to which this one is compared.
    """
    n, complete = len(result.returns), int(kept["complete"].sum())
    value = result.mean_return
    compared = {}
    if returns is not None:
        gain = confidence(result.returns - returns)
        compared = {"gain": gain.mean, "gain_half": gain.half_width}
    failed = {cause: count > 0 for cause, count in result.deaths.items()}
    return {
        "complete": complete / n,
        "complete_interval": list(wilson(complete, n)),
        "hours": float(kept["hours"].nanmean()),
        "fuel": float(kept["fuel"].mean()),
        "inspected": float(kept["inspected"].double().mean()),
        "lit": float(kept["lit"].double().mean()),
        "died": float(kept["died"].double().mean()) / inspectors,
        "episodes_with_deaths": int((kept["died"] > 0).sum()),
        "collisions": int(failed["conjunction_valid"].sum()),
        "causes": {cause: int(episodes.sum()) for cause, episodes in failed.items() if bool(episodes.any())},
        "decisions": float(result.decisions.double().mean()),
        "value": value.mean,
        "half": value.half_width,
    } | compared


def main() -> None:
    """Fly and print a table."""
    arguments = harness.parser(
        __doc__,
        episodes=256,
        batch=256,
        seed=1_000_010,
        preset="RSOInspection-v1",
        policies=list(RULES),
        time_limit=57_000.0,
        backend="compiled",
    )
    options, described = harness.begin(arguments)
    inspectors = 3 if options.preset == "MultiInspection-v1" else 1
    played = {}
    for name, actions in players(options.policies):
        played[name, actions] = play(name, actions, options)
        print(f"{name} by {actions}: {float(played[name, actions][1]['complete'].double().mean()):.1%} complete", flush=True)
    rows = []
    for (name, actions), (result, kept) in played.items():
        other = played.get(REFERENCE) if (name, actions) != REFERENCE else None
        figures = summary(result, kept, inspectors, None if other is None else other[0].returns)
        rows.append({"preset": options.preset, "policy": name, "actions": actions} | figures | training(name))
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
