"""Traces of runs, and components that follow another satellite."""

import dataclasses

import pytest
import torch

from bsk_torch import ConstellationTasking, act, obs, sats
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.component import Component, Field
from bsk_torch.sim.dyn.events import IMAGE_EVENT
from bsk_torch.sim.run import coupled as flight
from bsk_torch.vec3 import Vec3
from tests.support.refusals import check_refusals, refusal

ENVS, TICKS = 5, 40


def follow(bus):
    """Keep the distance to the leader, and the largest so far."""
    distance = (bus.beacon[0].r_BN_N - bus.r_BN_N).norm()
    bus.distance, bus.heard = distance, bus.heard + bus.beacon[0].sigma_BN.x


FOLLOWER = Component(
    slot="listener",
    after="navigation",
    update=follow,
    state=(Field("distance", exact=True), Field("heard", exact=True)),
    initial=lambda args: {name: torch.zeros(1).double() for name in ("distance", "heard")},
    records=("distance", "r_BN_N"),
    follows="beacon",
)


class LeaderDyn(dyn.BasicDynamicsModel):
    components = (Component(slot="beacon", after="storage", records=("r_BN_N", "sigma_BN")),)


class FollowerDyn(dyn.BasicDynamicsModel):
    components = (FOLLOWER,)


class Leader(sats.Satellite):
    dyn_type, fsw_type = LeaderDyn, fsw.BasicFSWModel
    observation_spec, action_spec = [obs.Time()], [act.NadirPoint(duration=17.0)]


class Follower(sats.Satellite):
    dyn_type, fsw_type = FollowerDyn, fsw.BasicFSWModel
    observation_spec, action_spec = [obs.Time()], [act.Charge(duration=23.0)]


def build(backend, satellites=None, **options):
    satellites = satellites or [Follower("A"), Leader("L"), Follower("B")]
    options = dict(num_envs=ENVS, seed=1, backend=backend, dtype=torch.float64, time_limit=100.0) | options
    return ConstellationTasking(satellites, **options)


def flown(env):
    """Flights of two steps, and the environment."""
    flights = []
    env.fleet.flight_observers.append(flights.append)
    td = env.reset()
    for _ in range(2):
        for group in env.group_map:
            td[group, "action"] = torch.zeros_like(td[group, "action_mask"][..., 0], dtype=torch.int64)
        td = env.step(td)["next"]
    return flights


@pytest.mark.parametrize(
    ("orbit", "backend"),
    [
        ("arc", "eager"),
        ("integrated", "eager"),
        pytest.param("arc", "compiled", marks=pytest.mark.compiled),
        pytest.param("integrated", "compiled", marks=pytest.mark.compiled),
    ],
)
@pytest.mark.nightly("integrated")
def test_a_component_reads_what_its_leader_records_in_the_same_tick(backend, orbit):
    env = build(backend, orbit=orbit)
    followers, leaders = env.fleet.simulators
    for turn in flown(env):
        ticks = int(turn.ticks.max())
        assert turn.ticks.tolist() == [ticks] * ENVS
        r, r_leader = turn.read(0, "r_BN_N"), turn.read(1, "r_BN_N")
        assert r.shape == (ENVS, 2, ticks + 1, 3)
        distance = (r - r_leader).norm(dim=-1)
        assert torch.allclose(turn.read(0, "distance")[..., 1:], distance[..., 1:], rtol=1e-14, atol=0)
    assert torch.equal(turn.read(1, "sigma_BN")[:, 0, -1], leaders.read("sigma_BN"))
    assert torch.equal(turn.read(0, "r_BN_N")[:, :, -1].flatten(0, 1), followers.read("r_BN_N"))


def test_a_stop_condition_ends_the_step_of_all_satellites_and_they_are_simulated_to_there():
    whole, cut = build("eager"), build("eager")
    first = torch.tensor([3, 0, 17, 99, 8])
    cut.fleet.stop_conditions.append(lambda turn: first[turn.envs])
    reference = flown(whole)[0]
    flights = flown(cut)
    assert (flights[0].ticks.tolist(), flights[1].ticks.tolist()) == ([3, 0, 17, 17, 8], [3, 0, 17, 17, 8])
    for k, name in ((0, "heard"), (1, "sigma_BN")):
        state = cut.fleet.simulators[k].read(name).view(ENVS, -1)
        assert torch.isfinite(state).all()
    at = reference.read(1, "sigma_BN")[:, 0]
    again = flights[0].read(1, "sigma_BN")[:, 0]
    for row, ticks in enumerate(flights[0].ticks.tolist()):
        assert torch.equal(at[row, : ticks + 1], again[row, : ticks + 1])
    assert cut.fleet.ticks.tolist() == (flights[0].ticks + flights[1].ticks).tolist()


def test_traces_in_parts_are_those_of_the_whole(monkeypatch):
    whole, parts = build("eager"), build("eager")
    reference = flown(whole)
    monkeypatch.setattr(flight, "MOST_NUMBERS", 2 * 18 * 13)
    found = flown(parts)
    assert len(reference) == 2
    assert len(found) > 4
    assert torch.equal(whole.fleet.simulators[0].state.planes, parts.fleet.simulators[0].state.planes)
    first = torch.cat([turn.read(0, "distance") for turn in found if int(turn.since[0]) == 0])
    envs = torch.cat([turn.envs for turn in found if int(turn.since[0]) == 0])
    assert torch.equal(first, reference[0].read(0, "distance")[envs])


@pytest.mark.compiled
@pytest.mark.parametrize("lockstep", [1, 2])
@pytest.mark.nightly("2")
def test_kernels_of_rows_that_stop_write_the_same_traces_as_the_eager_back_end(lockstep):
    traces = []
    event = dataclasses.replace(IMAGE_EVENT, records=("Omega_WB_B",))
    model = type("Dyn", (dyn.ImagingDynModel,), {"components": (event,)})
    kind = type("Imager", (Leader,), {"dyn_type": model, "fsw_type": fsw.ImagingFSWModel})
    for backend in ("eager", "compiled"):
        env = build(backend, [kind(f"I{k}") for k in range(lockstep)] if lockstep > 1 else [kind("I")], num_envs=3)
        env.reset()
        simulator = env.fleet.simulators[0]
        simulator.write("image_level", torch.arange(simulator.state.rows) == lockstep, torch.full((simulator.state.rows,), -1.0))
        trace = simulator.trace(9)
        ran = simulator.run(torch.full((simulator.state.rows,), 9), trace=trace)
        traces.append([row[: n + 1] for row, n in zip(trace.read("Omega_WB_B"), ran.tolist(), strict=True)])
        assert ran.view(3, lockstep).tolist() == [[9] * lockstep, [1] * lockstep, [9] * lockstep]
    for eager, compiled in zip(*traces, strict=True):
        assert torch.allclose(eager, compiled, rtol=0, atol=1e-12)


def test_rejects_wrong_leaders_and_records():
    def mutual():
        one, two = (dataclasses.replace(FOLLOWER, slot=slot, follows=other) for slot, other in ("xy", "yx"))
        models = [type("Mutual", (dyn.BasicDynamicsModel,), {"components": (part,)}) for part in (one, two)]
        return [type("K", (Leader,), {"dyn_type": model})(name) for model, name in zip(models, "AB", strict=True)]

    wrong = type("Wrong", (LeaderDyn,), {"components": (Component(slot="beacon", after="storage", records=("r_BN_M",)),)})
    recording = [type("L", (Leader,), {"dyn_type": wrong})("L")]
    several = [Follower("A"), Leader("L"), Leader("M")]
    check_refusals(
        refusal(lambda: build("eager", several), ValueError, "slot 'beacon'", "['L', 'M']"),
        refusal(lambda: build("eager", [Follower("A")]), ValueError, "slot 'beacon'", "none"),
        refusal(lambda: build("eager", recording), ValueError, "records='r_BN_M'", "'r_BN_N'"),
        refusal(lambda: build("eager", mutual()), ValueError, "['A', 'B']"),
    )


def test_vectors_of_a_trace_have_a_last_dimension():
    env = build("eager")
    turn = flown(env)[0]
    assert isinstance(env.fleet.simulators[1].read("sigma_BN"), torch.Tensor)
    assert turn.read(1, "sigma_BN").shape == (ENVS, 1, 18, 3)
    check_refusals(refusal(lambda: turn.read(1, "Omega"), ValueError, "'Omega'"))
    assert Vec3(*turn.read(1, "r_BN_N").unbind(-1)).norm().min() > 6.3e6
