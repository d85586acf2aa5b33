"""What rules and a policy deliver in a case of aeossp_standard that they choose the tasks of, as an environment.

Usage:
    python benchmarks/aeossp_policy.py [--folder cases] [--case test/case_0001] [--learn test/case_0002] [--frames 60000]
        [--num-envs 32] [--seed 0] [--run FOLDER] [--out FILE.json]

``--folder`` holds cases. The policy learns in episodes drawn in the manner of another case, ``--learn``; ``--run`` is the folder
of its training, which is not repeated if it is there.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import harness
import torch
from tensordict.nn import TensorDictModuleBase

from bsk_torch import ConstellationTasking
from bsk_torch.presets import PRESETS
from bsk_torch.rl.marl import MAPPOConfig
from bsk_torch.rl.policies import policy_of_file
from bsk_torch.rl.policies.shared_policy import rule, shared
from bsk_torch.rl.training import train
from bsk_torch.tasks.aeossp import case_env, drawn_case_env

DRAWN = "AEOSSP-drawn"
"""Name of the environment to learn in."""

RULES = ("nearest", "hasty", "farsighted")

COLUMNS = {
    "case": "{case}",
    "entrant": "{entrant}",
    "WCR": "{WCR:.4f}",
    "CR": "{CR:.4f}",
    "TAT, s": "{TAT:.0f}",
    "looks": "{looks}",
    "CPU s": "{cpu:.1f}",
}


def config(folder: Path, frames: int, num_envs: int, seed: int) -> MAPPOConfig:
    """Return the settings of the training."""

    def drawn(**options: Any) -> ConstellationTasking:
        return drawn_case_env(folder, **options)

    PRESETS[DRAWN] = drawn
    return MAPPOConfig(
        DRAWN,
        frames=frames,
        num_envs=num_envs,
        rollout=64,
        seed=seed,
        minibatch=256,
        learning_rate=1e-3,
        gamma=0.998,
        entropy=0.002,
        imitate="farsighted",
        imitation=0.4,
        imitation_temperature=0.1,
        evaluate_every=30_000,
        evaluate_episodes=8,
        options={"tick": 0.2},
    )


def delivered(env: ConstellationTasking, policy: TensorDictModuleBase) -> dict[str, Any]:
    """Return the measures of an episode."""
    begin, td = time.process_time(), env.reset()
    with torch.no_grad():
        while not bool(td["done"].all()):
            td = env.step(policy(td))["next"]
    measures = {name: float(value) for name, value in env.rewarder.measures().items()}
    return measures | {"looks": int((env.rewarder.completed >= 0.0).sum()), "cpu": time.process_time() - begin}


def main() -> None:
    """Train, fly and print a table."""
    arguments = harness.parser(
        __doc__,
        folder="cases",
        case="test/case_0001",
        learn="test/case_0002",
        frames=60_000,
        num_envs=32,
        seed=0,
        run="",
    )
    options, described = harness.begin(arguments)
    torch.set_num_threads(1)
    run = Path(options.run or tempfile.mkdtemp()) / "run"
    settings = config(Path(options.folder, options.learn), options.frames, options.num_envs, options.seed)
    if not run.exists():
        train(settings, run, episodes=0)
    env = case_env(Path(options.folder, options.case))
    entrants = {name: rule(name, env) for name in RULES} | {"policy": shared(policy_of_file(run), env)}
    rows = [{"case": options.case, "entrant": name} | delivered(env, policy) for name, policy in entrants.items()]
    harness.write(options, described, rows=rows)
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    main()
