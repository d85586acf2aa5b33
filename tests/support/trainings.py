"""A training of a second, and the weights that one leaves."""

import torch
from torch import Tensor, nn

from bsk_torch.rl.training.config import PPOConfig

TINY = PPOConfig(
    frames=96,
    seconds=None,
    num_envs=4,
    rollout=6,
    minibatch=12,
    epochs=1,
    hidden=(8,),
    evaluate_every=48,
    evaluate_episodes=2,
    options={"time_limit": 1200.0},
)


def weights(policy: nn.Module) -> Tensor:
    """All weights and statistics of a policy in one vector."""
    return torch.cat([value.double().flatten() for value in policy.state_dict().values()])
