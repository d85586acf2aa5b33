"""Queries for opportunities take bsk_rl's arguments, or say what to write; filters of an opportunity hide places."""

import numpy as np
import pytest
import torch

from bsk_torch import SatelliteTasking, act, dyn, obs, per_environment, sats, scene
from tests.support.refusals import check_refusals, refusal


class Foggy(scene.UniformTargets):
    def draw(self, key):
        return super().draw(key) | {"target_fog": key.named("fog").uniform(self.most_targets)}


class Imager(sats.ImagingSatellite):
    observation_spec = (obs.OpportunityProperties(dict(fn=lambda sat, opp: opp["object"].fog, name="fog"), n_ahead_observe=2),)
    action_spec = (act.Image(2),)
    dyn_type = dyn.GroundStationDynModel


def make(satellite, **options):
    given = dict(num_envs=3, time_limit=600.0, seed=1, backend="eager", dtype=np.float64)
    return SatelliteTasking(satellite, Foggy(300), **given | options)


@pytest.fixture(scope="module")
def env():
    return make(Imager("A"))


@pytest.fixture(scope="module")
def seen(env):
    return env.reset()["observation"]


@pytest.fixture
def satellite(env, seen):
    yield env.satellite
    env.satellite.access_filters.clear()
    env.satellite.simulator.memory.touch()


def test_types_are_accepted_beside_type(satellite):
    query = satellite.find_next_opportunities
    for kind in ("target", "ground_station"):
        assert torch.equal(query(1, kind).close, query(1, types=kind).close)
        assert torch.equal(query(1, kind).close, query(n=1, types=[kind], pad=True, max_lookahead=100).close)
    assert torch.equal(satellite.upcoming_opportunities(types="target").close, satellite.upcoming_opportunities("target").close)
    assert torch.equal(satellite.opportunities(types=["target"]).place, satellite.opportunities("target").place)
    assert torch.equal(satellite.next_opportunities(types="target")[1], satellite.next_opportunities("target")[1])


def test_rejects_what_tensors_cannot_answer(satellite):
    s = satellite

    def find(*given, **options):
        return s.find_next_opportunities(*(given or (3,)), **options)

    def filtered(function, **options):
        s.access_filters.clear()
        s.add_access_filter(function, **options)
        return find(2)

    both, one, names = ["target", "ground_station"], "one environment", ("access filter", "per_environment(function)")
    check_refusals(
        refusal(lambda: find(types=both), ValueError, "types", both, "satellite.one(row).find_next_opportunities()"),
        refusal(lambda: find(3, True), ValueError, "type", True, "pad="),
        refusal(lambda: find(types="targets"), ValueError, "type", "'targets'", "'target'"),
        refusal(lambda: find(3, "target", types="ground_station"), ValueError, "type='target'", "types='ground_station'"),
        refusal(lambda: find(0), ValueError, "n=0", "1"),
        refusal(lambda: find(max_lookahead=101), ValueError, "max_lookahead", 101, "1 to 100"),
        refusal(lambda: find(500, pad=False, max_lookahead=1), RuntimeError, "500", "environment 0", "pad=False"),
        refusal(lambda: find(filter=["tgt-3"]), TypeError, "filter", ["tgt-3"], "indices of places"),
        refusal(lambda: s.next_opportunities_dict(types="target"), TypeError, "satellite.one(env).next_opportunities_dict("),
        refusal(lambda: s.upcoming_opportunities_dict(types="target"), TypeError, "upcoming_opportunities_dict()", one),
        refusal(lambda: s.opportunities_dict(types="target"), TypeError, "opportunities_dict()", one),
        refusal(lambda: s.add_access_filter([3]), TypeError, "access filter", [3], "function"),
        refusal(lambda: s.add_access_filter(lambda a, b: True), TypeError, "access filter", "(a, b)", "opportunity"),
        refusal(lambda: find()["target"], KeyError, "opportunities", "'target'"),
        refusal(lambda: find()["object"].worth, AttributeError, "targets", "'worth'"),
        refusal(lambda: find()["object"] in [1], TypeError, "targets of all satellites", "opportunity['object'].id"),
        refusal(lambda: filtered(lambda opp: bool(opp["object"].priority > 0.5), types=["target"]), TypeError, *names),
        refusal(lambda: filtered(lambda opp: opp["window"][0] > 5.0), TypeError, "access filter", "opportunity['window']"),
    )


def test_opportunities_have_items_of_all_satellites(satellite):
    found = satellite.find_next_opportunities(3)
    assert found["window"][0] is found.open
    assert found["type"] == "target"
    assert torch.equal(found["object"].priority, satellite.scenario.priority.gather(1, found.place))
    assert torch.equal(found["object"].r_LP_P, found["r_LP_P"])
    assert found["object"].name.tolist()[1][0] == f"tgt-{found.place[1, 0]}"
    stations = satellite.find_next_opportunities(1, "ground_station")["object"]
    assert stations.shape == (3, 1)
    assert stations[0, 0] in satellite.simulator.world.stations


def test_targets_have_what_the_scenario_draws(satellite, seen):
    place = satellite.find_next_opportunities(2).place
    assert torch.equal(seen, satellite.scenario.drawn("target_fog").gather(1, place))
    assert satellite.one(1).find_next_opportunities(2, types="target")[1]["object"].fog == seen[1, 1]


def test_filters_of_an_opportunity_are_called_once_where_they_can(satellite, caplog):
    calls = []

    def worthy(opp):
        calls.append(opp)
        return opp["object"].priority > 0.5

    satellite.add_access_filter(worthy, types="target")
    assert bool((satellite.find_next_opportunities(2)["object"].priority > 0.5).all())
    assert satellite.find_next_opportunities(2) is satellite.find_next_opportunities(2)
    assert len(calls) == 1 + 300  # all at once, and the first time for the targets of one environment to compare
    satellite.simulator.memory.touch()
    satellite.find_next_opportunities(2)
    assert len(calls) == 2 + 300
    assert "one environment after the other" not in caplog.text


@pytest.mark.parametrize(
    ("access_filter", "slow"),
    [
        (lambda opp: opp["type"] != "target" or opp["object"].priority > 0.5, False),
        (per_environment(lambda opp: opp["type"] != "target" or bool(opp["object"].priority > 0.5)), True),
        (per_environment(lambda o: o["object"] in [3] or o["type"] != "target" or float(o["object"].priority) > 0.5), True),
    ],
)
def test_filters_may_tell_types_apart(satellite, access_filter, slow, caplog):
    satellite.add_access_filter(access_filter)
    assert bool((satellite.find_next_opportunities(2)["object"].priority > 0.5).all())
    assert satellite.allowed("ground_station").all()
    assert ("the access filter <function <lambda>" in caplog.text) == slow


def test_filters_of_ids_hide_targets(satellite):
    hidden = satellite.find_next_opportunities(1).place[:, 0].tolist()
    satellite.add_access_filter(per_environment(lambda opp: opp["object"].id not in hidden), types=["target"])
    assert not torch.isin(satellite.find_next_opportunities(3).place, torch.tensor(hidden)).any()
    shown = satellite.find_next_opportunities(3, filter=lambda opp: opp["object"].priority > -1.0)  # in place of the others
    assert shown.place[:, 0].tolist() == hidden
    assert not torch.isin(satellite.find_next_opportunities(3, filter=hidden).place, torch.tensor(hidden)).any()
    opportunity = satellite.find_next_opportunities(3)
    assert satellite.default_access_filter(opportunity).all()
    assert not satellite.default_access_filter(shown)[:, 0].any()


def test_filters_are_added_before_or_after_an_environment_is_built():
    satellite = Imager("A")
    satellite.add_access_filter(lambda opp: opp["object"].priority > 0.5, types="target")
    env = make(satellite, num_envs=2)
    env.reset()
    assert bool((env.satellite.find_next_opportunities(2)["object"].priority > 0.5).all())
    env.satellite.add_access_filter(lambda: env.scenario.priority < 0.9)
    found = env.satellite.find_next_opportunities(2)["object"].priority
    assert bool(((found > 0.5) & (found < 0.9)).all())
    assert len(satellite.access_filters) == 1
