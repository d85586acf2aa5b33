"""Choices of tasks of AEOS-Bench that last longer than a second: everything counts as in flights second by second."""

import pytest
import torch

import bsk_torch
from bsk_torch.env.rollout import play_episodes
from bsk_torch.tasks.aeos_bench import TaskReward
from bsk_torch.tasks.aeos_bench import scene as aeos_bench
from bsk_torch.tasks.aeos_bench.reward import NEVER, progress
from tests.tasks.aeos_bench.aeos_cases import constellation, tasks, write

SIZES = dict(satellites=(3, 5), tasks=(120, 200), seed=5, sensor="on")


def fly(env, seconds):
    """Fly by the rule; return the rewards, [N, S], and what was assigned in each second, [N, t, S]."""
    td, rule, n = env.reset(), bsk_torch.rule("nearest_task", env), env.batch_size[0]
    returns = torch.zeros(env.fleet.shape, dtype=torch.float64)
    assigned = torch.full((n, 3 * seconds, env.fleet.size), -1)
    while int(env.fleet.ticks.min()) < seconds:
        start = env.fleet.ticks
        td = env.step(rule(td))["next"]
        returns += td["agents", "reward"].squeeze(-1).double()
        task = env.satellites[0].simulator.memory[aeos_bench.ASSIGNED].view(n, -1)
        for row in range(n):
            assigned[row, int(start[row]) : int(env.fleet.ticks[row])] = task[row]
    return returns, assigned


def counted(env):
    memory = env.scenario.memory
    return {name: memory[f"task_{name}"].clone() for name in ("success", "best", "progress")}


@pytest.mark.compiled
@pytest.mark.parametrize("options", [dict(), dict(step_duration=10.0), dict(step_duration=60.0, until_done=True)])
def test_an_episode_that_ends_when_all_tasks_are_closed_has_the_measures_of_the_whole(options, tmp_path):
    """The last task is due at 300 s, or succeeds before: the same choices, successes and energies, in less time."""
    due = [dict(task, due_time=min(task["due_time"], 300 - k)) for k, task in enumerate(tasks(200))]
    write(tmp_path / "a", constellation(3), due)
    write(tmp_path / "b", constellation(2), due[:1])
    flown = {}
    for early in (False, True):
        env = bsk_torch.make(
            "AEOSBench-v1", num_envs=2, folder=tmp_path, order="listed", seed=0, time_limit=400, end_when_closed=early, **options
        )
        rule, returns, done = bsk_torch.rule("nearest_task", env), torch.zeros(2), torch.zeros(2, dtype=torch.bool)
        for playing, step in play_episodes(env, rule):
            returns += playing * step["next", "agents", "reward"].sum((1, 2))
            done |= step["next", "terminated"].squeeze(-1)
        flown[early] = env.rewarder.measures() | {"returns": returns}
        assert done.all() if early else not done.any()
        assert int(env.fleet.ticks.max()) <= 360 if early else int(env.fleet.ticks.min()) == 400
    for name, value in flown[False].items():
        torch.testing.assert_close(flown[True][name], value, rtol=0.0, atol=0.0, equal_nan=True, msg=name)
    assert flown[True]["CR"][0] > 0.0
    assert flown[True]["PC"][0] > 0.0


@pytest.mark.compiled
@pytest.mark.parametrize("options", [dict(step_duration=30.0), dict(step_duration=60.0, until_done=True)])
def test_a_flight_is_that_of_every_second_with_the_same_choices(options):
    """Successes, progress and attitudes are equal; energies and rewards are sums in another order."""
    held = bsk_torch.make("AEOSBench-v1", num_envs=3, rewarder=TaskReward(0.5), **SIZES, **options)
    returns, assigned = fly(held, 600)
    ends, single = held.fleet.ticks, bsk_torch.make("AEOSBench-v1", num_envs=3, rewarder=TaskReward(0.5), **SIZES)
    td, sums = single.reset(), torch.zeros_like(returns)
    seen = []
    for t in range(int(ends.max())):
        td = single.step(td.set(("agents", "action"), assigned[:, t] + 1))["next"]
        sums += torch.where((t < ends).unsqueeze(1), td["agents", "reward"].squeeze(-1).double(), 0.0)
        for row in torch.nonzero(ends == t + 1).flatten().tolist():
            now = counted(single) | {"energy": single.scenario.memory["sensor_energy"]}
            seen.append((row, {name: value[row].clone() for name, value in now.items()}))
    assert len(seen) == 3
    for row, found in seen:
        for name, value in counted(held).items():
            assert torch.equal(value[row], found[name]), name
        assert held.scenario.memory["sensor_energy"][row].item() == pytest.approx(found["energy"].item(), rel=1e-12)
    torch.testing.assert_close(returns, sums, rtol=0.0, atol=1e-7)
    assert (counted(held)["success"] >= 0.0).sum() > 5
    assert (returns.sum(1) > 0.0).all()
    last = ends == ends.max()
    attitudes = [env.satellites[0].dynamics.sigma_BN.reshape(3, -1)[last] for env in (held, single)]
    assert torch.equal(*attitudes)


def test_progress_is_that_of_a_loop():
    generator = torch.Generator().manual_seed(0)
    for chance in (0.5, 0.9, 1.0):
        visible = torch.rand(240, 25, generator=generator) < chance
        before = torch.randint(0, 4, (240,), generator=generator).double()
        duration = torch.randint(4, 30, (240,), generator=generator).double()
        run, first = progress(visible, before, duration)
        current, done = before.clone(), torch.full((240,), NEVER)
        for k in range(25):
            current = (current + 1.0) * (visible[:, k] & (done == NEVER))
            assert torch.equal(run[:, k], current)
            done = torch.where((current >= duration) & (done == NEVER), k + 1, done)
        assert torch.equal(first, done)
        assert (first < NEVER).any()


def test_all_places_above_the_horizon_are_found():
    """Satellites in circular orbits, at one tick, in a minute, and in an hour."""
    generator = torch.Generator().manual_seed(1)
    places, one, other = (torch.randn(20, count, 3, generator=generator, dtype=torch.float64) for count in (60, 5, 5))
    places = aeos_bench.EARTH_RADIUS * places / places.norm(dim=-1, keepdim=True)
    one = one / one.norm(dim=-1, keepdim=True)
    other = torch.linalg.cross(one, other)
    other = other / other.norm(dim=-1, keepdim=True)
    radius = aeos_bench.EARTH_RADIUS * (1.02 + 0.3 * torch.rand(20, 5, 1, 1, generator=generator, dtype=torch.float64))
    for ticks, share in ((1, 0.15), (60, 0.2), (3600, 1.0)):
        angle = (1.1e-3 * torch.arange(ticks, dtype=torch.float64)).view(1, 1, -1, 1)
        r_P = radius * (angle.cos() * one.unsqueeze(2) + angle.sin() * other.unsqueeze(2))
        visible = (torch.einsum("nskx,ntx->nskt", r_P, places) > aeos_bench.EARTH_RADIUS**2).any(2)
        ran = torch.full((20,), ticks)
        found = aeos_bench.above_horizon(r_P, ran, places)
        longer = torch.cat([r_P, torch.zeros_like(r_P[:, :, :3])], 2)  # ticks that have not been run
        assert torch.equal(aeos_bench.above_horizon(longer, ran, places), found)
        assert not (visible & ~found).any()
        assert visible.any()
        assert found.double().mean() <= share


@pytest.mark.compiled
def test_a_choice_ends_when_its_task_is_done_or_overdue():
    env = bsk_torch.make("AEOSBench-v1", num_envs=4, step_duration=600.0, until_done=True, **SIZES)
    td, rule, memory = env.reset(), bsk_torch.rule("nearest_task", env), env.satellites[0].simulator.memory
    ended = {"done": 0, "overdue": 0, "time": 0}
    while int(env.fleet.ticks.max()) < 3000:
        td = env.step(rule(td))["next"]
        now, due = env.fleet.ticks.double().unsqueeze(1), env.scenario.drawn("task_due")
        task = memory[aeos_bench.ASSIGNED].view(4, -1)
        success, last = (table.gather(1, task.clamp(min=0)) for table in (env.scenario.memory["task_success"], due))
        done, overdue = (task >= 0) & (success == now), (task >= 0) & (now == last + 1.0)
        waits = env.requires_retasking & env.fleet.present
        assert not (done & env.fleet.present & ~waits).any()
        ended["done"] += int((waits & done).sum())
        ended["overdue"] += int((waits & overdue).sum())
        ended["time"] += int((waits & ~done & ~overdue).sum())
        mask = td["agents", "action_mask"][..., 1:-1] & waits.unsqueeze(-1)
        assert torch.equal(mask, env.scenario.task_ongoing.unsqueeze(1) & waits.unsqueeze(-1))
    assert ended["done"] > 2
    assert ended["overdue"] > 2


@pytest.mark.compiled
def test_an_episode_depends_on_no_other_and_on_no_piece(monkeypatch):
    many = bsk_torch.make("AEOSBench-v1", num_envs=4, step_duration=45.0, until_done=True, **SIZES)
    monkeypatch.setattr(aeos_bench, "AT_ONCE", 1)
    monkeypatch.setattr(aeos_bench, "PIECE", 7)
    alone = bsk_torch.make("AEOSBench-v1", num_envs=1, env_ids=[2], step_duration=45.0, until_done=True, **SIZES)
    one, _ = fly(alone, 600)
    monkeypatch.undo()
    td, rule, returns = many.reset(), bsk_torch.rule("nearest_task", many), torch.zeros(5, dtype=torch.float64)
    while int(many.fleet.ticks[2]) < int(alone.fleet.ticks[0]):
        td = many.step(rule(td))["next"]
        returns += td["agents", "reward"][2].squeeze(-1).double()
    assert torch.equal(returns, one[0])
    assert all(torch.equal(value[2], counted(alone)[name][0]) for name, value in counted(many).items())
