"""Constellations of unlike satellites: a policy, a critic and a file's part for each group of agents."""

import shutil

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

import bsk_torch
from bsk_torch.rl.marl import MAPPOConfig, MAPPOTraining
from bsk_torch.rl.marl.networks import ConstellationCritic
from bsk_torch.rl.policies import check_fits, policy_of_file, read_card
from bsk_torch.rl.policies.shared_policy import GroupPolicies, for_each_group, member_views, shared
from bsk_torch.rl.rules.baselines import RandomPolicy
from bsk_torch.rl.training.collect import make_collector
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

IMAGER, RELAY = "broadcasting_set_imager", "relay"

CREW = {"n_imagers": 2, "n_relays": 1, "n_targets": 200, "time_limit": 600.0}

SIZES = dict(preset="RelayConstellation-v1", num_envs=2, rollout=8, minibatch=8, seconds=None)
CONSTANT = dict(learning_rate_schedule="constant", entropy_schedule="constant")


@pytest.fixture(scope="module")
def env():
    return bsk_torch.make("RelayConstellation-v1", num_envs=2, seed=0, as_set=True, **CREW)


def config(algorithm="mappo", **changes):
    return MAPPOConfig(algorithm=algorithm, options={"as_set": True} | CREW, **(SIZES | CONSTANT | {"frames": 16} | changes))


def always(action):
    return TensorDictModule(lambda mask: torch.full(mask.shape[:-1], action), in_keys=["action_mask"], out_keys=["action"])


def test_each_group_is_asked_for_what_its_satellites_can_do():
    idle = torch.tensor([[True, False]])
    parts = {name: TensorDict({"observation": torch.zeros(1, 2, 1), "action_mask": torch.stack([idle] * n + [~idle], -1)}, (1, 2))
             for name, n in (("a", 3), ("b", 5))}  # fmt: skip
    told = GroupPolicies({"a": always(1), "b": always(4)})(TensorDict(parts, (1,)))
    assert (told["a", "action"].tolist(), told["b", "action"].tolist()) == ([[1, 3]], [[4, 5]])


def test_every_group_is_seen_by_its_satellites_and_acts_at_random_without_a_rule(env):
    views = member_views(env)
    assert list(views) == [IMAGER, RELAY]
    assert [view.observation_spec["action_mask"].shape for view in views.values()] == [(2, 17), (2, 3)]
    assert views[RELAY].observation_spec["observation"].shape == (2, 7)
    policies = bsk_torch.rule("greedy", env).policies
    assert not isinstance(policies[IMAGER], RandomPolicy)
    assert isinstance(policies[RELAY], RandomPolicy)
    seen = []
    changed = for_each_group(
        lambda one, view: seen.append(view.satellite.actions.n_actions) or one, bsk_torch.rule("random", env), env
    )
    assert (seen, list(changed.policies)) == ([17, 3], [IMAGER, RELAY])


def test_a_central_critic_observes_the_living_of_all_groups():
    torch.manual_seed(0)
    critic = ConstellationCritic(2, 3, 8, True, other_sizes=[(4, 0)])
    own = [
        torch.randn(1, 2, 2),
        torch.randn(1, 2, 5, 3),
        torch.ones(1, 2, 5, dtype=torch.bool),
        torch.ones(1, 2, dtype=torch.bool),
    ]
    other, alive = torch.randn(1, 2, 4), torch.tensor([[True, False]])
    value = critic(*own, other, alive)
    assert value.shape == (1, 2, 1)
    moved = other.clone()
    moved[:, 1] += 1.0  # dead
    assert torch.equal(critic(*own, moved, alive), value)
    moved[:, 0] += 1.0
    assert not torch.equal(critic(*own, moved, alive), value)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run of one iteration, and its folder."""
    out = tmp_path_factory.mktemp("crew") / "run"
    training = MAPPOTraining(config(), out)
    return training, training.run(), out


def test_the_file_of_several_groups_holds_each_of_them(trained):
    training, policy, out = trained
    card = read_card(out)
    assert list(card["groups"]) == [IMAGER, RELAY]
    assert [part["network"] for part in card["groups"].values()] == ["attention", "mlp"]
    check_fits(card, training.env)
    start = training.env.reset()
    again = shared(policy_of_file(out), training.env)
    with torch.no_grad():
        first, second = (player(start.clone()) for player in (policy, again))
    for group in (IMAGER, RELAY):
        assert torch.equal(first[group, "action"], second[group, "action"])


def test_rejects_policies_of_other_groups_and_sizes(trained):
    card, name = read_card(trained[2]), "RelayConstellation-v1"
    groups = card["groups"] | {RELAY: card["groups"][RELAY] | {"plan": card["groups"][RELAY]["plan"] | {"n_observed": 6}}}
    made = lambda **options: bsk_torch.make(name, num_envs=1, backend="eager", **CREW, **options)
    smaller = lambda: check_fits(card | {"groups": groups}, made(as_set=True))
    check_refusals(
        refusal(lambda: check_fits(card, made(), name), ValueError, f"{IMAGER}, {RELAY}", f"broadcasting_imager, {RELAY}"),
        refusal(smaller, ValueError, "n_observed=6", RELAY, "n_observed=7"),
    )


@pytest.fixture(scope="module", params=["mappo", "ippo"])
def collected(request, tmp_path_factory):
    """An algorithm, its learner, and a batch."""
    settings = config(request.param)
    training = MAPPOTraining(settings, tmp_path_factory.mktemp(request.param))
    collector = make_collector(settings, training.env, training.actor, None)
    batch = next(iter(collector))
    collector.shutdown()
    return request.param, training.learner, batch


def weights(group):
    return [part.detach().clone() for network in (group.acting, group.critic) for part in network.parameters()]


def test_all_groups_learn_and_only_central_critics_observe_the_others(collected):
    algorithm, learner, batch = collected
    before = {name: weights(group) for name, group in learner.groups.items()}
    report = learner.learn(batch.clone())
    assert 0.0 < report["entropy"] <= float(torch.tensor(17.0).log())
    for name, group in learner.groups.items():
        assert group.other_groups == ([other for other in learner.groups if other != name] if algorithm == "mappo" else [])
        assert any(not torch.equal(old, new) for old, new in zip(before[name], weights(group), strict=True))
        assert all(bool(new.isfinite().all()) for new in weights(group))
        assert float(group.networks.normaliser.own.count) == float((~batch[name, "action_mask"][..., -1]).sum())


@pytest.mark.parametrize("decisions", [0, 1])
def test_a_group_without_a_choice_to_compare_learns_nothing(collected, decisions):
    _, learner, batch = collected
    batch = batch.clone()
    busy = (torch.arange(4) == 3).expand_as(batch[RELAY, "action_mask"]).clone()
    busy[:1, :decisions] = ~busy[:1, :decisions]
    batch[RELAY, "action_mask"] = busy
    before = {name: weights(group) for name, group in learner.groups.items()}
    assert learner.learn(batch)["entropy"] > 0.0
    assert all(torch.equal(old, new) for old, new in zip(before[RELAY], weights(learner.groups[RELAY]), strict=True))
    assert any(not torch.equal(old, new) for old, new in zip(before[IMAGER], weights(learner.groups[IMAGER]), strict=True))


def test_an_interrupted_training_of_several_groups_goes_on_as_if_nothing_had_happened(trained, tmp_path):
    whole = MAPPOTraining(config(frames=32), tmp_path / "whole").run().state_dict()
    shutil.copytree(trained[2], tmp_path / "parts")
    parts = MAPPOTraining(config(frames=32), tmp_path / "parts", resume=True).run().state_dict()
    assert whole.keys() == parts.keys()
    for name, value in whole.items():
        assert torch.equal(parts[name], value), name
    assert any(not torch.equal(value, whole[name]) for name, value in trained[1].state_dict().items())
