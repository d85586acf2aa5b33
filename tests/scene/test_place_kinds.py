"""Kinds of places that a scenario or a component declares are types of opportunities like the package's."""

import math
from typing import ClassVar

import pytest
import torch

from bsk_torch import SatelliteTasking, act, data, dyn, obs, sats, scene
from bsk_torch.astro.mean_orbit import mean_elements
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.component import Component
from bsk_torch.sim.places import AboveElevation, ClearOfEarth, FixedPlaces, GreatCirclePlaces, Lit, OrbitingPlaces, WithinRange
from tests.support.refusals import check_refusals, refusal

PLACES = 30


class Traffic(scene.Scenario):
    """Buoys, ships at the same points, and debris; every other ship is missing."""

    def draw(self, key):
        point = key.named("start").uniform(3 * PLACES).view(-1, PLACES, 3) - 0.5
        start = R_EARTH * point / point.norm(dim=-1, keepdim=True)
        a, i, node, f = key.named("debris").uniform(4 * PLACES).view(-1, 4, PLACES).unbind(1)
        zero = torch.zeros_like(a)
        r, v = elements_to_rv(Elements(6.9e6 + 4e5 * a, zero, math.pi * i, 6.28 * node, zero, 6.28 * f))
        exists = (torch.arange(PLACES) % 2 == 0).double().expand(len(key), -1)
        course = 400.0 * (key.named("course").uniform(3 * PLACES).view(-1, PLACES, 3) - 0.5)
        drawn = {"start": start, "course": course, "exists": exists, "debris": mean_elements(r.stack(), v.stack())}
        return drawn | {"rest": torch.zeros_like(course)}

    def place_kinds(self, tables):
        drawn, limit, count = tables.drawn, 0.3, tables.arguments.count
        above = [AboveElevation(limit)]
        return {
            "buoy": FixedPlaces(lambda: drawn["start"], limit, satellites=count, names=[f"B{k}" for k in range(PLACES)]),
            "moored": GreatCirclePlaces(tables, "start", "rest", above),
            "ship": GreatCirclePlaces(tables, "start", "course", above, exists="exists"),
            "debris": OrbitingPlaces(tables, "debris", [WithinRange(2e6), ClearOfEarth(5e4), Lit()]),
            "never": OrbitingPlaces(tables, "debris", [WithinRange(1.0)], advice="give debris a larger range"),
        }


class Watcher(sats.AccessSatellite):
    observation_spec: ClassVar = [
        obs.OpportunityProperties({"prop": "opportunity_open"}, {"prop": "r_LP_P"}, type=kind, n_ahead_observe=2)
        for kind in ("buoy", "ship", "debris")
    ]
    action_spec: ClassVar = [act.NadirPoint(duration=120.0)]
    dyn_type = dyn.GroundStationDynModel


def make(num_envs=3, satellite=Watcher, scenario=Traffic, **options):
    options = {"time_limit": 1800.0, "seed": 5, "backend": "eager"} | options
    return SatelliteTasking(satellite("Watcher1"), scenario=scenario(), rewarder=data.NoReward(), num_envs=num_envs, **options)


@pytest.fixture(scope="module")
def env():
    made = make()
    made.reset()
    return made


def test_kinds_are_types_of_opportunities(env):
    assert env.satellite.opportunity_types == ("ground_station", "buoy", "moored", "ship", "debris", "never")
    buoys, ships = (env.satellite.find_windows(5400.0, kind) for kind in ("buoy", "moored"))
    assert torch.isfinite(buoys.close).sum() > 10
    assert torch.equal(buoys.place, ships.place)
    for one, other in zip(buoys[:2], ships[:2], strict=True):
        assert torch.allclose(one, other, rtol=0, atol=1e-6)
    ships = env.satellite.find_windows(5400.0, "ship")
    there = torch.isfinite(ships.close)
    assert there.any()
    assert (ships.place[there] % 2 == 0).all()


def test_the_position_of_an_opportunity_is_where_the_place_is_now(env):
    env.rollout(2, auto_reset=False, tensordict=env.reset())
    ahead, time = env.satellite.find_next_opportunities(3, types="ship"), env.satellite.simulator.sim_time
    assert torch.allclose(time, torch.full_like(time, 240.0))
    moved = (ahead["r_LP_P"] - env.satellite.look_up(env.scenario.drawn("start"), ahead.place)).norm(dim=-1)
    assert (moved > 10.0).all()
    assert (moved < 350.0 * 240.0).all()


def test_debris_is_in_range_in_the_middle_of_its_windows(env):
    env.reset()
    ahead = env.satellite.find_next_opportunities(2, types="debris")
    assert (ahead.close > ahead.open).all()
    in_progress = ahead.open <= 0.0
    away = (ahead.r_LP_P - env.satellite.dynamics.r_BN_P.unsqueeze(1)).norm(dim=-1)
    assert (away[in_progress] < 2e6).all()
    assert (away > 0.0).all()


def test_objects_of_other_kinds_are_names(env):
    env.reset()
    found = env.satellite.find_next_opportunities(2, types="buoy")
    assert (found["object"] == [[f"B{k}" for k in row] for row in found.place.tolist()]).all()
    assert env.satellite.find_next_opportunities(1, types="debris")["object"][1, 0].startswith("debris-")


def test_episodes_do_not_depend_on_the_batch_and_have_bsk_rls_windows():
    wide, narrow = make().reset()["observation"], make(num_envs=1).reset()["observation"]
    assert torch.equal(wide[:1], narrow)
    made = make(compat="bsk_rl")
    made.reset()
    assert torch.isfinite(made.satellite.find_next_opportunities(2, types="debris").close).all()


def test_states_are_restored_with_their_windows(env):
    env.reset()
    before = env.get_state()
    seen = env.satellite.find_next_opportunities(3, types="debris")
    env.rollout(3, auto_reset=False, tensordict=env.reset())
    env.restore(before, torch.arange(3), torch.arange(3))
    again = env.satellite.find_next_opportunities(3, types="debris")
    assert torch.equal(seen.open, again.open)
    assert torch.equal(seen.r_LP_P, again.r_LP_P)


def test_components_bring_places_too():
    def lighthouses(tables):
        return {"lighthouse": FixedPlaces(torch.eye(3, dtype=torch.float64).unsqueeze(0) * R_EARTH, 0.1, names="XYZ")}

    class Model(dyn.BasicDynamicsModel):
        components = (Component(slot="lighthouses", update=lambda bus: None, places=lighthouses, before="hub"),)

    class Keeper(sats.AccessSatellite):
        dyn_type = Model
        observation_spec: ClassVar = [
            obs.OpportunityProperties({"prop": "opportunity_close"}, type="lighthouse", n_ahead_observe=1)
        ]
        action_spec: ClassVar = [act.NadirPoint(duration=120.0)]

    made = make(satellite=Keeper, scenario=scene.Scenario)
    made.reset()
    assert made.satellite.opportunity_types == ("lighthouse",)
    assert made.satellite.find_next_opportunities(1, types="lighthouse")["object"][0, 0] in "XYZ"


def test_rejects_wrong_kinds(env):
    class Tracking(Watcher):
        observation_spec: ClassVar = [obs.OpportunityProperties({"prop": "target_angle_rate"}, type="ship", n_ahead_observe=1)]

    def kinds(**given):
        return make(
            scenario=type("Wrong", (Traffic,), {"place_kinds": lambda self, tables: {k: f(tables) for k, f in given.items()}})
        )

    def debris(*clearances):
        return lambda tables: OrbitingPlaces(tables, "debris", clearances)

    env.reset()
    check_refusals(
        refusal(lambda: kinds(ship=lambda tables: [1.0]), TypeError, "'ship'", [1.0], "sim.places.Places"),
        refusal(lambda: kinds(ground_station=debris(Lit())), ValueError, "'ground_station'", "name"),
        refusal(lambda: kinds(debris=debris()), ValueError, "'debris'", "clearances"),
        refusal(lambda: make(satellite=Tracking), ValueError, "target_angle_rate", "'ship'"),
        # with the advice that belongs to the kind
        refusal(lambda: env.satellite.find_next_opportunities(1, types="never"), RuntimeError, "never", "a larger range"),
    )
