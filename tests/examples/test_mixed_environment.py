"""An inspection and imaging side by side, from a recorded start with the recorded actions: all three satellites are bsk_rl's."""

import numpy as np
import pytest
import torch

from bsk_torch import scene
from bsk_torch.tasks.inspection import SphericalRSO
from tests.examples.recorded import EXACT, example, load, start

pytestmark = pytest.mark.compiled

OBSERVED = 1e-6
"""Bound of observations, relative above one."""


@pytest.fixture(scope="module")
def flown():
    recorded = load("mixed_environment")
    points = SphericalRSO(n_points=100, theta_max=1.4, theta_solar_max=1.5)
    groups = {"ground_scene": ["Ground"], "rso_scene": ["RSO", "Inspector"]}
    scenes = scene.MixedScenario({"ground_scene": recorded.targets, "rso_scene": points}, groups)
    env = example("mixed_environment").make(**start(recorded), scenario=scenes, mask_busy=False)
    td, rows = env.reset(), []
    at = {name: (group, k) for group, names in env.group_map.items() for k, name in enumerate(names)}
    for k in range(len(recorded.arrays["action"]) + 1):
        rows.append({name: {"observation": td[group, "observation"][0, i].numpy()} for name, (group, i) in at.items()})
        rows[-1]["duration"] = float(td["duration"][0]) if k else 0.0
        rows[-1]["terminated"] = env.rewarder.is_terminated()[0].tolist()
        for name, (group, i) in at.items():
            if k:
                keys = ("reward", "mask", "requires_retasking")
                rows[-1][name] |= {key: float(td[group, key][0, i]) for key in keys}
        if k == len(recorded.arrays["action"]):
            break
        for group, names in env.group_map.items():
            action = torch.zeros(1, len(names), dtype=torch.int64)
            for name, (other, i) in at.items():
                if other == group:
                    given = int(recorded.arrays["action"][k, recorded.setup["names"].index(name)])
                    mask = td[group, "action_mask"][0, i]
                    action[0, i] = given if given >= 0 and bool(mask[given]) else len(mask) - 1
            td[group, "action"] = action
        td = env.step(td)["next"]
    return recorded, env, rows


def test_names_are_those_of_bsk_rl(flown):
    recorded, env, _ = flown
    assert len(env.satellites) == 3
    for part in env.satellites:
        k = recorded.setup["names"].index(part.names[0])
        assert list(part.action_description) == recorded.setup["action_description"][k]
        assert list(part.observation_description) == recorded.setup["observation_description"][k]


def test_rewards_and_ends_are_those_of_bsk_rl(flown):
    recorded, env, rows = flown
    arrays, names = recorded.arrays, recorded.setup["names"]
    for k, row in enumerate(rows[1:]):
        assert row["duration"] == pytest.approx(arrays["duration"][k], abs=EXACT)
        for i, name in enumerate(names):
            assert bool(row[name]["mask"]) == arrays["present"][k, i], (k, name)
            if not arrays["present"][k, i]:
                continue
            assert row[name]["reward"] == pytest.approx(arrays["reward"][k, i], abs=EXACT), (k, name)
            assert bool(row[name]["requires_retasking"]) == arrays["requires_retasking"][k, i], (k, name)
        assert row["terminated"] == arrays["terminated"][k].tolist()
    ended = np.flatnonzero(arrays["terminated"][:, 2])[0]
    assert 10 < ended < len(arrays["reward"]) - 10  # the inspection is complete, and the others continue
    assert arrays["reward"][ended, 2] > 1.0
    assert (arrays["reward"][:, 0] > 0.0).sum() > 10
    assert env.rewarder.cum_reward["Inspector"].item() == pytest.approx(arrays["reward"][:, 2].sum(), abs=EXACT)


def test_observations_are_those_of_bsk_rl(flown):
    recorded, _, rows = flown
    worst, seen = 0.0, 0
    for k, row in enumerate(rows):
        for i, name in enumerate(recorded.setup["names"]):
            wanted = recorded.arrays["obs"][k, i]
            wanted = wanted[~np.isnan(wanted)]
            seen += len(wanted)
            if len(wanted):
                error = np.abs(row[name]["observation"][: len(wanted)] - wanted) / np.maximum(1.0, np.abs(wanted))
                worst = max(worst, float(error.max()))
                assert worst < OBSERVED, (k, name, error)
    assert seen > 0
