"""What satellites can expect of tasks of AEOS-Bench, and how they share them."""

from __future__ import annotations

import math

import pytest
import torch

import bsk_torch
from bsk_torch.rl.policies.shared_policy import shared_baselines
from bsk_torch.tasks.aeos_bench import AEOSBench, AEOSBenchGenerator, TaskProperties
from bsk_torch.tasks.aeos_bench.bound import sight_bound
from bsk_torch.tasks.aeos_bench.outlook import (
    NEVER,
    TaskCandidates,
    find_candidates,
    match,
    sight_times,
    time_constant,
    turn_time,
)
from bsk_torch.tasks.aeos_bench.outlook import TaskOutlook as Outlook


def test_small_angles_decay_with_the_time_constant():
    """The error of the linear law after ten constants, over that after nine, from its numerical solution."""
    inertia, K, P, Ki = 100.0, 8.0, 24.0, 0.005
    tau = time_constant(*(torch.tensor(value, dtype=torch.float64) for value in (inertia, K, P, Ki))).item()
    x, v, h, errors = 1.0, 0.0, 1e-3, []
    for _ in range(int(10.0 * tau / h)):
        errors.append(x)
        v -= h * (P * (1.0 + Ki * inertia) * v + 0.25 * K * x) / inertia
        x += h * v
    assert x / errors[int(9.0 * tau / h)] == pytest.approx(math.exp(-1.0), rel=1e-2)


def test_turns_take_no_time_in_the_cone_and_longer_the_farther_they_are():
    cone, tau, acceleration = torch.tensor(0.005), torch.tensor(15.0), torch.tensor(0.002)
    times = turn_time(torch.linspace(0.0, 3.0, 100), cone, tau, acceleration)
    assert times[0] == 0.0
    assert bool((times.diff() > 0.0).all())


SOON = 300.0
"""Seconds in which expectations are compared with a flight."""


@pytest.fixture(scope="module")
def flight():
    """Two episodes of satellites that look at the Earth: which task is above whose horizon, [300, N, S, T], and expectations."""
    cases = AEOSBenchGenerator(4, 60)
    soon = AEOSBench(cases, horizon=SOON)
    env = bsk_torch.make("AEOSBench-v1", num_envs=2, seed=5, folder=cases, scenario=soon, backend="eager")
    env.reset()
    scenario, above, bound = env.scenario, [], sight_bound(env, interval=5.0)
    place, expected, action = scenario.drawn("task_place").unsqueeze(1), scenario.outlook(), env.full_action_spec.zero()
    for _ in range(int(SOON)):
        r = scenario.views().r_P.unsqueeze(2)
        above.append((place * (r - place)).sum(-1) > 0.0)
        env.step(action)
    return torch.stack(above), expected, env, bound


def test_tasks_rise_and_set_when_they_are_expected_to(flight):
    """The Earth's rotation curves paths, and orbits are no circles: it matters most for passes near the horizon."""
    above, expected, env, _ = flight
    due_later = env.scenario.drawn("task_due").unsqueeze(1) > SOON
    rises = ~above[0] & above.any(0) & (expected.start > expected.turn)
    sets = above[0] & ~above.all(0) & due_later
    errors = [
        (expected.start - above.long().argmax(0))[rises].abs(),
        (expected.last - (~above).long().argmax(0))[sets].abs(),
    ]
    for error in errors:
        assert len(error) > 5
        assert error.median() < 2.5
        assert error.max() < 30.0


def test_no_more_tasks_stay_in_sight_than_the_bound_says(flight):
    """The bound rounds up to 5 s: at most few tasks are just missed."""
    above, _, env, bound = flight
    scenario = env.scenario
    release, due, duration = (scenario.drawn(f"task_{name}") for name in ("release", "due", "duration"))
    longest = run = torch.zeros_like(duration)
    for tick, seen in enumerate(above.any(2)):
        run = (run + 1.0) * (seen & (release <= tick) & (tick <= due))
        longest = torch.maximum(longest, run)
    rate = (longest >= duration).sum(1) / 60.0
    assert bool((rate <= bound).all())
    assert bool((bound - rate < 0.05).all())
    assert rate.min() > 0.01


def test_nothing_can_be_completed_after_the_horizon(flight):
    env = flight[2]
    assert bool((env.scenario.task_time == SOON).all())
    assert torch.equal(sight_bound(env).double(), env.rewarder.measures()["CR"])


def drawn(seed: int, n: int = 6, s: int = 7, t: int = 9, count: int = 4) -> TaskCandidates:
    end = 100.0 * torch.rand(n, s, t, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    zero = torch.zeros_like(end)
    outlook = Outlook(zero, zero, zero, end, zero, end < 60.0)
    return find_candidates(outlook, torch.full((n, s), -1), count)


@pytest.mark.parametrize("seed", range(5))
def test_matches_are_stable(seed):
    """No satellite prefers a task whose satellite would complete it later; no task is taken twice."""
    candidates = drawn(seed)
    place, compared = match(candidates, 9), 0
    for cost, task, exists, taken in zip(candidates.cost, candidates.task, candidates.exists, place, strict=True):
        owners = {int(task[s, k]): s for s, k in enumerate(taken.tolist()) if k >= 0}
        assert len(owners) == int((taken >= 0).sum())
        for s, k in enumerate(taken.tolist()):
            better = range(k if k >= 0 else int(exists[s].sum()))
            for other in better:
                owner = owners[int(task[s, other])]
                assert cost[owner, taken[owner]] < cost[s, other]
                compared += 1
    assert compared > 3


@pytest.mark.parametrize("satellites", [1, 4])
def test_leads_are_over_the_first_of_the_others(satellites):
    end = 500.0 * torch.rand(2, satellites, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(satellites))
    task = torch.arange(5).expand(2, satellites, 5)
    lead = TaskProperties._lead(end, task)
    others = [[end[n, [o for o in range(satellites) if o != s]].tolist() for s in range(satellites)] for n in range(2)]
    first = torch.tensor(
        [[[min(column) for column in zip([1e9] * 5, *rows, strict=True)] for rows in some] for some in others],
        dtype=torch.float64,
    )
    torch.testing.assert_close(lead, (first - end).clamp(-300.0, 300.0))


def test_candidates_come_in_the_order_of_their_ends_and_pad():
    candidates = drawn(0, count=12)
    assert candidates.task.shape == (6, 7, 12)
    assert bool((candidates.cost.diff(dim=2) >= 0.0).all())
    assert not bool(candidates.exists[..., 9:].any())
    assert bool((candidates.cost[~candidates.exists] == NEVER).all())


def test_places_that_never_rise_are_not_expected():
    r = torch.tensor([[[7e6, 0.0, 0.0]]], dtype=torch.float64)
    v = torch.tensor([[[0.0, 7.5e3, 0.0]]], dtype=torch.float64)
    pole = torch.tensor([[[0.0, 0.0, 6378136.6]]], dtype=torch.float64)
    _, rise, below = sight_times(r, v, pole)
    assert rise > below


@pytest.mark.parametrize("haste", [1.0, 0.5])
def test_the_rule_points_at_different_tasks_and_candidates_are_observed_in_order(haste):
    options = dict(candidates=True, as_set=True, step_duration=10.0, haste=haste)
    env = bsk_torch.make("AEOSBench-v1", num_envs=2, seed=3, satellites=20, tasks=300, **options)
    rule, td, wait = bsk_torch.rule("soonest_task", env), env.reset(), env.full_action_spec.zero()
    for _ in range(12):  # until some tasks have been released
        td = env.step(wait)["next"]
    group = next(iter(env.group_map))
    seen = td[group, "observation", "tasks"]
    columns = [entry.name for entry in TaskProperties().entries]
    end, held, slack = (seen["rows"][..., columns.index(name)] for name in ("end", "held", "slack"))
    exists = seen["mask"] > 0.0
    assert not bool(held.any())
    assert bool(exists.any(2).sum(1).min() > 3)
    late = exists & (slack < 0.0)
    assert 0 < int(late.sum()) < int(exists.sum()) if haste < 1.0 else not late.any()
    cost = end + 3.0 * late  # 300 s
    assert bool((cost.diff(dim=2)[exists[..., 1:]] >= 0.0).all())
    assert torch.equal(td[group, "action_mask"][..., 1:9], exists)
    action = rule(td)[group, "action"]
    env.step(td)
    task = env.scenario.held_task
    assert torch.equal(task >= 0, action > 0)
    matched = seen["rows"][..., columns.index("matched")].any(-1)
    for chosen, own in zip(task, matched, strict=True):
        assert len(set(chosen[own].tolist())) == int(own.sum())
    assert int(matched.sum()) > 6


def test_baselines_of_candidates_are_those_that_choose_among_them():
    env = bsk_torch.make("AEOSBench-v1", num_envs=1, candidates=True, backend="eager")
    found = shared_baselines(env)
    assert {"random", "soonest_task"} <= found.keys()
    assert "nearest_task" not in found
    with pytest.raises(ValueError, match="nearest_task chooses among all tasks; make the environment without candidates"):
        bsk_torch.rule("nearest_task", env)
