"""Repeat recorded episodes of AFRL's safe-autonomy-sims, all at once."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

RECORDINGS = Path(__file__).parent / "recordings"


class Played(NamedTuple):
    """Results of the recorded actions of one episode: states [T + 1, 6], and the rest as the environment gives them."""

    states: np.ndarray
    observations: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    counts: dict[str, np.ndarray]
    dead: bool


def read(name):
    """Return the entries of each recorded episode by its name."""
    table = np.load(RECORDINGS / name)
    episodes = dict.fromkeys(key.split("/")[0] for key in table)
    return {case: {key.split("/")[1]: table[key] for key in table if key.startswith(f"{case}/")} for case in episodes}


def play(env, recorded):
    """Return the results of the recorded actions in one row of ``env`` for each episode, as they are when it has ended."""
    length = [len(case["actions"]) for case in recorded.values()]
    actions = torch.zeros(max(length), len(length), 3)
    for k, case in enumerate(recorded.values()):
        actions[: length[k], k] = torch.as_tensor(case["actions"])
    steps, states, dead = [env.reset()], [state_of(env)], torch.zeros(len(actions), len(length), dtype=torch.bool)
    for k, action in enumerate(actions):
        steps.append(env.step(steps[-1].select().set("action", action))["next"])
        states.append(state_of(env))
        dead[k] = env.dead
    seen, states = torch.stack([step["observation"] for step in steps]).numpy(), np.array(states)
    rest = {key: torch.stack([step[key] for step in steps[1:]])[..., 0] for key in ("reward", "terminated", "truncated")}
    return {
        case: Played(
            states[: n + 1, k],
            seen[: n + 1, k],
            *(rest[key][:n, k].numpy() for key in rest),
            {name: count[k, 0].numpy() for name, count in steps[n]["counts"].items()},
            bool(dead[n - 1, k]),
        )
        for k, (case, n) in enumerate(zip(recorded, length, strict=True))
    }


def state_of(env):
    """Return position and velocity, [N, 6]."""
    return torch.cat([env.satellite.dynamics.rho_H, env.satellite.dynamics.rho_dot_H], 1).numpy()
