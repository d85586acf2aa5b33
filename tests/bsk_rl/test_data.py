"""Rewarders with satellites whose stores the tests set."""

import pytest

from bsk_torch.bsk_rl.data import NoReward, ResourceReward, ScanningTimeReward, UniqueImageReward
from bsk_torch.bsk_rl.data.base import Data, DataStore, GlobalReward
from bsk_torch.bsk_rl.data.composition import ComposedData, ComposedReward
from bsk_torch.bsk_rl.data.unique_image_data import UniqueImageData
from bsk_torch.bsk_rl.scene import UniformNadirScanning, UniformTargets
from tests.bsk_rl.fakes import begin, fleet, step


def linked(rewarder, scenario, satellites):
    scenario.link_satellites(satellites)
    rewarder.link_scenario(scenario)
    begin(rewarder, scenario, satellites)
    return rewarder


def image(satellite, target):
    satellite.latest_target = target
    satellite.levels[0] += 8e6


# -- scanning --------------------------------------------------------------------------------------------------------------------


def test_scanning_pays_for_the_data_gained_over_the_rate():
    satellites = fleet(2)
    rewarder = linked(ScanningTimeReward(), UniformNadirScanning(value_per_second=0.5), satellites)
    satellites[0].levels = [100.0]
    assert step(rewarder, satellites) == {"Sat0": 5.0, "Sat1": 0.0}
    satellites[0].levels = [40.0]  # a downlink costs nothing
    satellites[1].levels = [10.0]
    assert step(rewarder, satellites) == {"Sat0": 0.0, "Sat1": 0.5}
    assert rewarder.cum_reward == {"Sat0": 5.0, "Sat1": 0.5}
    assert rewarder.data.scanning_time == 11.0
    assert satellites[0].data_store.data.scanning_time == 10.0


def test_scanning_takes_a_function_of_the_time():
    satellites = fleet(1)
    rewarder = linked(ScanningTimeReward(reward_fn=lambda t: t**2), UniformNadirScanning(), satellites)
    satellites[0].levels = [30.0]
    assert step(rewarder, satellites) == {"Sat0": 9.0}


def test_nothing_is_lost_by_a_rate_of_zero():
    satellites = fleet(1)
    satellites[0].baud = 0.0
    rewarder = linked(ScanningTimeReward(), UniformNadirScanning(), satellites)
    assert step(rewarder, satellites) == {"Sat0": 0.0}


# -- images ----------------------------------------------------------------------------------------------------------------------


def test_the_first_image_of_a_target_is_paid_and_shared_by_those_who_take_it_together():
    satellites, scenario = fleet(3), UniformTargets(4, priority_distribution=lambda: 0.8)
    rewarder = linked(UniqueImageReward(reward_fn=lambda p: 10 * p), scenario, satellites)
    first, second = scenario.targets[:2]
    image(satellites[0], first)
    image(satellites[1], first)
    image(satellites[2], second)
    assert step(rewarder, satellites) == {"Sat0": 4.0, "Sat1": 4.0, "Sat2": 8.0}
    image(satellites[2], first)  # known to others, imaged before
    assert step(rewarder, satellites) == {"Sat0": 0.0, "Sat1": 0.0, "Sat2": 0.0}
    assert rewarder.data.imaged == {first, second}
    assert rewarder.data.duplicates == 2
    assert rewarder.data.known == set(scenario.targets)


def test_satellites_do_not_see_what_they_have_imaged():
    satellites, scenario = fleet(2), UniformTargets(3)
    rewarder = linked(UniqueImageReward(), scenario, satellites)
    target = scenario.targets[0]
    image(satellites[0], target)
    step(rewarder, satellites)
    seen = [satellite.filters[-1]({"type": "target", "object": target}) for satellite in satellites]
    assert seen == [False, True]
    assert satellites[0].filters[-1]({"type": "ground_station", "object": target})


def test_filters_remain_over_episodes_and_hide_only_what_belongs_to_them():
    satellites, scenario = fleet(1), UniformTargets(3)
    rewarder = linked(UniqueImageReward(), scenario, satellites)
    image(satellites[0], scenario.targets[0])
    step(rewarder, satellites)
    begin(rewarder, scenario, satellites)
    assert len(satellites[0].filters) == 2
    assert all(hide({"type": "target", "object": target}) for hide in satellites[0].filters for target in scenario.targets)


def test_duplicates_are_counted_where_both_sides_know():
    one, other = UniqueImageData(imaged=["a", "a", "b"]), UniqueImageData(imaged={"b", "c"}, duplicates=2, known={"d"})
    assert one.duplicates == 1
    both = one + other
    assert (both.imaged, both.duplicates, both.known) == ({"a", "b", "c"}, 4, {"d"})


# -- resources -------------------------------------------------------------------------------------------------------------------


def test_a_resource_is_paid_by_its_change():
    satellites, scenario = fleet(2), UniformNadirScanning()

    class Weight:
        weight_vector = []

    satellites[0].observation_builder.observation_spec = [Weight(), object()]
    weights = iter([0.5, 0.25])
    rewarder = ResourceReward(reward_weight=lambda: next(weights), resource_fn=lambda satellite: sum(satellite.levels))
    linked(rewarder, scenario, satellites)
    satellites[0].levels = [-4.0]
    assert step(rewarder, satellites) == {"Sat0": -2.0, "Sat1": 0.0}
    begin(rewarder, scenario, satellites)
    assert rewarder.reward_weight == 0.25
    assert Weight.weight_vector == [0.5, 0.25]


# -- composition -----------------------------------------------------------------------------------------------------------------


class Partial(GlobalReward):
    """Pays one satellite only."""

    data_store_type = NoReward.data_store_type
    last = "Sat0"

    def calculate_reward(self, new_data_dict):
        return {self.last: 1.0}

    def is_terminated(self, satellite):
        return satellite.name == "Sat1"


def test_rewarders_are_summed_and_may_leave_satellites_out():
    satellites, scenario = fleet(2), UniformTargets(4, priority_distribution=lambda: 0.5)
    rewarder = ComposedReward(UniqueImageReward(), UniqueImageReward(reward_fn=lambda p: -p), Partial())
    linked(rewarder, scenario, satellites)
    image(satellites[0], scenario.targets[0])
    image(satellites[1], scenario.targets[1])
    assert step(rewarder, satellites) == {"Sat0": 1.0, "Sat1": 0.0}
    assert rewarder.rewarders[1].cum_reward == {"Sat0": -0.5, "Sat1": -0.5}
    assert rewarder.cum_reward == {"Sat0": 1.0, "Sat1": 0.0}
    assert [rewarder.is_terminated(satellite) for satellite in satellites] == [False, True]


def test_parts_are_found_by_their_attributes_and_do_not_hide_targets():
    satellites, scenario = fleet(1), UniformTargets(2)
    rewarder = linked(ComposedReward(NoReward(), UniqueImageReward()), scenario, satellites)
    image(satellites[0], scenario.targets[0])
    step(rewarder, satellites)
    assert satellites[0].filters == []
    assert rewarder.reward_fn(3.0) == 3.0
    assert rewarder.data.imaged == satellites[0].data_store.data.imaged == {scenario.targets[0]}
    assert satellites[0].data_store.data_stores[1].data is satellites[0].data_store.data.data[1]
    with pytest.raises(AttributeError, match="ComposedReward has no part"):
        _ = rewarder.weight


def test_composed_data_of_different_kinds_cannot_be_added():
    one, two = ComposedData(UniqueImageData()), ComposedData(UniqueImageData(), UniqueImageData())
    assert len((ComposedData() + two).data) == len((two + ComposedData()).data) == 2
    with pytest.raises(ValueError, match="1 kinds cannot be added to data of 2"):
        _ = one + two


def test_state_of_a_rewarder_lasts_over_episodes():
    class Counting(NoReward):
        calls = 0

        def calculate_reward(self, new_data_dict):
            self.calls += 1
            return super().calculate_reward(new_data_dict)

    satellites, scenario = fleet(1), UniformNadirScanning()
    rewarder = linked(Counting(), scenario, satellites)
    step(rewarder, satellites)
    begin(rewarder, scenario, satellites)
    step(rewarder, satellites)
    assert rewarder.calls == 2


def test_a_store_of_ones_own_gets_its_arguments():
    class Count(Data):
        def __init__(self, n=0):
            self.n = n

        def __add__(self, other):
            return Count(self.n + other.n)

    class Store(DataStore):
        data_type = Count

        def __init__(self, *args, factor, **kwargs):
            super().__init__(*args, **kwargs)
            self.factor = factor

        def get_log_state(self):
            return self.satellite.levels[0]

        def compare_log_states(self, old, new):
            return Count(self.factor * (new - old))

    class Reward(GlobalReward):
        datastore_type = Store  # the name before bsk_rl 1.0

        def __init__(self):
            super().__init__()
            self.data_store_kwargs = {"factor": 3}

        def calculate_reward(self, new_data_dict):
            return {name: float(data.n) for name, data in new_data_dict.items()}

    satellites = fleet(1)
    rewarder = linked(Reward(), UniformNadirScanning(), satellites)
    satellites[0].levels = [2.0]
    assert step(rewarder, satellites) == {"Sat0": 6.0}
