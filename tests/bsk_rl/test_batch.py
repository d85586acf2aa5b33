"""Programs of bsk_rl without custom classes, as one batched simulation: episodes are those of single environments."""

import logging

import gymnasium
import numpy as np
import pytest

from bsk_torch.bsk_rl import GeneralSatelliteTasking, SatelliteTasking, act, comm, data, obs, sats, scene
from bsk_torch.bsk_rl.batch import BatchedVectorEnv, NotBatchedError
from bsk_torch.bsk_rl.sim import dyn, fsw
from bsk_torch.bsk_rl.utils.orbital import random_circular_orbit, random_orbit
from bsk_torch.bsk_rl.vector import EpisodesVectorEnv
from tests.bsk_rl.fakes import Copied, targets_of
from tests.support.refusals import check_refusals, refusal

N, SEED = 4, 3

WORLD = dict(utc_init="2012 MAR 05 09:12:05.830 (UTC)")


class Scanner(sats.AccessSatellite):
    observation_spec = [
        obs.SatProperties(
            dict(prop="storage_level_fraction"),
            dict(prop="battery_charge_fraction"),
            dict(prop="wheel_speeds_fraction"),
            dict(prop="r_BN_P", norm=7e6),
            dict(prop="late", fn=lambda satellite: satellite.simulator.sim_time > 300.0),
            dict(prop="radius", norm=7e6, fn=lambda satellite: np.linalg.norm(satellite.dynamics.r_BN_N)),
        ),
        obs.Eclipse(norm=5700.0),
        obs.Time(),
        obs.Time(observe_time_remaining=True, norm=1e3),
        obs.OpportunityProperties(dict(prop="opportunity_open", norm=5700.0), type="ground_station", n_ahead_observe=2),
    ]
    action_spec = [act.Scan(duration=180.0), act.Charge(duration=120.0), act.Downlink(), act.Desat(duration=60.0)]
    dyn_type = (dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel)
    fsw_type = fsw.ContinuousImagingFSWModel


class Imager(sats.ImagingSatellite):
    observation_spec = [
        obs.SatProperties(dict(prop="c_hat_P"), dict(prop="r_BN_P", norm=7e6)),
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="r_LB_H", norm=1e6),
            dict(prop="opportunity_close", norm=300.0),
            dict(prop="target_angle"),
            dict(prop="target_angle_rate", norm=0.01),
            dict(name="length", fn=lambda sat, opp: opp["window"][1] - opp["window"][0], norm=300.0),
            n_ahead_observe=3,
        ),
        obs.ResourceRewardWeight(),
    ]
    action_spec = [act.Image(n_ahead_image=5), act.Charge(duration=60.0)]
    dyn_type = dyn.ImagingDynModel
    fsw_type = fsw.ImagingFSWModel


class Unweighted(Imager):
    observation_spec = Imager.observation_spec[:2]


SCAN_ARGS = dict(storageInit=1000.0, maxWheelSpeed=6000.0, instrumentBaudRate=1e6, dataStorageCapacity=1e10)
IMAGE_ARGS = dict(
    imageAttErrorRequirement=0.05,
    imageRateErrorRequirement=0.05,
    u_max=0.5,
    oe=random_orbit,
    batteryStorageCapacity=lambda: np.random.uniform(3e5, 4e5),
)


def scanning(satellite=None, scenario=None, **options):
    return SatelliteTasking(
        satellite or Scanner("Scanner", SCAN_ARGS),
        scenario or scene.UniformNadirScanning(2.0),
        data.ScanningTimeReward(),
        world_args=WORLD,
        max_step_duration=300.0,
        **{"time_limit": lambda: np.random.uniform(600.0, 1200.0), **options},
    )


def imaging(satellite=None, scenario=None, alone=False, **options):
    images = data.UniqueImageReward(lambda priority: 10.0 if priority > 0.5 else priority)
    return SatelliteTasking(
        satellite or (Unweighted if alone else Imager)("Imager", IMAGE_ARGS, generation_duration=300.0),
        scenario or scene.UniformTargets((600, 700)),
        images if alone else (images, data.ResourceReward(1e-5, lambda satellite: satellite.dynamics.battery_charge)),
        world_args=WORLD,
        **{"time_limit": 2000.0, **options},
    )


def imaging_alone(*args, **options):
    """Return the program with a single rewarder, which hides targets that have been imaged."""
    return imaging(*args, alone=True, **options)


class Halved(data.UniqueImageReward):
    def calculate_reward(self, new_data_dict):
        return {name: 0.5 * value for name, value in super().calculate_reward(new_data_dict).items()}


class Northern(scene.UniformTargets):
    """Targets of the northern hemisphere."""

    def regenerate_targets(self):
        super().regenerate_targets()
        for target in self.targets:
            target.r_LP_P[2] = abs(target.r_LP_P[2])


def customized(satellite=None, scenario=None, **options):
    """Return a program with a custom rewarder and custom targets."""
    return SatelliteTasking(
        satellite or Unweighted("Imager", IMAGE_ARGS, generation_duration=300.0),
        scenario or Northern((1200, 1300)),
        Halved(),
        world_args=WORLD,
        **{"time_limit": 2000.0, **options},
    )


def single_like(vector, k, make):
    """Return a single environment whose episode begins as that of environment ``k`` of a batch."""
    one = vector.get_attr("satellite")[k]
    kind = {scanning: Scanner, imaging: Imager, imaging_alone: Unweighted, customized: Unweighted}[make]
    given = SCAN_ARGS if make is scanning else IMAGE_ARGS
    functions = [name for name, value in kind.default_sat_args(**given).items() if callable(value)]
    assert len(functions) >= 5
    drawn = given | {name: one.sat_args[name] for name in functions}
    drawn |= dict(oe=None, rN=one.dynamics.r_BN_N, vN=one.dynamics.v_BN_N)
    options = dict(time_limit=float(vector.core.time_limit[k]))
    if make is not scanning:
        options["scenario"] = targets_of(vector, k)
    generation = {} if make is scanning else {"generation_duration": 300.0}
    return make(kind(one.name, drawn, **generation), **options)


@pytest.mark.compiled
@pytest.mark.parametrize("make", [scanning, imaging, imaging_alone, customized])
def test_episodes_are_those_of_single_environments_in_the_same_state(make):
    vector = make(num_envs=N, vectorize="batched")
    assert isinstance(vector, BatchedVectorEnv)
    observations = vector.reset(seed=SEED)[0]
    singles = [single_like(vector, k, make) for k in range(N)]
    for k, one in enumerate(singles):
        np.testing.assert_allclose(one.reset(seed=0)[0], observations[k], atol=2e-6)
    assert vector.single_observation_space == singles[0].observation_space
    assert vector.single_action_space == singles[0].action_space
    generator, over, steps = np.random.default_rng(0), np.zeros(N, dtype=bool), 0
    rewards = 0.0
    while not over.all():
        actions = generator.integers(vector.single_action_space.n, size=N)
        found = vector.step(actions)
        for k in np.flatnonzero(~over):
            expected = singles[k].step(actions[k])
            np.testing.assert_allclose(found[0][k], expected[0], atol=2e-6)
            assert found[1][k] == pytest.approx(expected[1], abs=1e-6)
            assert (found[2][k], found[3][k]) == expected[2:4]
            assert found[4]["d_ts"][k] == pytest.approx(expected[4]["d_ts"], abs=1e-9)
            assert found[4]["requires_retasking"][k] == expected[4]["requires_retasking"]
            steps, rewards = steps + 1, rewards + abs(expected[1])
            over[k] = expected[2] or expected[3]
    assert steps > 4 * N
    assert rewards > N


def test_a_seed_gives_the_same_episodes_and_the_next_ones_follow():
    vector = scanning(num_envs=2, backend="eager", time_limit=100.0)
    first = vector.reset(seed=SEED)[0]
    vector.step(np.zeros(2, dtype=int))
    second = vector.step(np.zeros(2, dtype=int))[0]  # the next episodes have begun
    assert (second[:, -3] == 0.1).all()  # all of the time is left
    assert not np.allclose(first, second)
    np.testing.assert_array_equal(vector.reset(seed=SEED)[0], first)


def test_what_can_be_read_of_each_episode():
    vector = scanning(num_envs=2, backend="eager", time_limit=100.0)
    vector.reset(seed=SEED)
    assert [satellite.name for satellite in vector.get_attr("satellite")] == ["Scanner"] * 2
    assert [simulator.sim_time for simulator in vector.get_attr("simulator")] == [0.0, 0.0]
    with pytest.raises(AttributeError, match="vectorize='episodes'"):
        vector.get_attr("latest_step_duration")


def test_gymnasium_makes_batches():
    made = gymnasium.make_vec(
        "SatelliteTasking-v1", num_envs=3, satellite=Scanner("Scanner", SCAN_ARGS), scenario=scene.UniformNadirScanning(),
        rewarder=data.ScanningTimeReward(), time_limit=100.0, backend="eager", autoreset_mode="SameStep",
    )  # fmt: skip
    assert isinstance(made.unwrapped, BatchedVectorEnv)
    made.reset(seed=0)
    assert made.step(np.zeros(3, dtype=int))[4]["_final_obs"].all()


class Paying(data.ScanningTimeReward):
    def calculate_reward(self, new_data_dict):
        return dict.fromkeys(new_data_dict, 1.0)


class Talking(Scanner):
    def reset_post_sim_init(self):
        super().reset_post_sim_init()
        self.mine = 3


class Named(Scanner):
    observation_spec = [obs.Time()]


def changed():
    satellite = Scanner("Scanner", SCAN_ARGS)
    satellite.mine = 3
    return satellite


class Silent(comm.FreeCommunication):
    def communication_pairs(self):
        return []


class Reset(Copied):
    def reset_post_sim_init(self):
        self.mine = 3


def test_rejects_custom_classes_in_one_simulation():
    def batched(kind=SatelliteTasking, satellite=None, **changes):
        usual = dict(scenario=scene.UniformNadirScanning(), rewarder=data.ScanningTimeReward())
        return kind(satellite or Scanner("S", SCAN_ARGS), **usual | changes, backend="eager", num_envs=2, vectorize="batched")

    scanner = lambda args={}, **options: Scanner("S", SCAN_ARGS | args, **options)
    mine = type("Mine", (SatelliteTasking,), {})
    table = [
        refusal(lambda: batched(rewarder=(Paying(), data.NoReward())), NotBatchedError, "Paying", "custom class"),
        refusal(lambda: batched(satellite=Talking("S", SCAN_ARGS)), NotBatchedError, "Talking", "reset_post_sim_init"),
        refusal(lambda: batched(satellite=changed()), NotBatchedError, "Scanner", "attributes", "mine"),
        refusal(lambda: batched(satellite=scanner(obs_type=dict)), NotBatchedError, "obs_type", dict),
        refusal(lambda: batched(scenario=Reset([], [])), NotBatchedError, "Reset", "reset_post_sim_init", "regenerate_targets"),
        refusal(lambda: batched(communicator=Silent()), NotBatchedError, "Silent", "custom class"),
        refusal(lambda: batched(satellite=scanner(WORLD)), NotBatchedError, "utc_init", "sat_args", "world_args"),
        refusal(lambda: batched(satellite=scanner({"storageInit": -1.0})), NotBatchedError, "ValueError", "storageInit", -1),
        refusal(lambda: batched(mine), NotBatchedError, "Mine", "SatelliteTasking"),
        refusal(lambda: batched(GeneralSatelliteTasking, [scanner()]), NotBatchedError, "GeneralSatelliteTasking"),
        refusal(lambda: scanning(num_envs=2, vectorize="fast"), ValueError, "vectorize='fast'", ["auto", "batched", "episodes"]),
        refusal(lambda: scanning(vectorize="batched"), ValueError, "vectorize", "'batched'", "num_envs"),
    ]
    check_refusals(table)


def test_otherwise_environments_are_put_side_by_side_with_a_warning(caplog):
    with caplog.at_level(logging.WARNING):
        made = SatelliteTasking(
            Named("Named", SCAN_ARGS), scene.UniformNadirScanning(), Paying(), time_limit=100.0, backend="eager", num_envs=2
        )
    assert isinstance(made, EpisodesVectorEnv)
    assert "2 simulations side by side, which is slow: Paying is a custom class, for one episode" in caplog.text
    assert "migration_fast.md" in caplog.text


def test_a_class_that_only_names_its_specification_is_batched_whatever_its_bases():
    args = SCAN_ARGS | dict(oe=lambda: random_circular_orbit(alt=600.0))
    made = SatelliteTasking(Named("Named", args), time_limit=100.0, backend="eager", num_envs=2)
    assert isinstance(made, BatchedVectorEnv)
    made.reset(seed=0)
    radius = made.core.satellite.dynamics.r_BN_N.norm(dim=-1)
    np.testing.assert_allclose(radius, 6971000.0, atol=1.0)


def test_custom_targets_are_drawn_for_each_episode():
    vector = customized(num_envs=3, vectorize="batched", backend="eager")
    vector.reset(seed=SEED)
    first = vector.core.scenario.r_LP_P.clone()
    exists = vector.core.scenario.drawn("target_exists").bool()
    assert (first[..., 2] >= 0.0).all()
    assert ((exists.sum(1) >= 1200) & (exists.sum(1) < 1300)).all()
    vector.reset()
    assert not (vector.core.scenario.r_LP_P[0, :9] == first[0, :9]).any()
    vector.reset(seed=SEED)
    assert (vector.core.scenario.r_LP_P == first).all()
