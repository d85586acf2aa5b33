"""
Offline learning and evaluation
===============================

Write a dataset, learn from it with TorchRL's discrete CQL, and score fitted Q evaluation against the returns of all actions.

On the command line::

    python examples/offline_cql.py
    python examples/offline_cql.py --data data/scan --steps 20000

Without ``--data``, the program first writes a dataset of NadirScan-v1. The steps:

- ``data.transitions`` is a tensordict in TorchRL's layout, which its replay buffers and losses take.
- The learned policy flies unseen episodes, next to the behaviors of the dataset.
- The value of the target is estimated from episodes with random actions only. Its true returns, and those of all actions at a
  sample of decisions, are in the dataset.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.data import Categorical, TensorDictReplayBuffer, TensorStorage
from torchrl.modules import MLP, QValueActor
from torchrl.objectives import DiscreteCQLLoss, SoftUpdate, ValueEstimators

import bsk_torch
from bsk_torch.lab.offline import (
    Behavior,
    OfflineDataset,
    Recipe,
    open_dataset,
    write_dataset,
)
from bsk_torch.lab.offline.off_policy import fitted_q, importance_sampling, score
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.policies import pretrained

PRESET = "NadirScan-v1"

FRESH = 1_000_003
"""First seed of the episodes in which policies are compared, which are not in the dataset."""


def make_env(num_envs: int, args: argparse.Namespace) -> bsk_torch.SatelliteTasking:
    """Return environments that play the episodes of seeds."""
    return bsk_torch.make(
        PRESET,
        num_envs=num_envs,
        env_ids=[0] * num_envs,
        time_limit=args.time_limit,
        backend=args.backend,
    )


def write(folder: Path, args: argparse.Namespace) -> None:
    """Write random episodes, and some of the pretrained policy with random actions."""
    env, policy = make_env(args.episodes, args), pretrained(PRESET)
    behaviors = [
        Behavior("random", None, 1.0),
        Behavior("pretrained,random=0.3", policy, 0.3),
    ]
    targets, options = {"pretrained": policy}, {"time_limit": args.time_limit}
    recipe = Recipe(
        PRESET, behaviors, range(args.episodes), targets, share=0.05, options=options
    )
    write_dataset(folder, env, recipe)


def buffer(data: OfflineDataset, batch_size: int) -> TensorDictReplayBuffer:
    """Return a replay buffer with the decisions of all behaviors, with rewards in units of the returns' deviation."""
    rows = data.transitions().exclude("action_mask", ("next", "action_mask"))
    count = int(rows["episode"].max()) + 1
    sums = torch.zeros(count).index_add(
        0, rows["episode"], rows["next", "reward"].squeeze(1)
    )
    rows["next", "reward"] = rows["next", "reward"] / sums.std()
    return TensorDictReplayBuffer(storage=TensorStorage(rows), batch_size=batch_size)


def learn(data: OfflineDataset, args: argparse.Namespace) -> TensorDictModuleBase:
    """Train a policy with conservative Q-learning; all actions of NadirScan-v1 are legal at all times."""
    torch.manual_seed(args.seed)
    rows = buffer(data, args.batch_size)
    n_actions = len(data.card["actions"])
    network = MLP(
        rows[:]["observation"].shape[1], n_actions, num_cells=[args.hidden] * 2
    )
    actor = QValueActor(network, in_keys=["observation"], spec=Categorical(n_actions))
    loss = DiscreteCQLLoss(actor, action_space="categorical")
    loss.make_value_estimator(ValueEstimators.TD0, gamma=args.gamma)
    target = SoftUpdate(loss, eps=0.995)
    optimizer = torch.optim.Adam(loss.parameters(), lr=args.learning_rate)
    for step in range(args.steps):
        terms = loss(rows.sample())
        total = terms["loss_qvalue"] + args.alpha * terms["loss_cql"]
        optimizer.zero_grad()
        total.backward()
        optimizer.step()
        target.step()
        if step % max(1, args.steps // 5) == 0:
            parts = terms["loss_qvalue"].detach(), terms["loss_cql"].detach()
            print(f"step {step}: " + ", ".join(f"{float(part):.4f}" for part in parts))
    return actor


def judge(data: OfflineDataset, args: argparse.Namespace) -> None:
    """Estimate the value of the pretrained policy from random episodes, and print the errors."""
    policy, starts = pretrained(PRESET), data.starts()
    truth = starts["action_value", "pretrained"]
    rows, known = data.transitions("random"), data.counterfactuals("random")
    values = known["action_value", "pretrained"]
    print(f"true value: {float(truth.mean()):.3f}")
    weighted = importance_sampling(rows, policy).weighted
    print(f"importance sampling: {weighted:.3f}")
    for name, trace in (("fitted Q", 0.0), ("fitted Q with traces", 1.0)):
        found = fitted_q(rows, policy, trace=trace, iterations=args.iterations)
        chosen = starts["target_action", "pretrained"].unsqueeze(1)
        estimate = found.values(starts).gather(1, chosen).mean()
        points = score(found.values(known), values)
        print(
            f"{name}: {float(estimate):.3f}; of {len(known)} decisions with all returns: error {points.rmse:.3f}, "
            f"{points.concordance:.0%} of the pairs of actions in order"
        )


def main() -> None:
    """Write, learn, compare, and judge."""
    parser = argparse.ArgumentParser(
        description="Learn from a dataset, and score its evaluation."
    )
    parser.add_argument(
        "--data", type=Path, help="dataset of NadirScan-v1; default: a new one"
    )
    parser.add_argument(
        "--episodes",
        type=int,
        default=32,
        help="episodes of each behavior, and of the comparison",
    )
    parser.add_argument(
        "--time-limit", type=float, default=28_500.0, help="length of episodes, s"
    )
    parser.add_argument("--steps", type=int, default=5000, help="gradient steps")
    parser.add_argument(
        "--iterations", type=int, default=200, help="iterations of fitted Q evaluation"
    )
    parser.add_argument("--batch-size", type=int, default=256)
    parser.add_argument("--hidden", type=int, default=64)
    parser.add_argument("--learning-rate", type=float, default=1e-3)
    parser.add_argument(
        "--alpha", type=float, default=0.1, help="weight of the conservative term"
    )
    parser.add_argument(
        "--gamma",
        type=float,
        default=0.99,
        help="discount per decision, in training only",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    args = parser.parse_args()

    with tempfile.TemporaryDirectory() as folder:
        path = args.data or Path(folder) / "data"
        if args.data is None:
            write(path, args)
        data = open_dataset(path)
        for name, behavior in data.card["behaviors"].items():
            print(
                f"{name}: {behavior['decisions']} decisions, return {behavior['mean_return']:.3f}"
            )
        learned = learn(data, args)
        env = make_env(args.episodes, args)
        seeds = range(FRESH, FRESH + args.episodes)
        print(f"learned: return {evaluate(learned, env, seeds=seeds).mean_return}")
        judge(data, args)


if __name__ == "__main__":
    main()
