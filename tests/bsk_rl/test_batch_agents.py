"""Constellations of bsk_rl without custom classes, as one batched simulation: episodes are those of single environments."""

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from bsk_torch.bsk_rl import ConstellationTasking, act, comm, data, obs, sats, scene
from bsk_torch.bsk_rl.batch import NotBatchedError
from bsk_torch.bsk_rl.batch_agents import BatchedAgentsVectorEnv
from bsk_torch.bsk_rl.sim import dyn, fsw
from bsk_torch.bsk_rl.utils.orbital import walker_delta_args
from bsk_torch.bsk_rl.vector import AgentsVectorEnv
from tests.bsk_rl.fakes import targets_of
from tests.support.refusals import check_refusals, refusal

N, SEED = 4, 2

WORLD = dict(utc_init="2012 MAR 05 09:12:05.830 (UTC)")


class Imager(sats.ImagingSatellite):
    observation_spec = [
        obs.SatProperties(dict(prop="battery_charge_fraction"), dict(prop="r_BN_P", norm=7e6)),
        obs.OpportunityProperties(dict(prop="priority"), dict(prop="opportunity_close", norm=300.0), n_ahead_observe=3),
        obs.RelativeProperties(dict(prop="r_DC_N", norm=1e6), chief_name="A"),
    ]
    action_spec = [act.Image(n_ahead_image=3), act.Charge(duration=60.0)]
    dyn_type = dyn.ImagingDynModel
    fsw_type = fsw.ImagingFSWModel


class Weak(Imager):
    action_spec = [act.Image(n_ahead_image=2), act.Drift(duration=50.0), act.Charge(duration=80.0)]


class Charger(sats.Satellite):
    observation_spec = [obs.SatProperties(dict(prop="battery_charge_fraction")), obs.Time()]
    action_spec = [act.Drift(duration=50.0), act.Charge(duration=80.0)]
    dyn_type = dyn.BasicDynamicsModel
    fsw_type = fsw.BasicFSWModel


IMAGE_ARGS = dict(imageAttErrorRequirement=0.05, imageRateErrorRequirement=0.05, u_max=0.5)
WEAK = dict(batteryStorageCapacity=2000.0, storedCharge_Init=lambda: np.random.uniform(100.0, 1500.0), basePowerDraw=-3.0)
CLASSES = {"A": (Imager, IMAGE_ARGS), "B": (Imager, IMAGE_ARGS), "C": (Weak, IMAGE_ARGS | WEAK)}


def make(satellites=None, scenario=None, **options):
    """Return two imagers in one plane that tell each other all they know, and a satellite that dies in most episodes."""
    return ConstellationTasking(
        satellites or [kind(name, args) for name, (kind, args) in CLASSES.items()],
        scenario or scene.UniformTargets((900, 1000)),
        data.UniqueImageReward(),
        communicator=comm.FreeCommunication(),
        world_args=WORLD,
        failure_penalty=-2.0,
        **{"time_limit": 900.0, **options},
    )


def single_like(vector, k):
    """Return a single environment whose episode begins as that of environment ``k`` of a batch."""
    made = []
    for one in vector.get_attr("satellites")[k]:
        kind, given = CLASSES[one.name]
        functions = [name for name, value in kind.default_sat_args(**given).items() if callable(value)]
        drawn = given | {name: one.sat_args[name] for name in functions}
        made.append(kind(one.name, drawn | dict(oe=None, rN=one.dynamics.r_BN_N, vN=one.dynamics.v_BN_N)))
    return make(made, targets_of(vector, k))


@pytest.mark.compiled
def test_episodes_are_those_of_single_environments_in_the_same_state():
    vector = make(num_envs=N, sat_arg_randomizer=walker_delta_args(n_planes=1, altitude=600.0))
    assert isinstance(vector, BatchedAgentsVectorEnv)
    assert vector.possible_agents == list("ABC")
    observations, infos = vector.reset(seed=SEED)
    singles = [single_like(vector, k) for k in range(N)]
    for k, one in enumerate(singles):
        for agent, seen in one.reset(seed=0)[0].items():
            np.testing.assert_allclose(observations[agent][k], seen, atol=2e-6)
    for agent in "ABC":
        assert vector.single_observation_spaces[agent] == singles[0].observation_space(agent)
        assert vector.single_action_spaces[agent] == singles[0].action_space(agent)
        assert infos[agent]["present"].all()
    generator, steps, deaths, rewards, shared = np.random.default_rng(1), 0, 0, 0.0, 0
    while any(one.agents for one in singles):
        before = [list(one.agents) for one in singles]
        actions = {agent: generator.integers(space.n, size=N) for agent, space in vector.single_action_spaces.items()}
        results = vector.step(actions)
        for k, one in enumerate(singles):
            if not before[k]:
                continue
            expected = one.step({agent: actions[agent][k] for agent in before[k]})
            steps += 1
            for agent in "ABC":
                assert results[4][agent]["present"][k] == (agent in before[k])
                if agent not in before[k]:
                    assert all((part[agent][k] == 0).all() for part in results[:4])
                    continue
                np.testing.assert_allclose(results[0][agent][k], expected[0][agent], atol=2e-6)
                assert results[1][agent][k] == pytest.approx(expected[1][agent], abs=1e-6)
                assert [bool(results[place][agent][k]) for place in (2, 3)] == [expected[place][agent] for place in (2, 3)]
                assert results[4][agent]["d_ts"][k] == pytest.approx(expected[4][agent]["d_ts"], abs=1e-9)
                assert results[4][agent]["requires_retasking"][k] == expected[4][agent]["requires_retasking"]
                rewards += max(0.0, expected[1][agent])
                deaths += expected[2][agent]
            shared += len(before[k]) > 1
            assert vector.agents[k] == one.agents
    assert steps > 8 * N
    assert deaths >= 2
    assert rewards > 5.0


@pytest.fixture(scope="module")
def chargers():
    made = [Charger(name, WEAK) for name in "AB"]
    return ConstellationTasking(made, time_limit=200.0, backend="eager", num_envs=3, vectorize="batched")


def test_an_environment_without_agents_begins_again_in_the_next_step(chargers):
    first = chargers.reset(seed=SEED)[0]
    everybody = {agent: np.zeros(3, dtype=int) for agent in "AB"}
    begun = 0
    for _ in range(9):
        over = np.array([not left for left in chargers.agents])
        observations, rewards, terminated, truncated, infos = chargers.step(everybody)
        for k in np.flatnonzero(over):
            begun += 1
            assert infos["A"]["present"][k]
            assert infos["A"]["requires_retasking"][k]
            assert rewards["A"][k] == infos["A"]["d_ts"][k] == observations["A"][k, 1] == 0.0
            assert not terminated["A"][k]
            assert not truncated["A"][k]
            assert chargers.agents[k] == ["A", "B"]
    assert begun >= 3
    np.testing.assert_array_equal(chargers.reset(seed=SEED)[0]["A"], first["A"])


def test_some_environments_are_reset():
    vector = ConstellationTasking([Charger("A", WEAK)], time_limit=100.0, backend="eager", num_envs=2, autoreset_mode="Disabled")
    with pytest.raises(ResetNeeded):
        vector.step({"A": [0, 0]})
    vector.reset(seed=SEED)
    while all(vector.agents):
        observations = vector.step({"A": [0, 0]})[0]
    with pytest.raises(ResetNeeded, match="reset_mask"):
        vector.step({"A": [0, 0]})
    over = np.array([not left for left in vector.agents])
    later = vector.reset(options={"reset_mask": over})[0]
    assert (later["A"][over, 1] == 0.0).all()
    kept = later["A"][~over]
    np.testing.assert_array_equal(kept, observations["A"][~over])


def test_rejects_wrong_calls_of_agents(chargers):
    def batched(*names, **options):
        return ConstellationTasking([Charger(name, WEAK) for name in names], backend="eager", num_envs=2, **options)

    chargers.reset(seed=SEED)
    crew = dict(meta_agent_groupings={"both": ["A", "B"]}, vectorize="batched")
    table = [
        refusal(lambda: chargers.step({"C": [0, 0, 0]}), KeyError, "'C'", ["A", "B"]),
        refusal(lambda: chargers.step({"A": [0, 0]}), ValueError, "actions['A']", 2, 3),
        refusal(lambda: chargers.step({"A": 0}), ValueError, "actions['A']=0", 3),
        refusal(lambda: chargers.step({"A": [0.7, 0.0, 0.0]}), TypeError, "actions['A']", "float64", "int64"),
        refusal(lambda: chargers.step(np.zeros((3, 2), dtype=np.int64)), TypeError, "actions", "array([[0, 0]", ["A", "B"]),
        refusal(lambda: chargers.reset(options={"reset_mask": np.zeros(3, dtype=bool)}), ValueError, "reset_mask", [3]),
        refusal(lambda: chargers.get_attr("simulator"), AttributeError, "'simulator'", "vectorize='episodes'"),
        refusal(lambda: batched("A", autoreset_mode="SameStep"), ValueError, "autoreset_mode", "'SameStep'", "'NextStep'"),
        refusal(lambda: batched("A", "B", **crew), NotBatchedError, "meta_agent_groupings", "several satellites"),
    ]
    check_refusals(table)


def test_meta_agents_are_put_side_by_side():
    made = ConstellationTasking(
        [Charger("A", WEAK), Charger("B", WEAK)], meta_agent_groupings={"both": ["A", "B"]}, time_limit=100.0, backend="eager",
        num_envs=2,
    )  # fmt: skip
    assert isinstance(made, AgentsVectorEnv)
    assert made.reset(seed=0)[0]["both"].shape == (2, 4)
