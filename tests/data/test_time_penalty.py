"""The price of time, alone and added to other rewards."""

import torch

from bsk_torch import ConstellationTasking, SatelliteTasking, act, data, obs, sats
from bsk_torch.sim import dyn, fsw


class Drifter(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=50.0), act.Charge(duration=20.0))
    dyn_type = dyn.BasicDynamicsModel
    fsw_type = fsw.BasicFSWModel


OPTIONS = dict(num_envs=2, time_limit=120.0, seed=0, backend="eager", dtype=torch.float64)


def test_each_second_has_its_price_for_every_satellite():
    env = SatelliteTasking(Drifter("A"), rewarder=data.TimePenalty(0.5), **OPTIONS)
    td = env.reset()
    for duration in ([50.0, 20.0], [20.0, 50.0], [50.0, 50.0]):
        td = env.step(td.set("action", torch.tensor([int(seconds == 20.0) for seconds in duration])))["next"]
        assert td["duration"].flatten().tolist() == duration
        assert td["reward"].flatten().tolist() == [-0.5 * seconds for seconds in duration]
    assert env.rewarder.cum_reward["A"].tolist() == [-60.0, -60.0]
    parts = data.TimePenalty(), data.NoReward()
    env = ConstellationTasking([Drifter("A"), Drifter("B")], rewarder=parts, **OPTIONS)
    td = env.reset()
    td["agents", "action"] = torch.tensor([[0, 1], [0, 0]])
    td = env.step(td)["next"]
    assert td["agents", "reward"].flatten(1).tolist() == [[-20.0, -20.0], [-50.0, -50.0]]
