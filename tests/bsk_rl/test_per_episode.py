"""Functions, rewarders and targets of one episode in a batch, and the views of one satellite that they read."""

import logging
from operator import attrgetter

import numpy as np
import pytest
import torch

from bsk_torch import SatelliteTasking as Core
from bsk_torch import act as core_act
from bsk_torch import obs as core_obs
from bsk_torch import sats as core_sats
from bsk_torch import scene as core_scene
from bsk_torch.bsk_rl import ConstellationTasking, SatelliteTasking, act, comm, data, obs, sats, scene
from bsk_torch.bsk_rl.data.base import Data, DataStore
from bsk_torch.bsk_rl.per_episode.functions import per_episode
from bsk_torch.bsk_rl.per_episode.targets import PerEpisodeTargets
from bsk_torch.bsk_rl.per_episode.views import view_of
from bsk_torch.bsk_rl.scene.targets import Target
from bsk_torch.bsk_rl.sim import dyn, fsw
from bsk_torch.rand import first_key
from tests.support.refusals import check_refusals, refusal

# -- functions -----------------------------------------------------------------------------------------------------------------


class Named(core_sats.Satellite):
    action_spec = (core_act.Drift(duration=10.0),)


def seen(function, num_envs=3):
    spec = (core_obs.SatProperties(dict(prop="x", fn=per_episode(function))),)
    made = type("Seen", (Named,), {"observation_spec": spec})("A")
    env = Core(made, num_envs=num_envs, backend="eager", seed=1, dtype=torch.float64)
    return env.satellite.dynamics.r_BN_N, env.reset()["observation"].squeeze(-1), env


@pytest.mark.parametrize("num_envs", [1, 3])
def test_functions_that_mix_episodes_or_fail_are_called_for_each(num_envs, caplog):
    def norm(sat):
        return np.linalg.norm(sat.dynamics.r_BN_N)

    def truth(sat):
        return 1.0 if sat.simulator.sim_time < 1.0 else 0.0

    with caplog.at_level(logging.WARNING):
        for function, expected in ((norm, lambda r: r.norm(dim=-1)), (truth, lambda r: torch.ones(num_envs))):
            _, found, env = seen(function, num_envs)
            torch.testing.assert_close(found, expected(env.satellite.dynamics.r_BN_N), rtol=1e-12, atol=0.0, check_dtype=False)
    assert caplog.text.count("is called for one episode after the other, which is slow") == 2


def test_functions_that_work_for_all_are_called_once():
    calls = []

    def charge(sat):
        calls.append(sat)
        return sat.dynamics.battery_charge_fraction

    env = seen(charge)[2]
    calls.clear()
    env.reset()
    env.rand_step()
    assert calls
    assert {type(satellite).__name__ for satellite in calls} == {"Seen"}


# -- views ---------------------------------------------------------------------------------------------------------------------


class SpeedyDynModel(dyn.GroundStationDynModel):
    @property
    def speed(self):
        return np.linalg.norm(self.v_BN_N)


class Imager(core_sats.ImagingSatellite):
    observation_spec = (core_obs.Time(),)
    action_spec = (core_act.Image(2),)
    dyn_type = SpeedyDynModel


@pytest.fixture(scope="module")
def env():
    env = Core(Imager("A"), core_scene.UniformTargets(300), num_envs=3, time_limit=1200.0, seed=1, backend="eager")
    env.reset()
    return env


@pytest.fixture(scope="module")
def one(env):
    return view_of(env.satellite, 2)


@pytest.mark.parametrize(
    "name", ["dynamics.r_BN_N", "dynamics.world.PN", "fsw.c_hat_P", "simulator.sim_time", "scenario.priority", "time_limit"]
)
def test_quantities_of_all_are_read_at_the_row(env, one, name):
    found, whole = (attrgetter(name)(satellite) for satellite in (one, env.satellite))
    assert isinstance(found, np.ndarray) == (whole.ndim > 1)
    assert np.array_equal(found, whole[2].numpy())


def test_other_names_of_one_satellite(env, one):
    assert (one.simulator.time_limit, one.simulator.sim_time_ns, one.simulator.sim_rate) == (1200.0, 0, 1.0)
    assert np.array_equal(one.sat_args["wheelSpeeds"], env.satellite.sat_args["wheelSpeeds"][2].numpy())
    assert one.dynamics.speed == pytest.approx(float(env.satellite.dynamics.v_BN_N[2].norm()), rel=1e-15)
    assert np.array_equal(one.others["A"].fsw.dynamics.satellite.dynamics.r_BN_N, one.dynamics.r_BN_N)
    assert one.is_alive() is one.dynamics.altitude_valid() is True
    assert one.next_eclipse() == tuple(time[2].item() for time in env.satellite.next_eclipse())
    assert (one.simulator.memory["imaged"], one.latest_target) == (0, None)
    assert one.dynamics.storageUnit.storageUnitDataOutMsg.read().storedDataName == ["image_buffer"]
    assert one.dynamics.instrument.nodeBaudRate == one.sat_args["instrumentBaudRate"] == one.dynamics.instrument_baud
    assert one.dynamics.scObject.scStateOutMsg.read().r_BN_N.tolist() == one.dynamics.r_BN_N.tolist()
    check_refusals(
        [
            refusal(lambda: setattr(one, "fuel", 1.0), AttributeError, "'fuel'", "read-only", "vectorize='episodes'"),
            refusal(lambda: one.dynamics.r_BN_Q, AttributeError, "SpeedyDynModel", "'r_BN_Q'", "'r_BN_N'"),
            refusal(lambda: one.sat_args["wheelSpeed"], KeyError, "'wheelSpeed'", "'wheelSpeeds'"),
            refusal(lambda: one.others["B"], KeyError, "'B'", "A"),
            refusal(lambda: one.opportunities_dict(types="targt"), ValueError, "'targt'", "'target'"),
            refusal(lambda: one.add_access_filter(lambda opportunity: True), AttributeError, "before the environment is built"),
        ]
    )


def test_opportunities_are_those_of_the_tensors(env, one):
    whole = env.satellite.find_next_opportunities(4, types="target")
    for k, found in enumerate(one.find_next_opportunities(4, types="target")):
        assert found["window"] == (whole.open[2, k].item(), whole.close[2, k].item())
        target = found["object"]
        assert (target.id, target.name) == (whole["object"].id[2, k], whole["object"].name[2, k])
        assert target.priority == whole["object"].priority[2, k].item()
        assert np.array_equal(target.r_LP_P, found["r_LP_P"])
    assert view_of(env.satellite, 1).find_next_opportunities(1, types="target")[0]["object"] != found["object"]


def test_queries_of_one_satellite(one):
    found = one.find_next_opportunities(4)
    closing = [opportunity["window"][1] for opportunity in found]
    assert closing == sorted(closing) == [opportunity["window"][1] for opportunity in one.upcoming_opportunities[:4]]
    first, second = one.find_next_opportunities(2, types="target")
    assert one.find_next_opportunities(1, types="target", filter=[first["object"]])[0]["object"] == second["object"]
    few = {first["object"].id, second["object"].id}
    only = {"types": "target", "filter": lambda opp: opp["object"].id in few, "max_lookahead": 2}
    padded = one.find_next_opportunities(500, **only)
    assert len(padded) == 500
    assert padded[-1] is padded[-2]
    with pytest.raises(RuntimeError, match="of 500 opportunities of type target found for environment 2"):
        one.find_next_opportunities(500, pad=False, **only)
    upcoming = one.upcoming_opportunities_dict(types="target")
    assert all(one.next_opportunities_dict(types="target")[target] == windows[0] for target, windows in upcoming.items())
    assert set(upcoming) <= set(one.known_targets)
    assert list(one.next_opportunities_dict(types="target", min_needed=3)) == list(upcoming)[:3]


# -- rewarders -----------------------------------------------------------------------------------------------------------------


class Visits(Data):
    def __init__(self, names=()):
        self.names = set(names)

    def __add__(self, other):
        return Visits(self.names | other.names)


class VisitStore(DataStore):
    data_type = Visits

    def get_log_state(self):
        return self.satellite.simulator.sim_time

    def compare_log_states(self, old_state, new_state):
        return Visits([f"{self.satellite.name} at {new_state:g}"])


class VisitReward(data.GlobalReward):
    data_store_type = VisitStore

    def initial_data(self, satellite):
        return Visits([f"{satellite.name} at 0"])

    def calculate_reward(self, new_data_dict):
        return {name: float(len(self.data.names) + len(new.names)) for name, new in new_data_dict.items()}

    def is_terminated(self, satellite):
        return len(satellite.data_store.data.names) >= 6


class Brief(sats.Satellite):
    observation_spec = [obs.SatProperties(dict(prop="visits", fn=lambda sat: len(sat.data_store.data.names)))]
    action_spec = [act.Charge(duration=5.0)]
    dyn_type = dyn.BasicDynamicsModel
    fsw_type = fsw.BasicFSWModel


def crew(rewarder, vectorize, communicator=None):
    return ConstellationTasking(
        [Brief(name) for name in "ABC"], rewarder=rewarder, communicator=communicator, time_limit=60.0, backend="eager",
        num_envs=2, vectorize=vectorize,
    )  # fmt: skip


@pytest.mark.parametrize("communicator", [comm.NoCommunication, comm.FreeCommunication])
def test_a_rewarder_in_a_batch_pays_as_in_single_episodes(communicator):
    batch, episodes = (crew(VisitReward(), vectorize, communicator()) for vectorize in ("batched", "episodes"))
    seen = [vector.reset(seed=1) for vector in (batch, episodes)]
    for _ in range(3):
        for agent in "ABC":
            for part, other in zip(*seen, strict=True):
                if not isinstance(part[agent], dict):
                    np.testing.assert_array_equal(part[agent], other[agent])
        seen = [vector.step({agent: [0, 0] for agent in "ABC"}) for vector in (batch, episodes)]
    assert batch.agents == episodes.agents


def test_records_begin_with_their_episode_and_cannot_be_copied():
    batch = crew(VisitReward(), "batched")
    batch.reset(seed=1)
    state = batch.core.get_state()
    batch.step({agent: [0, 0] for agent in "ABC"})
    check_refusals([refusal(batch.core.get_state, TypeError, "VisitReward", "copied and saved")])
    batch.core.restore(state)
    assert [len(store.data.names) for store in batch.core.satellites[0].data_store] == [1, 1]
    batch.reset(options={"reset_mask": np.array([True, False])})
    assert batch.step({agent: [0, 0] for agent in "ABC"})[1]["A"].tolist() == [4.0, 4.0]


class Wrong(VisitReward):
    def calculate_reward(self, new_data_dict):
        return {}


def test_rejects_rewards_of_one_episode_that_are_no_numbers():
    batch = crew(Wrong(), "batched")
    batch.reset(seed=1)
    step = lambda: batch.step({agent: [0, 0] for agent in "ABC"})
    check_refusals([refusal(step, TypeError, "Wrong.calculate_reward", {}, ["A", "B", "C"])])


class Chosen(data.UniqueImageReward):
    def create_data_store(self, satellite):
        super().create_data_store(satellite)
        satellite.add_access_filter(lambda opportunity: opportunity["object"].priority < 0.2, types="target")


class Photographer(sats.ImagingSatellite):
    observation_spec = [obs.OpportunityProperties(dict(prop="priority"), n_ahead_observe=2)]
    action_spec = [act.Image(2)]
    dyn_type, fsw_type = dyn.ImagingDynModel, fsw.ImagingFSWModel


def test_targets_of_a_rewarder_are_those_of_its_episode():
    made = Photographer("A"), scene.UniformTargets(500), Chosen()
    vector = SatelliteTasking(*made, time_limit=600.0, backend="eager", num_envs=2, vectorize="batched")
    for _ in range(2):
        vector.reset(options={"reset_mask": np.array([True, True])})
        for row in range(2):
            priority = [target.priority for target in vector.core.rewarder.records.of(row).scenario.targets]
            assert priority == vector.core.scenario.priority[row].tolist()


def test_filters_of_stores_hide_opportunities():
    made = Photographer("A"), scene.UniformTargets(500), Chosen()
    vector = SatelliteTasking(*made, time_limit=600.0, backend="eager", num_envs=2, vectorize="batched")
    assert (vector.reset(seed=1)[0] < 0.2).all()
    allowed = vector.core.satellite.allowed("target")
    assert torch.equal(allowed, vector.core.scenario.priority < 0.2)


# -- targets -------------------------------------------------------------------------------------------------------------------


class Bands(scene.UniformTargets):
    """Targets on circles of latitude, one of which is drawn for each episode, with the number of the band."""

    def regenerate_targets(self):
        self.targets, band = [], np.random.randint(1, 5)
        for k in range(self.n_targets):
            self.targets.append(Target(f"t{k}", [7e6, 0.0, 1e5 * band], 0.5))
            self.targets[-1].band = float(band)
            self.targets[-1].region = "north"


class Growing(scene.UniformTargets):
    def regenerate_targets(self):
        self.many = getattr(self, "many", 0)
        self.targets = [Target("one", [7e6, 0.0, 0.0], 1.0)] * int(np.random.randint(1, 9))


class Uneven(scene.UniformTargets):
    def regenerate_targets(self):
        super().regenerate_targets()
        self.targets[0].cover = 0.5


class Moving(scene.UniformTargets):
    def reset_post_sim_init(self):
        pass


def test_targets_of_one_episode_are_drawn_values():
    key = first_key(12)
    np.random.seed(1)
    before = np.random.get_state()[1].copy()
    values = PerEpisodeTargets(Bands((2, 6))).draw(key)
    assert (np.random.get_state()[1] == before).all()
    exists, band = values["target_exists"].bool(), values["target_band"]
    assert set(values) == {f"target_{name}" for name in ("exists", "r_LP_P", "priority", "band", "key")}
    assert exists.shape == band.shape == (12, 5)
    assert len(set(band[:, 0].tolist())) == 4
    assert torch.equal(values["target_r_LP_P"][..., 2][exists], 1e5 * band[exists])
    some = PerEpisodeTargets(Bands((2, 6))).draw(key.take([3, 1]))
    assert all(torch.equal(value[[3, 1]], some[name]) for name, value in values.items())
    check_refusals(
        [
            refusal(lambda: PerEpisodeTargets(Uneven(2)).draw(key), TypeError, "Target(tgt-1)", "'cover'"),
            refusal(lambda: PerEpisodeTargets(Growing(1)).draw(key), ValueError, "Growing.regenerate_targets()", "n_targets="),
            refusal(lambda: PerEpisodeTargets(Moving(1)), TypeError, "Moving", "reset_post_sim_init", "regenerate_targets"),
        ]
    )
