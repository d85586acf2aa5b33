"""A satellite of one environment is what bsk_rl's functions expect: arrays, numbers, lists and dictionaries."""

from operator import attrgetter

import numpy as np
import pytest
import torch

from bsk_torch import ConstellationTasking, SatelliteTasking, act, dyn, obs, sats, scene
from tests.support.refusals import check_refusals, refusal


class SpeedyDynModel(dyn.GroundStationDynModel):
    drag = 2.0

    @property
    def speed(self):
        return np.linalg.norm(self.v_BN_N)

    @property
    def speed_of_all(self):
        return self.v_BN_N.norm(dim=-1)

    def faster(self, by):
        return self.speed + by


class Imager(sats.ImagingSatellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Image(2),)
    dyn_type = SpeedyDynModel

    def momentum(self):
        return np.cross(self.dynamics.r_BN_N, self.dynamics.v_BN_N)


OPTIONS = dict(num_envs=3, time_limit=1200.0, seed=1, backend="eager")


@pytest.fixture(scope="module")
def env():
    env = SatelliteTasking(Imager("A"), scene.UniformTargets(300), **OPTIONS)
    env.reset()
    return env


@pytest.fixture(scope="module")
def one(env):
    return env.satellite.one(2)


@pytest.mark.parametrize(
    "name",
    [
        "dynamics.r_BN_N",
        "dynamics.BN",
        "dynamics.speed_of_all",
        "dynamics.world.PN",
        "fsw.c_hat_P",
        "simulator.sim_time",
        "simulator.world.omega_PN_N",
        "scenario.priority",
        "imaged",
        "time_limit",
    ],
)
def test_quantities_of_all_are_read_at_the_row(env, one, name):
    found, whole = (attrgetter(name)(satellite) for satellite in (one, env.satellite))
    assert isinstance(found, np.ndarray) == (whole.ndim > 1)
    assert np.array_equal(found, whole[2].numpy())


def test_what_bsk_rl_has_in_other_places_is_there(env, one):
    assert one.simulator.time_limit == 1200.0
    assert isinstance(one.simulator.sim_time, float)
    assert (one.simulator.sim_time_ns, one.simulator.sim_rate) == (0, 1.0)
    assert np.array_equal(one.sat_args["wheelSpeeds"], env.satellite.sat_args["wheelSpeeds"][2].numpy())
    assert np.array_equal(one.fsw.dynamics.satellite.dynamics.r_BN_N, one.dynamics.r_BN_N)
    assert one.is_alive() is True
    assert one.dynamics.altitude_valid() is True
    assert one.next_eclipse() == tuple(time[2].item() for time in env.satellite.next_eclipse())
    assert one.simulator.memory["imaged"] == 0
    assert one.latest_target is None


def test_what_a_user_has_added_runs_for_one_of_any_name(env, one):
    speed = float(env.satellite.dynamics.v_BN_N[2].norm())
    assert one.dynamics.speed == pytest.approx(speed, rel=1e-15)
    assert (one.dynamics.faster(1.0), one.dynamics.drag) == (pytest.approx(speed + 1.0), 2.0)
    assert one.momentum().shape == (3,)
    env = ConstellationTasking([Imager("A"), Imager("B")], scene.UniformTargets(300), **OPTIONS | dict(num_envs=2))
    env.reset()
    (satellite,) = env.satellites
    assert [(satellite.one(row).name, satellite.one(row).env) for row in range(4)] == [("A", 0), ("B", 0), ("A", 1), ("B", 1)]
    assert np.array_equal(satellite.one(3).scenario.priority, env.scenario.priority[1].numpy())


def test_views_are_read_only_and_their_arrays_copies(env, one):
    check_refusals(
        refusal(lambda: setattr(one, "fuel", 1.0), AttributeError, "'fuel'", "satellite.simulator.memory"),
        refusal(lambda: one.add_access_filter(lambda opportunity: True), AttributeError, "environment"),
    )
    before = env.satellite.dynamics.r_BN_N.clone()
    position = one.dynamics.r_BN_N
    position /= 2.0
    assert torch.equal(env.satellite.dynamics.r_BN_N, before)


def test_rejects_wrong_names(env, one):
    check_refusals(
        refusal(lambda: one.dynamics.r_BN_Q, AttributeError, "SpeedyDynModel", "'r_BN_Q'", "'r_BN_N'"),
        refusal(lambda: one.sat_args["wheelSpeed"], KeyError, "sat_args", "'wheelSpeed'", "'wheelSpeeds'"),
        refusal(lambda: env.satellite.one(3), IndexError, "row=3", "0 to 2"),
    )


def test_opportunities_are_those_of_the_tensors(env, one):
    whole = env.satellite.find_next_opportunities(4, types="target")
    for k, found in enumerate(one.find_next_opportunities(4, types="target")):
        assert found["window"] == (whole.open[2, k].item(), whole.close[2, k].item())
        assert (found["type"], found["object"].priority) == ("target", whole["object"].priority[2, k].item())
        assert found["object"].id == whole["object"].id[2, k]
        assert found["object"].name == whole["object"].name[2, k]
        assert np.array_equal(found["object"].r_LP_P, found["r_LP_P"])
        assert np.array_equal(found["r_LP_P"], whole["r_LP_P"][2, k].numpy())
    assert env.satellite.one(1).find_next_opportunities(4, types="target")[0]["object"] != found["object"]


def test_opportunities_of_several_types_are_sorted_together(one):
    found = one.find_next_opportunities(4)
    closing = [opportunity["window"][1] for opportunity in found]
    assert closing == sorted(closing)
    assert closing == [opportunity["window"][1] for opportunity in one.upcoming_opportunities[:4]]
    both = one.find_next_opportunities(4, types=["target", "ground_station"])
    assert closing == [opportunity["window"][1] for opportunity in both]
    assert one.find_next_opportunities(1, types=["ground_station"])[0]["object"] in one.simulator.world.stations
    assert one.find_next_opportunities(0) == []


def test_queries_take_filters_of_an_opportunity_or_lists_of_objects(one):
    first, second = one.find_next_opportunities(2, types="target")
    late = one.find_next_opportunities(1, types="target", filter=lambda opp: opp["window"][0] > first["window"][0])
    assert late[0]["window"][0] > first["window"][0]
    assert one.find_next_opportunities(1, types="target", filter=[first["object"]])[0]["object"] == second["object"]


def test_short_lists_are_padded_or_refused(one):
    few = {opportunity["object"].id for opportunity in one.find_next_opportunities(2, types="target")}
    only = {"types": "target", "filter": lambda opp: opp["object"].id in few, "max_lookahead": 2}
    found = one.find_next_opportunities(500, **only)
    assert len(found) == 500
    assert found[-1] is found[-2]
    check_refusals(
        refusal(lambda: one.find_next_opportunities(500, pad=False, **only), RuntimeError, "500", "2"),
        refusal(lambda: one.find_next_opportunities(1, max_lookahead=2, filter=lambda opp: False), RuntimeError, "0 of 1"),
    )


def test_dictionaries_map_objects_to_windows(one):
    upcoming = one.upcoming_opportunities_dict(types="target")
    for target, windows in upcoming.items():
        assert one.next_opportunities_dict(types="target")[target] == windows[0]
        assert target in one.known_targets
    assert list(one.next_opportunities_dict(types="target", min_needed=3)) == list(upcoming)[:3]
    assert one.opportunities_dict(types=["target"], filter=lambda opp: opp["object"].priority > 0.9).keys() < upcoming.keys()
    assert {opp["type"] for opp in one.upcoming_opportunities} <= {"target", "ground_station"}
    check_refusals(refusal(lambda: one.opportunities_dict(types="targt"), ValueError, "'targt'", "'target'"))
