"""Tasks of AEOS-Bench: who sees them, how they progress, what counts, and which case an episode flies."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from bsk_torch import ConstellationTasking, act
from bsk_torch.tasks.aeos_bench import AEOSBench, PointAtTask, TaskReward, read_cases
from bsk_torch.tasks.aeos_bench.preset import BenchSatellite, CaseSatellites, aeos_bench
from bsk_torch.tasks.aeos_bench.rules import NearestTask
from bsk_torch.tasks.aeos_bench.scene import EARTH_RADIUS, Views, in_access, near_cone
from tests.support.refusals import check_refusals, refusal
from tests.tasks.aeos_bench.aeos_cases import constellation, tasks, write


@pytest.fixture
def folder(tmp_path):
    write(tmp_path / "a", constellation(2), tasks(40))
    write(tmp_path / "b", constellation(3), tasks(60))
    return tmp_path


def fly(env: ConstellationTasking, seconds: int) -> list[torch.Tensor]:
    """Fly by the rule and return the reward of each second, [N, S]."""
    td, rule, rewards = env.reset(), NearestTask(env), []
    for _ in range(seconds):
        td = env.step(td.set(("agents", "action"), rule(td["agents", "action_mask"])))["next"]
        rewards.append(td["agents", "reward"].squeeze(-1))
    return rewards


def drawn_views(count: int, seed: int) -> tuple[Views, torch.Tensor]:
    """Satellites above random places, which point near places, and the places: [count, 4], [count, 30]."""
    generator = torch.Generator().manual_seed(seed)

    def unit(*shape: int) -> torch.Tensor:
        x = torch.randn(*shape, 3, generator=generator, dtype=torch.float64)
        return x / x.norm(dim=-1, keepdim=True)

    places = EARTH_RADIUS * unit(count, 30)
    r = unit(count, 4) * (EARTH_RADIUS * (1.02 + 0.3 * torch.rand(count, 4, 1, generator=generator, dtype=torch.float64)))
    aim = places[:, :4] + 3e4 * torch.randn(count, 4, 3, generator=generator, dtype=torch.float64)
    axis = (aim - r) / (aim - r).norm(dim=-1, keepdim=True)
    tangent = 0.02 * torch.rand(count, 4, generator=generator, dtype=torch.float64)
    return Views(r, axis, tangent), places


@pytest.mark.parametrize("seed", range(4))
def test_the_search_in_float32_finds_all_that_have_access(seed):
    views, places = drawn_views(500, seed)
    exact = in_access(Views(*(part.unsqueeze(2) for part in views)), places.unsqueeze(1))
    found = near_cone(views, places)
    near = found.closeness > found.limit.unsqueeze(2)
    assert torch.equal(near.any(2), found.closest > found.limit)
    assert exact.sum() > 50
    assert not (exact & ~near).any()
    assert near.double().mean() < 0.1  # few are left to test


def test_the_search_in_float32_finds_all_in_wide_cones_and_at_the_limb():
    views, places = drawn_views(500, 5)
    up = views.r_P / views.r_P.norm(dim=-1, keepdim=True)
    sideways = torch.linalg.cross(up, views.axis_P)
    sideways = sideways / sideways.norm(dim=-1, keepdim=True)
    sine = EARTH_RADIUS / views.r_P.norm(dim=-1, keepdim=True)
    limb = sine * sideways - (1.0 - sine * sine).sqrt() * up
    for axis in (views.axis_P, limb):
        for wide in (1.0, 10.0, 100.0, 700.0):  # up to 86 degrees
            seen = Views(views.r_P, axis, wide * views.tangent)
            exact = in_access(Views(*(part.unsqueeze(2) for part in seen)), places.unsqueeze(1))
            found = near_cone(seen, places)
            assert not (exact & ~(found.closeness > found.limit.unsqueeze(2))).any()
        assert exact.sum() > 1000


def test_access_is_a_cone_above_the_horizon():
    r = torch.tensor([7e6, 0.0, 0.0], dtype=torch.float64)
    down = -r / r.norm()
    below, far_side = EARTH_RADIUS * -down, EARTH_RADIUS * down
    view = Views(r, down, torch.tensor(0.01, dtype=torch.float64))
    assert bool(in_access(view, below))
    assert not bool(in_access(view, far_side))  # in the cone, through the Earth
    assert not bool(in_access(Views(r, -down, view.tangent), below))  # behind the sensor
    reach = (7e6 - EARTH_RADIUS) * 0.01
    for share, seen in ((0.99, True), (1.01, False)):
        place = below + torch.tensor([0.0, share * reach, 0.0], dtype=torch.float64)
        assert bool(in_access(view, place)) == seen


def test_progress_counts_seconds_without_a_gap(folder):
    """A gap resets the progress, a success is final, and the reward is what the measures say."""
    env = aeos_bench(folder / "b", num_envs=1, sensor="on", seed=0, backend="eager")
    td = env.reset()
    scenario, rewarder, memory = env.scenario, env.rewarder, env.scenario.memory
    seen = {"tasks": torch.tensor([4])}
    indices = lambda: (torch.zeros(len(seen["tasks"]), dtype=torch.int64),) * 2 + (seen["tasks"],)
    scenario.task_visible = indices
    nothing = env.action_spec.zero()["agents", "action"]
    returns = torch.zeros(3, dtype=torch.float64)

    def step(n: int) -> None:
        for _ in range(n):
            entries = env.step(td.set(("agents", "action"), nothing))["next"]
            returns.add_(entries["agents", "reward"].double().view(3))

    step(14)
    assert memory["task_progress"][0, 4] == 14.0
    seen["tasks"] = torch.tensor([], dtype=torch.int64)
    step(1)
    assert (memory["task_progress"][0, 4], memory["task_best"][0, 4]) == (0.0, 14.0)
    assert not scenario.task_succeeded.any()
    seen["tasks"] = torch.tensor([4])
    step(15)
    assert memory["task_success"][0, 4] == 30.0
    assert bool(scenario.task_offered[0, 4])
    assert not bool(scenario.task_ongoing[0, 4])
    seen["tasks"] = torch.tensor([], dtype=torch.int64)
    step(1)
    assert not bool(scenario.task_offered[0, 4])
    measures = {name: value.item() for name, value in rewarder.measures().items()}
    assert measures["CR"] == pytest.approx(1 / 60)
    assert measures["WCR"] == pytest.approx(1 / 60)
    assert measures["PCR"] == pytest.approx(1 / 60)
    assert measures["TAT"] == 30.0
    assert measures["PC"] == 0.0  # no satellite had a task
    assert returns.tolist() == pytest.approx([1 / 60, 0.0, 0.0], rel=1e-6)


def test_returns_are_the_completion_rate_and_a_share_of_progress(folder):
    for share, expected in ((0.0, "CR"), (1.0, "PCR")):
        env = aeos_bench(folder, num_envs=2, order="listed", sensor="on", seed=0, rewarder=TaskReward(share))
        total = torch.stack(fly(env, 700)).sum(0).sum(1)
        found = env.rewarder.measures()
        assert found["PCR"].max() > 0.0
        assert total.tolist() == pytest.approx(found[expected].tolist(), abs=1e-5)


def test_no_episode_depends_on_the_others(folder):
    """Three satellites of a padded case, next to another case, are the same as alone."""
    together = aeos_bench(folder, num_envs=4, order="listed", sensor="on", seed=0)
    alone = aeos_bench(folder, num_envs=1, order="listed", sensor="on", seed=0, env_ids=[1])
    for a, b in zip(fly(together, 60), fly(alone, 60), strict=True):
        assert torch.equal(a[1:2], b)
    assert torch.equal(together.scenario.memory["task_best"][1:2], alone.scenario.memory["task_best"])
    assert torch.equal(
        together.scenario.fleet.satellites[0].dynamics.r_BN_N[3:6], alone.scenario.fleet.satellites[0].dynamics.r_BN_N
    )


def test_a_saved_state_goes_on_as_it_was(folder):
    env = aeos_bench(folder, num_envs=2, order="listed", sensor="on", seed=0)
    fly(env, 30)
    saved, td = env.get_state(), env.fake_tensordict()
    td["agents", "action"] = env.action_spec.zero()["agents", "action"]
    first = [env.step(td.clone())["next", "agents", "observation"] for _ in range(5)]
    env.restore(saved)
    assert all(torch.equal(x, env.step(td.clone())["next", "agents", "observation"]) for x in first)


def test_cases_are_listed_or_drawn(folder):
    listed = aeos_bench(folder, num_envs=3, order="listed", seed=1)
    listed.reset()
    assert listed.scenario.drawn("case").flatten().tolist() == [1.0, 0.0, 1.0]
    assert listed.scenario.fleet.joined([s.present for s in listed.scenario.fleet.satellites]).sum(1).tolist() == [3, 2, 3]
    drawn = aeos_bench(folder, num_envs=64, seed=0)
    drawn.reset()
    cases = drawn.scenario.drawn("case").flatten()
    assert 16 < cases.sum() < 48


def test_sensors_are_on_as_the_action_says(folder):
    power = {}
    for sensor in ("assigned", "on"):
        env = aeos_bench(folder / "a", num_envs=1, sensor=sensor, seed=0)
        td = env.reset()
        action = env.action_spec.zero()["agents", "action"]
        env.step(td.set(("agents", "action"), action))
        power[sensor] = env.scenario.sensor_on.tolist()
    assert power == {"assigned": [[False, False]], "on": [[True, True]]}
    env = aeos_bench(folder / "a", num_envs=1, sensor="chosen", seed=0)
    td = env.reset()
    assert env.action_spec["agents", "action"].space.n == 2 * 41 + 1
    env.step(td.set(("agents", "action"), torch.tensor([[3, 41 + 3]])))
    assert env.scenario.sensor_on.tolist() == [[False, True]]
    assert env.rewarder.measures()["PC"].item() == 10.0


def test_rejects_steps_longer_than_a_tick(folder):
    class Idle(BenchSatellite):
        action_spec = (act.DiscreteFSWAction("sensor_off", duration=5.0), PointAtTask())

    env = aeos_bench(folder / "a", num_envs=1, seed=0)
    scenario = AEOSBench(env.scenario.cases)
    form = {name: value[0, 0].tolist() for name, value in scenario.cases.satellites.items()}
    slow = ConstellationTasking(
        [Idle(name, form | {"checkInertia": False}) for name in "AB"],
        scenario,
        TaskReward(),
        sat_arg_randomizer=CaseSatellites(scenario),
        sim_rate=1.0,
    )
    td = slow.reset()
    td["agents", "action"] = torch.tensor([[0, 0]])
    check_refusals([refusal(lambda: slow.step(td), RuntimeError, "PointAtTask", "AEOSBenchTracedDynModel")])


def test_cases_can_be_selected(folder):
    cases = read_cases(folder)
    one = dataclasses.replace(
        cases,
        names=cases.names[1:],
        satellites={name: value[1:] for name, value in cases.satellites.items()},
        tasks={name: value[1:] for name, value in cases.tasks.items()},
        **{name: getattr(cases, name)[1:] for name in ("present", "sensors", "enabled", "places")},
    )
    env = aeos_bench(one, num_envs=1, seed=0)
    env.reset()
    assert env.scenario.cases.names == ("b",)
