"""Subset simulation finds known probabilities, and blends keep the distribution of random numbers."""

import math
from statistics import NormalDist

import pytest
import torch
from tensordict import TensorDict

from bsk_torch.lab.risk.estimate import interval
from bsk_torch.lab.risk.subset import HAPPENS, RARER, STUCK, SubsetSimulation
from bsk_torch.rand import Blend, Key, blended

SEEDS = torch.arange(20_000)


def key_of(seeds, name="x", **given):
    none = torch.zeros_like(seeds)
    return Key(seeds, none, none, name, **given)


def sums(limit):
    """Episodes whose level is the sum of four standard normal numbers over 2; the event is a sum above the limit."""

    def fly(seeds):
        total = sum(key_of(seeds, f"term {k}").normal(1).squeeze(1) for k in range(4)) / 2.0
        level = torch.where(total > limit, torch.inf, total)
        return TensorDict({"level": level, "seconds": torch.full_like(total, 2.0), "total": total}, total.shape)

    return fly


def walks(limit, steps=20):
    """Episodes whose level is the end of a walk of steps of -1 or 1, drawn one after the other, as noise is."""

    def fly(seeds):
        lots = [key_of(seeds, moment=torch.full_like(seeds, k)).uniform(1).squeeze(1) for k in range(steps)]
        end = sum(torch.where(lot < 0.5, -1.0, 1.0) for lot in lots).double()
        level = torch.where(end >= limit, torch.inf, end)
        return TensorDict({"level": level, "seconds": torch.ones_like(end)}, end.shape)

    return fly


def estimate(fly, smallest=1e-9, size=200, count=16, seed=0):
    simulation = SubsetSimulation(fly, size, seed)
    climb = simulation.climb(smallest)
    return climb, simulation.repeat(climb.stages, count), simulation


@pytest.mark.parametrize("probability", [1e-3, 1e-6])
def test_a_sum_of_normal_numbers_exceeds_a_limit_as_often_as_it_must(probability):
    climb, found, simulation = estimate(sums(NormalDist().inv_cdf(1.0 - probability)), size=500, count=8)
    mean, low, high = interval(found.estimates)
    assert climb.why == HAPPENS
    assert low < probability < high
    assert probability / 2.0 < mean < 2.0 * probability
    assert simulation.tally.seconds == 2.0 * simulation.tally.episodes
    assert simulation.tally.episodes < 30_000
    assert bool((found.last.flown["total"] >= climb.stages[-1].threshold).all())


def test_a_random_walk_ends_far_out_as_often_as_it_must():
    exact = sum(math.comb(20, k) for k in (19, 20)) / 2**20  # 19 or 20 steps up: an end of 18 or 20
    climb, found, _ = estimate(walks(18.0), count=8)
    mean, low, high = interval(found.estimates)
    assert climb.why == HAPPENS
    assert low < exact < high
    assert exact / 2.0 < mean < 2.0 * exact


def test_estimates_have_no_bias():
    exact = 1e-2
    fly = sums(NormalDist().inv_cdf(1.0 - exact))
    _, found, _ = estimate(fly, size=20, count=1000)
    error = float(found.estimates.std()) / 1000**0.5
    assert error < 0.1 * exact
    assert abs(float(found.estimates.mean()) - exact) < 4.0 * error


def test_events_that_never_happen_have_no_share_and_say_why():
    climb, found, _ = estimate(walks(21.0), smallest=1e-12, size=50, count=4)
    assert (climb.why, float(found.estimates.sum())) == (STUCK, 0.0)
    assert float(climb.last.level.max()) == 20.0
    climb, found, _ = estimate(sums(50.0), smallest=1e-3, size=50, count=4)
    assert climb.why == RARER
    assert 0.0 < float(found.reached.mean()) < 5e-3


def test_repetitions_and_batches_do_not_depend_on_each_other():
    fly = sums(3.0)
    simulation = SubsetSimulation(fly, 20)
    stages = simulation.climb(1e-9).stages
    few, many = simulation.repeat(stages, 2), simulation.repeat(stages, 5)
    assert torch.equal(few.estimates, many.estimates[:2])
    one_by_one = SubsetSimulation(lambda seeds: _joined([fly(seed) for seed in seeds.split(1)]), 20)
    again = one_by_one.climb(1e-9)
    assert again.stages == stages
    assert torch.equal(one_by_one.repeat(stages, 2).estimates, few.estimates)


def _joined(parts):
    return torch.cat(parts)


def table(step, share=1.0, parts=2):
    """Blends of the seeds with others, in their place."""
    other = SEEDS + torch.arange(parts).unsqueeze(1) * 10**6
    steps, shares = torch.full(other.shape, step, dtype=torch.float64), torch.full(other.shape, share, dtype=torch.float64)
    steps[0] = shares[0] = 1.0
    return Blend(SEEDS, other.T.contiguous(), steps.T.contiguous(), shares.T.contiguous())


def test_blended_numbers_have_the_same_distribution_in_any_rows():
    with blended(table(0.3, 0.5, parts=4)):
        u, z = key_of(SEEDS).uniform(2), key_of(SEEDS).normal(2)
    assert float((u.sort(0).values - (SEEDS.unsqueeze(1) + 0.5) / len(SEEDS)).abs().max()) < 1.63 / len(SEEDS) ** 0.5
    assert bool(((u >= 0.0) & (u < 1.0)).all())
    assert float(z.mean(0).abs().max()) < 4.0 / len(SEEDS) ** 0.5
    assert float((z.std(0) - 1.0).abs().max()) < 0.03
    assert abs(float(torch.corrcoef(z.T)[0, 1])) < 4.0 / len(SEEDS) ** 0.5
    blend = table(0.3, 0.5, parts=7)
    with blended(blend):
        whole = key_of(SEEDS[:50]).normal(5)
        alone = torch.cat([key_of(seed).normal(5) for seed in SEEDS[:50].split(1)])
    assert torch.equal(whole, alone)


def test_a_small_step_changes_little_and_a_small_share_few_quantities():
    plain = key_of(SEEDS).normal(1)
    with blended(table(0.1)):
        near = key_of(SEEDS).normal(1)
    assert float((near - plain).std()) == pytest.approx((2.0 - 2.0 * 0.99**0.5) ** 0.5, rel=0.05)
    with blended(table(1.0, share=0.2)):
        names = [key_of(SEEDS, str(k)).normal(3) != key_of(SEEDS, str(k))._independent_normal(3) for k in range(3)]
        moments = [key_of(SEEDS, moment=SEEDS * 0 + k).uniform(1) for k in range(2)]
        plain = [key_of(SEEDS, moment=SEEDS * 0 + k)._independent(1) for k in range(2)]
    assert all(bool((changed.all(1) == changed.any(1)).all()) for changed in names)
    shares = [float(changed.any(1).double().mean()) for changed in names]
    assert shares == pytest.approx([0.2] * 3, abs=0.02)
    both = [(one - other).abs() > 1e-9 for one, other in zip(moments, plain, strict=True)]
    assert float((both[0] & both[1]).double().mean()) == pytest.approx(0.04, abs=0.01)


def test_other_seeds_and_seeds_of_themselves_keep_their_numbers():
    one = torch.ones(1, 1, dtype=torch.float64)
    plain = key_of(SEEDS).uniform(3)
    with blended(Blend(torch.tensor([7]), torch.tensor([[7]]), one, one)):
        assert torch.equal(key_of(SEEDS).uniform(3), plain)
    with blended(Blend(torch.tensor([7]), torch.tensor([[9]]), one, one)):
        inside = key_of(SEEDS).uniform(3)
    assert torch.allclose(inside[7], plain[9], rtol=0.0, atol=1e-15)
    assert torch.equal(inside[8:], plain[8:])
    assert torch.equal(key_of(SEEDS).uniform(3), plain)
