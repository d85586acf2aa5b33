"""Communication between satellites whose lines of sight the tests set."""

from bsk_torch.bsk_rl.comm import (
    BroadcastCommunication,
    CommunicationMethod,
    FreeCommunication,
    LOSCommunication,
    LOSMultiCommunication,
    MultiDegreeCommunication,
    NoCommunication,
)
from bsk_torch.bsk_rl.data import UniqueImageReward
from bsk_torch.bsk_rl.scene import UniformTargets
from tests.bsk_rl.fakes import begin, fleet, step


def imaged(communicator, count, pairs=(), time=10.0):
    """Let every satellite image one target, communicate, and return what each knows by the numbers of the targets."""
    satellites, scenario, rewarder = fleet(count), UniformTargets(count), UniqueImageReward()
    scenario.link_satellites(satellites)
    rewarder.link_scenario(scenario)
    communicator.link_satellites(satellites)
    begin(rewarder, scenario, satellites)
    communicator.reset_overwrite_previous()
    communicator.reset_post_sim_init()
    for satellite, target in zip(satellites, scenario.targets, strict=True):
        satellite.latest_target = target
        satellite.levels[0] += 1.0
    step(rewarder, satellites)
    satellites[0].simulator.pairs, satellites[0].simulator.sim_time = list(pairs), time
    communicator.communicate()
    return [sorted(scenario.targets.index(target) for target in satellite.data_store.data.imaged) for satellite in satellites]


def test_without_communication_satellites_know_their_own():
    assert imaged(NoCommunication(), 3) == [[0], [1], [2]]


def test_freely_all_know_all():
    assert imaged(FreeCommunication(), 3) == [[0, 1, 2]] * 3


def test_those_who_see_one_another_tell_one_another_one_step_far():
    assert imaged(LOSCommunication(), 4, [(0, 1), (1, 2)]) == [[0, 1], [0, 1, 2], [1, 2], [3]]


def test_each_direction_is_listed_twice_so_that_half_of_all_pairs_count_as_all():
    communicator = LOSCommunication()
    assert imaged(communicator, 4, [(0, 1), (1, 2), (2, 3)]) == [[0, 1, 2, 3]] * 4
    numbers = [(one.name, other.name) for one, other in communicator.communication_pairs()]
    assert numbers.count(("Sat0", "Sat1")) == numbers.count(("Sat1", "Sat0")) == 2
    assert len(numbers) == 12
    assert numbers[:4] == [("Sat0", "Sat1"), ("Sat1", "Sat0"), ("Sat1", "Sat0"), ("Sat0", "Sat1")]


def test_chains_join_satellites():
    assert imaged(LOSMultiCommunication(), 5, [(0, 3), (3, 4)]) == [[0, 3, 4], [1], [2], [0, 3, 4], [0, 3, 4]]


def test_links_of_chains_may_be_of_one_direction():
    class Ring(CommunicationMethod):
        def communication_pairs(self):
            return [(self.satellites[2], self.satellites[0]), (self.satellites[1], self.satellites[2])]

    class Chained(MultiDegreeCommunication, Ring):
        pass

    communicator = Chained()
    assert imaged(communicator, 4) == [[0, 1, 2], [0, 1, 2], [0, 1, 2], [3]]
    names = [(one.name[-1], other.name[-1]) for one, other in communicator.communication_pairs()]
    assert names == [("0", "1"), ("0", "2"), ("1", "0"), ("1", "2"), ("2", "0"), ("2", "1")]


def test_only_those_who_broadcast_are_heard():
    class Broadcasts(BroadcastCommunication, FreeCommunication):
        pass

    class Action:
        broadcast_pending = False

    actions = [Action(), Action()]

    class Method(Broadcasts):
        def reset_post_sim_init(self):
            for satellite, action in zip(self.satellites, actions, strict=False):
                satellite.action_builder.action_spec = [object(), action]
            actions[1].broadcast_pending = True

    assert imaged(Method(), 3) == [[0, 1], [1], [1, 2]]
    assert not actions[1].broadcast_pending


def test_communication_waits_for_its_period():
    assert imaged(FreeCommunication(min_period=60.0), 2, time=59.0) == [[0], [1]]
    communicator = FreeCommunication(min_period=60.0)
    assert imaged(communicator, 2, time=60.0) == [[0, 1]] * 2
    assert communicator.last_communication_time == 60.0
