"""Objects made and called in torch's inference mode also work outside of it, and the other way round."""

import pickle

import pytest
import torch

import bsk_torch

pytestmark = pytest.mark.compiled

OPTIONS = {"num_envs": 2, "seed": 0, "time_limit": 900.0, "max_step_duration": 120.0}

PRESETS = {
    "NadirScan-v1": {},
    "AEOS-v1": {"n_targets": 50},
    "Constellation-v1": {"n_satellites": 3, "n_planes": 1, "phasing": 0, "n_targets": 50},
    "RSOInspection-v1": {},
}


def made(preset, **changes):
    return bsk_torch.make(preset, **{**OPTIONS, **PRESETS[preset], **changes})


def flown(env, steps=2):
    torch.manual_seed(1)
    flight = env.rollout(steps, break_when_any_done=False)
    return {key: value.clone() for key, value in flight.items(True, True)}


def same(one, other):
    return one.keys() == other.keys() and all(torch.equal(one[key], other[key]) for key in one)


@pytest.mark.parametrize("preset", PRESETS)
def test_made_in_it_and_used_outside(preset):
    expected = flown(made(preset))
    with torch.inference_mode():
        env = made(preset)
        inside = flown(env)
    env.set_seed(0)
    assert same(inside, expected)
    assert same(flown(env), expected)
    with torch.inference_mode():
        env.set_seed(0)
        assert same(flown(env), expected)
    env.set_seed(0)
    assert same(flown(env), expected)


def test_environments_made_in_it_are_used_outside():
    with torch.inference_mode():
        env = made("NadirScan-v1", num_envs=40)
        env.reset()
    env.set_seed(0)
    assert same(flown(env), flown(made("NadirScan-v1", num_envs=40)))
    env.reset()
    with torch.inference_mode():
        env = made("AEOS-v1")
        env.reset()
        env.rollout(2, break_when_any_done=False)
        env.satellite.find_windows(2e4)
        assert not [path for path, value in tensors(env.state) if value.is_inference()]


@pytest.mark.parametrize("change", ["states", "queries", "arguments", "seeds", "copies", "pickles"])
def test_calls_between_steps(change):
    """Each call in inference mode, then steps and resets outside of it."""
    env = made("AEOS-v1", num_envs=3)
    env.reset()
    with torch.inference_mode():
        if change == "states":
            env.restore(env.get_state())
            env.restore(env.get_state()[:2], [1, 2], [0, 1])
        elif change == "queries":
            env.satellite.find_windows(2e4)
        elif change == "arguments":
            env.set_sat_args({"batteryStorageCapacity": 3e8})
            env.set_sat_args({"storedCharge_Init": torch.tensor(1e5, dtype=torch.float64)})
        elif change == "seeds":
            env.reseed([4, 5, 6])
        elif change == "copies":
            other = env.like(2)
            other.restore(env, [0, 1], [2, 0])
            env = other
        else:
            env = pickle.loads(pickle.dumps(env))
    flown_once = env.rollout(2, break_when_any_done=False, auto_reset=False, tensordict=env.observe())
    assert flown_once["next", "reward"].isfinite().all()
    env.reset()
    flown(env)


def tensors(table, path=""):
    """Every tensor of a tree of state with its path."""
    for name in table:
        yield f"{path}{name}", table[name]
    for name, inner in table.tables.items():
        yield from tensors(inner, f"{path}{name}.")
