"""Planners for several agents, for real numbers, and over policies that remember."""

import math

import pytest
import torch
from torchrl.envs.utils import step_mdp

import bsk_torch
from bsk_torch.env.rollout import decide
from bsk_torch.lab.planners import CrossEntropy, Rollout, TreeSearch
from bsk_torch.lab.planners.branches import carried
from bsk_torch.rl.evaluation.evaluate import SIMULATED, evaluate, start_episodes
from bsk_torch.rl.networks.plans import PLANS
from bsk_torch.rl.policies import pretrained_file
from tests.lab.planners.conftest import ENDLESS, same, scanning

pytestmark = pytest.mark.compiled


@pytest.fixture(scope="module")
def crew():
    """Two episodes of three imagers with few targets."""
    return bsk_torch.make("AEOSConstellation-v1", num_envs=2, env_ids=[0, 0], time_limit=500.0, n_targets=(5000, 5001))


def test_agents_are_improved_one_after_the_other(crew):
    crew.set_seed(0)
    now = crew.reset()
    before = crew.get_state()
    planned = Rollout(crew, "greedy", horizon=300.0, budget=3)
    decided = planned(now.clone())
    assert same(crew.get_state(), before)
    needed = now["agents", "requires_retasking"].squeeze(-1)
    assert bool(needed.all())
    assert decided[SIMULATED].tolist() == pytest.approx([3 * 3 * 300.0] * 2)  # three agents, three actions
    legal = now["agents", "action_mask"].gather(-1, decided["agents", "action"].unsqueeze(-1))
    assert bool(legal.all())


def test_flights_after_planning_are_those_without_it(crew):
    """Copying may solve orbits further ahead; where satellites fly, and what they see, stays the same, bit for bit."""
    base, seen = bsk_torch.rule("greedy", crew), []
    for plans in (False, True):
        crew.set_seed(2)
        now = crew.reset()
        for _ in range(3):
            if plans:
                Rollout(crew, "greedy", horizon=400.0, budget=2)(now.clone())
            now = crew.step(base(now))["next"]
        seen.append((now.clone(), crew.get_state()))
    assert same(seen[0][1], seen[1][1])
    assert same(seen[0][0], seen[1][0])


def test_a_crew_with_a_planner_is_no_worse_than_its_base(crew):
    plain = evaluate(bsk_torch.rule("greedy", crew), crew, seeds=[0, 1])
    planned = evaluate(Rollout(crew, "greedy", budget=4, **ENDLESS), crew, seeds=[0, 1])
    assert bool((planned.returns >= plain.returns - 1e-12).all())
    assert float(planned.returns.sum()) > float(plain.returns.sum())
    assert bool((planned.simulated > 0.0).all())


def test_trees_of_crews(crew):
    crew.set_seed(0)
    now = crew.reset()
    one = TreeSearch(crew, "greedy", horizon=200.0, budget=6, leaves=2, actions=3)(now.clone())
    again = TreeSearch(crew, "greedy", horizon=200.0, budget=6, leaves=2, actions=3, rows=3)(now.clone())
    assert torch.equal(one["agents", "action"], again["agents", "action"])
    assert bool((one[SIMULATED] > 0.0).all())


# -- real numbers -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def inspection():
    """Two inspections that a drifting inspector does not survive, or does not bring far."""
    return bsk_torch.make("RSOInspection-v1", actions="thrust", num_envs=2, env_ids=[0, 0], time_limit=8000.0)


def test_samples_that_are_drawn_again_about_the_best_improve_on_the_base(inspection):
    plain = evaluate(bsk_torch.rule("drift", inspection), inspection, seeds=[0, 1])
    planner = CrossEntropy(inspection, "drift", horizon=math.inf, budget=32, iterations=2)
    planned = evaluate(planner, inspection, seeds=[0, 1])
    assert bool((planned.returns >= plain.returns - 1e-9).all())
    assert float(planned.returns.sum()) > float(plain.returns.sum()) + 0.1


def test_more_iterations_are_no_worse_at_a_decision(inspection):
    """The best sample is kept, and the samples of the first iteration are the same."""
    inspection.set_seed(1)
    now = inspection.reset()
    worth = []
    for iterations in (1, 3):
        planner = CrossEntropy(inspection, "drift", horizon=6000.0, budget=12 * iterations, iterations=iterations)
        flown = []
        fly = planner._flown

        def watched(*given, fly=fly, flown=flown):
            found = fly(*given)
            flown.append(found[0])
            return found

        planner._flown = watched
        planner(now.clone())
        worth.append(torch.cat(flown, 1).amax(1))
    assert bool((worth[1] >= worth[0]).all())


def test_samples_do_not_depend_on_other_rows(inspection):
    alone = bsk_torch.make("RSOInspection-v1", actions="thrust", num_envs=1, env_ids=[0], time_limit=8000.0)
    actions = []
    for env, rows in ((inspection, 64), (alone, 5)):
        env.reseed([7] * env.num_envs)
        before = env.reset()
        found = CrossEntropy(env, "survey", horizon=3000.0, budget=16, iterations=2, rows=rows)(before)
        actions.append(found["inspector", "action"][0])
        assert torch.isfinite(actions[-1]).all()
    assert torch.equal(*actions)


# -- bases ------------------------------------------------------------------------------------------------------------


def test_the_memory_of_a_base_is_copied():
    """Only with its memory does the base policy fly in copies as it does outside: its own branch has the return of its flight."""
    env = scanning(2, 1500.0)
    torch.manual_seed(0)
    networks = PLANS["gru"].of(env, (16, 16)).build()
    with torch.no_grad():
        for weight in networks.actor.parameters():
            weight.mul_(6.0)  # so that decisions differ
    base = networks.policy
    plain = evaluate(base, env, seeds=[0, 1])
    planner = Rollout(env, base, **ENDLESS)
    now = start_episodes(env, [0, 1])
    for _ in range(3):  # at each decision on the way of the base policy
        decide(base, now)
        rows, memory = torch.arange(2), carried(now, base, env)
        assert bool((now["next", "memory"] != memory["memory"]).any())
        jobs = planner._jobs(now, memory, rows, rows * 0, now["action"].unsqueeze(1), rows)
        flown = planner.branches.fly(env, jobs)
        assert (env.returns + flown.reward + flown.rest).tolist() == pytest.approx(plain.returns.tolist(), abs=1e-12)
        now = step_mdp(env.step(now), keep_other=False)
    assert bool((evaluate(planner, env, seeds=[0, 1]).returns >= plain.returns - 1e-12).all())


def test_trained_policies_are_bases():
    env = bsk_torch.make("AEOS-v1", num_envs=2, env_ids=[0, 0], time_limit=300.0, as_set=True, n_targets=(300, 301))
    planned = Rollout(env, pretrained_file("AEOS-v1"), budget=4, **ENDLESS)
    plain = evaluate(planned.base, env, seeds=[0, 1])
    assert bool((evaluate(planned, env, seeds=[0, 1]).returns >= plain.returns - 1e-9).all())
