"""What TorchRL and users may rely on, beyond what ``check_env_specs`` checks."""

import copy
import functools
import pickle

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import ParallelEnv, check_env_specs

import bsk_torch
from bsk_torch import SatelliteTasking, act, data, scene
from bsk_torch.presets.nadir_scan import ScanningSatellite, scanning_args

pytestmark = pytest.mark.compiled

SHORT = dict(time_limit=150.0, seed=3)


class Scanner(ScanningSatellite):
    """With actions of a sixth of the preset's lengths: ticks of the eager back end take milliseconds each."""

    action_spec = (act.Scan(duration=30.0), act.Charge(duration=20.0), act.Downlink(duration=10.0), act.Desat(duration=10.0))


def make(num_envs=3, sat_args=None, obs_type=torch.Tensor, kind=Scanner, **options):
    satellite = kind("Scanner1", sat_args=scanning_args() | (sat_args or {}), obs_type=obs_type)
    task = dict(
        scenario=scene.UniformNadirScanning(value_per_second=1 / 28500.0),
        rewarder=data.ScanningTimeReward(),
        failure_penalty=-1.0,
        terminate_on_time_limit=True,
    )
    return SatelliteTasking(satellite, num_envs=num_envs, **(task | SHORT | options))


def actions(steps, n, seed=0):
    return torch.randint(0, 4, (steps, n), generator=torch.Generator().manual_seed(seed))


def play(env, plan, td=None):
    """Play a plan [T, N] without resets in between; the outputs of each step."""
    td = env.reset() if td is None else td
    outputs = []
    for action in plan:
        td = env.step(td.select("observation").set("action", action))["next"]
        outputs.append(td.clone())
    return outputs


def equal(a, b, rows=slice(None)):
    return all(torch.equal(a[key], b[key][rows]) for key in ("observation", "reward", "done", "duration"))


def test_specs():
    check_env_specs(make(2), break_when_any_done="both")
    check_env_specs(make(2, obs_type=dict))


@pytest.mark.parametrize("backend", ["eager", "compiled"])
def test_one_alone_equals_one_of_many_bit_for_bit(backend):
    """A batch of 512 and the same environment alone; resets included."""
    plan, options = actions(2, 512), dict(time_limit=34.0, dtype=torch.float64, backend=backend)
    many = make(512, **options)
    together = play(many, plan)
    for i in (0, 7, 300):
        alone = make(1, **options, env_ids=[i])
        for a, b in zip(play(alone, plan[:, i : i + 1]), together, strict=True):
            assert equal(a, b, slice(i, i + 1))
        assert torch.equal(alone.get_state()["satellites_0", "planes"][0], many.get_state()["satellites_0", "planes"][i])


def test_a_pool_of_prepared_episodes_changes_nothing():
    """Second and third episodes of a large batch, which come from a pool, and of a small one, which do not."""
    many, few = make(33, env_ids=range(7, 40)), make(2, env_ids=[7, 8])
    assert many.pool is not None
    few.pool = None
    many.reset()
    few.reset()
    for row in (0, 1, 0):
        mask = torch.arange(33).unsqueeze(-1) == row
        a = many.reset(TensorDict({"_reset": mask}, [33]))
        b = few.reset(TensorDict({"_reset": mask[:2]}, [2]))
        assert torch.equal(a["observation"][row], b["observation"][row])
    assert torch.equal(many.get_state()["satellites_0", "planes"][:2], few.get_state()["satellites_0", "planes"])
    assert many.episode[:3].tolist() == [2, 1, 0]


def test_small_batches_prepare_several_episodes_from_the_second_one_on():
    """As many as have begun, up to a bound, with the numbers of episodes that are drawn one by one; none of another seed."""
    bulk, single = make(3), make(3)
    single.pool, begun = None, []
    start = bulk.pool.start
    bulk.pool.start = lambda fleet, rows, key: (begun.append(len(rows)), start(fleet, rows, key))
    for k in range(13):
        masks = torch.tensor([[True, k % 2 == 0, k % 3 == 0]]).mT
        some = TensorDict({"_reset": masks | (k == 0)}, [3])
        a, b = bulk.reset(some.clone()), single.reset(some.clone())
        assert torch.equal(a["observation"][masks[:, 0]], b["observation"][masks[:, 0]])
    assert bulk.episode.tolist() == [12, 6, 4]
    assert torch.equal(bulk.get_state()["satellites_0", "planes"], single.get_state()["satellites_0", "planes"])
    assert sum(begun) > sum(bulk.episode.tolist())
    assert len(begun) < 7
    for seed in range(3):
        bulk.set_seed(seed)
        bulk.reset()
    assert len(begun) < 7


def test_permutation():
    order = torch.tensor([4, 2, 0, 3, 1])
    plan = actions(3, 5)
    straight = play(make(5, dtype=torch.float64), plan)
    shuffled = play(make(5, dtype=torch.float64, env_ids=order), plan[:, order])
    assert len(straight) >= len(plan)
    for a, b in zip(shuffled, straight, strict=True):
        assert equal(a, b, order)


def test_partial_reset_touches_only_its_rows():
    env = make(4)
    play(env, actions(2, 4))
    before, old = env.get_state(), env.simulator.argument("wheelSpeeds").clone()
    env.reset(TensorDict({"_reset": torch.tensor([[True], [False], [True], [False]])}, [4]))
    after, speeds = env.get_state(), env.simulator.argument("wheelSpeeds")
    for key in before.keys(True, True):
        assert torch.equal(before[key][1::2], after[key][1::2]), key
    assert (after["satellites_0", "ticks"] == 0).tolist() == [True, False, True, False]
    assert (speeds != old).any(-1).tolist() == [True, False, True, False]


def test_partial_step_touches_only_its_rows():
    env = make(4)
    td = env.reset()
    before = env.get_state()
    mask = torch.tensor([[True], [False], [False], [True]])
    env.step(td.select("observation").set("action", torch.tensor([0, 1, 2, 3])).set("_step", mask))
    after = env.get_state()
    for key in before.keys(True, True):
        assert torch.equal(before[key][1:3], after[key][1:3]), key
    assert after["satellites_0", "ticks"].tolist() == [30, 0, 0, 10]


@pytest.mark.parametrize("way", ["set_state", "state_dict", "pickle", "deepcopy"])
def test_resume_equals_uninterrupted(way):
    plan = actions(4, 3)
    env = make()
    td = play(env, plan[:2])[-1]
    if way == "pickle":
        other = pickle.loads(pickle.dumps(env))
    elif way == "deepcopy":
        other = copy.deepcopy(env)
    elif way == "state_dict":
        other = make(seed=99)
        other.load_state_dict(env.state_dict())
    else:
        other = make(seed=99)
        other.reset(TensorDict({"state": env.get_state()}, [3]), set_state=True)
    for a, b in zip(play(other, plan[2:], td), play(env, plan[2:], td), strict=True):
        assert equal(a, b)
    assert torch.equal(other.reset()["observation"], env.reset()["observation"])


def test_state_of_a_step_is_restored_for_some_rows():
    env = make()
    play(env, actions(1, 3))
    saved = env.get_state()
    play(env, actions(1, 3, seed=1), env.reset())
    rows = torch.tensor([[False], [True], [False]])
    env.reset(TensorDict({"state": saved.clone(), "_reset": rows}, [3]), set_state=True)
    assert torch.equal(env.get_state()["satellites_0", "planes"][1], saved["satellites_0", "planes"][1])
    assert not torch.equal(env.get_state()["satellites_0", "planes"][0], saved["satellites_0", "planes"][0])


def test_actions_and_outputs_stay_what_they_were():
    """What was given to a step, and what it gave, is the caller's: neither later steps nor resets write to it."""
    env = make(4)
    td = env.reset()
    kept = []
    for action in actions(3, 4):
        td = td.set("action", action.clone())
        kept.append((td, td.clone()))
        td = env.step(td)["next"].exclude("reward")
        kept.append((td, td.clone()))
        env.reset(TensorDict({"_reset": torch.tensor([[True], [False], [True], [False]])}, [4]))
    assert len(kept) == 6
    for now, before in kept:
        for key in before.keys(True, True):
            assert torch.equal(now[key], before[key]), key


def test_seeds_name_episodes_whose_observations_follow_one_another():
    first, again, other = (make(2, seed=s).reset()["observation"] for s in (5, 5, 6))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    env = make(2, seed=5)
    one, two = env.reset()["observation"], env.reset()["observation"]
    assert not torch.equal(one, two), "every episode is a new one"
    rollout = make(2).rollout(4, break_when_any_done=False)
    assert torch.equal(rollout["observation"][:, 1:], rollout["next", "observation"][:, :-1])
    assert rollout["observation"].diff(dim=1).abs().sum() > 0


def test_time_limit_beats_the_action_and_terminates():
    env = make(2, time_limit=40.5)
    out = play(env, torch.tensor([[0, 1], [2, 1]]))
    assert out[0]["duration"].flatten().tolist() == [30.0, 20.0]
    assert out[1]["duration"].flatten().tolist() == [10.0, 20.0]
    assert env.requires_retasking.tolist() == [True, True]
    out = play(env, torch.tensor([[0, 0]]), out[1])[0]
    assert out["duration"].flatten().tolist() == [1.0, 1.0], "40.5 s is rounded up to 41"
    assert env.requires_retasking.tolist() == [False, False]
    assert out["truncated"].all()
    assert out["terminated"].all()
    assert play(env, torch.tensor([[0, 0]]), out)[0]["duration"].flatten().tolist() == [0.0, 0.0]


def test_time_limits_and_longest_steps():
    env = make(3, time_limit=bsk_torch.rand.per_env([100.0, 200.0, 300.0]))
    env.reset()
    assert env.state.limit_ticks.tolist() == [100, 200, 300]
    env = make(2, max_step_duration=8.0)
    assert play(env, torch.tensor([[0, 2]]))[0]["duration"].flatten().tolist() == [8.0, 8.0]
    assert not env.requires_retasking.any()


def test_a_long_episode_after_short_ones_has_all_its_windows():
    """Arcs are made for the limits of the first draw; a longer episode makes them longer, and leaves the others alone."""
    limit = [300.0]
    env, long = make(2, time_limit=lambda: limit[0]), make(2, time_limit=40000.0)
    env.reset()
    limit[0] = 40000.0
    before = env.get_state()["satellites_0", "lookahead", "arcs", "flown"][1].clone()
    long.reset()
    row = TensorDict({"_reset": torch.tensor([[True], [False]])}, [2])
    a, b = env.reset(row.clone()), long.reset(row.clone())
    assert torch.equal(a["observation"][0], b["observation"][0])
    mine, other = (e.simulator.access.windows["ground_station"] for e in (env, long))
    assert torch.equal(mine.close[0][mine.close[0] < 40000.0], other.close[0][other.close[0] < 40000.0])
    assert torch.equal(env.get_state()["satellites_0", "lookahead", "arcs", "flown"][1][: len(before)], before)


def test_dead_satellites_terminate_with_the_penalty():
    env = make(2, sat_args=dict(storedCharge_Init=bsk_torch.rand.per_env([100.0, 500000.0])))
    out = play(env, torch.tensor([[3, 3]]))[0]
    assert out["terminated"].flatten().tolist() == [True, False]
    assert out["reward"].flatten().tolist() == [-1.0, 0.0]
    assert env.satellite.aliveness()["battery_valid"].tolist() == [False, True]


class Drifter(ScanningSatellite):
    action_spec = (act.Drift(duration=3600.0),)


def test_endless_episodes_extend_their_look_ahead():
    env = SatelliteTasking(
        Drifter("Drifter1", sat_args=dict(wheelSpeeds=[0.0, 0.0, 0.0])), num_envs=2, sim_rate=60.0, backend="eager", seed=1
    )
    out = play(env, torch.zeros(7, 2, dtype=torch.int64))
    assert torch.isfinite(out[-1]["observation"]).all()
    assert not out[-1]["truncated"].any()
    assert (env.simulator.arcs.start > 0).all(), "arcs have moved on"
    assert (out[-1]["observation"][:, 8] > 0).all(), "the next pass closes in the future"


def test_callables_constants_and_distributions():
    draws = iter(range(1000))
    sat_args = dict(
        mass=lambda: 300.0 + next(draws), panelArea=0.5, u_max=bsk_torch.rand.Uniform(0.1, 0.2), nHat_B=[0.0, 0.0, -2.0]
    )
    env = make(3, sat_args=sat_args)
    env.reset()
    mass = env.satellite.sat_args["mass"]
    assert mass.diff().tolist() == [1.0, 1.0]
    assert torch.equal(env.satellite.sat_args["panelArea"], torch.full((3,), 0.5, dtype=torch.float64))
    assert ((env.satellite.sat_args["u_max"] >= 0.1) & (env.satellite.sat_args["u_max"] < 0.2)).all()


def test_nan_stays_in_its_row_and_is_named():
    env = make(3)
    plan = actions(3, 3)
    clean = play(make(3), plan)
    td = env.reset()
    env.simulator.state.planes[env.simulator.tick.state.slices["omega_BN_B"], 1] = torch.nan
    dirty = play(env, plan, td)
    for a, b in zip(dirty, clean, strict=True):
        assert equal(a[[0, 2]], b[[0, 2]])
    with pytest.raises(FloatingPointError, match=r"environment 1 .* at tick"):
        env.check_finite()
    make(1).check_finite()


def test_float32_simulation_stays_close():
    """Rounding of single precision in two actions of the preset; the README's table has the long run."""
    plan = actions(2, 4)
    double, single = (
        play(make(4, sim_dtype=dtype, dtype=torch.float64, kind=ScanningSatellite, time_limit=900.0), plan)
        for dtype in (torch.float64, torch.float32)
    )
    error = (double[-1]["observation"] - single[-1]["observation"]).abs().max()
    assert error < 2e-3, error


def test_parallel_env():
    env = ParallelEnv(2, functools.partial(make, 2), mp_start_method="forkserver")  # that of tests.support.programs
    try:
        rollout = env.rollout(2)
        assert rollout["observation"].shape == (2, 2, 2, 12)
    finally:
        env.close()


def test_reseeded_environments_begin_with_the_first_episode_of_their_seed():
    env, other = make(3), make(3, seed=8)
    first = other.reset()["observation"]
    env.reset()
    env.reseed([8, None, 8], torch.tensor([True, True, False]))
    assert env.state.seed.tolist() == [8, 3, 3]
    assert torch.equal(env.reset()["observation"][0], first[0])
    assert env.episode.tolist() == [0, 1, 1]
    env.reseed(8)
    assert torch.equal(env.reset()["observation"], first)
