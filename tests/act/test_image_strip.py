"""Strips on the ground: Basilisk's stripLocation, and what actions record of them."""

import numpy as np
import pytest
import torch

from bsk_torch import SatelliteTasking, act, data, dyn, fsw, obs, rand, sats, scene
from tests.basilisk.replay import RECORDINGS

ARGS = dict(
    imageAttErrorRequirement=0.01,
    imageRateErrorRequirement=0.01,
    instrumentBaudRate=1e6,
    dataStorageCapacity=1e12,
    storageInit=0.0,
    u_max=0.4,
    oe=rand.random_orbit(a=7171.0, i=45.0),
    imageTargetMinimumElevation=0.5,
)


class StripImager(sats.ImagingSatellite):
    observation_spec = (obs.Time(), obs.OpportunityProperties(dict(prop="priority"), n_ahead_observe=4))
    action_spec = (act.ImageStrip(4), act.Charge(duration=60.0))
    dyn_type = dyn.StripImagingDynModel
    fsw_type = fsw.StripImagingFSWModel


class HybridStripImager(StripImager):
    action_spec = (act.HybridImageStrip(4, max_duration=200.0),)


def make(kind=StripImager, **options):
    fixed = dict(
        scenario=scene.StripTargets(scene.UniformTargets(300), length=rand.Uniform(50e3, 150e3)),
        rewarder=data.StripImageReward(),
        num_envs=4,
        seed=0,
        sim_rate=0.5,
        time_limit=6000.0,
        dtype=torch.float64,
    )
    return SatelliteTasking(kind("A", ARGS), **(fixed | options))


def test_places_are_those_of_basilisk():
    """Of five strips, in every tick, to 1e-15 of the radius for each of 300 additions; access begins in the same tick."""
    with np.load(RECORDINGS / "strips.npz") as file:
        start, end, speed, before, place, access = (
            torch.tensor(file[k]) for k in ("start", "end", "speed", "before", "place", "access")
        )
    n, radius = len(start), start.norm(dim=-1)
    env = make(num_envs=n, backend="eager")
    env.reset()
    simulator, everywhere = env.simulator, torch.ones(n, dtype=torch.bool)
    middle = start + end
    middle = middle / middle.norm(dim=-1, keepdim=True) * radius.unsqueeze(-1)
    along = end - start
    along = along / along.norm(dim=-1, keepdim=True) * radius.unsqueeze(-1)
    half = torch.asin((0.5 * (end - start).norm(dim=-1) / radius).clamp(max=1.0))
    rate = speed / radius
    simulator.command(everywhere, torch.full((n,), simulator.mode_names.index("image_strip")))
    strip = dict(middle=middle, along=along, half=half, rate=rate, angle=-half - rate * before)
    for name, value in strip.items():
        simulator.write(f"strip_{name}", everywhere, value)
    for k in range(60):
        begun = simulator.read("strip_angle") >= -half - 1e-12
        assert torch.equal(begun, access[:, k])
        simulator.run(torch.ones(n, dtype=torch.int64))
        torch.testing.assert_close(simulator.read("r_LP_P"), place[:, k], rtol=0.0, atol=1e-6)


@pytest.mark.compiled
def test_a_recorded_strip_pays_once():
    env = make()
    td, paid = env.reset(), torch.zeros(4)
    worth, done = env.scenario.priority, torch.zeros(4, 300, dtype=torch.bool)
    for _ in range(14):
        level = env.satellite.dynamics.storage_level.clone()
        td = env.step(td.set("action", torch.zeros(4, dtype=torch.int64)))["next"]
        target = env.satellite.latest_target.clamp(min=0).unsqueeze(1)
        needed = torch.floor(0.9 * env.scenario.strip_seconds.gather(1, target) / 0.5) * 0.5
        recorded = (env.satellite.dynamics.storage_level - level).unsqueeze(1) / 1e6
        complete = (recorded >= needed) & ~done.gather(1, target)
        assert torch.equal(td["reward"], torch.where(complete, worth.gather(1, target), 0.0))
        done = done.scatter(1, target, done.gather(1, target) | complete)
        paid = paid + td["reward"].squeeze(1)
        # recording ends with the strip: at most its time, with both ends
        assert bool((recorded <= env.scenario.strip_seconds.gather(1, target) + 1.0).all())
        assert torch.equal(env.satellite.allowed("target"), ~done)
    assert bool((paid > 0.0).any())


@pytest.mark.compiled
def test_a_strip_is_centered_in_its_window_or_starts_after_the_turn():
    env = make(time_limit=3000.0)
    td = env.reset()
    ahead = env.satellite.find_next_opportunities(4)
    now = env.simulator.sim_time
    opens, closes = env.satellite.window_of(ahead.place[:, 0])
    seconds = env.scenario.strip_seconds.gather(1, ahead.place[:, :1]).squeeze(1)
    before = torch.maximum(0.5 * (opens + closes - seconds) - now, torch.full_like(now, 60.0))
    td = env.step(td.set("action", torch.zeros(4, dtype=torch.int64)))["next"]
    wanted = torch.ceil((before + seconds) / 0.5) * 0.5
    assert float((td["duration"].squeeze(1) - wanted).abs().max()) <= 0.5
    # the place has reached the end of the strip, to two ticks
    late = env.simulator.read("strip_angle") - env.simulator.read("strip_half")
    assert float((late / env.simulator.read("strip_rate")).abs().max()) <= 1.0


@pytest.mark.compiled
def test_hybrid_actions_choose_the_time_before_a_strip():
    env = make(HybridStripImager)
    td = env.reset()
    place = env.satellite.find_next_opportunities(4).place
    td["action", "values"] = torch.tensor([[0.0], [0.25], [0.5], [2.0]], dtype=torch.float64)
    td["action", "choice"] = torch.tensor([0, 1, 2, 3])
    td = env.step(td)["next"]
    chosen = place.gather(1, torch.arange(4).unsqueeze(1)).squeeze(1)
    assert torch.equal(env.satellite.latest_target, chosen)
    seconds = env.scenario.strip_seconds.gather(1, chosen.unsqueeze(1)).squeeze(1)
    wanted = torch.tensor([0.0, 50.0, 100.0, 200.0], dtype=torch.float64) + seconds
    assert float((td["duration"].squeeze(1) - wanted).abs().max()) <= 0.5


@pytest.mark.compiled
def test_strips_do_not_depend_on_the_batch():
    flown = []
    for n in (2, 5):
        env = make(num_envs=n)
        td = env.reset()
        for _ in range(3):
            td = env.step(td.set("action", torch.ones(n, dtype=torch.int64)))["next"]
        flown.append([env.simulator.read(name)[:2] for name in ("r_LP_P", "strip_angle", "sigma_BN", "storage")])
    assert all(torch.equal(a, b) for a, b in zip(*flown, strict=True))


def test_ends_lie_half_a_strip_from_the_middle():
    env = make(backend="eager", scenario=scene.StripTargets(scene.UniformTargets(50), length=2e5))
    env.reset()
    start, end = env.scenario.ends()
    radius = env.scenario.r_LP_P.norm(dim=-1)
    chord = 2.0 * radius * torch.sin(0.5 * 2e5 / radius)
    torch.testing.assert_close((end - start).norm(dim=-1), chord, rtol=1e-12, atol=0.0)
    torch.testing.assert_close(start.norm(dim=-1), radius, rtol=1e-14, atol=0.0)
    assert float((env.scenario.strip_along * env.scenario.r_LP_P).sum(-1).abs().max()) < 1e-1  # of 4e13 m^2
