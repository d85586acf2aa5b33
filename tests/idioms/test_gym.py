"""Lines of bsk_rl programs around environments: making, reading, stepping."""

import gymnasium
import pytest

from bsk_torch import act, obs, sats
from bsk_torch.wrappers.rllib import unpack_config
from tests.idioms.runner import run, title
from tests.wrappers.constellations import trio


class Flyer(sats.Satellite):
    observation_spec = (obs.SatProperties(dict(prop="battery_charge_fraction")), obs.Time())
    action_spec = (act.Drift(duration=10.0), act.Charge(duration=20.0))


EAGER = {"backend": "eager", "time_limit": 20.0}
"""bsk_torch's own arguments of every environment here."""


def made(env):
    return isinstance(env, gymnasium.Env)


IDIOMS = [
    ('gym.make("bsk_torch/SatelliteTasking-v1", satellite=Flyer("S"), **eager)', made),
    ('gym.make("bsk_torch/GeneralSatelliteTasking-v1", satellites=[Flyer("A"), Flyer("B")], **eager)', made),
    ("bsk_rl.NO_ACTION", lambda value: value == 2**31 - 1),
    ("bsk_rl.GeneralSatelliteTasking([Flyer('A'), Flyer('B')], **eager)", lambda env: env.joint),
    ("unpack_config(SatelliteTasking)(dict(satellite=Flyer('S'), **eager))", made),
    ("env.reset(seed=1)[1]['d_ts']", lambda value: value == 0.0),
    ("env.action_space.sample()", lambda value: value in (0, 1)),
    ("env.observation_space.shape", lambda value: value == (2,)),
    ("env.step(0)[-1]['requires_retasking']", lambda value: value is True),
    ("env.unwrapped.simulator.sim_time", lambda value: value == pytest.approx(10.0)),
    ("env.unwrapped.satellite.dynamics.battery_charge_fraction", lambda value: 0.0 < value < 1.0),
    ("np.linalg.norm(env.unwrapped.satellite.dynamics.r_BN_N)", lambda value: 6.8e6 < value < 6.95e6),
    ("env.unwrapped.satellite.action_description", lambda value: value == ["action_drift", "action_charge"]),
    ("sum(env.unwrapped.rewarder.cum_reward.values())", lambda value: value == 0.0),
    ("[sat.name for sat in env.unwrapped.satellites]", lambda value: value == ["S"]),
    ("env.unwrapped.get_satellite('S').is_alive()", lambda value: value is True),
    ("crew.step({'S0': 0, 'S1': None})[-1]['S0']['d_ts']", lambda value: value > 0.0),
]


@pytest.fixture(scope="module")
def names():
    from bsk_torch.wrappers.pettingzoo import parallel_env

    env = run('gym.make("bsk_torch/SatelliteTasking-v1", satellite=Flyer("S"), **eager)', gym=gymnasium, Flyer=Flyer, eager=EAGER)
    env.reset(seed=1)
    env.step(0)
    crew = parallel_env(trio(backend="eager"))
    crew.reset(seed=1)
    return {"env": env, "crew": crew, "Flyer": Flyer, "eager": EAGER, "unpack_config": unpack_config, "gym": gymnasium}


@pytest.mark.parametrize("idiom", IDIOMS, ids=title)
def test_a_line_of_bsk_rl_works_as_it_stands(idiom, names):
    line, check = idiom
    if line.startswith("env.unwrapped"):
        names["env"].reset(seed=1)
        names["env"].step(0)
    elif line.startswith("env.step"):
        names["env"].reset(seed=1)
    assert check(run(line, **names))
