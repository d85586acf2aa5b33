"""Networks for sets of targets: symmetry, padding, masks, and what is kept in a file."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

import bsk_torch
from bsk_torch.rl.networks.attention import LEAST
from bsk_torch.rl.networks.normaliser import MASK, OWN, ROWS, FeatureNormaliser, symlog
from bsk_torch.rl.networks.plans import CLOCKS, AttentionPlan
from bsk_torch.rl.policies import build_policy, check_fits, policy_of_file, pretrained_file, read_card, save_policy

N, K, F, D = 6, 5, 4, 3
OTHERS = 2
"""Actions before the images."""


@pytest.fixture
def networks():
    torch.manual_seed(0)
    plan = AttentionPlan(("observation", "target"), (("observation", "time"),), D, F, OTHERS + K, (OTHERS, OTHERS + K), (32, 32))
    return plan.build()


@pytest.fixture
def seen():
    torch.manual_seed(1)
    return torch.randn(N, D), torch.randn(N, K, F), torch.arange(K) < torch.tensor([K, K, 4, 3, 1, 0]).unsqueeze(-1)


def logits(networks, seen):
    own, _, mask = seen
    others = torch.ones(*own.shape[:-1], OTHERS, dtype=torch.bool)
    return networks.actor[0].module(*seen, torch.cat([others, mask], -1))


def value(networks, seen):
    return networks.critic.module(*seen, torch.zeros(*seen[0].shape[:-1], CLOCKS))


# Float32 sums over K tokens in another order: a few units in the last place of numbers of order one.
SUMS = dict(rtol=0.0, atol=2e-6)


def test_logits_of_images_follow_their_targets_and_nothing_else_depends_on_order(networks, seen):
    own, rows, mask = seen
    order = torch.stack([torch.randperm(K) for _ in range(N)])
    shuffled = own, rows.gather(1, order.unsqueeze(-1).expand(-1, -1, F)), mask.gather(1, order)
    before, after = logits(networks, seen), logits(networks, shuffled)
    torch.testing.assert_close(after[:, OTHERS:], before[:, OTHERS:].gather(1, order), **SUMS)
    torch.testing.assert_close(after[:, :OTHERS], before[:, :OTHERS], **SUMS)
    torch.testing.assert_close(value(networks, shuffled), value(networks, seen), **SUMS)
    assert before[0, OTHERS:].std() > 1e-4  # the logits do differ


def test_padding_has_no_influence_and_existing_targets_do(networks, seen):
    own, rows, mask = seen
    noise = torch.where(mask.unsqueeze(-1), rows, 100.0 * torch.randn_like(rows))
    assert torch.equal(logits(networks, (own, noise, mask)), logits(networks, seen))
    assert torch.equal(value(networks, (own, noise, mask)), value(networks, seen))
    assert bool((logits(networks, seen)[:, OTHERS:][~mask] == LEAST).all())
    own, rows, mask = seen
    changed = rows.clone()
    changed[:, 0] += 1.0
    assert bool(((logits(networks, (own, changed, mask)) - logits(networks, seen))[:4, OTHERS + 1].abs() > 1e-7).all())
    own, rows, mask = seen
    legal = torch.ones(N, OTHERS + 2, dtype=torch.bool)
    torch.testing.assert_close(networks.actor[0].module(own, rows, mask, legal), logits(networks, seen)[:, : OTHERS + 2], **SUMS)


@pytest.mark.parametrize("number", [1, K + 3])
def test_the_number_of_images_is_that_of_the_action_mask(networks, seen, number):
    own, rows, mask = seen
    rows, mask = (torch.nn.functional.pad(part, pad)[:, :number] for part, pad in ((rows, (0, 0, 0, 3)), (mask, (0, 3))))
    others, images = logits(networks, (own, rows, mask)).split([OTHERS, number], -1)
    known, padding = logits(networks, (own, rows[:, :K], mask[:, :K])).split([OTHERS, min(number, K)], -1)
    torch.testing.assert_close(others, known, **SUMS)
    torch.testing.assert_close(images[:, :K], padding, **SUMS)
    assert bool((images[:, K:] == LEAST).all())
    assert float(others.detach().std()) > 0.0


@pytest.mark.compiled
def test_a_published_policy_chooses_among_any_number_of_targets():
    """With fewer targets than either number, the number does not matter."""
    card, flown = read_card(pretrained_file("AEOS-v1")), []
    for n_ahead in (24, 48):
        env = bsk_torch.make("AEOS-v1", num_envs=2, n_targets=20, n_ahead=n_ahead, as_set=True, time_limit=900.0)
        check_fits(card, env)
        env.set_seed(0)
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            flown.append(env.rollout(20, build_policy(card), break_when_any_done=False)["action"])
    assert torch.equal(*flown)
    assert int(flown[0].max()) > 0


def test_logits_do_not_depend_on_the_batch_and_are_nearly_uniform_at_first(networks, seen):
    alone = torch.cat([logits(networks, tuple(part[k : k + 1] for part in seen)) for k in range(N)])
    torch.testing.assert_close(alone, logits(networks, seen), **SUMS)
    two = tuple(part.view(2, N // 2, *part.shape[1:]) for part in seen)
    torch.testing.assert_close(logits(networks, two).view(N, -1), logits(networks, seen), **SUMS)
    assert value(networks, two).shape == (2, N // 2, 1)
    spread = logits(networks, tuple(part[:2] for part in seen)).detach()
    assert float(spread.amax() - spread.amin()) < 0.1


@pytest.mark.parametrize("exploration", [ExplorationType.RANDOM, ExplorationType.DETERMINISTIC])
def test_only_legal_actions_are_taken(networks, seen, exploration):
    torch.manual_seed(2)
    mask = torch.rand(N, OTHERS + K) < 0.4
    mask[:, 0] |= ~mask.any(1)
    situation = TensorDict({**dict(zip((OWN, ROWS, MASK), seen, strict=True)), "action_mask": mask}, [N])
    with set_exploration_type(exploration):
        for _ in range(50):
            action = networks.actor(situation.clone())["action"]
            assert bool(mask.gather(1, action.unsqueeze(-1)).all())


def test_normaliser_merges_moments_of_parts_and_ignores_padding():
    torch.manual_seed(0)
    x = 3.0 * torch.randn(1000, 4, dtype=torch.float64) + 5.0
    normaliser = FeatureNormaliser(4)
    for part in x.split([1, 9, 490, 500]):
        normaliser.update(part)
    expected = symlog(x)
    torch.testing.assert_close(normaliser.mean, expected.mean(0))
    torch.testing.assert_close(normaliser.variance, expected.var(0, correction=0))
    z = normaliser(x)
    torch.testing.assert_close(z.mean(0), torch.zeros(4, dtype=torch.float64), rtol=0.0, atol=1e-6)
    rows = torch.randn(7, 5, 2)
    mask = torch.rand(7, 5) < 0.5
    one, other = FeatureNormaliser(2), FeatureNormaliser(2)
    one.update(torch.where(mask.unsqueeze(-1), rows, 1e6), mask)
    other.update(rows[mask])
    assert torch.equal(one.mean, other.mean)
    one.update(rows, torch.zeros_like(mask))
    assert torch.equal(one.variance, other.variance)
    assert float(one.count) == float(mask.sum())
    normaliser = FeatureNormaliser(1)
    normaliser.update(torch.ones(10, 1))
    assert float(normaliser(torch.ones(1, 1))) == pytest.approx(0.0, abs=1e-3)
    assert float(normaliser(torch.full((1, 1), 1e30))) == 10.0


@pytest.mark.compiled
@pytest.mark.parametrize(("preset", "first"), [("AEOS-v1", 0), ("AEOSPower-v1", 3)])
def test_a_plan_finds_the_set_and_the_images(preset, first):
    env = bsk_torch.make(preset, num_envs=2, seed=0, n_targets=50, as_set=True)
    plan = AttentionPlan.of(env, (32,))
    assert (plan.set_key, plan.images) == (("observation", "target"), (first, first + 32))
    assert (plan.n_actions, plan.n_features) == (first + 32, 8)
    now = plan.build().policy(env.reset())
    assert (now["logits"].shape, now[OWN].shape) == ((2, first + 32), (2, plan.n_own))
    assert not bool(torch.isnan(now["logits"]).any())


def test_a_kept_policy_acts_the_same(tmp_path):
    torch.manual_seed(3)
    plan = AttentionPlan(("observation", "target"), (("observation", "time"),), 1, F, OTHERS + K, (OTHERS, OTHERS + K), (32,))
    networks = plan.build()
    situation = TensorDict({
        "observation": {"target": {"rows": 5.0 * torch.randn(40, K, F), "mask": torch.ones(40, K)}, "time": torch.rand(40)},
        "action_mask": torch.ones(40, OTHERS + K, dtype=torch.bool),
    }, [40])  # fmt: skip
    networks.normaliser.update(situation)
    save_policy(tmp_path / "policy.pt", plan, networks, "AEOS-v1", {})
    kept = policy_of_file(tmp_path / "policy.pt")
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        mine, same = networks.policy(situation.clone()), kept(situation.clone())
    assert torch.equal(mine["logits"], same["logits"])
    assert torch.equal(mine["action"], same["action"])
    assert len(set(mine["action"].tolist())) > 1
