"""Every hook of a subclass runs, and its tensors are those of an episode."""

import pytest
import torch
from tensordict import TensorDict

from bsk_torch import ConstellationTasking, act, comm, data, obs, sats, scene
from tests.comm.test_comm import ALL, FakeFleet, Given


def attached(method, size: int = 3):
    method.attach(FakeFleet(size))
    return method


class Shouting(comm.NoCommunication):
    """Defines the pairs of a class that has none."""

    def communication_pairs(self):
        return ~super().communication_pairs()


class Taciturn(comm.NoCommunication):
    """Changes nothing of the class."""

    def link(self, fleet):
        super().link(fleet)


class Interpreted(comm.NoCommunication):
    def communicate(self, moves):
        return super().communicate(moves) | True


def test_classes_without_communication():
    assert attached(comm.NoCommunication()).is_silent
    assert attached(Taciturn()).is_silent
    for method in (Shouting(), Interpreted(), comm.FreeCommunication(), Given()):
        assert not attached(method).is_silent
    for method in (Shouting(), Interpreted()):
        assert attached(method).exchange(ALL).all()
    patched = attached(comm.NoCommunication())
    patched.communicate = lambda moves: torch.ones(3, 3, 3, dtype=torch.bool)
    assert not patched.is_silent


def test_subclasses_of_no_communication_are_asked_in_an_environment():
    attributes = {"action_spec": (act.Charge(duration=5.0),), "observation_spec": (obs.Time(norm=1.0),)}
    cls = type("Imager", (sats.ImagingSatellite,), attributes)
    links = []
    for method in (Shouting(), comm.NoCommunication()):
        env = ConstellationTasking(
            [cls("A"), cls("B")],
            scene.UniformTargets(400),
            data.UniqueImageReward(),
            method,
            num_envs=2,
            time_limit=60.0,
            seed=1,
            backend="eager",
        )
        env.reset()
        env.step(TensorDict({("agents", "action"): torch.zeros(2, 2, dtype=torch.int64)}, env.batch_size))
        links.append(env.links)
    assert links[0].all()
    assert links[1] is None


def test_tensors_of_its_own():
    """Contacts that are counted in an attribute would not start again with an episode; in memory they do."""

    class Counting(comm.FreeCommunication):
        def communication_pairs(self):
            pairs = super().communication_pairs()
            self.contacts = self.contacts + pairs if hasattr(self, "contacts") else pairs.long()
            return pairs

    class Remembering(comm.FreeCommunication):
        def link(self, fleet):
            super().link(fleet)
            fleet.memory.declare("contacts", 0, fleet.size, fleet.size)

        def communication_pairs(self):
            pairs = super().communication_pairs()
            self.fleet.memory["contacts"] = self.fleet.memory["contacts"] + pairs
            return pairs

    counting, remembering = attached(Counting()), attached(Remembering())
    counting.exchange(ALL)
    with pytest.raises(TypeError, match=r"Counting.contacts is a tensor that has changed .* fleet.memory.declare"):
        counting.exchange(ALL)
    for _ in range(2):
        remembering.exchange(ALL)
    assert remembering.fleet.memory["contacts"][0, 0].tolist() == [0, 2, 2]
