"""Imitation of a rule before reinforcement learning."""

import math

import pytest
import torch
from tensordict import TensorDict

from bsk_torch.rl.marl import MAPPOConfig
from bsk_torch.rl.marl.mappo import DECIDES, MAPPOLearner
from bsk_torch.rl.policies.shared_policy import shared
from bsk_torch.rl.rules.baselines import BASELINES
from bsk_torch.rl.rules.imaging import IMAGING_RULES, URGENCY, ImagingRule
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.rl.training.imitation import RANKED, TAUGHT, find_teacher, imitation_loss, taught
from bsk_torch.rl.training.ppo import Learner

SHORT = {"as_set": True, "n_targets": 200, "time_limit": 1200.0}

pytestmark = pytest.mark.compiled


def config(**changes):
    sizes = dict(num_envs=4, rollout=6, minibatch=24, epochs=8, hidden=(32,), seconds=None, frames=24)
    return PPOConfig(
        "AEOSPower-v1", network="attention", options=SHORT, **(sizes | dict(imitate="hasty", imitation=0.5) | changes)
    )


@pytest.fixture(scope="module")
def played():
    """An environment, and a batch of what random actions do there."""
    env = config().make_env()
    torch.manual_seed(0)
    return env, env.rollout(6, auto_reset=True, break_when_any_done=False)


@torch.no_grad()
def batch_of(played, learner):
    batch = learner.policy.select_out_keys("action", "action_log_prob")(played[1].clone())
    assert batch["action_log_prob"].isfinite().all()
    return batch


@torch.no_grad()
def chosen(learner, batch):
    learner.networks.normaliser(batch)
    return learner.networks.actor.get_dist(batch).probs


def test_the_rule_is_asked_in_each_situation(played):
    env, batch = played
    teacher = find_teacher("hasty", env)
    lesson = taught(teacher, batch)
    alone = BASELINES["hasty"](env, 0)(batch[:, 3])["action"]
    assert lesson.shape == batch.shape
    assert torch.equal(lesson[:, 3], alone)
    assert len(lesson.unique()) > 2


@pytest.mark.parametrize("name", [name for name in RANKED if name in IMAGING_RULES])
def test_a_temperature_turns_what_actions_are_worth_into_probabilities(played, name):
    env, batch = played
    rule = ImagingRule.of(env, IMAGING_RULES[name])
    worths = torch.stack([rule.worths(situation["observation"], situation["action_mask"]) for situation in batch.unbind(1)], 1)
    soft = taught(find_teacher(name, env, 0.2), batch)
    assert soft.shape == batch["action_mask"].shape
    assert (soft[~batch["action_mask"]] == 0.0).all()
    assert torch.allclose(soft.sum(-1), torch.ones(batch.shape))
    best, second = worths.topk(2).values.unbind(-1)
    assert torch.equal(worths.argmax(-1)[best > second], taught(find_teacher(name, env), batch)[best > second])
    close = (second > -best) & (best < URGENCY)  # between which a factor in probability can be seen
    assert close.any()
    ratio = soft.gather(-1, worths.topk(2).indices).log().diff(dim=-1).squeeze(-1)
    assert torch.allclose(ratio[close], ((second / best - 1.0) / 0.2)[close].float(), atol=1e-3)
    cold = taught(find_teacher(name, env, 1e-6), batch)
    assert torch.equal(cold.argmax(-1)[best > second], worths.argmax(-1)[best > second])


def ranking(monkeypatch, played, worths, temperature):
    """What a teacher teaches if the rule gives these worths to charge, downlink, desaturation and the images that follow."""
    env, _ = played
    table = torch.full((1, env.action_spec.space.n), -torch.inf)
    table[0, : len(worths)] = torch.tensor(worths)
    monkeypatch.setattr(ImagingRule, "worths", lambda rule, observation, action_mask: table)
    teacher = find_teacher("hasty", env, temperature)
    return teacher(env.observation_spec.zero()[:1])["probabilities"][0, : len(worths)]


@pytest.mark.parametrize("scale", [1.0, 1e-6])
def test_only_the_ratio_to_the_best_image_counts(monkeypatch, played, scale):
    lesson = ranking(monkeypatch, played, [-URGENCY, -URGENCY, -URGENCY, 0.5 * scale, 0.4 * scale, 0.0, -scale], 0.1)
    expected = torch.tensor([0.0, 0.0, 0.0, 0.0, -2.0, -10.0, -30.0]).exp() * torch.tensor([0, 0, 0, 1, 1, 1, 1])
    assert torch.allclose(lesson, expected / expected.sum(), atol=1e-6)


@pytest.mark.parametrize(
    ("worths", "lesson"),
    [
        ([-URGENCY, -URGENCY, -URGENCY, 0.0, -0.1, -2.0], [0, 0, 0, 1, 0, 0]),
        ([-URGENCY, -URGENCY, -URGENCY, -30.0, -20.0], [0, 0, 0, 0, 1]),
        ([-URGENCY, -URGENCY, -URGENCY, 0.0, 0.0], [0, 0, 0, 0.5, 0.5]),
        ([-URGENCY, URGENCY, -URGENCY, 1.0, 0.9], [0, 1, 0, 0, 0]),
        ([-URGENCY, URGENCY, -URGENCY, 0.0, -0.5], [0, 1, 0, 0, 0]),
        ([-URGENCY, -torch.inf, -URGENCY], [0.5, 0, 0.5]),
        ([-URGENCY], [1]),
    ],
    ids=["the best is worth nothing", "none can be reached", "equal", "downlink", "downlink, no worth", "no image", "one action"],
)
@pytest.mark.parametrize("temperature", [1e-300, 0.1, 5.0])
def test_without_an_image_of_worth_the_best_actions_share_the_probability(monkeypatch, played, worths, lesson, temperature):
    assert torch.allclose(ranking(monkeypatch, played, worths, temperature), torch.tensor(lesson).float(), atol=1e-6)


def test_probabilities_are_learned_by_their_cross_entropy():
    logits = torch.tensor([[2.0, 0.0, 5.0], [0.0, 1.0, 0.0]], requires_grad=True)
    legal = torch.tensor([[True, True, False], [True, True, True]])
    soft = torch.tensor([[0.7, 0.3, 0.0], [0.2, 0.3, 0.5]])
    sample = TensorDict({"logits": logits, "action_mask": legal, TAUGHT: soft}, (2,))
    first = -(soft[0, :2] * logits[0, :2].log_softmax(-1)).sum()
    second = -(soft[1] * logits[1].log_softmax(-1)).sum()
    assert torch.allclose(imitation_loss(sample), (first + second) / 2)
    assert torch.allclose(imitation_loss(sample, torch.tensor([False, True])), second)
    imitation_loss(sample).backward()
    assert logits.grad[0, 2] == 0.0


def test_a_policy_learns_how_close_a_choice_was(played):
    torch.manual_seed(1)
    learner = Learner(config(learning_rate=3e-3, learning_rate_schedule="constant", imitation_temperature=0.02), played[0])
    learner.anneal(0.0)
    batch = batch_of(played, learner)
    soft = taught(learner.teacher, batch)

    def distance():
        return 0.5 * (chosen(learner, batch) - soft).abs().sum(-1).mean()

    before = distance()
    for _ in range(12):
        learner.learn(batch_of(played, learner))
    assert before > 0.1
    assert distance() < 0.2 * before


def test_nothing_is_estimated_for_a_training_that_only_imitates(played):
    learner = Learner(config(imitation=1.0, imitation_temperature=0.2), played[0])
    critic = {name: weight.clone() for name, weight in learner.critic.state_dict().items()}
    actor = {name: weight.clone() for name, weight in learner.acting.state_dict().items()}
    learner.anneal(0.99)
    report = learner.learn(batch_of(played, learner))
    assert all(torch.equal(weight, critic[name]) for name, weight in learner.critic.state_dict().items())
    assert any(not torch.equal(weight, actor[name]) for name, weight in learner.acting.state_dict().items())
    assert report["entropy"] > 0.0
    assert all(math.isnan(report[name]) for name in ("loss_critic", "explained_variance", "clip_fraction"))


def test_the_policy_learns_what_the_rule_does_and_then_what_pays(played):
    torch.manual_seed(1)
    learner = Learner(config(learning_rate=3e-3, learning_rate_schedule="constant"), played[0])
    learner.anneal(0.0)
    batch = batch_of(played, learner)
    lesson = taught(learner.teacher, batch).unsqueeze(-1)
    before = chosen(learner, batch).gather(-1, lesson).mean()
    for _ in range(12):
        learner.learn(batch_of(played, learner))
    after = chosen(learner, batch).gather(-1, lesson).mean()
    assert learner.imitates
    assert before < 0.3
    assert after > 0.8
    learner.anneal(0.5)
    assert not learner.imitates
    learner.learn(batch_of(played, learner))


def test_illegal_actions_stay_illegal(played):
    learner = Learner(config(), played[0])
    learner.anneal(0.0)
    batch = batch_of(played, learner)
    learner.learn(batch)
    assert (chosen(learner, batch)[~batch["action_mask"]] == 0.0).all()


def test_only_decisions_that_count_are_learned_from():
    logits = torch.tensor([[2.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    legal = torch.ones(3, 2, dtype=torch.bool)
    sample = TensorDict({"logits": logits, "action_mask": legal, TAUGHT: torch.tensor([0, 1, 0])}, (3,))
    surprise = -logits.log_softmax(-1)[torch.arange(3), sample[TAUGHT]]
    assert torch.allclose(imitation_loss(sample), surprise.mean())
    counts = torch.tensor([True, False, True])
    assert torch.allclose(imitation_loss(sample, counts), (surprise[0] + surprise[2]) / 2)


def test_satellites_of_a_constellation_imitate_what_the_rule_fits(caplog):
    crew = {"n_imagers": 2, "n_relays": 1, "n_targets": 200, "time_limit": 600.0, "as_set": True}
    sizes = dict(num_envs=2, rollout=8, minibatch=8, seconds=None, frames=16, imitation=1.0)
    options = MAPPOConfig("RelayConstellation-v1", options=crew, imitate="hasty", **sizes)
    env = options.make_env()
    learner = MAPPOLearner(options, env)
    imager, relay = learner.groups.values()
    assert imager.teacher is not None
    assert relay.teacher is None
    assert "these satellites learn by themselves" in caplog.text
    learner.anneal(0.0)
    assert imager.imitates
    assert not relay.imitates
    actor = shared(learner.policy, env)
    with torch.no_grad():
        batch = env.rollout(8, actor, auto_reset=True, break_when_any_done=False)
    seen = {}
    original = imager.counts

    def watched(sample):
        seen["decides"], seen["taught"], seen["mask"] = sample[DECIDES], sample[TAUGHT], sample["action_mask"]
        return original(sample)

    imager.counts = watched
    learner.learn(batch)
    legal = seen["mask"].gather(-1, seen["taught"].unsqueeze(-1)).squeeze(-1)
    assert seen["decides"].any()
    assert legal[seen["decides"]].all()


def test_both_types_of_a_cluster_learn_how_its_rule_ranks_actions():
    cluster = {"n_targets": 200, "time_limit": 300.0, "as_set": True}
    sizes = dict(num_envs=2, rollout=4, minibatch=8, seconds=None, frames=8, imitation=1.0)
    config = MAPPOConfig("HeteroCluster-v1", options=cluster, imitate="cooperative", imitation_temperature=0.1, **sizes)
    env = config.make_env()
    learner = MAPPOLearner(config, env)
    learner.anneal(0.0)
    with torch.no_grad():
        batch = env.rollout(4, shared(learner.policy, env), auto_reset=True, break_when_any_done=False)
    before = [parameter.clone() for parameter in learner.policy.parameters()]
    learner.learn(batch)
    assert all(group.imitates for group in learner.groups.values())
    changed = [not torch.equal(a, b) for a, b in zip(before, learner.policy.parameters(), strict=True)]
    assert any(changed)
    assert all(parameter.isfinite().all() for parameter in learner.policy.parameters())
