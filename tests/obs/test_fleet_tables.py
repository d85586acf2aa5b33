"""Observations that read tables of rewarders and communicators, for all satellites at once and for each."""

import numpy as np
import pytest
import torch

from bsk_torch import ConstellationTasking, act, comm, data, obs, per_environment, sats
from tests.support.refusals import check_refusals, refusal


class Numbered(data.GlobalReward):
    """Keeps a number of each satellite, ten times its own plus the steps so far, and the steps of the episode."""

    def link(self, scenario, fleet):
        super().link(scenario, fleet)
        fleet.memory.declare("known", 0.0, fleet.size)
        fleet.memory.declare("steps", 0.0)

    def calculate_reward(self, before, after):
        memory = self.fleet.memory
        memory["steps"] = memory["steps"] + 1.0
        memory["known"] = 10.0 * torch.arange(self.fleet.size) + memory["steps"].unsqueeze(1)
        return memory["known"]


class Heard(comm.CommunicationMethod):
    """Everyone hears the first satellite, and how often it did is kept."""

    def link(self, fleet):
        super().link(fleet)
        fleet.memory.declare("heard", 0.0, fleet.size)

    def communication_pairs(self):
        pairs = torch.zeros(self.fleet.num_envs, self.fleet.size, self.fleet.size, dtype=torch.bool)
        pairs[:, 0, 1:] = True
        self.fleet.memory["heard"] = self.fleet.memory["heard"] + pairs.sum(1)
        return pairs


class Tables(obs.Observation):
    def get_obs(self):
        satellite = self.satellite
        known, heard = (satellite.rows_of(satellite.fleet.memory[name]) for name in ("known", "heard"))
        return {"known": known, "heard": heard, "steps": satellite.of_env(satellite.rewarder.memory["steps"])}


class ForOne(obs.Observation):
    """The same, written for one satellite."""

    @per_environment
    def get_obs(self):
        satellite = self.satellite
        known, heard = (satellite.rows_of(satellite.fleet.memory[name]) for name in ("known", "heard"))
        return np.array([known, heard if known > 0.0 else 0.0, satellite.of_env(satellite.fleet.memory["steps"])])


class Short(sats.Satellite):
    observation_spec = (Tables("tables"), ForOne("one"))
    action_spec = (act.Drift(duration=20.0),)


class Long(Short):
    action_spec = (act.Drift(duration=20.0), act.Charge(duration=60.0))


def make(*satellites, num_envs=4):
    options = dict(rewarder=Numbered(), communicator=Heard(), time_limit=600.0, backend="eager", seed=0)
    return ConstellationTasking(satellites, num_envs=num_envs, **options)


@pytest.mark.parametrize("num_envs", [1, 4])
def test_each_satellite_observes_its_row(num_envs):
    env = make(Short("a"), Long("c"), Short("b"), num_envs=num_envs)
    td = env.reset()
    for _ in range(3):
        for group in env.group_map:
            td[group, "action"] = torch.zeros_like(td[group, "action_mask"][..., 0], dtype=torch.int64)
        td = env.step(td)["next"]
    assert set(env.group_map) == {"short", "long"}
    for group, numbers in (("short", (0, 2)), ("long", (1,))):
        seen = td[group, "observation"]
        for k, number in enumerate(numbers):
            expected = [10.0 * number + 3.0, 3.0 * (number > 0), 3.0]
            assert seen[:, k].tolist() == [expected * 2] * num_envs


class Whole(obs.Observation):
    def get_obs(self):
        return self.satellite.fleet.memory["known"].flatten()


class Number(obs.Observation):
    @per_environment
    def get_obs(self):
        return float(self.satellite.fleet.memory["known"].numel())


def test_rejects_tables_of_all_satellites():
    def sees(entry):
        return make(type("Sees", (Short,), dict(observation_spec=(entry,)))("a"))

    check_refusals(
        refusal(lambda entry=entry: sees(entry), TypeError, f"{type(entry).__name__}.get_obs()", "satellite.rows_of(table)")
        for entry in (Whole("whole"), Number("number"))
    )
