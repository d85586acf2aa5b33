"""Bounds: never below what policies reach, and around the optimum where that can be counted out."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

import bsk_torch
from bsk_torch import make
from bsk_torch.astro.frames import angle_between
from bsk_torch.env.rollout import play_episodes
from bsk_torch.lab.bounds import (
    Envelope,
    ScheduledPolicy,
    carried_over,
    imaging_bound,
    milp_schedule,
    record_transitions,
    relaxed_schedule,
    scanning_bound,
)
from bsk_torch.lab.bounds.graph import image_graph
from bsk_torch.lab.bounds.paths import best_paths, neighbours
from bsk_torch.lab.bounds.windows import Openings, openings, satellite_positions
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.policies import pretrained
from bsk_torch.rl.rules.baselines import BASELINES

HALF_ORBIT = 2850.0

SEED = 4_000_001


def envelope(direct: list[int], every: list[int], step: float = 1.0) -> Envelope:
    return Envelope(0.1, tuple(direct), tuple(every), step, {}, 0)


# -- the envelope -------------------------------------------------------------------------------------------------------------


def test_an_envelope_lies_below_all_transitions_and_is_the_highest_that_ascends():
    generator = torch.Generator().manual_seed(0)
    angle = torch.rand(5000, generator=generator, dtype=torch.float64) * 1.5
    ticks = (20 + 60 * angle + 30 * torch.rand(5000, generator=generator, dtype=torch.float64)).long()
    one_step = torch.rand(5000, generator=generator) < 0.7
    made = Envelope.below(angle, ticks, one_step, step=0.5, arguments={}, width=0.1, bins=12, margin=1, enough=1)
    assert made.smallest_margin(angle, ticks, one_step) == 1  # and some transition is as near as that
    assert list(made.direct) == sorted(made.direct)
    assert list(made.any) == sorted(made.any)
    assert all(a <= d for a, d in zip(made.any, made.direct, strict=True))
    least = [int(ticks[(angle >= 0.1 * k) & one_step].min()) for k in range(12)]
    assert list(made.direct) == [t - 1 for t in least]
    faster = ticks.clone()
    faster[0] -= 90
    assert made.smallest_margin(angle, faster, one_step) < 0


def test_an_envelope_is_saved_and_read(tmp_path):
    made = envelope([2, 5], [2, 3])
    made.save(tmp_path / "made.json")
    assert Envelope.load(tmp_path / "made.json") == made


def test_images_of_the_step_before_last_a_single_tick():
    imaged, ticks = torch.tensor([True, True, False, True]), torch.tensor([1, 2, 1, 60])
    assert carried_over(imaged, ticks).tolist() == [True, False, False, False]


@pytest.mark.parametrize("preset", ["AEOS-v1", "AEOSCity-v1", "AEOSPower-v1"])
def test_no_recorded_transition_lies_below_the_envelope_of_the_package(preset):
    env: Any = make(preset, num_envs=16, time_limit=HALF_ORBIT, **({} if preset == "AEOSCity-v1" else {"n_targets": 4000}))
    found = record_transitions(env, BASELINES["hasty"](env, 0), SEED)
    assert len(found.ticks) > 100
    assert Envelope.load().smallest_margin(*found[:3]) >= 0


# -- geometry -----------------------------------------------------------------------------------------------------------------


def test_positions_are_those_of_the_simulation():
    env = make("AEOS-v1", num_envs=3, time_limit=300.0, n_targets=50)
    env.step(env.rand_action(env.reset()))
    now = env.satellite.simulator.sim_time
    found = satellite_positions(env.satellite, torch.arange(3), now)
    assert torch.allclose(found, env.satellite.dynamics.r_BN_P, atol=1e-2)  # m; the state is that of the same arcs


def test_angles_between_vectors():
    u = torch.tensor([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 0.0, 0.0]], dtype=torch.float64)
    v = torch.tensor([[0.0, 3.0, 0.0], [5.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], dtype=torch.float64)
    assert angle_between(u, v).tolist() == pytest.approx([torch.pi / 2, 0.0, torch.pi])


def test_openings_hold_every_image_that_is_taken():
    env = make("AEOS-v1", num_envs=4, time_limit=HALF_ORBIT, n_targets=2000)
    env.set_seed(SEED)
    env.reset()
    every = openings(env.satellite, env.state.limit_ticks)
    policy, state, images = BASELINES["hasty"](env, 0), env.simulator.state, env.satellite.imaged.clone()
    taken, before = 0, state.ticks.clone()
    env.set_seed(SEED)
    for playing, _ in play_episodes(env, policy, env.reset()):
        own = (env.satellite.imaged > images) & playing & (state.ticks - before > 1)
        for row in torch.nonzero(own).flatten().tolist():
            target, tick = int(env.satellite.latest_target[row]), int(state.ticks[row])
            mine = (every.row == row) & (every.target == target) & (every.first <= tick) & (every.last >= tick)
            assert int(mine.sum()) == 1
            taken += 1
        images, before = env.satellite.imaged.clone(), state.ticks.clone()
    assert taken > 50


# -- the relaxation -----------------------------------------------------------------------------------------------------------


class Tiny:
    """One satellite at rest above a few targets, whose windows and priorities are drawn."""

    def __init__(self, seed: int, targets: int = 5, cells: int = 30) -> None:
        g = torch.Generator().manual_seed(seed)
        first = torch.randint(1, cells - 12, (targets,), generator=g)
        last = first + torch.randint(2, 11, (targets,), generator=g)
        order = torch.argsort(first, stable=True)
        self.openings = Openings(torch.zeros(targets, dtype=torch.int64), order, first[order], last[order])
        side = torch.rand(targets, generator=g, dtype=torch.float64)
        self.places = torch.stack([side, torch.zeros_like(side), torch.full_like(side, -1.0)], -1)
        self.priority = torch.rand(1, targets, generator=g, dtype=torch.float64)
        self.envelope = envelope([2, 4, 4, 6, 7, 7, 8, 8, 9, 9], [2, 3, 3, 4, 4, 5, 5, 6, 6, 6])
        self.cells = cells

    def graph(self, ticks: int) -> Any:
        cells = self.cells // ticks + 2
        return image_graph(
            self.openings, torch.zeros(1, cells, 3).double(), self.places.unsqueeze(0), self.envelope, ticks, cells
        )

    def optimum(self) -> float:
        """The best schedule with direct slews alone: all orders, each image as early as can be, the satellite at rest."""
        spans = {int(t): (int(a), int(b)) for t, a, b in zip(*self.openings[1:], strict=True)}
        best = 0.0
        for count in range(1, len(spans) + 1):
            for order in itertools.permutations(spans, count):
                tick = 0
                for k, target in enumerate(order):
                    if k:
                        angle = angle_between(self.places[order[k - 1]], self.places[target])
                        tick += int(self.envelope.least(angle.unsqueeze(0), direct=True))
                    tick = max(tick, spans[target][0])
                    if tick > spans[target][1]:
                        break
                else:
                    best = max(best, float(self.priority[0, list(order)].sum()))
        return best


def test_the_relaxation_is_no_lower_than_the_best_schedule():
    failures = []
    for seed in range(12):
        tiny = Tiny(seed)
        optimum = tiny.optimum()
        for ticks, bits in itertools.product([1, 2], [0, 4]):
            paths = best_paths(tiny.graph(ticks), tiny.priority, iterations=200, bits=bits)
            upper, lower = float(paths.upper), float(paths.lower)
            if not (upper >= optimum - 1e-9 and lower <= upper + 1e-9):
                failures.append(f"seed={seed}, ticks={ticks}, bits={bits}: {lower} to {upper}, optimum {optimum}")
    assert not failures, "\n".join(failures)


@pytest.mark.parametrize("seed", range(12))
def test_with_exact_time_and_direct_slews_alone_the_bounds_enclose_the_optimum(seed):
    tiny = Tiny(seed)
    tiny.envelope = replace(tiny.envelope, any=tiny.envelope.direct)
    optimum, paths = tiny.optimum(), best_paths(tiny.graph(1), tiny.priority, iterations=400, bits=4, gap=0.0)
    assert float(paths.lower) <= optimum + 1e-9 <= float(paths.upper) + 2e-9
    assert float(paths.lower) == pytest.approx(optimum, rel=0.15)


def test_paths_remember_the_neighbours_that_are_quickest_to_return_from():
    tiny = Tiny(1)
    graph = tiny.graph(1)
    memory = neighbours(graph, 2)
    assert bool((memory >= 0).any())
    for window, kept in enumerate(memory.tolist()):
        assert window not in kept
        pairs = set(zip(graph.pair_from.tolist(), graph.pair_to.tolist(), strict=True))
        assert all(other < 0 or {(window, other), (other, window)} <= pairs for other in kept)


def test_satellites_of_an_episode_share_the_targets():
    tiny = Tiny(3)
    one = best_paths(tiny.graph(1), tiny.priority, iterations=200)
    twice = Openings(*(torch.cat([column, column]) for column in tiny.openings))
    twice = twice._replace(row=torch.arange(2).repeat_interleave(len(tiny.openings.row)))
    cells = tiny.cells + 2
    graph = image_graph(twice, torch.zeros(2, cells, 3).double(), tiny.places.expand(2, -1, -1), tiny.envelope, 1, cells)
    team = best_paths(graph, tiny.priority, satellites=2, iterations=200)
    assert float(one.upper) - 1e-6 <= float(team.upper) <= float(tiny.priority.sum()) + 1e-9


# -- bounds of tasks ----------------------------------------------------------------------------------------------------------


IMAGING = [
    ("AEOS-v1", "AEOS-v1", 3000),
    ("AEOSCity-v1", "AEOSCity-v1", None),
    ("CloudyAEOS-v1", "CloudyAEOS-v1", 3000),
    ("AEOSPower-v1", "AEOSPower-v1", 3000),
]


@pytest.mark.parametrize(("preset", "name", "n_targets"), IMAGING)
def test_no_policy_images_more_than_the_bound(preset, name, n_targets):
    options: dict[str, Any] = dict(num_envs=12, time_limit=HALF_ORBIT) | ({"n_targets": n_targets} if n_targets else {})
    env: Any = make(preset, as_set=True, **options)
    env.set_seed(SEED)
    env.reset()
    bound = imaging_bound(env, iterations=25)
    assert bool((bound.upper <= bound.in_view * (1.0 + 1e-9)).all())
    assert bool((bound.found <= bound.upper + 1e-9).all())
    plain: Any = make(preset, **options)
    for where, policy in (
        (env, pretrained(name)),
        *((plain, BASELINES[rule](plain, 0)) for rule in ("random", "nearest", "hasty")),
    ):
        assert float((bound.upper - evaluate(policy, where, seed=SEED).returns).min()) >= 0.0


def test_the_bound_does_not_disturb_the_episode():
    env = make("AEOS-v1", num_envs=2, time_limit=900.0, n_targets=500)
    policy = BASELINES["hasty"](env, 0)
    alone = evaluate(policy, env, seed=SEED).returns
    env.set_seed(SEED)
    start = env.reset()
    imaging_bound(env, iterations=2)
    for _ in play_episodes(env, policy, start):
        pass
    assert torch.equal(env.returns, alone)


def test_the_bound_of_an_episode_does_not_depend_on_the_others():
    env = make("AEOS-v1", num_envs=4, time_limit=900.0, n_targets=3000)
    env.set_seed(SEED)
    env.reset()
    both = imaging_bound(env, iterations=5)
    alone = make("AEOS-v1", num_envs=2, time_limit=900.0, n_targets=3000)
    alone.set_seed(SEED)
    alone.reset()
    assert torch.equal(imaging_bound(alone, iterations=5).upper, both.upper[:2])


def test_no_constellation_images_more_than_the_bound():
    env = make("AEOSConstellation-v1", num_envs=4, time_limit=HALF_ORBIT, n_targets=1500)
    env.set_seed(SEED)
    env.reset()
    bound = imaging_bound(env, iterations=10)
    for rule in ("random", "hasty"):
        assert float((bound.upper - evaluate(bsk_torch.rule(rule, env), env, seed=SEED).returns).min()) >= 0.0


def test_no_policy_scans_more_than_the_bound():
    env = make("NadirScan-v1", num_envs=16)
    env.set_seed(SEED)
    env.reset()
    bound = scanning_bound(env)
    for policy in (BASELINES["random"](env, 0), BASELINES["rule"](env, 0), pretrained("NadirScan-v1")):
        assert float((bound.upper - evaluate(policy, env, seed=SEED).returns).min()) >= 0.0
    assert bool((bound.upper <= 1.0 + 1e-6).all())
    assert bool((bound.recorded + bound.downlinked <= 60.0 + 1e-6).all())
    capacity = env.satellite.sat_args["dataStorageCapacity"].unsqueeze(-1)
    assert bool(((bound.level >= -1.0) & (bound.level <= capacity + 1.0)).all())


def test_schedules_are_flown_and_pay_what_they_can():
    env = make("AEOS-v1", num_envs=4, time_limit=HALF_ORBIT, n_targets=1000)
    env.set_seed(SEED)
    env.reset()
    upper, rule = imaging_bound(env, iterations=5).upper, BASELINES["nearest"](env, 0)
    for schedule in (relaxed_schedule(env, iterations=20), milp_schedule(env, seconds=5.0)):
        assert schedule.target.shape == schedule.tick.shape
        for row in schedule.target.tolist():
            kept = [target for target in row if target >= 0]
            assert len(kept) == len(set(kept))
        returns = evaluate(ScheduledPolicy(env, schedule, rule), env, seed=SEED).returns
        planned = (env.scenario.priority.double().gather(1, schedule.target.clamp(min=0)) * (schedule.target >= 0)).sum(1)
        assert float((upper - returns).min()) >= 0.0
        assert float(returns.sum()) > 0.7 * float(planned.sum())  # slews take longer than is typical now and then
        env.set_seed(SEED)
        env.reset()


def scanning(**args: Any) -> Tensor:
    env = make("NadirScan-v1", num_envs=1, time_limit=5700.0, backend="eager", sat_args=args)
    env.set_seed(SEED)
    env.reset()
    return scanning_bound(env).upper


def test_less_of_a_resource_lowers_the_bound_of_scanning():
    battery = 200 * 3600.0
    plenty = scanning(storedCharge_Init=battery, storageInit=0.0)
    assert float(plenty) == pytest.approx(0.2, abs=1e-6)  # one of the five orbits that pay 1
    full = scanning(storedCharge_Init=battery, storageInit=40e9 - 4e6 * 600.0, transmitterBaudRate=0.0)
    assert float(full) == pytest.approx(600.0 / 28_500.0, rel=1e-6)  # the room that is left, in seconds of the instrument
    poor = scanning(storedCharge_Init=0.02 * battery, storageInit=0.0, panelEfficiency=0.02)
    assert float(poor) < 0.5 * float(plenty)
