"""Satellites that image others in the drop-in; ``programs.spacecraft`` flies as bsk_rl does."""

import logging
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bsk_torch.bsk_rl import ConstellationTasking, act, data, obs, sats, scene
from bsk_torch.bsk_rl.data.rso_imaging import RSOImageData
from bsk_torch.bsk_rl.sim import dyn, fsw
from bsk_torch.bsk_rl.utils.rso_imaging import RSOImageRecord, candidate_snapshot, target_geometry
from tests.bsk_rl.fakes import Fake, begin
from tests.support.refusals import check_refusals, refusal

EPOCH = "2026 OCT 01 00:00:00.000 (UTC)"


class Imager(sats.Satellite):
    observation_spec = [obs.RSOTargetProperties(dict(prop="valid"), dict(prop="priority"), n_ahead_observe=3)]
    action_spec = [
        act.ImageRSO(2, max_duration=30.0, min_pointing_hold_s=5.0, require_illumination_during_hold=False),
        act.Downlink(duration=30.0),
        act.Charge(duration=5.0),
    ]
    dyn_type = (dyn.SpaceToSpaceImagingDynModel, dyn.GroundStationDynModel)
    fsw_type = fsw.SpaceToSpaceImagingFSWModel


class Target(sats.Satellite):
    observation_spec = [obs.SatProperties(dict(prop="sigma_BN"))]
    action_spec = [act.Drift(duration=1e9)]
    dyn_type = dyn.RSOTargetDynModel
    fsw_type = fsw.FSWModel


NEAR = [
    scene.RSOTarget("near", "A", (7e6 + 1e3, 0.0, 0.0), (0.0, 7500.0, 0.0), priority=2.0),
    scene.RSOTarget("rso/2", "B", (7e6 + 2e3, 0.0, 0.0), (0.0, 7500.0, 0.0)),
]
CAMERA = dict(
    rN=[7e6, 0.0, 0.0],
    vN=[0.0, 7500.0, 0.0],
    oe=None,
    sigma_init=[0.0, 0.0, 0.0],
    omega_init=[0.0, 0.0, 0.0],
    wheelSpeeds=[0.0, 0.0, 0.0],
    imageAttErrorRequirement=2.0,
    instrumentBaudRate=1000,
    transmitterBaudRate=-100,
)


def make(kind=Imager, catalog=None, rewarder=None, **options):
    catalog = scene.RSOTargetCatalog(NEAR) if catalog is None else catalog
    return ConstellationTasking(
        [Target("A"), kind("Eye", dict(CAMERA)), Target("B")],
        scene.RSOTargets(catalog, ["Eye"]),
        rewarder or data.RSOImageReward(quality_threshold=0.0),
        world_args=dict(utc_init=EPOCH, gsMinimumElevation=np.radians(-90.0)),
        time_limit=200.0,
        backend="eager",
        **options,
    )


def act_of(action, **others):
    return {"Eye": action} | others


IMAGER_ARGUMENTS = ("instrumentBaudRate", "imageTargetMaximumRange", "transmitterPacketSize")

REST = {"A": 0, "B": 0}


@pytest.fixture(scope="module")
def env():
    return make()


def test_an_image_is_taken_waits_and_comes_down(env):
    seen, _ = env.reset(seed=0)
    eye = env.get_satellite("Eye")
    np.testing.assert_array_equal(seen["Eye"], [1.0, 2.0, 1.0, 1.0, 0.0, 0.0])
    assert eye.observation_builder.observation_spec[0].candidate_ids() == ("near", "rso/2", None)
    _, reward, *_, info = env.step(act_of(0, **REST))
    (record,) = eye.fsw.rso_capture.records
    assert (record.record_id, record.target_id, record.capture_time) == ("Eye:1", "near", 7.0)
    assert (record.size_bits, record.hold_valid_time_s, record.delivery_time) == (1000.0, 5.0, None)
    assert info["Eye"]["requires_retasking"]
    assert info["__common__"]["d_ts"] == 7.0
    assert reward["Eye"] == 0.0
    assert env.scenario.pending == {"near": {"Eye:1"}}
    assert eye.dynamics.storage_level == 1000.0
    with pytest.raises(ValueError, match="'near' cannot be chosen: it is pending or in cooldown"):
        env.step(act_of("near"))
    _, reward, *_ = env.step(act_of(2))
    assert reward["Eye"] == 2.0
    assert eye.data_store.data.deliveries["Eye:1"] == replace(record, delivery_time=37.0)
    assert env.rewarder.last_reward_components == {
        "acquisition": {"A": 0.0, "Eye": 0.0, "B": 0.0},
        "delivery": {"A": 0.0, "Eye": 2.0, "B": 0.0},
    }
    assert not env.scenario.pending["near"]


def test_another_command_or_the_deadline_ends_a_task():
    class Slow(Imager):
        action_spec = [act.ImageRSO(2, max_duration=20.0, min_pointing_hold_s=100.0), act.Charge(duration=5.0)]

    env = make(Slow, max_step_duration=10.0)
    env.reset(seed=0)
    capture = env.get_satellite("Eye").fsw.rso_capture
    env.step(act_of("rso/2", **REST))
    assert capture.target.id == "rso/2"
    env.step(act_of(2))
    assert capture.target is None
    env.step(act_of("near"))
    *_, info = env.step(act_of(None))
    assert info["Eye"]["requires_retasking"]
    assert capture.target is None
    assert capture.held_s == 0.0
    assert capture.records == []
    assert env.satellites[1].action_builder.action_spec[0].chosen_target_ids == ["rso/2", "near"]


def test_rejects_wrong_actions(env):
    def empty():
        env.scenario.cooldown_until["near"] = 1e9
        env.scenario.revision += 1
        candidate_snapshot(eye, 3)
        env.step(act_of(1))

    env.reset(seed=0)
    eye = env.get_satellite("Eye")
    table = [
        refusal(lambda: env.step(act_of("nera", **REST)), ValueError, "'nera'", "'near'"),
        refusal(empty, ValueError, "action=1", "image_rso", "candidate"),
        refusal(lambda: eye.fsw.action_image([7e6, 0.0, 0.0]), NotImplementedError, "satellites", "act.ImageRSO"),
    ]
    check_refusals(table)


def test_what_was_observed_counts_where_the_candidates_have_changed(env):
    env.reset(seed=0)
    env.scenario.revision += 1
    with pytest.warns(UserWarning, match="the action means the target that was observed"):
        env.step(act_of(1, **REST))
    assert env.get_satellite("Eye").fsw.rso_capture.records[0].target_id == "rso/2"


def test_models_of_imagers_and_of_others(env):
    env.reset(seed=0)
    eye, target = env.get_satellite("Eye"), env.get_satellite("A")
    geometry = target_geometry(eye, env.scenario.targets_by_id["near"])
    np.testing.assert_allclose(geometry[0], [1e3, 0.0, 0.0], atol=1e-6)
    assert geometry[1:] == pytest.approx((1e3, 90.0))
    assert {key: m.read().hasAccess for key, m in eye.dynamics.rso_access_messages.items()} == {"near": 1, "rso/2": 1}
    assert set(eye.dynamics.rso_partition_names.values()) == set(eye.sat_args["bufferNames"])
    assert target.sat_args["batteryStorageCapacity"] == 288000.0
    for holder, name in ((target.dynamics, "rso_partition_names"), (target.fsw, "rso_capture")):
        assert not hasattr(holder, name)
    with pytest.raises(ValueError, match="Eye knows the target 'near' already"):
        eye.dynamics.bind_rso_target(env.scenario.targets_by_id["near"])
    with pytest.raises(ValueError, match="Eye does not know the target 'else'"):
        eye.fsw.action_image_rso(SimpleNamespace(id="else"))


def test_catalogs_follow_the_epoch_or_have_it(env, tmp_path):
    env.reset(seed=0)
    assert env.scenario.catalog.utc_init == EPOCH
    env.scenario.catalog.save(tmp_path / "catalog.json")
    assert scene.RSOTargetCatalog.load(tmp_path / "catalog.json") == env.scenario.catalog
    other = make(catalog=scene.RSOTargetCatalog(NEAR, utc_init="2020 OCT 01 00:00:00.000 (UTC)"))
    with pytest.raises(ValueError, match="the catalog has utc_init='2020 OCT 01"):
        other.reset(seed=0)


def test_priorities_change_after_the_reward_of_a_step():
    events = [scene.RSOPriorityEvent(0.0, (("near", 3.0),)), scene.RSOPriorityEvent(5.0, (("near", 7.0),))]
    worth = data.RSOImageReward(acquisition_reward_fn=lambda record, target: target.priority, quality_threshold=0.0)
    env = make(catalog=scene.RSOTargetCatalog(NEAR, priority_events=events), rewarder=worth)
    seen, _ = env.reset(seed=0)
    assert seen["Eye"][1] == 3.0
    seen, reward, *_ = env.step(act_of("near", **REST))
    assert reward["Eye"] == 3.0
    assert env.scenario.targets_by_id["near"].priority == 7.0
    assert env.scenario.applied_events == [(0, 0.0), (1, 7.0)]


def test_rejects_wrong_satellites():
    def built(*satellites):
        scenario = scene.RSOTargets(scene.RSOTargetCatalog(NEAR), ["Eye"])
        ConstellationTasking(list(satellites), scenario, backend="eager").reset(seed=0)

    blind = type("Blind", (Target,), {"dyn_type": dyn.DynamicsModel})
    a, b, eye, spare = Target("A"), Target("B"), Imager("Eye"), Imager("Spare")
    needed = "SpaceToSpaceImagingDynModel"
    table = [
        refusal(lambda: built(a, eye, spare, b), ValueError, ["Spare"], needed, "imager_names"),
        refusal(lambda: built(a, eye), ValueError, "'B'", "A, Eye"),
        refusal(lambda: built(a, Target("A"), eye), ValueError, ["A"], "unique names"),
        refusal(lambda: built(a, Target("Eye"), b), ValueError, "imager Eye", "RSOTargetDynModel", needed),
        refusal(lambda: built(blind("A"), eye, b), ValueError, "target A", "dyn.RSOTargetDynModel"),
    ]
    check_refusals(table)


def test_several_episodes_are_flown_side_by_side(caplog):
    with caplog.at_level(logging.WARNING):
        env = make(num_envs=2)
    assert "2 simulations side by side, which is slow: RSOImageReward is for one episode at a time" in caplog.text
    env.reset(seed=0)
    seen, *_ = env.step({"Eye": np.array([0, 1]), "A": np.zeros(2, int), "B": np.zeros(2, int)})
    np.testing.assert_array_equal(seen["Eye"], [[1.0, 1.0, 0.0, 0.0, 0.0, 0.0], [1.0, 2.0, 0.0, 0.0, 0.0, 0.0]])


def test_arguments_of_imagers_and_targets():
    images, range_, packet = (Imager("Eye").sat_args_generator[name] for name in IMAGER_ARGUMENTS)
    assert (images, range_, packet) == (8e6, -1, -1)
    assert "transmitterBaudRate" not in Target("A").sat_args_generator


# -- rewards ---------------------------------------------------------------------------------------------------------------------


class Eye(Fake):
    dyn_type, fsw_type = dyn.SpaceToSpaceImagingDynModel, fsw.SpaceToSpaceImagingFSWModel

    def __init__(self, name):
        super().__init__(name)
        self.capture = SimpleNamespace(records=[], check_capture=lambda: False)
        self.fsw = SimpleNamespace(rso_capture=self.capture)
        self.scenario, self.sat_args = None, {}

    @property
    def dynamics(self):
        names = [self.rso_scenario.partition_name(target.id) for target in NEAR]
        message = SimpleNamespace(storedDataName=names, storedData=list(self.levels))
        unit = SimpleNamespace(storageUnitDataOutMsg=SimpleNamespace(read=lambda: message))
        return SimpleNamespace(storageUnit=unit, bind_rso_target=lambda target: None)

    def take(self, target_id, time, quality=1.0):
        number = len(self.capture.records) + 1
        self.capture.records.append(RSOImageRecord(f"{self.name}:{number}", target_id, self.name, time, 10.0, quality, 5.0))
        self.levels[[target.id for target in NEAR].index(target_id)] += 10.0


class Still(Fake):
    dyn_type, fsw_type = dyn.RSOTargetDynModel, fsw.FSWModel

    def __init__(self, name):
        super().__init__(name)
        self.sat_args = {}


def play(**options):
    """Return a rewarder, two imagers, and a function that ends a step and returns their rewards."""
    rewarder, eyes = data.RSOImageReward(**dict(quality_threshold=0.5) | options), [Eye("Eye"), Eye("Ear")]
    satellites = [*eyes, Still("A"), Still("B")]
    scenario = scene.RSOTargets(scene.RSOTargetCatalog(NEAR), ["Eye", "Ear"])
    for eye in eyes:
        eye.levels = [0.0, 0.0]
    scenario.utc_init = EPOCH
    scenario.link_satellites(satellites)
    rewarder.link_scenario(scenario)
    begin(rewarder, scenario, satellites)

    def end():
        reward = rewarder.reward({s.name: s.data_store.update_from_logs() for s in satellites})
        assert reward.pop("A") == reward.pop("B") == 0.0
        return list(reward.values())

    return rewarder, eyes, end


def worth(record, target):
    return 10.0 * target.priority


@pytest.mark.parametrize(
    ("credit", "first", "later"), [("shared", [10.0, 10.0], [0.0, 0.0]), ("per_imager", [20.0, 20.0], [0.0, 0.0])]
)
def test_images_of_a_service_are_paid_once(credit, first, later):
    _, (eye, ear), end = play(acquisition_reward_fn=worth, multi_imager_credit=credit)
    eye.take("near", 5.0)
    ear.take("near", 6.0)
    assert end() == first
    eye.take("near", 20.0)
    assert end() == later
    eye.take("rso/2", 30.0, quality=0.4)  # of a quality that does not suffice
    assert end() == [0.0, 0.0]


def test_the_oldest_image_comes_down_first_and_the_target_cools_down():
    rewarder, (eye, _), end = play(multi_imager_credit="shared", cooldown_s=100.0)
    scenario = rewarder.scenario
    eye.take("near", 5.0)
    eye.take("near", 8.0)
    assert end() == [0.0, 0.0]
    revision = scenario.revision
    eye.levels[0] = 6.0  # of 20
    assert end() == [2.0, 0.0]
    assert eye.data_store.remaining_bits == {"Eye:2": 6.0}
    assert scenario.revision == revision + 1
    assert scenario.pending["near"] == {"Eye:2"}
    assert scenario.cooldown_until == {"near": 105.0}
    assert [scenario.is_eligible("near", time) for time in (104.0, 105.0)] == [False, False]
    scenario.block_pending_targets = False
    assert [scenario.is_eligible("near", time) for time in (104.0, 105.0)] == [False, True]
    eye.levels[0] = 0.0
    assert end() == [0.0, 0.0]  # of the same service
    eye.take("near", 60.0)
    end()
    eye.levels[0] = 0.0
    assert end() == [0.0, 0.0]  # taken while the target cooled down
    eye.take("near", 160.0)
    end()
    eye.levels[0] = 0.0
    assert end() == [2.0, 0.0]


def test_data_of_images():
    one, other = (RSOImageRecord(f"Eye:{k}", "near", "Eye", 5.0, 10.0, 1.0, 5.0) for k in range(2))
    both = RSOImageData({"Eye:0": one}) + RSOImageData({"Eye:1": other}, {"Eye:0": one})
    assert set(both.captures) == {"Eye:0", "Eye:1"}
    assert both.deliveries == {"Eye:0": one}
    with pytest.raises(ValueError, match="two different images are called"):
        both + RSOImageData({"Eye:0": replace(one, quality=0.5)})


def test_rejects_wrong_images():
    def left():
        ear.data_store.log_state = {ear.rso_scenario.partition_name("near"): 5.0}, ()
        ear.data_store.update_from_logs()

    rewarder, (eye, ear), end = play(multi_imager_credit="shared", acquisition_reward_fn=lambda record, target: float("nan"))
    eye.take("near", 5.0)
    record = eye.capture.records[0]
    unknown = {"Ear:7": replace(record, record_id="Ear:7", source_imager="Ear")}
    table = [
        refusal(end, ValueError, "acquisition_reward_fn", "nan", "Eye:1"),
        refusal(lambda: rewarder.calculate_reward({"Ear": RSOImageData({"Eye:1": record})}), ValueError, "Ear", "Eye:1"),
        refusal(lambda: rewarder.calculate_reward({"Ear": RSOImageData({}, unknown)}), ValueError, "Ear:7"),
        refusal(left, ValueError, "5.0 bit", "Ear", "'near'"),
    ]
    check_refusals(table)


def test_rejects_wrong_arguments():
    named = lambda *names: scene.RSOTargets(scene.RSOTargetCatalog(NEAR), imager_names=[*names])
    properties, rewarder = obs.RSOTargetProperties, data.RSOImageReward
    table = [
        refusal(lambda: named(), ValueError, "imager_names", [], "unique names"),
        refusal(lambda: named("Eye", "Eye"), ValueError, "imager_names", ["Eye", "Eye"], "unique names"),
        refusal(lambda: named("A"), ValueError, ["A"], "imagers", "targets"),
        refusal(lambda: rewarder(quality_threshold=1.5), ValueError, "quality_threshold", 1.5),
        refusal(lambda: rewarder(cooldown_s=-1.0), ValueError, "cooldown_s", -1.0),
        refusal(lambda: rewarder(multi_imager_credit="split"), ValueError, "multi_imager_credit", "'split'", "'shared'"),
        refusal(lambda: rewarder(delivery_reward_fn=3), ValueError, "delivery_reward_fn", 3, "function"),
        refusal(lambda: play(), ValueError, ["Eye", "Ear"], "multi_imager_credit", "'shared'", "'per_imager'"),
        refusal(lambda: act.ImageRSO(0), ValueError, "n_ahead_image", 0),
        refusal(lambda: act.ImageRSO(1, hold_mode="other"), ValueError, "hold_mode", "'other'"),
        refusal(lambda: act.ImageRSO(1, max_duration=0.0), ValueError, "max_duration", 0.0),
        refusal(lambda: properties(dict(prop="priorty")), ValueError, "prop", "'priorty'", "'priority'"),
        refusal(lambda: properties(dict(prop="priority", norm=0.0)), ValueError, "norm", 0.0, "'priority'"),
        refusal(lambda: properties(dict(prop="valid"), dict(prop="valid")), ValueError, ["valid", "valid"], "names"),
    ]
    check_refusals(table)
