"""Recordings: fields at the ticks of runs, switched on and off between steps."""

import pytest
import torch

import bsk_torch
from bsk_torch.env.base import ResetNeededError
from tests.sim.tick.test_trace import build
from tests.support.refusals import check_refusals, refusal

FIELDS = ("sigma_BN", "omega_BN_B", "Omega_WB_B")

BACKENDS = ["eager", pytest.param("compiled", marks=pytest.mark.compiled)]


def scan(backend="eager", **options):
    options = {"num_envs": 3, "seed": 3, "time_limit": 300.0} | options
    return bsk_torch.make("NadirScan-v1", backend=backend, **options)


def act(env, td, seed):
    """A step of random actions, the same in environments with as many episodes, and a reset of those that have ended."""
    generator = torch.Generator().manual_seed(seed)
    for key in env.action_keys:
        spec = env.full_action_spec[key]
        td = td.set(key, torch.randint(0, int(spec.space.n), spec.shape, generator=generator))
    return env.step_and_maybe_reset(td)[1]


def played(env, steps):
    """Play some steps; yields nothing but plays on as it is asked, with what the satellites of type 0 are at the ends."""
    td = env.reset()
    for seed in range(steps):
        td = act(env, td, seed)
        yield env.fleet.ticks.clone(), env.episode.clone(), env.simulator.read("sigma_BN").clone()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.nightly("eager")
def test_recording_changes_nothing_and_shows_what_satellites_are_at_the_ends_of_steps(backend):
    """Across steps and resets; rows that are not recorded are not in it."""
    short = {"time_limit": 20.0, "max_step_duration": 12.0} if backend == "eager" else {}  # whose ticks take milliseconds each
    plain, env = (scan(backend, **short) for _ in range(2))
    ends, recording = [], None
    for one, other in zip(played(plain, 6), played(env, 6), strict=True):
        for a, b in zip(one, other, strict=True):
            assert torch.equal(a, b)
        if recording is None:
            recording = env.record(FIELDS, rows=[0, 2])
            first = other
        else:
            ends.append(other)
    assert torch.equal(plain.simulator.state.planes, env.simulator.state.planes)
    assert recording["env"].unique().tolist() == [0, 2]
    episodes = recording["episode"].unique().tolist()
    assert episodes == list(range(len(episodes)))
    assert len(episodes) > 2
    for ticks, episode, sigma in ends:
        for row in (0, 2):
            data = recording.of(row, int(episode[row]))
            assert torch.equal(data["sigma_BN"][data["tick"] == ticks[row]], sigma[row : row + 1])
    last = recording.of(2)
    assert last["episode"].unique().tolist() == [int(env.episode[2])]
    assert last["tick"].tolist() == list(range(int(env.fleet.ticks[2]) + 1))
    assert float(last["time"][-1]) == float(env.fleet.sim_time[2])
    begun = recording.of(0, 0)
    assert torch.equal(begun["sigma_BN"][0], first[2][0]), "it begins with the present"
    assert recording["Omega_WB_B"].shape == (len(recording.time), 3)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("every", [1, 4])
@pytest.mark.nightly("4-eager")
def test_records_are_the_states_after_each_tick(backend, every):
    """The same flight in one run, and tick by tick."""
    whole, single = scan(backend), scan(backend)
    for env in (whole, single):
        env.reset()
    everyone, limit = torch.ones(3, dtype=torch.bool), whole.state.limit_ticks
    with whole.record(FIELDS, every=every) as recording:
        whole.fleet.run(everyone, limit, torch.tensor([25, 0, 10]))
    assert recording["tick"].tolist() == [k for n in (26, 1, 11) for k in range(0, n, every)]
    for tick in range(1, 26):
        single.fleet.run(everyone, limit, torch.tensor([tick, 0, min(tick, 10)]))
        data = recording.of(0)
        for name in FIELDS:
            assert torch.equal(data[name][data["tick"] == tick], single.simulator.read(name)[:1][: int(tick % every == 0)])
    whole.fleet.run(everyone, limit, torch.tensor([30, 30, 30]))
    assert int(recording["tick"].max()) == 25 - 25 % every, "it has been stopped"


@pytest.mark.compiled
@pytest.mark.parametrize("population", [None, (1, 2)])
@pytest.mark.nightly("population1")
def test_satellites_whose_events_end_steps(population):
    """In a constellation the image of one ends the run of all, in lockstep."""
    options = dict(num_envs=3, n_satellites=3, n_targets=120, seed=3, time_limit=2400.0)
    options |= {} if population is None else {"population": population}
    plain, env = (bsk_torch.make("Constellation-v1", **options) for _ in range(2))
    one, other = plain.reset(), env.reset()
    recording = env.record("sigma_BN", rows=1, satellites=env.names[:2])
    for seed in range(6):
        one, other = act(plain, one, seed), act(env, other, seed)
        assert torch.equal(plain.simulator.state.planes, env.simulator.state.planes)
    data = recording.of(1)
    assert data["sigma_BN"].shape[1:] == (2, 3)
    now = env.simulator.read("sigma_BN").view(3, 3, 3)[1, :2]
    there = torch.ones(2, dtype=torch.bool) if env.fleet.present is None else env.fleet.present[1, :2]
    assert torch.equal(data["sigma_BN"][-1][there], now[there])
    assert data["sigma_BN"][:, ~there].isnan().all()
    assert float(data["time"][-1]) == float(env.fleet.sim_time[1])


@pytest.mark.parametrize("backend", BACKENDS)
def test_satellites_that_depend_on_one_another(backend):
    """What a component computes from another satellite is the same in the recording; types without a field show NaN."""
    env, flights = build(backend), []
    env.reset()
    env.fleet.flight_observers.append(flights.append)
    kept = []
    env.fleet.flight_observers.append(lambda flight: kept.append(flight.read(0, "distance").clone()))
    recording = env.record(("distance", "r_BN_N"), rows=[1, 3])
    ends = torch.tensor([5, 17, 9, 12, 0])
    env.fleet.run(torch.ones(5, dtype=torch.bool), env.state.limit_ticks, ends)
    for row in (1, 3):
        data = recording.of(row)
        assert len(data["time"]) == int(ends[row]) + 1
        columns = env.fleet.columns[0]
        assert torch.equal(data["distance"][:, columns].mT, kept[0][row][:, : int(ends[row]) + 1])
        assert data["distance"][:, env.fleet.columns[1]].isnan().all()
        assert torch.equal(data["r_BN_N"][-1][columns], env.fleet.simulators[0].read("r_BN_N").view(5, 2, 3)[row])


def test_an_episode_that_is_restored_is_recorded_from_there():
    env = scan(max_step_duration=10.0)
    td = act(env, env.reset(), 0)
    saved = env.get_state()
    recording = env.record("sigma_BN", rows=0)
    act(env, td, 1)
    assert len(recording.take())
    assert not len(recording.time)
    assert recording.nbytes == 0
    env.restore(saved)
    assert recording.time.tolist() == [float(saved["satellites_0", "ticks"][0])]
    check_refusals(
        refusal(lambda: recording.of(1), KeyError, "1", "[0]"),
        refusal(lambda: recording["sigma"], KeyError, "'sigma'", "'sigma_BN'"),
    )
    assert "sigma_BN" in repr(recording)


def test_rejects_wrong_recordings():
    env = scan()
    check_refusals(refusal(lambda: env.record("sigma_BN"), ResetNeededError, "record()"))
    env.reset()
    check_refusals(
        refusal(lambda: env.record("sigma_B"), ValueError, "'sigma_B'", "'sigma_BN'"),
        refusal(lambda: env.record(()), ValueError, "fields=()"),
        refusal(lambda: env.record("sigma_BN", every=0), ValueError, "every=0", "1"),
        refusal(lambda: env.record("sigma_BN", rows=[3]), IndexError, "[3]", "0", "2"),
        refusal(lambda: env.record("sigma_BN", satellites="Scanner"), KeyError, "'Scanner'", "'Scanner1'"),
    )
    assert not env.fleet.recordings


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", ["NadirScan-v1", "RelayConstellation-v1"])
@pytest.mark.nightly("RelayConstellation-v1-eager")
def test_properties_are_those_of_the_ends_of_steps(name, backend):
    """Of three numbers and of one, beside fields; NaN for satellites whose models do not have them."""
    length = 60.0 if backend == "compiled" else 15.0  # ticks of the eager back end take milliseconds
    env = bsk_torch.make(name, backend=backend, num_envs=3, seed=3, time_limit=900.0, max_step_duration=length)
    td, read = env.reset(), ("omega_BN_B", "nadir_pointing_error", "solar_pointing_error", "v_BN_P", "storage_level")
    recording = env.record(read)
    for seed in range(4):
        td = act(env, td, seed)
        assert env.satellites
        each, last = env.satellites, [recording.of(env_id)[-1:] for env_id in range(3)]
        for prop in read[1:]:
            shown = torch.cat([data[prop].reshape(1, len(env.names), -1) for data in last])
            column = 0
            for satellite in each:
                model = next((m for m in (satellite.dynamics, satellite.fsw) if hasattr(type(m), prop)), None)
                count = satellite.simulator.count
                mine = shown[:, column : column + count]
                column += count
                if model is None:
                    assert mine.isnan().all()
                    continue
                assert all(int(data["tick"]) == int(ticks) for data, ticks in zip(last, env.fleet.ticks, strict=True))
                torch.testing.assert_close(mine, getattr(model, prop).reshape(3, count, -1), rtol=1e-12, atol=1e-12)
