"""Transfers from waypoint to waypoint: what they reach, what is legal, and the shield between satellites."""

import pytest
import torch
from tensordict import TensorDict

from bsk_torch import ConstellationTasking, act, formations, obs, rand, sats
from bsk_torch.act.waypoint import HillWaypoint
from bsk_torch.sim import dyn, fsw

MODELS = dyn.DynamicsModel, (fsw.MagicOrbitalManeuverFSWModel, fsw.FSWModel)
ECCENTRIC = [7.2e6, 0.04, 0.9, 0.4, 1.0, 2.0]
"""Elements of the chief: perigee at 6,912 km."""

STARTS = rand.Uniform([-150.0] * 3 + [-0.1] * 3, [150.0] * 3 + [0.1] * 3)
SIX = [[60.0, 0, 0], [-60.0, 0, 0], [0, 60.0, 0], [0, -60.0, 0], [0, 0, 60.0], [0, 0, -60.0]]


def kind(name, *entries, fsw_type=MODELS[1]):
    spec = (obs.Time(norm=1.0),)
    attributes = {"action_spec": entries, "observation_spec": spec, "dyn_type": MODELS[0], "fsw_type": fsw_type}
    return type(name, (sats.Satellite,), attributes)


def make(entry, names=("D1",), starts=STARTS, num_envs=4, beside=(), chief="C", dv=100.0, **options):
    """A chief on an eccentric orbit, and deputies that fly from waypoint to waypoint."""
    leader, deputy = kind("Chief", act.Drift(duration=1e9)), kind("Deputy", *beside, entry)
    satellites = [leader("C"), *(deputy(name, sat_args=dict(dv_available_init=dv)) for name in names)]
    each = starts if isinstance(starts, dict) else dict.fromkeys(names, starts)
    defaults = dict(
        sat_arg_randomizer=formations.relative_to_chief("C", ECCENTRIC, each),
        sim_rate=20.0,
        time_limit=1e5,
        seed=1,
        backend="eager",
        dtype=torch.float64,
        orbit="integrated",
    )
    env = ConstellationTasking(satellites, num_envs=num_envs, **(defaults | options))
    td = env.reset()
    return env, entry_of(env), td


def entry_of(env):
    return next(g for g in env.satellites if "D1" in g.names).actions.entries[-1]


def shielded(entry, chosen, decides):
    """The transfers that are flown."""
    return entry.shielded(chosen, decides)[0]


def fly(env, td, action):
    """Take the actions [N, count] of deputies; the outputs of the step."""
    td["chief", "action"] = torch.zeros(env.num_envs, 1, dtype=torch.int64)
    td["deputy", "action"] = action
    return env.step(td)["next"]


def decided(env, action):
    """The decision of the deputies' actions [N, count], without flying."""
    entry, flat = entry_of(env), action.flatten()
    return entry.decide(flat, torch.ones_like(flat, dtype=torch.bool), flat, torch.full_like(flat, -1))


class TestFlight:
    @pytest.mark.parametrize(("duration", "choices"), [(600.0, ([0, 1, 2, 3], [4, 5, 0, 1])), (2000.0, ([0, 1, 2, 4],))])
    @pytest.mark.nightly("2000.0")
    def test_legal_transfers_arrive(self, duration, choices):
        """What is not predicted, the Earth's flattening first, moves them by up to a part in a hundred of the way."""
        env, entry, td = make(HillWaypoint("C", SIX, [duration]))
        assert len(choices) > 0
        for choice in choices:
            assert bool(td["deputy", "action_mask"][..., :6].all())
            td = fly(env, td, torch.tensor(choice).unsqueeze(1))
            rho, _ = entry.relative_state()
            assert float(td["chief", "duration"][0]) == duration
            missed = torch.linalg.vector_norm(rho - entry.waypoints[choice], dim=-1)
            assert bool((missed < 3.0).all()), missed

    def test_distances_are_kept_on_the_way(self):
        """On legal transfers, at every tick; 2 m less are what paths bend between moments, and what is not predicted."""
        entry = HillWaypoint("C", 12, [400.0], keep_out=40.0, keep_in=250.0, keep_apart=30.0)
        env, entry, td = make(entry, ("D1", "D2"), num_envs=8, max_step_duration=20.0)
        legal = td["deputy", "action_mask"][..., :12]
        assert bool((~legal).any())
        kept = (legal.sum(-1) > 1).all(-1)  # else the only one may be that which keeps the distances best
        assert int(kept.sum()) > 2
        satellites = [env.fleet.satellite(name).dynamics for name in ("C", "D1", "D2")]
        action, places = legal.long().argmax(-1), []
        for _ in range(20):
            td = fly(env, td, action)
            action = torch.full_like(action, 12)  # go on
            places.append(torch.stack([each.r_BN_N for each in satellites], 1)[kept])
        assert not bool(td["deputy", "action_mask"][kept][..., 12].any())  # arrived
        place = torch.stack(places)
        apart = torch.linalg.vector_norm(place.unsqueeze(2) - place.unsqueeze(3), dim=-1).flatten(0, 1)
        assert bool((apart[:, 0, 1:] > 38.0).all())
        assert bool((apart[:, 0, 1:] < 252.0).all())
        assert bool((apart[:, 1, 2] > 28.0).all())


class TestLegality:
    def legal(self, start, **limits):
        _, entry, td = make(HillWaypoint("C", SIX, [600.0], **limits), starts=start, num_envs=1)
        mask = td["deputy", "action_mask"][0, 0, :6]
        assert torch.equal(mask, entry.mask()[0])
        return mask.tolist()

    def test_through_the_chief_is_not(self):
        """Motion along the normal is apart from that in the plane, so the way to the other side is straight."""
        start = [0.0, 0.0, 60.0, 0.0, 0.0, 0.0]
        assert self.legal(start) == [True] * 6
        assert self.legal(start, keep_out=15.0) == [True, True, True, True, True, False]

    def test_beyond_the_bound_is_not(self):
        assert self.legal([0.0, 100.0, 0.0, 0.0, 0.0, 0.0], keep_in=105.0)[3]
        assert sum(self.legal([0.0, 100.0, 0.0, 0.0, 0.2, 0.0], keep_in=95.0)) == 1

    def test_more_than_is_allowed_or_left_is_not(self):
        for limit, left in ((0.2, 100.0), (1.0, 0.2 + 1e-6)):
            _, entry, _ = make(HillWaypoint("C", SIX, [600.0], max_dv=limit), num_envs=16, dv=left)
            allowed = entry.ahead().cost.flatten(1) <= 0.2
            some = allowed.any(1)
            assert bool(some.any())
            assert torch.equal(entry.mask()[some], allowed[some])
            assert bool((entry.mask()[~some].sum(1) == 1).all())

    def test_near_one_that_drifts_on_is_not(self):
        starts = {"D1": [0.0, 100.0, 0.0, 0, 0, 0], "D2": [0.0, -60.0, 5.0, 0, 0, 0]}
        _, free, _ = make(HillWaypoint("C", SIX, [600.0]), ("D1", "D2"), starts, num_envs=1)
        _, apart, _ = make(HillWaypoint("C", SIX, [600.0], keep_apart=25.0), ("D1", "D2"), starts, num_envs=1)
        assert bool(free.mask()[0].all())
        assert apart.mask()[0].tolist() == [True, True, True, False, True, True]

    def test_one_is_legal_where_none_keeps_the_distances(self):
        """It takes a deputy that escapes back by several manoeuvres, none of which is more than allowed."""
        start = [500.0, 0.0, 0.0, 0.9, 0.0, 0.0]
        env, entry, td = make(HillWaypoint("C", 32, max_dv=1.0, keep_in=900.0), starts=start, num_envs=1)
        left, farthest = [], []
        for _ in range(6):
            mask = td["deputy", "action_mask"][0, 0, :96]
            alone = int(mask.sum()) == 1
            if not alone:
                break
            action = mask.long().argmax().view(1, 1)
            dv = torch.linalg.vector_norm(decided(env, action).command)
            assert float(dv) == pytest.approx(1.0)
            td = fly(env, td, action)
            assert float(td["chief", "duration"]) == 600.0
            left.append(float(entry.most_dv))
            farthest.append(float(torch.linalg.vector_norm(entry.relative_state()[0])))
        assert left, "none was needed"
        assert not alone
        assert max(farthest) < 900.0

    def test_an_empty_tank_does_nothing(self):
        env, entry, _ = make(HillWaypoint("C", SIX, [600.0]), num_envs=2)
        entry.satellite.simulator.write("dv_available", torch.ones(2, dtype=torch.bool), torch.zeros(2, dtype=torch.float64))
        assert entry.mask().sum(1).tolist() == [1, 1]
        assert bool((decided(env, torch.zeros(2, 1, dtype=torch.int64)).command == 0.0).all())


class TestShield:
    def make(self, keep_apart, names=("D1", "D2", "D3")):
        entry = HillWaypoint("C", SIX, [600.0, 900.0], keep_apart=keep_apart)
        starts = {"D1": [0.0, 100.0, 0.0, 0, 0, 0], "D2": [0.0, -100.0, 0.0, 0, 0, 0], "D3": [0.0, 0.0, 100.0, 0, 0, 0]}
        return make(entry, names, {name: starts[name] for name in names}, num_envs=2)

    def test_the_same_waypoint_at_once_is_for_the_first(self):
        env, entry, td = self.make(20.0)
        assert bool(td["deputy", "action_mask"][..., 0].all())
        same = torch.zeros(2, 3, dtype=torch.int64)
        flown = shielded(entry, same.flatten(), torch.ones(6, dtype=torch.bool)).view(2, 3)
        assert flown[:, 0].tolist() == [0, 0]
        assert torch.equal(flown[0], flown[1])
        assert len(set(flown[0].tolist())) == 3
        decision = decided(env, same)
        assert decision.key.tolist() == [0] * 6  # what is recorded
        dv_N = entry._thrust.change_of_velocity(entry.ahead().manoeuvre(flown.flatten()))
        assert torch.equal(decision.command, dv_N)
        td = fly(env, td, same)
        rho = entry.relative_state()[0].view(2, 3, 3)
        nearest = torch.cdist(rho, rho)[:, [0, 0, 1], [1, 2, 2]]
        assert bool((nearest > 20.0).all())

    def test_without_a_distance_all_fly_what_they_chose(self):
        _, entry, _ = self.make(0.0)
        same = torch.zeros(6, dtype=torch.int64)
        assert torch.equal(shielded(entry, same, torch.ones(6, dtype=torch.bool)), same)

    def test_those_that_do_not_decide_are_no_hindrance(self):
        _, entry, _ = self.make(20.0)
        same, decides = torch.zeros(6, dtype=torch.int64), torch.tensor([False, True, False, True, False, False])
        assert torch.equal(shielded(entry, same, decides)[[1, 3]], same[[1, 3]])

    def test_it_is_the_nearest_clear_one(self):
        """By brute force over all paths."""
        _, entry, _ = self.make(30.0, ("D1", "D2"))
        ahead, legal = entry.ahead(), entry.mask().view(2, 2, 12)
        rho, velocity = (x.view(2, 2, 3) for x in entry.relative_state())
        for first in range(12):
            after = velocity[:, 0] + ahead.rows(0, 2).manoeuvre(torch.full((2,), first))
            clear = ahead.rows(1, 2).apart(rho[:, :1], after.unsqueeze(1)).flatten(1)[0] >= 30.0
            for wanted in range(12):
                chosen = torch.tensor([first, wanted] * 2)
                found = int(shielded(entry, chosen, torch.ones(4, dtype=torch.bool))[1])
                if clear[wanted]:
                    assert found == wanted
                    continue
                options = [k for k in range(12) if clear[k] and legal[0, 1, k]]

                def away(k, wanted=wanted):
                    far = torch.linalg.vector_norm(entry.waypoints[k // 2] - entry.waypoints[wanted // 2])
                    return float(far), abs(float(entry.durations[k % 2] - entry.durations[wanted % 2]))

                assert found in options
                assert away(found) == min(away(k) for k in options)

    def test_where_none_is_clear_the_widest_is_flown(self):
        _, entry, _ = self.make(20.0, ("D1", "D2"))
        entry.keep_apart = 1e4
        entry._options = None  # what is legal was found for the other distance
        legal = entry.mask().view(2, 2, 12)
        assert legal.sum(-1).tolist() == [[1, 1], [1, 1]]
        flown = shielded(entry, torch.zeros(4, dtype=torch.int64), torch.ones(4, dtype=torch.bool)).view(2, 2)
        assert torch.equal(flown[:, 1], legal[:, 1].long().argmax(1))

    def test_one_that_does_not_keep_the_distances_lasts_for_the_shortest_duration(self):
        """It was chosen for that time; later on it may come as near as it likes."""
        env, entry, _ = self.make(20.0, ("D1", "D2"))
        longest = torch.full((2, 2), 1)
        assert decided(env, longest).duration.tolist()[::2] == [900.0, 900.0]
        entry.keep_apart, entry._options = 1e4, None
        assert bool(entry.options.stuck.all())
        assert decided(env, longest).duration.tolist() == [600.0] * 4


def test_transfers_are_found_once_for_a_decision(monkeypatch):
    """And again after every change of the state."""
    env, entry, td = make(HillWaypoint("C", SIX, [600.0], keep_apart=20.0), ("D1", "D2"))
    calls, legal = [], HillWaypoint.legal
    monkeypatch.setattr(HillWaypoint, "legal", lambda entry, ahead, rows: calls.append(rows) or legal(entry, ahead, rows))
    for k in range(3):
        td = fly(env, td, td["deputy", "action_mask"][..., :6].long().argmax(-1))
        assert [len(rows) for rows in calls] == [8] * (k + 1)
    rows = torch.tensor([True] + [False] * 7)
    entry.satellite.simulator.write("dv_available", rows, torch.zeros(8, dtype=torch.float64))
    assert (entry.mask().sum(1).tolist()[0], calls[3].tolist()) == (1, [0])
    env.reset(TensorDict({"_reset": torch.tensor([[False], [True], [False], [False]])}, [4]))
    assert calls[4].tolist() == [2, 3]
    again = entry.mask()
    entry._options = None
    assert torch.equal(again, entry.mask())


def test_results_do_not_depend_on_other_episodes():
    limits = dict(max_dv=0.3, keep_out=15.0, keep_in=300.0, keep_apart=25.0)
    names = ("D1", "D2", "D3")
    whole, entry, _ = make(HillWaypoint("C", 8, [300.0, 500.0], **limits), names, num_envs=5)
    part, alone, _ = make(HillWaypoint("C", 8, [300.0, 500.0], **limits), names, num_envs=1)
    assert torch.equal(entry.mask()[:3], alone.mask())
    same = torch.zeros(5, 3, dtype=torch.int64)
    found, single = decided(whole, same), decided(part, same[:1])
    assert torch.equal(found.command[:3], single.command)
    assert torch.equal(found.duration[:3], single.duration)


def test_beside_other_actions():
    env, _, td = make(HillWaypoint("C", SIX, [600.0]), beside=(act.Drift(duration=40.0),), num_envs=2)
    assert env.satellites[1].action_description == ["action_drift", *(f"waypoint_{d}_600s" for d in range(6))]
    before = env.satellites[1].simulator.read("dv_available").tolist()
    td = fly(env, td, torch.tensor([[0], [3]]))
    assert td["chief", "duration"].flatten().tolist() == [40.0, 600.0]
    left = env.satellites[1].simulator.read("dv_available").tolist()
    assert left[0] == before[0]
    assert left[1] < before[1]
