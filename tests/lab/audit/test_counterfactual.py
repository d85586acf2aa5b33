"""Rescues and proofs: what flies never beats the bound, the hopeless are proven lost, what is saved flies again."""

import pytest
import torch
from tensordict.nn import TensorDictModule

import bsk_torch
from bsk_torch import rand
from bsk_torch.lab.audit.charge_bound import least_charge, longest_action, most_power, sunlight
from bsk_torch.lab.audit.counterfactual import LEAST_DEMANDING, LOST, OPEN, SAVED, candidate_plans, exhaust, spliced
from bsk_torch.lab.audit.failures import can_be_saved, explain
from bsk_torch.rl.evaluation.evaluate import start_episodes
from bsk_torch.rl.evaluation.replay import OVER, fly

CAPACITY = 200 * 3600.0

SCAN, CHARGE, DOWNLINK, DESAT = range(4)

DARK, SUNLIT = 51, 0
"""Seeds of an episode that begins 1,978 s before sunrise, and of one without eclipses; tests make sure of both."""

NONE = torch.zeros(0, dtype=torch.int64)


def build(num_envs=256, time_limit=2400.0, **sat_args):
    options = {"time_limit": time_limit, "sat_args": sat_args}
    return bsk_torch.make("NadirScan-v1", num_envs=num_envs, env_ids=[0] * num_envs, **options)


def always(action):
    return TensorDictModule(lambda mask: torch.full(mask.shape[:1], action), in_keys=["action_mask"], out_keys=["action"])


# -- the bound ----------------------------------------------------------------------------------------------------------


def survives(charge, gain, longest):
    """Whether actions of at most ``longest`` ticks can be chosen such that the battery is not empty at the end of any."""
    levels = [charge]
    for change in gain:
        levels.append(max(levels[-1] + change, 0.0))
    reached = [charge > 0.0]
    for tick in range(1, len(levels)):
        reached.append(levels[tick] > 0.0 and any(reached[max(0, tick - longest) : tick]))
    return reached[-1]


@pytest.mark.parametrize("longest", [1, 2, 4])
def test_the_bound_is_exactly_what_a_battery_needs_whose_actions_end_as_late_as_they_can(longest):
    gain = torch.randint(-3, 3, (40, 12)).double()
    need = least_charge(gain, longest)[:, 0]
    alive = torch.tensor([[survives(charge, row.tolist(), longest) for charge in range(1, 40)] for row in gain])
    doomed = torch.arange(1, 40) <= need.unsqueeze(1)
    assert not bool((alive & doomed).any())
    assert float((~alive & doomed).sum()) > 0.5 * float((~alive).sum())  # and it tells most of those that die


@pytest.mark.compiled
def test_what_flies_is_lit_as_foreseen_and_never_charged_above_the_bound():
    env, row = build(16, 6000.0, storedCharge_Init=rand.Uniform(0.0, 0.05 * CAPACITY)), torch.arange(16)
    start_episodes(env, range(16))
    lit, _ = sunlight(env, row, torch.arange(1.0, 6001.0, dtype=torch.float64))
    most = [env.satellite.dynamics.battery_charge]
    for gain in most_power(env, row).unbind(1):
        most.append((most[-1] + gain).clamp(0.0, CAPACITY))
    bound, dark = torch.stack(most, 1), 0
    for _ in range(30):
        env.play(torch.randint(0, 4, (16,)))
        tick, seen = env.simulator.ticks, env.satellite.dynamics
        torch.testing.assert_close(seen.illumination, lit[row, tick - 1], atol=1e-8, rtol=0.0)  # acos near 1
        assert bool((seen.battery_charge <= bound[row, tick] + 1e-6).all())
        dark += int((seen.illumination == 0.0).sum())
    assert 0 < dark < 30 * 16


@pytest.mark.compiled
def test_whoever_has_less_than_the_bound_dies_whatever_he_does():
    env, seeds = build(64, storedCharge_Init=rand.Uniform(0.0, 0.03 * CAPACITY)), torch.arange(64)
    start_episodes(env, range(64))
    first = env.satellite.dynamics.battery_charge
    doomed = first <= least_charge(most_power(env, seeds), longest_action(env))[:, 0]
    assert 5 < int(doomed.sum()) < 60
    for plan in candidate_plans(env, n_random=4):
        assert not bool((fly(env, seeds, plan.expand(64, -1)).survived & doomed).any())


# -- searches -----------------------------------------------------------------------------------------------------------


@pytest.mark.compiled
def test_every_plan_ends_with_charging():
    plans = candidate_plans(build(1), n_random=3)
    assert set(plans[:, -1].tolist()) == {CHARGE}
    assert plans[LEAST_DEMANDING, :11].tolist() == [DESAT] * 10 + [CHARGE]
    assert len(plans.unique(dim=0)) == len(plans)


def test_plans_follow_what_is_kept():
    actions, plans = torch.tensor([[0, 0, 2, OVER], [3, 3, 3, 3]]), torch.tensor([[1, 2, 1], [0, 0, 1]])
    assert spliced(actions, torch.tensor([2, 0]), plans).tolist() == [[0, 0, 1, 2, 1, 1, 1], [0, 0, 1, 1, 1, 1, 1]]


@pytest.mark.compiled
@pytest.mark.parametrize(("charge", "bound_tells"), [(2e3, True), (1.5e4, True), (2.5e4, False)])
def test_the_hopeless_are_proven_lost_by_search_and_where_it_tells_by_the_bound(charge, bound_tells):
    env = build(storedCharge_Init=charge, wheelSpeeds=[2500.0, -2500.0, 2500.0])
    bounded, searched = (exhaust(env, DARK, NONE, 0, bound=bound) for bound in (True, False))
    assert bounded.outcome == searched.outcome == LOST
    assert bounded.states < searched.states
    assert (bounded.states == 1) == bound_tells


@pytest.mark.compiled
def test_the_easy_are_saved_by_search():
    env = build(16, time_limit=400.0, storedCharge_Init=0.5 * CAPACITY)
    verdict = exhaust(env, DARK, NONE, 0)
    assert verdict.outcome == SAVED
    assert bool(fly(env, torch.tensor([DARK]), verdict.actions.unsqueeze(0)).survived)


@pytest.mark.compiled
def test_a_search_with_too_few_rows_charges_and_gives_up():
    rich = exhaust(build(16, storedCharge_Init=0.5 * CAPACITY), DARK, NONE, 0)
    assert rich.outcome == SAVED
    assert rich.actions[-1] == CHARGE
    poor = build(16, storedCharge_Init=2.5e4, wheelSpeeds=[2500.0, -2500.0, 2500.0])
    assert exhaust(poor, DARK, NONE, 0).outcome == LOST
    assert exhaust(poor, DARK, NONE, 0, bound=False).outcome == OPEN


# -- failures -----------------------------------------------------------------------------------------------------------


@pytest.mark.compiled
def test_failures_are_told_apart_and_rescues_fly_again():
    env, seeds = build(storedCharge_Init=2.5e4), torch.tensor([SUNLIT, DARK])
    flown, (sunlit, dark) = explain(always(SCAN), env, seeds)
    assert flown.survived.tolist() == [False, False]
    assert (sunlit.seed, sunlit.outcome, sunlit.cause, sunlit.start.dark) == (SUNLIT, SAVED, "battery_valid", 0.0)
    assert (dark.seed, dark.outcome, dark.lost_from, dark.rescue) == (DARK, LOST, 0, None)
    assert dark.start.dark == pytest.approx(1978.0, abs=30.0)  # eclipses are known to 30 s
    assert dark.start.charge == pytest.approx(2.5e4 / CAPACITY)
    last = sunlit.last_chance.decision
    assert sunlit.rescue[:last] == [SCAN] * last
    assert sunlit.lost_from == last + 1
    again = fly(env, seeds[:1], torch.tensor([sunlit.rescue]))
    assert bool(again.survived)
    assert float(again.returns) <= sunlit.best_return
    assert can_be_saved(env, seeds).tolist() == [True, False]


@pytest.mark.compiled
def test_whoever_is_dead_at_the_start_is_lost():
    _, (failure,) = explain(always(SCAN), build(16, storedCharge_Init=0.0), torch.tensor([SUNLIT]))
    assert (failure.outcome, failure.lost_from, failure.best_return) == (LOST, 0, None)


@pytest.mark.compiled
def test_what_a_policy_did_is_what_its_list_of_actions_does_in_any_batch():
    wide, narrow = build(8, 1200.0), build(3, 1200.0)
    seeds = torch.arange(5)
    flown = fly(wide, seeds, always(DESAT))
    again = fly(narrow, seeds, flown.actions.clamp(min=0), notes=True)
    assert torch.equal(again.returns, flown.returns)
    assert torch.equal(again.actions, flown.actions)
    assert again.series["wheel_speeds"].shape == (5, flown.actions.shape[1] + 1, 3)
