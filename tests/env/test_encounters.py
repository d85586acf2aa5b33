"""Conjunctions and ranges in an environment: when steps end, who dies, and what bsk_rl books."""

import pytest
import torch

from bsk_torch import ConstellationTasking, act, dyn, fsw, obs, rand, sats
from bsk_torch.constants import MU_EARTH
from bsk_torch.formations import relative_to_chief
from bsk_torch.rand import random_orbit
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled


class Careful(sats.Satellite):
    observation_spec = (obs.SatProperties(dict(prop="r_BN_N")), obs.Time())
    action_spec = (act.Drift(duration=200.0),)
    dyn_type, fsw_type = (dyn.ConjunctionDynModel, dyn.MaxRangeDynModel), fsw.FSWModel


class Chief(Careful):
    dyn_type = dyn.ConjunctionDynModel


class Free(Careful):
    dyn_type = dyn.DynamicsModel


APPROACH = [100.0, 0.0, 0.0, -1.0, 0.0, 0.0]
"""Comes within 20 m of the chief after 80 s or so, and is there for some time."""

ESCAPE = [0.0, 350.0, 0.0, 0.0, 1.0, 0.0]
"""Is 400 m from the chief after 50 s or so."""

WAITS = [0.0, 200.0, 0.0, 0.0, 0.0, 0.0]
"""Stays 200 m behind the chief."""


def make(states, kinds=None, args=None, num_envs=2, **options):
    """An environment of a chief and deputies with relative states, by name; ``args`` are those of single satellites."""
    kinds, args = {"RSO": Chief} | (kinds or {}), args or {}
    far = dict(chief_name="RSO", max_range_radius=400.0)
    given = {
        name: (far if name != "RSO" and kinds.get(name, Careful) is Careful else {}) | args.get(name, {})
        for name in ("RSO", *states)
    }
    satellites = [kinds.get(name, Careful)(name, given[name]) for name in given]
    options = dict(seed=1, time_limit=600.0, dtype=torch.float64) | options
    formation = relative_to_chief("RSO", random_orbit(), states)
    return ConstellationTasking(satellites, sat_arg_randomizer=formation, num_envs=num_envs, **options)


def step(env, td, moves=None):
    """One step in which all drift."""
    td = td.select(*[(name, "action_mask") for name in env.group_map])
    for name in env.group_map:
        td[name, "action"] = torch.zeros_like(td[name, "action_mask"][..., 0], dtype=torch.int64)
    if moves is not None:
        td["_step"] = moves
    return env.step(td)["next"]


def distance(env, one, other):
    r = [env.fleet.satellite(name).dynamics.r_BN_N for name in (one, other)]
    return (r[0] - r[1]).norm(dim=-1)


def rewards(env, td):
    """The reward of every agent of the first environment by name."""
    return {agent: td[name, "reward"][0, k].item() for name, agents in env.group_map.items() for k, agent in enumerate(agents)}


def dead(env, row=0):
    return {name for name, flag in zip(env.names, env.dead[row].tolist(), strict=True) if flag}


@pytest.fixture(scope="module")
def collided():
    """Environments of two orbits after the step in which A collides with the chief."""
    env = make({"A": APPROACH, "B": WAITS})
    td = step(env, env.reset())
    return env, td


def test_a_collision_ends_the_step_of_all_in_its_first_tick_and_both_die(collided):
    env, td = collided
    assert (distance(env, "A", "RSO") <= 20.0).all()
    assert (distance(env, "A", "RSO") > 19.0).all()  # a tick before it was a metre more
    assert 75.0 < td["duration"].min() < 85.0
    assert dead(env) == dead(env, 1) == {"A", "RSO"}
    assert rewards(env, td) == {"RSO": -1.0, "A": -1.0, "B": 0.0}
    rso, deputies = env.satellites
    assert rso.dynamics.conjunctions.tolist() == [[False, True, False]] * 2
    assert deputies.dynamics.conjunctions.tolist() == [[True, False, False], [False, False, False]] * 2
    assert deputies.aliveness()["conjunction_valid"].tolist() == [False, True] * 2
    assert deputies.aliveness()["range_valid"].all()


def test_a_collision_ends_one_step_and_the_dead_fly_on(collided):
    env, td = collided
    before = env.fleet.satellite("RSO").dynamics.r_BN_N
    state = env.get_state()
    after = step(env, td)
    assert after["duration"].min() > 15.0  # the two are within their radii for a while
    assert (distance(env, "A", "RSO") < 400.0).all()
    assert ((env.fleet.satellite("RSO").dynamics.r_BN_N - before).norm(dim=-1) > 1e5).all()
    assert rewards(env, after)["A"] == 0.0  # it has left
    ends = env.fleet.satellite("B").dynamics.r_BN_N
    env.restore(state)
    assert env.dead.tolist() == [[True, True, False]] * 2
    again = step(env, td)
    assert torch.equal(again["duration"], after["duration"])
    assert torch.equal(env.fleet.satellite("B").dynamics.r_BN_N, ends)
    env.restore(state)


def test_encounters_are_saved_and_forgotten_at_a_reset():
    env = make({"A": APPROACH, "B": WAITS})
    td = step(env, env.reset())
    other = make({"A": APPROACH, "B": WAITS})
    other.reset()
    other.restore(env.get_state())
    assert other.satellites[0].dynamics.conjunctions.tolist() == [[False, True, False]] * 2
    assert torch.equal(step(other, td)["duration"], step(env, td)["duration"])
    env.reset()
    assert not env.satellites[0].dynamics.conjunctions.any()
    assert not env.dead.any()


def test_partial_steps_leave_the_other_episodes_where_they_are():
    env = make({"A": APPROACH, "B": WAITS})
    td = env.reset()
    before = env.fleet.satellite("A").dynamics.r_BN_N[1]
    td = step(env, td, torch.tensor([True, False]))
    assert td["duration"][1] == 0.0
    assert torch.equal(env.fleet.satellite("A").dynamics.r_BN_N[1], before)
    assert (dead(env), dead(env, 1)) == ({"A", "RSO"}, set())
    step(env, td, torch.tensor([False, True]))
    assert dead(env, 1) == {"A", "RSO"}


def test_episodes_do_not_depend_on_the_batch(collided):
    env, td = collided
    alone = make({"A": APPROACH, "B": WAITS}, num_envs=1, env_ids=[1])
    after = step(alone, alone.reset())
    whole = make({"A": APPROACH, "B": WAITS}, num_envs=5)
    beside = step(whole, whole.reset())
    for name in env.group_map:
        assert torch.equal(after[name, "observation"][0], td[name, "observation"][1])
        assert torch.equal(after[name, "observation"][0], beside[name, "observation"][1])
    assert after["duration"][0] == td["duration"][1] == beside["duration"][1]


def test_integrated_orbits_and_the_eager_back_end_end_at_the_same_ticks(collided):
    _, td = collided
    flown = make({"A": APPROACH, "B": WAITS}, num_envs=1, orbit="integrated")
    assert step(flown, flown.reset())["duration"][0] == td["duration"][0]
    assert dead(flown) == {"A", "RSO"}
    env, td = collided
    eager = make({"A": APPROACH, "B": WAITS}, backend="eager")
    after = step(eager, eager.reset())
    assert torch.equal(after["duration"], td["duration"])
    assert torch.equal(eager.dead, env.dead)


@pytest.mark.parametrize(("rate", "every"), [(7.0, 7), (0.3, 1), (1.5, 2)])
def test_a_check_rate_delays_the_end_to_the_next_look(collided, rate, every):
    """The later satellite of a pair says how often it is looked at; the chief's rate would not matter."""
    _, td = collided
    env = make(
        {"A": APPROACH, "B": WAITS}, args={"A": dict(conjunction_check_rate=rate), "RSO": dict(conjunction_check_rate=60.0)}
    )
    first = td["duration"].flatten()
    expected = torch.ceil(first / every) * every
    assert step(env, env.reset())["duration"].flatten().tolist() == expected.tolist()


@pytest.mark.parametrize("exact", [False, True])
def test_a_fast_passage_is_seen_between_ticks_only_where_that_is_asked_for(exact):
    """An equatorial and a polar orbit cross at 10.7 km/s after four and a half ticks; neither is there at a tick."""
    back = -22.5 * (MU_EARTH / 7e6**3) ** 0.5
    args = {name: dict(oe=[7e6, 0.0, i, 0.0, 0.0, back]) for name, i in (("A", 0.0), ("B", torch.pi / 2))}
    satellites = [Chief("A", args["A"]), Chief("B", args["B"] | dict(conjunction_exact=exact))]
    env = ConstellationTasking(satellites, num_envs=1, sim_rate=5.0, time_limit=100.0, backend="eager", dtype=torch.float64)
    td = step(env, env.reset())
    assert td["duration"].item() == (25.0 if exact else 100.0)
    assert dead(env) == ({"A", "B"} if exact else set())
    assert distance(env, "A", "B") > 10e3


def test_the_time_limit_is_looked_at_first(collided):
    _, td = collided
    first = int(td["duration"][0])
    for limit, dies in ((first, False), (first + 1, True)):
        env = make({"A": APPROACH, "B": WAITS}, num_envs=1, time_limit=float(limit))
        after = step(env, env.reset())
        assert after["duration"].item() == first
        assert bool(env.dead.any()) is dies
        assert bool(after["truncated"]) is not dies


def test_other_types_and_tasks_end_with_the_step():
    """A wheeled satellite, which watches no other, is simulated to the tick of the collision."""

    class Wheeled(Careful):
        action_spec = (act.NadirPoint(duration=60.0),)
        dyn_type, fsw_type = dyn.BasicDynamicsModel, fsw.BasicFSWModel

    env = make({"A": APPROACH, "W": ESCAPE}, kinds={"W": Wheeled}, num_envs=1)
    td = step(env, env.reset())
    assert td["duration"].item() == 60.0
    td = step(env, td)
    assert 15.0 < td["duration"].item() < 25.0
    assert len({int(simulator.ticks[0]) for simulator in env.fleet.simulators}) == 1
    assert dead(env) == {"RSO", "A"}
    assert not env.fleet.simulators[-1].records


def test_a_deputy_that_is_too_far_away_dies_alone():
    env = make({"A": ESCAPE, "B": WAITS})
    td = step(env, env.reset())
    assert 45.0 < td["duration"].min() < 55.0
    far = distance(env, "A", "RSO")
    assert ((far >= 400.0) & (far < 401.1)).all()
    assert (dead(env), rewards(env, td)) == ({"A"}, {"RSO": 0.0, "A": -1.0, "B": 0.0})
    assert env.satellites[1].dynamics.out_of_ranges.tolist() == [[True, False, False], [False, False, False]] * 2
    assert set(env.satellites[0].aliveness()) == {"altitude_valid", "conjunction_valid"}
    after = step(env, td)
    assert after["duration"].min() > 100.0  # the others go on, and the same range ends no other step
    assert dead(env) == {"A"}


@pytest.mark.parametrize("first", [True, False], ids=["before the chief", "after the chief"])
def test_the_chief_may_die_with_its_deputy(first):
    """bsk_rl needs the chief to come first here."""
    args = {"A": dict(enforce_range_on_chief=True)}
    env = make({"A": ESCAPE, "B": WAITS}, args=args)
    if first:
        satellites = [env.builder.satellites[k] for k in (1, 0, 2)]
        formation = relative_to_chief("RSO", random_orbit(), {"A": ESCAPE, "B": WAITS})
        env = ConstellationTasking(satellites, sat_arg_randomizer=formation, num_envs=2, seed=1, time_limit=600.0)
    step(env, env.reset())
    assert dead(env) == {"A", "RSO"}
    chief = env.fleet.satellite("RSO")
    assert chief.aliveness()["range_valid_A"].tolist() == [False, False]
    assert chief.aliveness()["conjunction_valid"].all()


def test_chiefs_of_any_model_are_watched_at_radii_of_each_episode():
    env = make({"A": ESCAPE}, kinds={"RSO": Free}, num_envs=1)
    step(env, env.reset())
    assert dead(env) == {"A"}
    env = make({"A": ESCAPE, "B": WAITS}, args={"A": dict(max_range_radius=rand.per_env([380.0, 400.0]))})
    td = step(env, env.reset())
    assert td["duration"][0] < td["duration"][1] - 10.0


TOUCHES = [5.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_an_episode_that_begins_in_collision_has_a_step_of_no_length():
    env = make({"A": TOUCHES, "B": WAITS})
    td = env.reset()
    assert not env.dead.any()
    td = step(env, td)
    assert (td["duration"].tolist(), rewards(env, td)) == ([[0.0], [0.0]], {"RSO": -1.0, "A": -1.0, "B": 0.0})
    assert env.state.removed.tolist() == [[True, True, False]] * 2
    td = step(env, td)
    assert td["duration"].tolist() == [[200.0], [200.0]]
    assert rewards(env, td) == {"RSO": 0.0, "A": 0.0, "B": 0.0}


def test_bsk_rl_reports_those_that_die_in_a_step_of_no_length_twice():
    env = make({"A": TOUCHES, "B": WAITS}, compat="bsk_rl")
    td = step(env, env.reset())
    assert (td["duration"].tolist(), rewards(env, td)) == ([[0.0], [0.0]], {"RSO": -1.0, "A": -1.0, "B": 0.0})
    assert not env.state.removed.any()
    td = step(env, td)
    assert td["duration"].tolist() == [[200.0], [200.0]]
    assert rewards(env, td) == {"RSO": -1.0, "A": -1.0, "B": 0.0}
    assert env.state.removed.tolist() == [[True, True, False]] * 2


@pytest.mark.parametrize(("compat", "victims"), [(None, {"RSO", "B"}), ("bsk_rl", {"A", "B"})])
def test_bsk_rl_books_a_collision_on_the_satellite_before_the_later_one(compat, victims):
    env = make({"A": WAITS, "B": APPROACH}, compat=compat)
    step(env, env.reset())
    assert dead(env) == victims
    seen = {name: env.fleet.satellite(name).dynamics.conjunctions[0].tolist() for name in ("RSO", "A", "B")}
    other = {"RSO": [False, False, True], "A": [False] * 3, "B": [True, False, False]}
    assert seen == (other if compat is None else {"RSO": [False] * 3, "A": [False, False, True], "B": [False, True, False]})


def test_rejects_wrong_arguments():
    given = lambda **args: make({"A": WAITS}, args={"A": args}, backend="eager")
    wrong = dict(conjunction_exact=True, conjunction_check_rate=7.0)
    check_refusals(
        refusal(lambda: given(chief_name="RS0"), ValueError, "sat_args of A", "chief_name", "'RS0'", "'RSO'"),
        refusal(lambda: given(chief_name=3), ValueError, "chief_name=3", "RSO"),
        refusal(lambda: given(conjunction_radius=0.0), ValueError, "conjunction_radius=0"),
        refusal(lambda: given(conjunction_radius=-2.0), ValueError, "conjunction_radius=-2"),
        refusal(lambda: given(max_range_radius=0.0), ValueError, "max_range_radius=0"),
        refusal(lambda: given(max_range_radius=float("nan")), ValueError, "max_range_radius=nan"),
        refusal(lambda: given(conjunction_check_rate=0.0), ValueError, "conjunction_check_rate=0"),
        refusal(lambda: given(**wrong), ValueError, "conjunction_check_rate=7", "conjunction_exact=True"),
        refusal(lambda: given(enforce_range_on_chief="yes"), ValueError, "enforce_range_on_chief", "'yes'", [False, True]),
    )
