from types import SimpleNamespace
from typing import Any

import pytest
import torch

from bsk_torch import ConstellationTasking, act, comm, obs, sats
from bsk_torch.act.discrete import PENDING
from bsk_torch.comm.base import LAST, connected
from bsk_torch.sim.state import StateTable
from tests.comm.fleets import Seeing, make_fleet, recorded, states, step

ALL = torch.tensor([True, True, True])


class FakeFleet(SimpleNamespace):
    """Three episodes without physics; satellites of two types, of which the second cannot broadcast."""

    def __init__(self, size: int, talkers: int | None = None) -> None:
        talkers = size if talkers is None else talkers
        super().__init__(num_envs=3, size=size, device=torch.device("cpu"), names=[f"Sat{k}" for k in range(size)], present=None)
        self.memory, self.sim_time = StateTable(3), torch.zeros(3, dtype=torch.float64)
        self.simulators = [self.part(count) for count in (talkers, size - talkers) if count]
        if talkers:
            self.simulators[0].memory.declare(PENDING, False, dtype=torch.bool)

    def part(self, count: int) -> SimpleNamespace:
        size, of_env = 3 * count, lambda table: table.repeat_interleave(count, 0)
        return SimpleNamespace(memory=StateTable(size), ticks=torch.zeros(size, dtype=torch.int64), of_env=of_env, count=count)

    def joined(self, parts: list[torch.Tensor]) -> torch.Tensor:
        return torch.cat([part.view(3, -1) for part in parts], 1)


class Given(comm.CommunicationMethod):
    """Talks as it is told."""

    pairs: torch.Tensor

    def communication_pairs(self) -> torch.Tensor:
        return self.pairs


class GivenMulti(comm.MultiDegreeCommunication, Given):
    pass


class GivenBroadcast(comm.BroadcastCommunication, Given):
    pass


def linked(method: Any, size: int = 3, talkers: int | None = None) -> Any:
    method.link(FakeFleet(size, talkers))
    return method


def graphs(size: int, density: float) -> torch.Tensor:
    """Three random directed graphs."""
    return torch.rand(3, size, size) < density


def test_nobody_and_everybody_and_given_pairs():
    assert not linked(comm.NoCommunication()).communicate(ALL).any()
    free = linked(comm.FreeCommunication(), 4).communicate(ALL)
    assert torch.equal(free, ~torch.eye(4, dtype=torch.bool).expand(3, 4, 4))
    method = linked(Given(), 5)
    method.pairs = graphs(5, 0.3)
    assert torch.equal(method.communicate(ALL), method.pairs)


def test_a_minimum_period():
    """Asked at 40, 100, 130 and 200 s in the first episode, at other times elsewhere; the reset counts as the last time."""
    method = linked(comm.FreeCommunication(min_period=60.0))
    times = torch.tensor([[40, 59, 60], [100, 119, 70], [130, 120, 119], [200, 179, 180]], dtype=torch.float64)
    talked = []
    for time in times:
        method.fleet.sim_time = time
        talked.append(method.communicate(ALL)[:, 0, 1].tolist())
    assert talked == [[False, False, True], [True, True, False], [False, False, False], [True, True, True]]
    assert method.fleet.memory[LAST].tolist() == [200.0, 179.0, 180.0]
    method.fleet.memory.reset(torch.tensor([1]))
    assert method.fleet.memory[LAST].tolist() == [200.0, 0.0, 180.0]


def test_time_passes_without_talk_where_episodes_move():
    method = linked(Given(min_period=60.0))
    method.pairs, method.fleet.sim_time = torch.zeros(3, 3, 3, dtype=torch.bool), torch.full((3,), 70.0, dtype=torch.float64)
    method.communicate(ALL)
    assert method.fleet.memory[LAST].tolist() == [70.0] * 3
    method = linked(comm.FreeCommunication())
    method.fleet.sim_time = torch.full((3,), 70.0, dtype=torch.float64)
    moves = torch.tensor([True, False, True])
    assert method.communicate(moves)[:, 0, 1].tolist() == moves.tolist()
    assert method.fleet.memory[LAST].tolist() == [70.0, 0.0, 70.0]


def components(pairs: torch.Tensor) -> torch.Tensor:
    """Who is in a component with whom, by walking from everybody along links in both directions."""
    size, links = len(pairs), (pairs | pairs.mT).tolist()
    found = torch.zeros(size, size, dtype=torch.bool)
    for start in range(size):
        reached, open_ = {start}, [start]
        while open_:
            here = open_.pop()
            new = {k for k in range(size) if links[here][k]} - reached
            reached |= new
            open_ += new
        found[start, list(reached)] = True
    return found


@pytest.mark.parametrize("size", [1, 2, 3, 5, 9, 17, 33, 64])
@pytest.mark.parametrize("links", [0.5, 1.0, 3.0])
def test_components_are_those_of_a_walk(size, links):
    drawn = graphs(size, links / size)
    assert len(drawn)
    for graph in drawn:
        assert torch.equal(connected(graph.unsqueeze(0))[0], components(graph))


@pytest.mark.parametrize("size", [2, 3, 4, 5, 6, 8, 9, 10, 33, 65, 66, 100])
def test_the_longest_chain(size):
    """Links point one way, from one end to the other, in random order."""
    order = torch.randperm(size)
    chain = torch.zeros(1, size, size, dtype=torch.bool)
    chain[0, order[:-1], order[1:]] = True
    assert connected(chain).all()
    chain[0, order[size // 2 - 1], order[size // 2]] = False
    assert int(connected(chain).sum()) == (size // 2) ** 2 + (size - size // 2) ** 2


def test_everybody_in_a_component_talks_but_types_that_only_listen():
    method = linked(GivenMulti(), 12)
    method.pairs = graphs(12, 0.08)
    expected = torch.stack([components(graph) for graph in method.pairs]) & ~torch.eye(12, dtype=torch.bool)
    assert torch.equal(method.communicate(ALL), expected)
    assert not torch.equal(expected, method.pairs | method.pairs.mT)
    method = linked(GivenBroadcast(), 5, talkers=2)
    method.pairs = torch.ones(3, 5, 5, dtype=torch.bool)
    method.fleet.simulators[0].memory[PENDING] = torch.ones(6, dtype=torch.bool)
    found = method.communicate(ALL)
    assert found[:, :2].all()
    assert not found[:, 2:].any()


def test_messages_are_sent_by_those_who_have_one_when_it_is_time():
    method = linked(GivenBroadcast(), 6)
    method.pairs, memory = graphs(6, 0.5), method.fleet.simulators[0].memory
    memory[PENDING] = pending = torch.rand(18) < 0.5
    found = method.communicate(ALL)
    for env in range(3):
        for sender in range(6):
            heard = method.pairs[env, sender] if pending[6 * env + sender] else torch.zeros(6, dtype=torch.bool)
            assert torch.equal(found[env, sender], heard)
    assert not memory[PENDING].any()
    assert not method.communicate(ALL).any()
    # Only the second episode may talk; no other hears it there, and the message is gone all the same.
    method = linked(GivenBroadcast(min_period=60.0), 3)
    method.pairs, memory = torch.ones(3, 3, 3, dtype=torch.bool), method.fleet.simulators[0].memory
    method.pairs[1] = False
    memory[PENDING] = torch.ones(9, dtype=torch.bool)
    method.fleet.sim_time = torch.tensor([59.0, 60.0, 60.0], dtype=torch.float64)
    assert not method.communicate(torch.tensor([True, True, False])).any()
    assert memory[PENDING].view(3, 3).any(1).tolist() == [True, False, True]
    method.fleet.sim_time = method.fleet.sim_time + 1.0
    assert method.communicate(ALL).flatten(1).any(1).tolist() == [True, False, True]


def test_chains_of_what_is_heard():
    """Broadcast before MultiDegree: senders reach their component. The other way round: what they send is passed both ways."""

    class Reaching(comm.BroadcastCommunication, comm.MultiDegreeCommunication, Given):
        pass

    class Relayed(comm.MultiDegreeCommunication, comm.BroadcastCommunication, Given):
        pass

    chain = torch.zeros(3, 4, 4, dtype=torch.bool)
    chain[:, range(3), range(1, 4)] = True
    found = []
    for cls in (Reaching, Relayed):
        method = linked(cls(), 4)
        method.pairs = chain
        method.fleet.simulators[0].memory[PENDING] = torch.tensor([True, False, False, False] * 3)
        found.append(torch.nonzero(method.communicate(ALL)[0]).tolist())
    assert found == [[[0, 1], [0, 2], [0, 3]], [[0, 1], [1, 0]]]


def in_a_row(count: int, degrees: float) -> list[dict[str, Any]]:
    """Satellites behind one another on a circular orbit 700 km up, where lines of sight reach 51 degrees at the equator."""
    oe = torch.zeros(count, 6, dtype=torch.float64)
    oe[:, 0], oe[:, 5] = 7.078e6, torch.deg2rad(degrees * torch.arange(count, dtype=torch.float64))
    return states(oe)


def test_three_links_of_four_satellites_are_no_more(backend):
    """bsk_rl would let all four talk to each other."""
    fleet = make_fleet(in_a_row(4, 45.0), backend=backend)
    method = comm.LOSCommunication()
    method.link(fleet)
    step(fleet, 100)
    links = torch.nonzero(method.communicate(torch.tensor([True]))[0]).tolist()
    assert links == [[0, 1], [1, 0], [1, 2], [2, 1], [2, 3], [3, 2]]


def test_satellites_in_between_pass_data_on():
    fleet = make_fleet(in_a_row(5, 45.0), 2)
    method = comm.LOSMultiCommunication()
    method.link(fleet)
    step(fleet, 100)
    found = method.communicate(torch.tensor([True, False]))
    assert torch.equal(found[0], ~torch.eye(5, dtype=torch.bool))
    assert not found[1].any()


def test_contacts_between_communications_are_lost(recording):
    """Basilisk's pairs, of the steps after which 200 s have passed since the last time; some others would have been more."""
    file = recording("los_unlimited")
    fleet, lost, asked = recorded(file), 0, torch.tensor([True])
    method = comm.LOSCommunication(min_period=200.0)
    method.link(fleet)
    last, time, missed = 0, 0, torch.zeros(5, 5, dtype=torch.bool)
    for ticks, pairs in zip(file["ticks"].tolist(), torch.tensor(file["pairs"]), strict=True):
        step(fleet, ticks)
        time += ticks
        due = time - last >= 200
        assert torch.equal(method.communicate(asked)[0], pairs if due else torch.zeros_like(pairs))
        last, missed = (time, missed & ~pairs) if due else (last, missed | pairs)
        if due:
            lost, missed = lost + int(missed.any()), torch.zeros_like(missed)
    assert lost > 0


class Low(sats.Satellite):
    """A satellite that feels drag."""

    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=30.0),)
    dyn_type = Seeing


def low_pair(**options):
    satellites = [Low(name, {"oe": [6.62e6, 0.0, 0.9, 0.0, 0.0, f]}) for name, f in (("A", 0.0), ("B", 0.05))]
    given = {"communicator": comm.LOSCommunication(), "num_envs": 1, "seed": 0, "backend": "eager", "time_limit": 60.0}
    return ConstellationTasking(satellites, **{**given, **options})


def test_drag_and_sight_advise_what_works_together():
    leaves_out = r"world_args=\{'baseDensity': 0.0\}"
    with pytest.raises(ValueError, match=rf"drag is felt.*{leaves_out}, as communication along lines of sight needs"):
        low_pair()
    with pytest.raises(ValueError, match=rf"pass orbit='arc'.*{leaves_out}"):
        low_pair(orbit="integrated")
    env = low_pair(world_args={"baseDensity": 0.0})
    env.rollout(1)
    assert env.links.tolist() == [[[False, True], [True, False]]]
