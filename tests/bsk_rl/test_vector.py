"""The vector form: N environments of one program, side by side, each as a single one under its seed."""

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from bsk_torch.bsk_rl import (
    NO_ACTION,
    ConstellationTasking,
    GeneralSatelliteTasking,
    SatelliteTasking,
    act,
    comm,
    data,
    obs,
    sats,
)
from bsk_torch.bsk_rl.sim import dyn, fsw
from bsk_torch.bsk_rl.vector import AgentsVectorEnv, EpisodesVectorEnv
from tests.support.refusals import check_refusals, refusal

N, SEED = 3, 5


class Noisy(sats.Satellite):
    """Draws from NumPy's global generator in every observation."""

    observation_spec = [
        obs.SatProperties(dict(prop="r_BN_N"), dict(prop="noise", fn=lambda satellite: np.random.rand())),
        obs.Time(),
    ]
    action_spec = [act.Drift(duration=20.0), act.Charge(duration=10.0)]
    dyn_type = dyn.BasicDynamicsModel
    fsw_type = fsw.BasicFSWModel


def single(**options):
    if "num_envs" in options:
        options = {"vectorize": "episodes", **options}
    return SatelliteTasking(Noisy("Noisy"), time_limit=lambda: np.random.uniform(30.0, 66.0), backend="eager", **options)


@pytest.fixture(scope="module")
def vector():
    return single(num_envs=N)


def test_the_spaces_are_batches_of_those_of_one(vector):
    assert isinstance(vector, EpisodesVectorEnv)
    one = single()
    assert vector.single_observation_space == one.observation_space
    assert vector.single_action_space == one.action_space
    assert vector.observation_space.shape == (N, 5)


def test_episodes_are_those_of_single_environments_though_all_draw_from_the_same_generator(vector):
    observations, infos = vector.reset(seed=SEED)
    singles = [single() for _ in range(N)]
    actions = np.array([[0, 1, 0], [1, 1, 0]])
    expected = []
    for k, one in enumerate(singles):  # one whole episode after the other: the generator is not shared
        first = one.reset(seed=SEED + k)[0]
        expected.append([first, *(one.step(int(row[k])) for row in actions)])
    np.testing.assert_array_equal(observations, [each[0] for each in expected])
    assert infos["requires_retasking"].all()
    for number, row in enumerate(actions):
        found = vector.step(row)
        for place in range(4):
            np.testing.assert_array_equal(found[place], [each[number + 1][place] for each in expected])
        np.testing.assert_array_equal(found[4]["d_ts"], [each[number + 1][4]["d_ts"] for each in expected])
    assert len({tuple(row) for row in found[0]}) == N


def test_the_generator_of_the_caller_is_left_alone(vector):
    vector.reset(seed=SEED)
    np.random.seed(1)
    wanted = np.random.RandomState(1).rand(3)
    found = [np.random.rand()]
    vector.step(np.zeros(N, dtype=int))
    found.append(np.random.rand())
    vector.reset()
    np.testing.assert_array_equal([*found, np.random.rand()], wanted)


def run(vector, steps, action=0):
    """Return the flags and observations of some steps."""
    return [vector.step(np.full(N, action))[:4] for _ in range(steps)]


def test_the_next_step_begins_the_next_episode_whose_seed_follows_from_the_first(vector):
    vector.reset(seed=SEED)
    first = run(vector, 6)
    ended = np.array([row[2] | row[3] for row in first])
    assert ended.any(0).all()
    row = int(np.flatnonzero(ended[:, 0])[0]) + 1
    assert first[row][1][0] == 0.0
    assert not first[row][2][0]
    assert not first[row][3][0]
    follower = single()
    follower.reset(seed=SEED)
    later = int(follower.np_random.integers(2**32))
    np.testing.assert_array_equal(first[row][0][0], follower.reset(seed=later)[0])
    vector.reset(seed=SEED)
    for again, before in zip(run(vector, 6), first, strict=True):
        for a, b in zip(again, before, strict=True):
            np.testing.assert_array_equal(a, b)


def test_other_autoreset_modes():
    same = single(num_envs=2, autoreset_mode="SameStep")
    assert same.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    same.reset(seed=SEED)
    for _ in range(4):
        observations, _, terminated, truncated, infos = same.step(np.zeros(2, dtype=int))
        if (terminated | truncated).any():
            break
    row = int(np.flatnonzero(terminated | truncated)[0])
    assert infos["final_obs"][row][-1] == pytest.approx(1.0)  # fraction of the time limit
    assert observations[row][-1] == 0.0
    disabled = single(num_envs=2, autoreset_mode=AutoresetMode.DISABLED)
    disabled.reset(seed=SEED)
    disabled.step(np.zeros(2, dtype=int))
    kept = disabled.get_attr("simulator")[1].sim_time
    disabled.reset(options={"reset_mask": np.array([True, False])})
    assert [simulator.sim_time for simulator in disabled.get_attr("simulator")] == [0.0, kept]


def test_attributes_and_methods_of_the_environments(vector):
    vector.reset(seed=SEED)
    assert [found.name for found in vector.call("get_satellite", "Noisy")] == ["Noisy"] * N
    assert len({id(found) for found in vector.get_attr("satellite")}) == N
    vector.set_attr("max_step_duration", [4.0, 8.0, 12.0])
    vector.reset(seed=SEED)
    np.testing.assert_allclose(vector.step(np.zeros(N, dtype=int))[4]["d_ts"], [4.0, 8.0, 12.0])
    vector.set_attr("max_step_duration", 1e9)


def test_gymnasium_makes_vectors():
    made = gymnasium.make_vec("SatelliteTasking-v1", num_envs=2, satellite=Noisy("Noisy"), time_limit=100.0, backend="eager")
    assert isinstance(made.unwrapped, EpisodesVectorEnv)
    assert made.reset(seed=0)[0].shape == (2, 5)
    with pytest.raises(gymnasium.error.Error, match=r"bsk_torch\.bsk_rl\.ConstellationTasking\(.*num_envs=2\)"):
        gymnasium.make_vec("ConstellationTasking-v1", num_envs=2, satellites=[Noisy("Noisy")])


def test_one_environment_of_the_vector_form_has_its_dimension_too():
    assert single(num_envs=1).reset(seed=0)[0].shape == (1, 5)


def test_several_satellites_of_one_agent():
    def make(**options):
        return GeneralSatelliteTasking([Noisy("A"), Noisy("B")], time_limit=35.0, backend="eager", **options)

    vector = make(num_envs=2)
    observations, infos = vector.reset(seed=SEED)
    assert [part.shape for part in observations] == [(2, 5), (2, 5)]
    assert infos["A"]["requires_retasking"].all()
    found = vector.step((np.array([0, NO_ACTION]), np.array([1, 0])))
    for k, actions in enumerate(((0, 1), (NO_ACTION, 0))):
        one = make()
        one.reset(seed=SEED + k)
        expected = one.step(actions)
        for part, wanted in zip(found[0], expected[0], strict=True):
            np.testing.assert_array_equal(part[k], wanted)
        assert found[1][k] == expected[1]


class Weak(Noisy):
    """Dies of an empty battery in some episodes."""

    observation_spec = [obs.SatProperties(dict(prop="battery_charge_fraction")), obs.Time()]


class Spent(data.ResourceReward):
    """Charge that has been spent; draws a little."""

    def calculate_reward(self, new_data_dict):
        return {name: value + 1e-3 * np.random.rand() for name, value in super().calculate_reward(new_data_dict).items()}


def constellation(**options):
    args = dict(
        batteryStorageCapacity=1000.0, storedCharge_Init=lambda: np.random.uniform(100.0, 900.0), basePowerDraw=-6.0, oe=None,
        rN=[7e6, 0.0, 0.0], vN=[0.0, 7.5e3, 0.0],
    )  # fmt: skip
    return ConstellationTasking(
        [Weak("A", args), Weak("B", args)],
        rewarder=Spent(resource_fn=lambda satellite: satellite.dynamics.battery_charge),
        communicator=comm.FreeCommunication(),
        time_limit=100.0,
        backend="eager",
        **options,
    )


@pytest.fixture(scope="module")
def agents():
    return constellation(num_envs=N)


def test_agents_get_arrays_by_name_as_single_environments_give_numbers(agents):
    assert isinstance(agents, AgentsVectorEnv)
    assert agents.possible_agents == ["A", "B"]
    assert agents.observation_space("A").shape == (N, 2)
    expected = []
    for k in range(N):
        one = constellation()
        played = [one.reset(seed=SEED + k)]
        while one.agents and len(played) < 9:
            played.append((list(one.agents), one.step(dict.fromkeys(one.agents, 0))))
        expected.append(played)
    assert {len(played) for played in expected} != {9}, "no episode has ended"
    observations, infos = agents.reset(seed=SEED)
    np.testing.assert_array_equal(observations["B"], [played[0][0]["B"] for played in expected])
    assert infos["A"]["present"].all()
    lost = 0
    for number in range(1, min(map(len, expected))):
        results = agents.step({name: np.zeros(N, dtype=int) for name in agents.possible_agents})
        for k, played in enumerate(expected):
            left, wanted = played[number]
            for name in agents.possible_agents:
                assert results[4][name]["present"][k] == (name in left)
                for found, part in zip(results[:4], wanted[:4], strict=True):
                    np.testing.assert_array_equal(found[name][k], part[name] if name in left else np.zeros_like(found[name][k]))
                lost += name not in left
        assert agents.agents == [one.agents for one in agents.get_attr("unwrapped")]
    assert lost, "no agent has left before its environment ended"


def test_an_environment_without_agents_begins_again_in_the_next_step(agents):
    agents.reset(seed=SEED)
    everybody = {name: np.zeros(N, dtype=int) for name in agents.possible_agents}
    times = []
    for _ in range(12):
        before = [bool(left) for left in agents.agents]
        _, rewards, terminated, _, infos = agents.step(everybody)
        times.append(infos["A"]["d_ts"])
        for k in np.flatnonzero(~np.array(before)):
            assert agents.agents[k] == ["A", "B"]
            assert rewards["A"][k] == 0.0
            assert not terminated["A"][k]
    assert (np.array(times)[1:] == 0.0).any(), "no environment has begun again"


def test_agents_without_autoreset():
    vector = constellation(num_envs=2, autoreset_mode="Disabled")
    everybody = {name: np.zeros(2, dtype=int) for name in "AB"}
    with pytest.raises(ResetNeeded):
        vector.step(everybody)
    vector.reset(seed=SEED)
    while all(vector.agents):
        vector.step(everybody)
    with pytest.raises(ResetNeeded, match="reset_mask"):
        vector.step(everybody)
    over = np.array([not left for left in vector.agents])
    before = vector.get_attr("simulator")
    observations, infos = vector.reset(options={"reset_mask": over})
    assert observations["A"].shape == (2, 2)
    assert (infos["A"]["d_ts"][over] == 0.0).all()
    assert [one is two for one, two in zip(before, vector.get_attr("simulator"), strict=True)] == (~over).tolist()
    vector.step(everybody)


def test_rejects_wrong_calls(agents):
    agents.reset(seed=SEED)
    table = [
        *(refusal(lambda n=n: single(num_envs=n), ValueError, "num_envs", repr(n)) for n in (0, -1, 2.5, "3", True)),
        refusal(lambda: single(autoreset_mode="SameStep"), ValueError, "autoreset_mode", "'SameStep'", "num_envs"),
        refusal(lambda: agents.step({"C": np.zeros(N, dtype=int)}), KeyError, "'C'", ["A", "B"]),
        refusal(lambda: agents.step({"A": np.zeros(2, dtype=int)}), ValueError, "actions['A']", 2, N),
        refusal(lambda: agents.step({"A": 0}), ValueError, "actions['A']=0", N),
        refusal(lambda: agents.step(np.zeros(N, dtype=int)), TypeError, "actions", "array([0, 0, 0])", ["A", "B"]),
        refusal(lambda: agents.reset(seed=[1, 2]), ValueError, "seed", 2, N),
        refusal(lambda: agents.reset(options={"reset_mask": np.zeros(N, dtype=bool)}), ValueError, "reset_mask", [N]),
        refusal(lambda: constellation(num_envs=2, autoreset_mode="SameStep"), ValueError, "autoreset_mode", "'SameStep'"),
        refusal(lambda: agents.set_attr("max_step_duration", [1.0, 2.0]), ValueError, "values", 2, N),
    ]
    check_refusals(table)
