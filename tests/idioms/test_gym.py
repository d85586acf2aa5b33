"""Lines of bsk_rl programs around environments: making, importing, reading, sampling arguments."""

import importlib
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from bsk_torch.utils import actuator_primitives, attitude, orbital
from bsk_torch.utils.rllib import unpack_config

from bsk_torch import act, obs, sats
from bsk_torch.rand import Distribution
from tests.idioms.runner import run, title
from tests.wrappers.constellations import trio


class Flyer(sats.Satellite):
    observation_spec = (obs.SatProperties(dict(prop="battery_charge_fraction")), obs.Time())
    action_spec = (act.Drift(duration=10.0), act.Charge(duration=20.0))


EAGER = {"backend": "eager", "time_limit": 20.0}
"""bsk_torch's own arguments of every environment here."""


def made(env):
    return isinstance(env, gymnasium.Env)


def is_random(value):
    return isinstance(value, Distribution)


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
    ("orbital.random_orbit(i=45.0, a=7000, e=0.01)", is_random),
    ("orbital.random_circular_orbit(alt=800)", is_random),
    ("orbital.random_epoch(2010, 2012)", is_random),
    ("orbital.random_unit_vector()", is_random),
    ("attitude.random_tumble(maxSpinRate=0.0001)[1]", is_random),
    ("actuator_primitives.balancedHR16Triad(useRandom=True, randomBounds=(-3000, 3000))[2]", is_random),
    ("orbital.walker_delta(4, 2, 0.25, 500e3, 45.0)", lambda value: len(value) == 4),
    ("orbital.lla2ecef(0.0, 90.0, 1.0)", lambda value: np.allclose(value, [0, 1, 0])),
    ("orbital.rv2HN(np.array([7e6, 0, 0]), np.array([0, 7.5e3, 0]))", lambda value: np.allclose(value, np.eye(3))),
    ("crew.step({'S0': 0, 'S1': None})[-1]['S0']['d_ts']", lambda value: value > 0.0),
]

IMPORTS = [
    "from bsk_rl import ConstellationTasking, GeneralSatelliteTasking, SatelliteTasking, NO_ACTION",
    "from bsk_rl.utils.orbital import random_orbit, walker_delta_args, rv2HN",
    "from bsk_rl.scene.targets import UniformTargets, CityTargets",
    "from bsk_rl.scene.scenario import UniformNadirScanning",
    "from bsk_rl.data.unique_image_data import UniqueImageReward",
    "from bsk_rl.data.base import GlobalReward",
    "from bsk_rl.obs.observations import SatProperties, Eclipse",
    "from bsk_rl.act.discrete_actions import Charge, Image",
    "from bsk_rl.comm.communication import LOSCommunication",
    "from bsk_rl.sats.access_satellite import ImagingSatellite",
    "from bsk_rl.sim.dyn.ground_imaging import ImagingDynModel",
    "from bsk_rl.sim.fsw.base import BasicFSWModel",
    "from bsk_rl.utils.functional import aliveness_checker",
    "from bsk_rl.utils.rllib.callbacks import EpisodeDataWrapper",
    "from bsk_rl.gym import is_no_action",
]


@pytest.fixture(scope="module")
def names():
    from bsk_torch.wrappers.pettingzoo import parallel_env

    env = run('gym.make("bsk_torch/SatelliteTasking-v1", satellite=Flyer("S"), **eager)', gym=gymnasium, Flyer=Flyer, eager=EAGER)
    env.reset(seed=1)
    env.step(0)
    crew = parallel_env(trio(backend="eager"))
    crew.reset(seed=1)
    modules = {"orbital": orbital, "attitude": attitude, "actuator_primitives": actuator_primitives, "gym": gymnasium}
    return {"env": env, "crew": crew, "Flyer": Flyer, "eager": EAGER, "unpack_config": unpack_config, **modules}


@pytest.mark.parametrize("idiom", IDIOMS, ids=title)
def test_a_line_of_bsk_rl_works_as_it_stands(idiom, names):
    line, check = idiom
    if line.startswith("env.unwrapped"):
        names["env"].reset(seed=1)
        names["env"].step(0)
    elif line.startswith("env.step"):
        names["env"].reset(seed=1)
    assert check(run(line, **names))


@pytest.mark.parametrize("line", IMPORTS)
def test_an_import_of_bsk_rl_works_with_the_package_renamed(line):
    found = SimpleNamespace()
    exec(line.replace("bsk_rl", "bsk_torch"), vars(found))
    names = [name.strip() for name in line.partition(" import ")[2].split(",")]
    assert all(hasattr(found, name) for name in names)
    assert importlib.import_module(line.split()[1].replace("bsk_rl", "bsk_torch"))
