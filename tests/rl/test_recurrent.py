"""Policies with a memory: what is carried from decision to decision, and that it is learned from as it was used."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp
from torchrl.modules import set_recurrent_mode

import bsk_torch
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.networks.plans import INIT, MEMORY, GRUPlan
from bsk_torch.rl.policies.files import policy_of_file
from bsk_torch.rl.policies.shared_policy import SharedPolicy
from bsk_torch.rl.training.collect import make_collector
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.rl.training.trainer import Training
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

TINY = PPOConfig(
    network="gru",
    frames=96,
    seconds=None,
    num_envs=4,
    rollout=24,
    minibatch=48,
    epochs=1,
    hidden=(8, 6),
    options={"time_limit": 900.0},
)


@pytest.fixture
def networks():
    return GRUPlan(12, 4, (8, 6)).build()


def situations(n):
    return TensorDict({"observation": torch.randn(n, 12), "action_mask": torch.ones(n, 4, dtype=torch.bool)}, [n])


def test_earlier_situations_matter(networks):
    policy = networks.policy
    with torch.no_grad():
        first = policy(situations(5))
        now = situations(5)
        fresh = policy(now.clone())["logits"]
        remembering = policy(now.clone().update(first["next"].select(MEMORY)))["logits"]
        forgetting = now.clone().update(first["next"].select(MEMORY)).update({INIT: torch.ones(5, 1, dtype=torch.bool)})
        assert not torch.allclose(fresh, remembering, atol=1e-7)
        assert torch.equal(policy(forgetting)["logits"], fresh)


def test_constellations_have_no_memory(networks):
    check_refusals(refusal(lambda: SharedPolicy(networks.policy), ValueError, "memory", "constellation", "'attention'"))


def test_experience_is_judged_as_it_was_made(tmp_path):
    training = Training(TINY, tmp_path)
    with torch.no_grad():  # an untrained actor is nearly uniform, whatever it remembers
        training.learner.networks.actor[0][-1].module.weight.mul_(100.0)
    collector = make_collector(TINY, training.env, training.actor, None)
    batch = next(iter(collector))
    collector.shutdown()
    assert bool(batch["next", "done"][:, :-1].any())  # memories end within the batch
    training.learner.networks.normaliser(batch)
    with set_recurrent_mode(True), torch.no_grad():
        again = training.learner.networks.actor.get_dist(batch.clone()).log_prob(batch["action"])
    torch.testing.assert_close(again, batch["action_log_prob"], atol=2e-6, rtol=0.0)  # float32, in another order


def test_a_recurrent_policy_learns_loads_and_flies(tmp_path):
    trained = Training(TINY, tmp_path).run()
    kept = policy_of_file(tmp_path / "policy.pt")
    env = bsk_torch.make("NadirScan-v1", num_envs=3, seed=0, time_limit=900.0)
    assert evaluate(kept, env, seed=1).returns.equal(evaluate(trained, env, seed=1).returns)
    env.set_seed(1)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        now = env.reset()
        for _ in range(3):
            now = step_mdp(env.step(kept(now)))
    assert float(now[MEMORY].abs().min()) > 0.0
