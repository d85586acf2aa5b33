"""Lines of bsk_rl programs with scenarios, data, rewarders and communicators of their own."""

from __future__ import annotations

import numpy as np
import pytest

import bsk_torch
from bsk_torch import rand, scene

from .runner import Idiom, run, title

pytestmark = pytest.mark.compiled

POINT = np.array([7e6, 0.0, 0.0])


class Sites(scene.UniformTargets):
    def regenerate_targets(self):
        self.targets = [scene.Target(f"site-{k}", POINT, np.random.rand()) for k in range(self.n_targets)]


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
    names = dict(POINT=POINT, Sites=Sites, T0=T0, env=env)
    result = check(run(line, **names))
    assert result is None or result is not False


def test_windows_of_an_environment_reach_further_afterwards(env):
    before = env.satellite.window_calculation_time.clone()
    env.satellite.calculate_additional_windows(700.0)
    assert (env.satellite.window_calculation_time - before).tolist() == [1200.0]
