"""Lines of bsk_rl programs with scenarios, data, rewarders and communicators of their own."""

from __future__ import annotations

import numpy as np
import pytest

import bsk_torch
from bsk_torch import data, rand, scene

from .runner import Idiom, run, title

pytestmark = pytest.mark.compiled

POINT = np.array([7e6, 0.0, 0.0])


class MyData(data.Data):
    def __init__(self, n=0):
        self.n = n

    def __add__(self, other):
        return MyData(self.n + other.n)


class MyStore(data.DataStore):
    data_type = MyData


class Sites(scene.UniformTargets):
    def regenerate_targets(self):
        self.targets = [scene.Target(f"site-{k}", POINT, np.random.rand()) for k in range(self.n_targets)]


def in_form(cls: type) -> bool:
    """Whether a class is one of bsk_rl's form, which environments run."""
    return issubclass(cls, data.GlobalReward) and cls.is_single


def is_rewarder(made: object) -> bool:
    return isinstance(made, data.GlobalReward)


def drawn(scenario, name):
    return scenario.draw(rand.first_key(2))[f"target_{name}"]


IDIOMS: list[Idiom] = [
    ("scene.targets.Target('tgt', r_LP_P=[7e6, 0, 0], priority=0.5)", lambda t: t.name == "tgt" and t.r_LP_P.shape == (3,)),
    ("scene.Target('tgt', POINT, 0.5).id", lambda name: name.startswith("tgt_")),
    ("repr(scene.Target('tgt', POINT, 0.5))", lambda text: text == "Target(tgt)"),
    ("{scene.Target('a', POINT, 0.5): 1}", len),
    ("Sites(n_targets=(2, 5))", lambda s: drawn(s, "priority").shape == (2, 4)),
    (
        "type('T', (scene.UniformTargets,), {'regenerate_targets': lambda self: super(T0, self).regenerate_targets()})",
        lambda cls: cls(3),
    ),
    ("type('D', (data.base.Data,), {'__add__': lambda self, other: self})()", lambda d: d + d is d),
    ("MyStore(None, initial_data=MyData(3)).data.n", lambda n: n == 3),
    ("type('R', (data.GlobalReward,), dict(data_store_type=MyStore))", in_form),
    ("type('R', (data.base.GlobalReward,), dict(datastore_type=MyStore))", lambda cls: cls().data_type is MyData),
    ("type('R', (data.UniqueImageReward,), dict(calculate_reward=lambda self, new_data_dict: {}))", in_form),
    ("type('R', (data.UniqueImageReward,), dict(is_truncated=lambda self, satellite: False))", in_form),
    ("type('R', (data.UniqueImageReward,), dict(initial_data=lambda self, satellite: None))(reward_fn=min)", is_rewarder),
    ("type('R', (data.NoReward,), dict(create_data_store=lambda self, satellite: None))()", is_rewarder),
    ("type('R', (data.ScanningTimeReward,), dict(data_type=MyData, reset_pre_sim_init=lambda self: None))()", is_rewarder),
    ("data.UniqueImageData(imaged={1, 2}, known={1, 2, 3}) + data.UniqueImageData(imaged={2})", lambda d: d.duplicates == 1),
    ("data.UniqueImageStore.data_type", lambda kind: kind is data.UniqueImageData),
    (
        "type('C', (comm.CommunicationMethod,), {'communication_pairs': lambda self: [(self.satellites[0],) * 2]})",
        lambda cls: cls(min_period=60.0).min_period == 60.0,
    ),
    ("env.scenario.target_objects(0)[3].name", lambda name: name == "tgt-3"),
    ("env.rewarder.data.imaged", lambda imaged: not imaged.any()),
    ("len(env.rewarder.data_of(0).known)", lambda count: count == 40),
    ("env.satellite.data_store.data.imaged", lambda imaged: imaged.shape == (1, 40)),
    ("env.satellite.one(0).data_store.data.imaged", lambda imaged: imaged == set()),
    ("env.satellite.one(0).dynamics.storageUnit.storageUnitDataOutMsg.read().storedData[0]", lambda level: level == 0.0),
    ("env.satellite.one(0).dynamics.instrument.nodeBaudRate", lambda rate: rate > 0.0),
    ("env.satellite.calculate_additional_windows(6000.0)", lambda nothing: nothing is None),
]

T0 = Sites


@pytest.fixture(scope="module")
def env():
    made = bsk_torch.make("AEOS-v1", n_targets=40, num_envs=1, time_limit=300.0, seed=1)
    made.reset()
    return made


@pytest.mark.parametrize("idiom", IDIOMS, ids=title)
def test_idiom(idiom: Idiom, env):
    line, check = idiom
    names = dict(POINT=POINT, Sites=Sites, MyData=MyData, MyStore=MyStore, T0=T0, env=env)
    result = check(run(line, **names))
    assert result is None or result is not False


def test_windows_of_an_environment_reach_further_afterwards(env):
    before = env.satellite.window_calculation_time.clone()
    env.satellite.calculate_additional_windows(700.0)
    assert (env.satellite.window_calculation_time - before).tolist() == [1200.0]
