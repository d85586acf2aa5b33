"""What rules, or a trained policy, reach in the presets of inspection: completion, time, fuel and deaths over fresh episodes.

Usage:
    python benchmarks/inspection_rules.py [--episodes 256] [--seed 1000010] [--preset RSOInspection-v1] [--time-limit 57000]
        [--policy FILE] [--out FILE.json]

``--policy`` is a folder of a run, or a file, for ``actions="waypoints"``; without it the rules drift, circumnavigate and survey
act by changes of velocity, and survey also by waypoints.
"""

from __future__ import annotations

from typing import Any

import harness
import torch
from tensordict.nn import TensorDictModuleBase

import bsk_torch
from bsk_torch.env import ConstellationTasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.rl.policies import load_policy
from bsk_torch.rl.policies.shared_policy import shared, shared_baseline

HOUR = 3600.0

RULES = (("drift", "thrust"), ("circumnavigate", "thrust"), ("survey", "thrust"), ("survey", "waypoints"))
"""Rules, and the actions by which they act."""

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
    "return": "{value:.2f} +- {half:.2f}",
}


def fuel(env: ConstellationTasking) -> torch.Tensor:
    """What the tanks of all inspectors are good for, m/s [N]."""
    return env.fleet.each(lambda part: part.fsw.dv_available)[:, env.scenario.inspector_columns].sum(1)


def fly(env: ConstellationTasking, policy: TensorDictModuleBase, seed: int) -> dict[str, float]:
    """Play an episode in every row; time is that of complete inspections, fuel that of all inspectors together."""
    env.set_seed(seed)
    start = env.reset()
    full, total = fuel(env), torch.zeros(env.num_envs, dtype=torch.float64)
    for playing, step in play_episodes(env, policy, start):
        rewards = [step["next", group.name, "reward"].double().flatten(1).sum(1) for group in env.groups]
        total += torch.where(playing, torch.stack(rewards).sum(0), 0.0)
    rewarder, deviation = env.rewarder, total.std() if env.num_envs > 1 else torch.zeros(())
    return {
        "complete": float(rewarder.bonus_reward_yielded.double().mean()),
        "hours": float(rewarder.bonus_reward_time.nanmean()) / HOUR,
        "fuel": float((full - fuel(env)).mean()),
        "inspected": float(rewarder.inspected.sum(1).double().mean()),
        "lit": float(rewarder.illuminated.sum(1).double().mean()),
        "died": float(env.dead[:, env.scenario.inspector_columns].double().mean()),
        "episodes_with_deaths": float(env.dead[:, env.scenario.inspector_columns].any(1).double().mean()),
        "value": float(total.mean()),
        "half": 1.96 * float(deviation) / env.num_envs**0.5,
    }


def main() -> None:
    """Fly and print a table."""
    arguments = harness.parser(
        __doc__, episodes=256, seed=1_000_010, preset="RSOInspection-v1", time_limit=57_000.0, backend="compiled", policy=""
    )
    options, described = harness.begin(arguments)
    players: Any = [("trained", "waypoints")] if options.policy else RULES
    rows = []
    for name, actions in players:
        world = dict(num_envs=options.episodes, time_limit=options.time_limit, backend=options.backend, actions=actions)
        env = bsk_torch.make(options.preset, **world)
        policy = shared(load_policy(options.policy), env) if options.policy else shared_baseline(name, env)
        rows.append({"preset": options.preset, "policy": name, "actions": actions} | fly(env, policy, options.seed))
        print(harness.cell("{policy} by {actions}: {complete:.1%} complete", rows[-1]), flush=True)
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
