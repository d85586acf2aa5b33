"""Screened sampling finds known probabilities without bias, whatever its surrogate predicts."""

import math
from dataclasses import replace
from statistics import NormalDist

import pytest
import torch
from tensordict import TensorDict

from bsk_torch.lab.risk.estimate import interval
from bsk_torch.lab.risk.screened import BLIND, ScreenedSampling, _bernoulli, _choose, _proportional
from bsk_torch.lab.risk.surrogate import TAIL, chance, fitted
from bsk_torch.rand import Key

LOTS = torch.rand(4000, dtype=torch.float64, generator=torch.Generator().manual_seed(0))


def normal(seeds, name):
    none = torch.zeros_like(seeds)
    return Key(seeds, none, none, name).normal(1)


def draws(seeds):
    """Four standard normal numbers."""
    return torch.cat([normal(seeds, f"term {k}") for k in range(4)], 1)


def flying(probability, noise, number=draws):
    """Episodes whose level is standard normal: the sum of what is drawn over 2, and noise that the draws do not show."""
    limit = NormalDist().inv_cdf(1.0 - probability)

    def fly(seeds):
        total = (1.0 - noise**2) ** 0.5 * number(seeds).sum(1) / 2.0 + noise * normal(seeds, "noise").squeeze(1)
        level = torch.where(total > limit, torch.inf, total)
        return TensorDict({"level": level, "seconds": torch.full_like(total, 2.0), "total": total}, total.shape)

    return fly


def estimate(probability, noise, size=100, pool=20_000, learned=200, count=8, seed=0):
    sampling = ScreenedSampling(flying(probability, noise), draws, size, pool, learned, seed=seed)
    screen = sampling.learn()
    return screen, sampling.repeat(screen, count), sampling


@pytest.mark.parametrize(("probability", "pool"), [(1e-2, 5000), (1e-4, 60_000)])
@pytest.mark.nightly("0.0001-60000")
def test_a_sum_of_drawn_numbers_exceeds_a_limit_as_often_as_it_must(probability, pool):
    screen, found, sampling = estimate(probability, 0.1, pool=pool)
    mean, low, high = interval(found.estimates)
    assert low < probability < high
    assert probability / 2.0 < mean < 2.0 * probability
    assert screen.explained > 0.9
    error = float(found.estimates.std()) / 8**0.5 / mean
    assert 1.0 / (probability * error**2) > sampling.tally.episodes
    assert sampling.tally.seconds == 2.0 * sampling.tally.episodes
    assert float(found.weight.sum()) == pytest.approx(mean)
    assert bool((found.sample.level == torch.inf).all())


@pytest.mark.parametrize("noise", [0.3, 1.0])
@pytest.mark.nightly("0.3")
def test_estimates_have_no_bias_even_where_draws_explain_nothing(noise):
    _, found, _ = estimate(1e-2, noise, pool=1000, size=40, count=200)
    error = float(found.estimates.std()) / 200**0.5
    assert error < 0.2 * 1e-2
    assert abs(float(found.estimates.mean()) - 1e-2) < 4.0 * error


def test_inclusion_has_the_probabilities_that_weights_assume_and_that_add_up():
    level = torch.randn(400, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    chances = torch.sigmoid(4.0 * (level - 2.0))
    often, runs = torch.zeros(400), 2000
    known = torch.zeros(400, dtype=torch.float64)
    for k in range(runs):
        none = torch.tensor([k])
        chosen, inclusion = _choose(level, chances, 40, Key(none, none, none).uniform(200).squeeze(0))
        often[chosen] += 1.0
        known[chosen] = inclusion
    assert bool(((known > 0.0) & (known <= 1.0)).all())
    assert bool((known >= BLIND * 0.1 - 1e-12).all())
    error = (known * (1.0 - known) / runs).sqrt()
    assert float(((often / runs - known).abs() / (error + 1e-9)).max()) < 5.0
    share = _proportional(torch.tensor([1e-9, 1.0, 1.0, 2.0, 100.0, 1000.0], dtype=torch.float64), 3.0)
    assert (float(share.sum()), share[-2:].tolist()) == (pytest.approx(3.0), [1.0, 1.0])
    assert float(share[3]) == pytest.approx(0.5)
    assert _proportional(torch.ones(3, dtype=torch.float64), 5.0).tolist() == [1.0] * 3
    hits = torch.cat([_bernoulli(0.25, 40, LOTS[k : k + 60]) for k in range(0, 3000, 60)])
    assert len(hits) / 2000 == pytest.approx(0.25, abs=0.04)
    assert int(hits.max()) < 40


def test_repetitions_and_batches_do_not_depend_on_each_other():
    screen, found, sampling = estimate(1e-2, 0.3, pool=2000, learned=80, count=3)
    assert torch.equal(sampling.repeat(screen, 2).estimates, found.estimates[:2])
    fly = flying(1e-2, 0.3)

    def one_by_one(seeds):
        parts = [fly(seed) for seed in seeds.split(1)]
        return torch.cat(parts)

    other = ScreenedSampling(one_by_one, draws, 100, 2000, 80)
    assert torch.equal(other.repeat(other.learn(), 3).estimates, found.estimates)


def test_without_anything_drawn_it_is_as_good_as_independent_episodes():
    sampling = ScreenedSampling(flying(0.1, 1.0), lambda seeds: torch.zeros(len(seeds), 0, dtype=torch.float64), 100, 1000, 40)
    screen = sampling.learn()
    found = sampling.repeat(screen, 20)
    assert screen.explained < 0.05
    assert float(found.estimates.std()) == pytest.approx(math.sqrt(0.1 * 0.9 / 100), rel=0.6)
    assert abs(float(found.estimates.mean()) - 0.1) < 4.0 * math.sqrt(0.1 * 0.9 / 2000)


def test_a_surrogate_ignores_what_does_not_matter_and_accepts_what_never_happens():
    x = draws(torch.arange(600))
    never = torch.where(normal(torch.arange(600), "when") > 0.0, torch.inf, x[:, :1])
    same = torch.ones(600, 1, dtype=torch.float64)
    values, level = torch.cat([x, never, same], 1), x[:, 0].abs() - 0.2 * x[:, 1]
    found = fitted(values[:400], level[:400], LOTS[:400])
    assert float((found(values[400:]) - level[400:]).std()) < 0.1
    assert found.spread < 0.1
    likely = chance(found, level[:400], 1.0)(found(values[400:]))
    assert float((likely - (level[400:] > 1.0).double()).abs().mean()) < 0.05
    without = chance(found, level[:400], 9.0)(torch.tensor([8.9, 9.0], dtype=torch.float64))
    assert 0.0 < float(without[0]) < float(without[1]) < 1.0


def test_errors_with_a_long_tail_make_events_likelier_far_below_the_threshold():
    values, half = draws(torch.arange(2000)), 2000
    errors = torch.where(LOTS[:half] > 0.9, -torch.log(LOTS[half:]), 0.05 * normal(torch.arange(half), "error").squeeze(1))
    level = values[:, 0] + errors
    found = chance(fitted(values, level, LOTS[:half]), level, 6.0)
    light = replace(found, begin=1e9)
    far = torch.tensor([2.0], dtype=torch.float64)
    assert float(light(far)) < 1e-5
    assert 1e-4 < float(found(far)) < TAIL
    assert torch.equal(found(torch.tensor([6.0, 7.0]).double()), light(torch.tensor([6.0, 7.0]).double()))


def test_the_chance_is_known_where_all_learned_episodes_have_the_event():
    values = draws(torch.arange(100))
    level = torch.full((100,), torch.inf, dtype=torch.float64)
    found = chance(fitted(values, level.clamp(max=0.0), LOTS[:100]), level, 1.0)
    assert 0.0 <= float(found(torch.zeros(1, dtype=torch.float64))) <= 1.0
