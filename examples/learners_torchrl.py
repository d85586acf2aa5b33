"""
PPO, DQN and discrete SAC with TorchRL
======================================

Train with losses of TorchRL, with a discount per second and masks of actions, and compare the policy with rules.

On the command line::

    python examples/learners_torchrl.py
    python examples/learners_torchrl.py --learner dqn --steps 2000000
    python examples/learners_torchrl.py --learner sac --preset AEOSPower-v1

Decisions vary in duration, so gamma is a discount per second. ``DurationGAE`` and ``DurationTD0`` are TorchRL's value estimators
with this discount.

Observations are normalized inside the networks. Losses keep references to the buffers of a network, which ``FeatureNormaliser``
updates in place; PPO updates it after each batch. Target networks and ensembles of critics are copies, which such updates do not
reach: DQN and SAC normalize by mean and deviation of the first decisions, which are random.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import ActionMask, TransformedEnv
from torchrl.modules import (
    MLP,
    EGreedyModule,
    MaskedCategorical,
    ProbabilisticActor,
    QValueActor,
    ValueOperator,
)
from torchrl.objectives import (
    ClipPPOLoss,
    DiscreteSACLoss,
    DQNLoss,
    LossModule,
    SoftUpdate,
)

from bsk_torch import SatelliteTasking
from bsk_torch.presets import make
from bsk_torch.rl.durations import DurationGAE, DurationTD0
from bsk_torch.rl.evaluation import FRESH, compare, comparison_table
from bsk_torch.rl.networks import FeatureNormaliser

LEAST = 0.05
"""Final fraction of the learning rate."""

NEVER = -1e9
"""Logit of illegal actions. Discrete SAC multiplies TorchRL's default, -inf, by a probability of 0, and learns NaN."""


def network(
    normalizer: FeatureNormaliser, outputs: int, options: argparse.Namespace
) -> nn.Sequential:
    """Return a network [N, F] -> [N, outputs] on normalized observations."""
    width, cells = len(normalizer.mean), [options.hidden] * 2
    return nn.Sequential(
        normalizer, MLP(width, outputs, num_cells=cells, activation_class=nn.Tanh)
    )


def masked_actor(net: nn.Module) -> ProbabilisticActor:
    """Return a policy of legal actions, whose logits ``net`` computes."""
    return ProbabilisticActor(
        TensorDictModule(net, ["observation"], ["logits"]),
        in_keys={"logits": "logits", "mask": "action_mask"},
        distribution_class=MaskedCategorical,
        distribution_kwargs={"neg_inf": NEVER},
        return_log_prob=True,
    )


def descend(optimizer: torch.optim.Optimizer, losses: TensorDictBase) -> None:
    """Take a gradient step on the sum of the losses."""
    optimizer.zero_grad()
    sum(value for name, value in losses.items() if name.startswith("loss")).backward()
    nn.utils.clip_grad_norm_(optimizer.param_groups[0]["params"], 0.5)
    optimizer.step()


def slow_down(
    optimizer: torch.optim.Optimizer, done: int, options: argparse.Namespace
) -> None:
    """Set the learning rate after a number of decisions."""
    remaining = max(LEAST, 1.0 - done / options.steps)
    optimizer.param_groups[0]["lr"] = options.learning_rate * remaining


def collect(
    env: SatelliteTasking,
    policy: TensorDictModuleBase | None,
    steps: int,
    options: argparse.Namespace,
) -> Iterator[TensorDictBase]:
    """Yield batches [N, T] of ``steps`` decisions per environment; without a policy, of random legal actions."""
    frames = options.num_envs * steps
    total = frames if policy is None else max(frames, options.steps // frames * frames)
    masked = env if policy is not None else TransformedEnv(env, ActionMask())
    collector = Collector(
        masked,
        policy,
        frames_per_batch=frames,
        total_frames=total,
        auto_register_policy_transforms=False,
    )
    yield from collector
    collector.shutdown(close_env=False)


# -- on policy --------------------------------------------------------------------------------------------------------


def ppo(env: SatelliteTasking, options: argparse.Namespace) -> TensorDictModuleBase:
    """Train by proximal policy optimization."""
    normalizer = FeatureNormaliser(env.observation_spec["observation"].shape[-1])
    actor = masked_actor(network(normalizer, env.action_spec.space.n, options))
    critic = ValueOperator(network(normalizer, 1, options), in_keys=["observation"])
    loss = ClipPPOLoss(
        actor, critic, clip_epsilon=0.2, entropy_coeff=0.01, normalize_advantage=True
    )
    advantages = DurationGAE(gamma=options.gamma, lmbda=0.95, value_network=critic)
    optimizer = torch.optim.Adam(loss.parameters(), options.learning_rate, eps=1e-5)
    for k, batch in enumerate(collect(env, actor, options.rollout, options)):
        slow_down(optimizer, k * batch.numel(), options)
        with torch.no_grad():
            advantages(batch)
        decisions = batch.reshape(-1)
        for _ in range(8):
            for rows in torch.randperm(len(decisions)).split(options.batch_size):
                descend(optimizer, loss(decisions[rows]))
        # only now: the stored probabilities use the old statistics
        normalizer.update(decisions["observation"])
    return actor


# -- off policy -------------------------------------------------------------------------------------------------------


def replay(
    env: SatelliteTasking, normalizer: FeatureNormaliser, options: argparse.Namespace
) -> TensorDictReplayBuffer:
    """Return a buffer with random decisions, of which the networks learn mean and deviation of observations."""
    storage = LazyTensorStorage(options.buffer)
    buffer = TensorDictReplayBuffer(storage=storage, batch_size=options.batch_size)
    for batch in collect(env, None, options.rollout, options):
        normalizer.update(batch["observation"])
        buffer.extend(kept(batch, options))
    return buffer


def kept(batch: TensorDictBase, options: argparse.Namespace) -> TensorDictBase:
    """Return the decisions of a batch with what losses need, and scaled rewards."""
    names = ["observation", "action_mask"]
    ended = ["reward", "duration", "done", "terminated"]
    keys = [*names, "action", *(("next", name) for name in (*names, *ended))]
    rows = batch.select(*keys).reshape(-1)
    return rows.set(("next", "reward"), rows["next", "reward"] * options.scale)


def learn(
    env: SatelliteTasking,
    policy: TensorDictModuleBase,
    loss: LossModule,
    buffer: TensorDictReplayBuffer,
    options: argparse.Namespace,
) -> None:
    """Collect and learn in turns."""
    loss.make_value_estimator(DurationTD0, gamma=options.gamma)
    target = SoftUpdate(loss, tau=options.tau)
    optimizer = torch.optim.Adam(loss.parameters(), options.learning_rate)
    for k, batch in enumerate(collect(env, policy, 1, options)):
        buffer.extend(kept(batch, options))
        slow_down(optimizer, k * batch.numel(), options)
        for _ in range(options.updates):
            descend(optimizer, loss(buffer.sample()))
            target.step()
        for module in policy.modules():
            if isinstance(module, EGreedyModule):
                module.step(batch.numel())


def dqn(env: SatelliteTasking, options: argparse.Namespace) -> TensorDictModuleBase:
    """Train by double deep Q-learning."""
    normalizer = FeatureNormaliser(env.observation_spec["observation"].shape[-1])
    buffer, spec = (
        replay(env, normalizer, options),
        env.full_action_spec_unbatched["action"],
    )
    actor = QValueActor(
        network(normalizer, spec.space.n, options),
        in_keys=["observation"],
        spec=spec,
        action_mask_key="action_mask",
    )
    explorer = EGreedyModule(
        spec=env.action_spec,
        eps_init=0.5,
        eps_end=0.02,
        annealing_num_steps=options.steps // 2,
        action_mask_key="action_mask",
    )
    loss = DQNLoss(actor, action_space="categorical", double_dqn=True, delay_value=True)
    learn(env, TensorDictSequential(actor, explorer), loss, buffer, options)
    return actor


def sac(env: SatelliteTasking, options: argparse.Namespace) -> TensorDictModuleBase:
    """Train by soft actor-critic of discrete actions."""
    normalizer = FeatureNormaliser(env.observation_spec["observation"].shape[-1])
    buffer, n_actions = replay(env, normalizer, options), env.action_spec.space.n
    actor = masked_actor(network(normalizer, n_actions, options))
    critic = TensorDictModule(
        network(normalizer, n_actions, options), ["observation"], ["action_value"]
    )
    loss = DiscreteSACLoss(
        actor,
        critic,
        action_space="categorical",
        num_actions=n_actions,
        target_entropy_weight=options.entropy,
    )
    learn(env, actor, loss, buffer, options)
    return actor


LEARNERS = {"ppo": ppo, "dqn": dqn, "sac": sac}

OFF_POLICY = dict(num_envs=128, gamma=0.9999, batch_size=512, tau=0.02)
"""Defaults of DQN and SAC."""

SETTINGS = {
    "ppo": dict(
        steps=1_500_000,
        num_envs=256,
        learning_rate=2.5e-3,
        gamma=0.99999,
        batch_size=2048,
    ),
    "dqn": OFF_POLICY | dict(steps=1_000_000, learning_rate=2e-3, scale=10.0),
    "sac": OFF_POLICY
    | dict(steps=500_000, learning_rate=1e-3, scale=30.0, entropy=0.02),
}
"""Defaults that differ between learners."""


def train(options: argparse.Namespace) -> TensorDictModuleBase:
    """Train in new episodes; return the policy."""
    torch.manual_seed(options.seed)
    env = make(
        options.preset, num_envs=options.num_envs, seed=options.seed, **world(options)
    )
    return LEARNERS[options.learner](env, options)


def world(options: argparse.Namespace) -> dict[str, object]:
    """Return arguments of the preset."""
    limit = {} if options.time_limit is None else {"time_limit": options.time_limit}
    return {"backend": options.backend} | limit


def arguments(line: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse the command line, or ``line``."""
    parser = argparse.ArgumentParser(description="Train with TorchRL's losses.")
    parser.add_argument("--learner", default="ppo", choices=LEARNERS)
    parser.add_argument(
        "--preset",
        default="NadirScan-v1",
        help="single-satellite preset with vector observations",
    )
    parser.add_argument("--steps", type=int, help="number of training decisions")
    parser.add_argument("--num-envs", type=int, help="episodes at once")
    parser.add_argument(
        "--rollout",
        type=int,
        default=32,
        help="decisions per episode between two updates of PPO",
    )
    parser.add_argument(
        "--hidden", type=int, default=64, help="width of the two hidden layers"
    )
    parser.add_argument(
        "--learning-rate", type=float, help="initial value; decreases linearly"
    )
    parser.add_argument("--gamma", type=float, help="discount per second")
    parser.add_argument("--batch-size", type=int, help="decisions in a gradient step")
    parser.add_argument(
        "--updates",
        type=int,
        default=4,
        help="gradient steps of DQN and SAC per step of all episodes",
    )
    parser.add_argument(
        "--buffer", type=int, default=500_000, help="decisions that DQN and SAC keep"
    )
    parser.add_argument(
        "--tau",
        type=float,
        default=0.005,
        help="part of the weights that a target network takes over",
    )
    parser.add_argument(
        "--scale", type=float, default=1.0, help="factor of rewards for DQN and SAC"
    )
    parser.add_argument(
        "--entropy",
        type=float,
        default=0.1,
        help="target entropy of SAC, as a part of the largest",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--episodes", type=int, default=1024, help="unseen episodes per evaluation"
    )
    parser.add_argument(
        "--time-limit",
        type=float,
        help="length of an episode, s (default: the preset's)",
    )
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of an episode; needs the extra viz",
    )
    parser.set_defaults(**SETTINGS[parser.parse_known_args(line)[0].learner])
    return parser.parse_args(line)


def main() -> None:
    """Train and evaluate."""
    options = arguments()
    torch.set_num_threads(1)
    begin = time.process_time()
    policy = train(options)
    print(f"{options.steps} decisions, {time.process_time() - begin:.0f} core-seconds")
    fresh = make(options.preset, num_envs=options.episodes, **world(options))
    print(comparison_table(compare({options.learner: policy}, fresh, options.seed)))
    if options.figure is not None:
        from bsk_torch.viz.episodes import draw, record

        alone = make(options.preset, num_envs=1, **world(options))
        draw(
            record(policy, alone, seed=options.seed + FRESH),
            options.figure,
            options.learner,
        )


if __name__ == "__main__":
    main()
