"""The loss of PPO, and that of TorchRL for the same decisions."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import ClipPPOLoss

from bsk_torch.rl.networks.plans import MLPPlan
from bsk_torch.rl.training.loss import clipped_loss

CLIP, N, WIDTH = 0.2, 256, 5

FLOAT32 = dict(rtol=1e-5, atol=1e-6)
"""Sums of a few hundred numbers."""

PLANS = {"numbered": MLPPlan(WIDTH, 4, (16, 16)), "real": MLPPlan(WIDTH, 0, (16, 16), ((-1.0, 1.0), (0.0, 3.0)))}


@pytest.fixture(params=PLANS)
def decided(request):
    """Networks, and decisions by slightly different ones."""
    torch.manual_seed(4)
    networks, others = PLANS[request.param].build(), PLANS[request.param].build()
    sample = TensorDict({"seen": {"own": torch.randn(N, WIDTH), "clock": torch.rand(N, 2)}}, (N,))
    sample["action_mask"] = torch.rand(N, 4) < 0.6
    sample["action_mask"][:, 0] = True
    with torch.no_grad():
        for weights in (*networks.actor.parameters(), *others.actor.parameters()):
            weights.add_(0.1 * torch.randn_like(weights))
        distribution = others.actor.get_dist(sample)
        sample["action"] = distribution.sample()
        sample["action_log_prob"] = distribution.log_prob(sample["action"])
    sample["advantage"], sample["value_target"] = torch.randn(N, 1), torch.randn(N, 1)
    return networks, sample.select("seen", "action_mask", "action", "action_log_prob", "advantage", "value_target")


def gradients(networks, loss):
    weights = [*networks.actor.parameters(), *networks.critic.parameters()]
    return torch.autograd.grad(loss, weights, allow_unused=True, materialize_grads=True)


def test_the_loss_is_that_of_torchrl_for_decisions_that_count(decided):
    networks, sample = decided
    terms = clipped_loss(networks.actor, networks.critic, sample.clone(), CLIP)
    reference = ClipPPOLoss(
        networks.actor, networks.critic, clip_epsilon=CLIP, entropy_coeff=0.01, loss_critic_type="l2", functional=False
    )
    expected = reference(sample.clone())
    assert 0.02 < float(expected["clip_fraction"]) < 0.98
    for name in ("loss_critic", "kl_approx", "clip_fraction", "explained_variance"):
        torch.testing.assert_close(getattr(terms, name), expected[name].reshape(()), **FLOAT32)
    torch.testing.assert_close(terms.objective, expected["loss_objective"], **FLOAT32)
    losses = [terms.objective + terms.loss_critic, expected["loss_objective"] + expected["loss_critic"]]
    if len(sample["action"].shape) == 1:  # the entropy of real numbers is estimated from random draws
        torch.testing.assert_close(terms.entropy, expected["entropy"], **FLOAT32)
        losses = [losses[0] - 0.01 * terms.entropy, losses[1] + expected["loss_entropy"]]
    for found, wanted in zip(*(gradients(networks, loss) for loss in losses), strict=True):
        torch.testing.assert_close(found, wanted, **FLOAT32)
    networks, sample = decided
    counts = torch.arange(N) % 3 == 0
    some = clipped_loss(networks.actor, networks.critic, sample.clone(), CLIP, counts)
    alone = clipped_loss(networks.actor, networks.critic, sample[counts].clone(), CLIP)
    for name in ("objective", "loss_critic", "kl_approx", "clip_fraction", "explained_variance"):
        torch.testing.assert_close(getattr(some, name), getattr(alone, name), **FLOAT32)


def test_a_state_with_one_legal_action_has_no_entropy_and_no_gradient():
    networks = PLANS["numbered"].build()
    sample = TensorDict({"seen": {"own": torch.randn(8, WIDTH), "clock": torch.rand(8, 2)}}, (8,))
    sample["action_mask"] = torch.tensor([False, True, False, False]).expand(8, 4)
    sample["action"], sample["action_log_prob"] = torch.ones(8, dtype=torch.long), torch.zeros(8)
    sample["advantage"], sample["value_target"] = torch.ones(8, 1), torch.ones(8, 1)
    terms = clipped_loss(networks.actor, networks.critic, sample, CLIP)
    assert float(terms.entropy.detach()) == 0.0
    for gradient in gradients(networks, terms.objective - terms.entropy):
        assert not gradient.any()
