"""Trainings that collect the next batch while they learn from one."""

import copy
import dataclasses

import pytest
import torch

from bsk_torch.rl.training import PPOConfig
from bsk_torch.rl.training.trainer import Training
from tests.support.trainings import weights

pytestmark = [pytest.mark.compiled, pytest.mark.usefixtures("forked")]

SMALL = dict(num_envs=4, rollout=8, minibatch=16, epochs=2, hidden=(16,), seconds=None, evaluate_every=0)


def config(frames, **changes):
    shape = dict(learning_rate_schedule="constant", entropy_schedule="constant", options={"time_limit": 1800.0})
    return PPOConfig(frames=frames, collector="multi", workers=1, ahead=True, **(SMALL | shape | changes))


class Watched(Training):
    """Keeps every batch, and the policy at the time when it was learned from."""

    def _learn(self, batch):
        self.seen = [*getattr(self, "seen", []), (batch.clone(), copy.deepcopy(self.learner.policy_state()))]
        return super()._learn(batch)


def log_probabilities(training, batch, state):
    training.learner.load_policy_state(state)
    networks = training.learner.networks
    with torch.no_grad():
        return networks.actor.get_dist(networks.normaliser(batch.clone())).log_prob(batch["action"])


def test_batches_are_by_the_policy_one_update_before_and_resume_bit_for_bit(tmp_path):
    whole = Watched(config(4 * 32), tmp_path / "whole")
    expected = weights(whole.run()).clone()
    states = [state for _, state in whole.seen]
    for k, (batch, _) in enumerate(whole.seen):
        by_previous = log_probabilities(whole, batch, states[max(0, k - 1)])
        torch.testing.assert_close(by_previous, batch["action_log_prob"], rtol=1e-5, atol=1e-6)
        if k:
            assert not torch.allclose(log_probabilities(whole, batch, states[k]), batch["action_log_prob"], atol=1e-5)
    half = config(2 * 32)
    Training(half, tmp_path / "parts").run()
    again = Training(dataclasses.replace(half, frames=4 * 32), tmp_path / "parts", resume=True).run()
    assert torch.equal(weights(again), expected)
