"""Off-policy evaluation: estimates by hand, and of the policy that has acted itself."""

import math

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from bsk_torch.lab.offline.off_policy import _Episodes, fitted_q, importance_sampling, score
from tests.support.refusals import check_refusals, refusal

FIRST = TensorDictModule(lambda mask: torch.zeros(len(mask), dtype=torch.int64), in_keys=["action_mask"], out_keys=["action"])
"""A policy that takes action 0."""


def corridor(episodes=400, length=4, seed=0):
    """Random walks: action 0 earns 1 in the last of ``length`` states if it was always taken; the state counts decisions."""
    generator = torch.Generator().manual_seed(seed)
    action = (torch.rand(episodes, length, generator=generator) < 0.5).long()
    place = torch.arange(length).expand(episodes, length)
    right = (action == 0).long().cumprod(1)
    before = torch.cat([torch.ones(episodes, 1), right[:, :-1].float()], 1)
    after = right.float()
    ended = place == length - 1
    mask = torch.ones(episodes, length, 2, dtype=torch.bool)

    def column(value):
        return value.flatten().unsqueeze(1)

    return TensorDict(
        {
            "observation": torch.stack([place.float(), before], 2).flatten(0, 1),
            "action_mask": mask.flatten(0, 1),
            "action": action.flatten(),
            "action_log_prob": torch.full((episodes * length,), math.log(0.5)),
            "episode": torch.arange(episodes).repeat_interleave(length),
            "next": {
                "observation": torch.stack([place.float() + 1.0, after], 2).flatten(0, 1),
                "action_mask": mask.flatten(0, 1),
                "reward": column((right.bool() & ended).float()),
                "duration": column(torch.full((episodes, length), 2.0)),
                "done": column(ended),
            },
        },
        [episodes * length],
    )


def test_importance_sampling_of_a_corridor():
    rows = corridor()
    found = importance_sampling(rows, FIRST)
    assert abs(found.ordinary.mean - 1.0) < found.ordinary.half_width < 0.5
    assert found.weighted == pytest.approx(1.0)
    winners = int(rows["next", "reward"].sum())
    assert found.effective == pytest.approx(winners)
    discounted = importance_sampling(rows, FIRST, gamma=0.9)
    assert discounted.weighted == pytest.approx(0.9**8)  # rewards count at the ends of four decisions of 2 s


def test_importance_sampling_without_a_common_episode():
    never = TensorDictModule(lambda mask: torch.full((len(mask),), 2), in_keys=["action_mask"], out_keys=["action"])
    found = importance_sampling(corridor(), never)
    assert (found.ordinary.mean, found.weighted, found.effective) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("trace", [0.0, 0.5, 1.0])
def test_fitted_values_of_a_corridor(trace):
    rows = corridor()
    found = fitted_q(rows, FIRST, trace=trace, iterations=60, batch_size=64, learning_rate=3e-3)
    right = rows["observation"][:, 1] == 1.0
    values = found.values(rows)
    assert values.dtype == torch.float64
    torch.testing.assert_close(values[right, 0], torch.ones(int(right.sum()), dtype=torch.float64), atol=0.1, rtol=0.0)
    torch.testing.assert_close(values[right, 1], torch.zeros(int(right.sum()), dtype=torch.float64), atol=0.1, rtol=0.0)
    again = fitted_q(rows, FIRST, trace=trace, iterations=60, batch_size=64, learning_rate=3e-3)
    assert torch.equal(again.values(rows), values)


def test_backups_follow_the_episode_as_long_as_the_actions_agree():
    rows = corridor(episodes=50)
    data = _Episodes.of(rows, FIRST, 0.9)
    then = torch.rand(len(rows), dtype=torch.float64)
    one = data.backed_up(then, 0.0)
    end = rows["next", "done"].squeeze(1)
    reward = rows["next", "reward"].squeeze(1).double()
    torch.testing.assert_close(one, 0.81 * (reward + torch.where(end, 0.0, then)))
    found = data.backed_up(then, 1.0)
    for k in range(len(rows)):
        agrees = k + 1 < len(rows) and bool(rows["action"][k + 1] == 0)
        rest = 0.0 if bool(end[k]) else (found[k + 1] if agrees else then[k])
        assert float(found[k]) == pytest.approx(float(0.81 * (reward[k] + rest)))
    assert bool(((data.backed_up(then, 0.5) - one).abs() > 0.0).any())


def test_scores_by_hand():
    truth = torch.tensor([[1.0, 3.0, torch.nan], [2.0, 2.0, 5.0]], dtype=torch.float64)
    guess = torch.tensor([[2.0, 1.0, 9.0], [2.0, 2.0, 5.0]], dtype=torch.float64)
    found = score(guess, truth)
    assert found.rmse == pytest.approx(1.0)  # errors 1, -2 and three zeros
    assert found.concordance == pytest.approx(2.0 / 3.0)
    assert found.regret == pytest.approx(1.0)


def test_rejects_wrong_arguments():
    walks = corridor(4)
    fitted = lambda **changed: fitted_q(walks, FIRST, **changed)
    table = [
        refusal(lambda: fitted(gamma=0.0), ValueError, "gamma", 0.0),
        refusal(lambda: importance_sampling(walks, FIRST, gamma=0.0), ValueError, "gamma", 0.0),
        refusal(lambda: fitted(trace=2.0), ValueError, "trace", 2.0),
        refusal(lambda: fitted(iterations=0), ValueError, "iterations=0"),
        refusal(lambda: fitted(batch_size=0), ValueError, "batch_size=0"),
    ]
    check_refusals(table)


@pytest.mark.compiled
def test_the_policy_that_has_acted_has_its_mean_return(written):
    from bsk_torch.rl.policies.pretrained import pretrained

    rows, policy = written.transitions("pretrained"), pretrained("NadirScan-v1")
    found = importance_sampling(rows, policy)
    assert found.effective == 3.0
    assert found.ordinary.mean == pytest.approx(written.card["behaviors"]["pretrained"]["mean_return"], abs=1e-6)
    assert found.weighted == pytest.approx(float(written.starts()["action_value", "pretrained"].mean()), abs=1e-6)
    estimated = fitted_q(rows, policy, trace=1.0, iterations=3)
    assert estimated.values(written.counterfactuals()).shape == (len(written.counterfactuals()), 4)
