"""Environments whose satellites manoeuvre: partial steps, resets, copies, lines of sight, options."""

import copy
import pickle

import pytest
import torch

from bsk_torch import ConstellationTasking, act, comm, data, dyn, fsw, obs, sats
from tests.support.manoeuvring import START, Kick, Mover, make, push, step
from tests.support.refusals import check_refusals, refusal

ORBITS = ["arc", "integrated"]
FIELDS = ("r_BN_N", "v_BN_N", "dv_available", "thrust_count", "delta_v_N")


def fields(env, rows=slice(None)):
    return [env.simulator.read(name)[rows] for name in FIELDS]


def same(a, b):
    return all(torch.equal(x, y) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize("orbit", ORBITS)
@pytest.mark.nightly("integrated")
def test_partial_steps_leave_other_rows_alone(orbit):
    """Also one that has been pushed and has not flown on yet; it goes on later as if nothing had been in between."""
    env, all_at_once = make(3, orbit=orbit), make(3, orbit=orbit)
    td, other = env.reset(), all_at_once.reset()
    for one in (env, all_at_once):
        push(one, 0.0, 3.0, 0.0, rows=torch.tensor([False, True, True]))
    before = fields(env, slice(1, 2))
    arc = env.simulator.arcs.flown[1].clone()
    td = step(env, td, 1, 1, 1, mask=[True, False, True])
    assert same(before, fields(env, slice(1, 2)))
    assert torch.equal(arc, env.simulator.arcs.flown[1])
    assert env.simulator.ticks.tolist() == [60, 0, 60]
    step(env, td, 1, 1, 1, mask=[False, True, False])
    step(all_at_once, other, 1, 1, 1)
    assert same(fields(env), fields(all_at_once))


@pytest.mark.parametrize("orbit", ORBITS)
@pytest.mark.nightly("integrated")
def test_a_reset_begins_with_a_full_tank_on_the_first_orbit(orbit):
    epoch = {"utc_init": "2021 MAR 05 07:12:33.250 (UTC)"}
    env, fresh = (make(2, orbit=orbit, world_args=epoch) for _ in range(2))
    td = env.reset()
    fresh.reset()
    start = fields(env)
    for _ in range(2):
        td = step(env, td, 1)
    td["_reset"] = torch.tensor([[True], [False]])
    env.reset(td)
    assert same(fields(env, slice(0, 1)), [part[:1] for part in start])
    assert env.simulator.arcs.restarts
    assert env.simulator.arcs.begun.round().tolist() == [0.0, 60.0]
    assert torch.equal(env.simulator.arcs.flown[0, :60], fresh.simulator.arcs.flown[0, :60])
    assert env.satellite.fsw.thrust_count.tolist() == [0.0, 2.0]


@pytest.mark.parametrize("options", [{}, {"replan": False}, {"orbit": "integrated"}])
@pytest.mark.nightly("options2")
def test_copies_and_pickles_go_on_alike(options):
    env = make(2, **options)
    td = step(env, env.reset(), 1)
    push(env, 1.0, 0.0, 2.0)
    copied, pickled = copy.deepcopy(env), pickle.loads(pickle.dumps(env))
    branch = make(2, **options)
    branch.restore(env, [0, 1], [0, 1])
    for one in (env, copied, pickled, branch):
        step(one, td, 1)
    assert all(same(fields(env), fields(other)) for other in (copied, pickled, branch))


def test_rejects_wrong_states():
    env, other = make(), make(replan=False)
    env.reset()
    push(env, 1.0, 0.0, 0.0)
    saved = env.get_state()

    def crafted(name, value):
        state, key = saved.clone(), ("satellites_0", "lookahead", "arcs", name)
        env.restore(state.set(key, torch.full_like(state[key], value)))

    check_refusals(
        refusal(lambda: other.restore(saved), ValueError, "state", "windows"),
        refusal(lambda: crafted("solved", 3601.0), ValueError, "arcs.solved", 3601.0, "hours"),
        refusal(lambda: crafted("solved", 1e9), ValueError, "arcs.solved", 1e9),
        refusal(lambda: crafted("epoch", 7200.0), ValueError, "arcs.", 3600.0),
    )
    env.restore(saved)


def test_options_of_movers():
    check_refusals(
        refusal(lambda: make(replan=True, compat="bsk_rl"), ValueError, "replan=True", "compat='bsk_rl'"),
        refusal(lambda: make(replan="yes"), ValueError, "replan"),
    )
    assert make(compat="bsk_rl").options.replan is False
    assert make().options.replan is True
    assert Mover.default_sat_args()["dv_available_init"] == 100.0


class Seer(sats.Satellite):
    """Manoeuvres, and sees others."""

    dyn_type = (dyn.BasicDynamicsModel, dyn.LOSCommDynModel)
    fsw_type = (fsw.MagicOrbitalManeuverFSWModel, fsw.BasicFSWModel)
    observation_spec = (obs.SatProperties({"prop": "dv_available"}),)
    action_spec = (act.Drift(duration=60.0), Kick())


@pytest.mark.parametrize("replan", [True, False])
def test_lines_of_sight_after_manoeuvres(replan):
    """They are searched on the orbits that are flown; 40 km apart, satellites see each other all the time."""
    behind = START | {"vN": START["vN"], "rN": [START["rN"][0], START["rN"][1] - 3e4, START["rN"][2] - 2e4]}
    env = ConstellationTasking(
        [Seer("A", START), Seer("B", behind)],
        rewarder=data.NoReward(),
        communicator=comm.LOSCommunication(),
        num_envs=2,
        joint=True,
        seed=0,
        backend="eager",
        replan=replan,
        sim_rate=5.0,
    )
    td = env.reset()
    for action in ([1, 0], [1, 1], [0, 0]):
        td = env.step(td.set("action", torch.tensor([action, [0, 0]])))["next"]
        assert env.links is not None
        assert env.links[:, 0, 1].all()
    assert env.satellites[0].fsw.thrust_count.tolist() == [2.0, 1.0, 0.0, 0.0]
