"""Several scenarios and channels of rewards in the drop-in; ``programs.mixed`` flies one as bsk_rl does."""

from copy import copy, deepcopy

import pytest

from bsk_torch.bsk_rl.data import MixedReward, NoReward, ScanningTimeReward, UniqueImageReward
from bsk_torch.bsk_rl.data.composition import MixedData
from bsk_torch.bsk_rl.data.nadir_data import ScanningTime
from bsk_torch.bsk_rl.data.unique_image_data import UniqueImageData
from bsk_torch.bsk_rl.scene import MixedScenario, Scenario, UniformNadirScanning, UniformTargets
from tests.bsk_rl.fakes import begin, fleet, step
from tests.support.refusals import check_refusals, refusal


class Counted(Scenario):
    """A scenario that keeps what it is called with."""

    def __init__(self):
        self.calls = []

    def __getattribute__(self, name):
        if name.startswith("reset_") or name == "after_step":
            object.__getattribute__(self, "calls").append(name)
        return super().__getattribute__(name)


def scene(**groups):
    groups = groups or {"ground": ["Sat0"], "strip": ["Sat1", "Sat2"]}
    return MixedScenario({"ground": UniformTargets(4), "strip": UniformNadirScanning()}, groups)


def reward(**given):
    defaults = dict(
        rewarders={"images": UniqueImageReward(), "scans": ScanningTimeReward()},
        satellite_mapping={"images": ["Sat0"], "scans": ["Sat1"]},
        scenario_mapping={"images": "ground", "scans": "strip"},
    )
    return MixedReward(**defaults | given)


def linked(rewarder=None, scenario=None):
    satellites, scenario, rewarder = fleet(3), scenario or scene(), rewarder or reward()
    scenario.utc_init = "2026 OCT 01 00:00:00.000 (UTC)"
    scenario.link_satellites(satellites)
    rewarder.link_scenario(scenario)
    begin(rewarder, scenario, satellites)
    return rewarder, satellites


def test_each_scenario_has_its_satellites():
    scenario, (_, satellites) = scene(), linked()
    scenario.link_satellites(satellites)
    assert [s.name for s in scenario.scenarios["ground"].satellites] == ["Sat0"]
    assert [s.name for s in scenario.scenarios["strip"].satellites] == ["Sat1", "Sat2"]
    assert [len(satellite.places) for satellite in satellites] == [4, 0, 0]


def test_a_scenario_under_two_ids_is_called_once_with_all_its_satellites():
    one, other = Counted(), Counted()
    mixed = MixedScenario({"a": one, "b": other, "c": one}, {"a": ["Sat0"], "b": ["Sat2"], "c": ["Sat1", "Sat0"]})
    mixed = deepcopy(mixed)  # as an environment does
    mixed.utc_init, satellites = "epoch", fleet(3)
    mixed.link_satellites(satellites)
    one, other = mixed.scenarios["a"], mixed.scenarios["b"]
    for hook in ("reset_overwrite_previous", "reset_pre_sim_init", "reset_during_sim_init", "reset_post_sim_init"):
        getattr(mixed, hook)()
    mixed.after_step(1.0)
    calls = ["reset_overwrite_previous", "reset_pre_sim_init", "reset_during_sim_init", "reset_post_sim_init", "after_step"]
    assert one.calls == other.calls == calls
    assert one.satellites == satellites[:2]
    assert one.utc_init == other.utc_init == "epoch"


def test_satellites_get_the_rewards_of_their_channels():
    rewarder, satellites = linked()
    target = rewarder.scenario.scenarios["ground"].targets[0]
    satellites[0].latest_target, satellites[0].levels = target, [8e6]
    satellites[1].levels, satellites[2].levels = [50.0], [100.0]
    assert step(rewarder, satellites) == {"Sat0": target.priority, "Sat1": 5.0, "Sat2": 0.0}
    assert rewarder.cum_reward == {"Sat0": target.priority, "Sat1": 5.0, "Sat2": 0.0}
    assert rewarder.rewarders["scans"].cum_reward == {"Sat1": 5.0}
    assert set(rewarder.data.data) == {"images", "scans"}
    assert rewarder.rewarders["images"].data.imaged == {target}
    assert rewarder.data.scanning_time == 5.0  # of one channel
    stores = [satellite.data_store for satellite in satellites]
    assert [list(store.data_stores) for store in stores] == [["images"], ["scans"], []]
    assert [len(satellite.filters) for satellite in satellites] == [1, 0, 0]  # which the rewarder of images installs


def test_a_satellite_may_have_several_channels_of_one_type():
    rewarder, satellites = linked(
        reward(
            rewarders={"one": ScanningTimeReward(), "two": ScanningTimeReward(lambda time: 10.0 * time)},
            satellite_mapping={"one": ["Sat1", "Sat2"], "two": ["Sat1"]},
            scenario_mapping={"one": "strip", "two": "strip"},
        )
    )
    for satellite in satellites:
        satellite.levels = [20.0]
    assert step(rewarder, satellites) == {"Sat0": 0.0, "Sat1": 22.0, "Sat2": 2.0}
    with pytest.raises(AttributeError, match=r"Ambiguous attribute 'scanning_time': the channels \['one', 'two'\] of MixedData"):
        _ = rewarder.data.scanning_time
    with pytest.raises(AttributeError, match="MixedData has no channel with attribute 'imaged'"):
        _ = rewarder.data.imaged


def test_received_data_of_other_channels_is_kept():
    rewarder, satellites = linked()
    satellites[1].levels = [50.0]
    step(rewarder, satellites)
    for satellite in satellites[::2]:
        satellite.data_store.stage_communicated_data(satellites[1].data_store.data)
        satellite.data_store.update_with_communicated_data()
    assert [set(satellite.data_store.data.data) for satellite in satellites] == [{"images", "scans"}, {"scans"}, {"scans"}]
    assert satellites[2].data_store.data.scanning_time == 5.0
    assert satellites[0].data_store.data_stores["images"].data is satellites[0].data_store.data.data["images"]


def test_only_the_channels_of_a_satellite_end_its_episode():
    class Ending(NoReward):
        def is_terminated(self, satellite):
            return True

        def is_truncated(self, satellite):
            return True

    rewarder, satellites = linked(
        reward(
            rewarders={"images": UniqueImageReward(), "scans": Ending()},
            satellite_mapping={"images": ["Sat0"], "scans": ["Sat2"]},
        )
    )
    assert [rewarder.is_terminated(satellite) for satellite in satellites] == [False, False, True]
    assert [rewarder.is_truncated(satellite) for satellite in satellites] == [False, False, True]


def test_data_of_channels_are_added():
    one, none = MixedData({"a": ScanningTime(2.0)}), MixedData()
    whole = one + MixedData({"a": ScanningTime(3.0), "b": UniqueImageData()})
    assert whole.data["a"].scanning_time == 5.0
    assert set(whole.data) == {"a", "b"}
    assert copy(one).data["a"] is not one.data["a"]
    assert (none + one).data["a"].scanning_time == (one + none).data["a"].scanning_time == 2.0
    with pytest.raises(TypeError, match="channel 'a' has ScanningTime, to which UniqueImageData cannot be added"):
        one + MixedData({"a": UniqueImageData()})
    with pytest.raises(TypeError):
        one + ScanningTime(1.0)


def test_rejects_wrong_channels():
    class Generous(NoReward):
        def calculate_reward(self, new_data_dict):
            return {"Sat2": 1.0}

    link = lambda **given: linked(reward(**given))
    same = dict.fromkeys(("images", "scans"), NoReward())
    groups = lambda images: dict(satellite_mapping={"images": [images], "scans": ["Sat1"]})
    grund = {"images": "grund", "scans": "strip"}
    rewarder, satellites = link(rewarders={"images": UniqueImageReward(), "scans": Generous()})
    table = [
        refusal(lambda: step(rewarder, satellites), ValueError, "'scans'", "'Sat2'"),
        refusal(lambda: reward(satellite_mapping={"images": []}), ValueError, "satellite_mapping", ["images"], "rewarders"),
        refusal(lambda: reward(scenario_mapping={"images": "ground"}), ValueError, "scenario_mapping", ["images"], "rewarders"),
        refusal(lambda: reward(rewarders=same), ValueError, ["images", "scans"], "rewarder"),
        refusal(lambda: link(scenario_mapping=None), ValueError, "scenario_mapping", ["ground", "strip"]),
        refusal(lambda: link(scenario_mapping=grund), ValueError, "scenario_mapping['images']", "'grund'", "'ground'"),
        refusal(lambda: link(**groups("Sat9")), ValueError, "satellite_mapping['images']", "'Sat9'", "'Sat0'"),
        refusal(lambda: link(**groups("Sat1")), ValueError, "satellite_mapping['images']", ["Sat1"], "'ground'"),
        refusal(lambda: MixedScenario({"a": Scenario()}, {"b": ["Sat0"]}), ValueError, "satellite_mapping", ["b"], ["a"]),
        refusal(lambda: scene(ground=["Sta0"], strip=[]).link_satellites(fleet(1)), ValueError, "'Sta0'", "'Sat0'"),
        refusal(lambda: scene(ground=["Sat0"], strip=[]).link_satellites(fleet(1) * 2), ValueError, "satellites", ["Sat0"]),
    ]
    check_refusals(table)


def test_channels_of_one_scenario():
    scenario = UniformNadirScanning()
    with pytest.raises(ValueError, match=r"scenario_mapping needs a scene.MixedScenario; the scenario is a UniformNadirScanning"):
        linked(scenario=scenario)
    rewarder, satellites = linked(
        reward(rewarders={"images": NoReward(), "scans": ScanningTimeReward()}, scenario_mapping=None), scenario
    )
    satellites[1].levels = [10.0]
    assert step(rewarder, satellites)["Sat1"] == 1.0
