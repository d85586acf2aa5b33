"""The phases of a step as kernels of rows: the numbers of the phases on tensors, bit for bit."""

import random

import pytest
import torch

import bsk_torch
from bsk_torch import SatelliteTasking, act, data, dyn, rand, scene
from bsk_torch.env.native import reason_for_tensors
from bsk_torch.presets.nadir_scan import ScanningSatellite

ACTIONS = (
    act.Scan(duration=180.0),
    act.Charge(duration=120.0),
    act.Charge("short_charge", duration=0.5),
    act.Downlink(duration=60.3),
    act.Desat(duration=45.0),
    act.Drift(duration=400.0),
)


class PaidBySteps(data.GlobalReward):
    """A reward of a user, in float32."""

    def calculate_reward(self, before, after):
        return (0.3 * self.step_duration).float().unsqueeze(1)


def pair(seed: int) -> tuple[SatelliteTasking, SatelliteTasking]:
    """Return an environment drawn by ``seed`` twice, the second one with its phases on tensors."""
    draw = random.Random(seed)

    class Drawn(ScanningSatellite):
        action_spec = tuple(draw.sample(ACTIONS, draw.randint(1, len(ACTIONS))))

    args = {"storedCharge_Init": rand.Uniform(0.0, 20_000.0), "wheelSpeeds": rand.Uniform(-4000.0, 4000.0, size=3)}
    options = {
        "rewarder": draw.choice(
            [data.ScanningTimeReward(), data.NoReward(), PaidBySteps(), [data.ScanningTimeReward(), PaidBySteps()]]
        ),
        "failure_penalty": draw.choice([0.0, -1.0, -0.1]),
        "terminate_on_time_limit": draw.random() < 0.5,
        "time_limit": draw.choice([700.0, 3000.5]),
        "max_step_duration": draw.choice([1e9, 100.0]),
        "dtype": draw.choice([torch.float32, torch.float64]),
        "num_envs": draw.choice([1, 3, 20]),
    }
    interval = draw.random() < 0.7
    made = [
        SatelliteTasking(
            Drawn("EO1", sat_args=args, variable_interval=interval),
            scenario=scene.UniformNadirScanning(value_per_second=1 / 700),
            seed=seed,
            **options,
        )
        for _ in range(2)
    ]
    made[1].__dict__["native"] = None
    return made[0], made[1]


@pytest.mark.compiled
@pytest.mark.parametrize("seed", range(4))
def test_kernels_and_tensors_give_the_same_numbers(seed):
    native, tensors = pair(seed)
    assert native.native is not None
    states = [env.reset() for env in (native, tensors)]
    ended = 0
    for _ in range(25):
        action = torch.randint(len(native.satellite.action_description), (native.num_envs,))
        for td in states:
            td["action"] = action
        pairs = [env.step_and_maybe_reset(td) for env, td in zip((native, tensors), states, strict=True)]
        steps, states = ([each[k] for each in pairs] for k in (0, 1))
        ended += int(steps[0]["next", "done"].sum())
        for key in steps[0].keys(True, True):
            assert torch.equal(steps[0][key], steps[1][key]), key
    assert ended
    saved = [env.get_state() for env in (native, tensors)]
    for key in saved[0].keys(True, True):
        torch.testing.assert_close(saved[0][key], saved[1][key], rtol=0, atol=0, equal_nan=True, msg=str(key))


@pytest.mark.compiled
@pytest.mark.parametrize(
    "options", [{"name": "AEOS-v1"}, {"name": "Constellation-v1", "n_satellites": 3}], ids=lambda o: o["name"]
)
def test_images_by_kernels_and_on_tensors(options):
    kernels, tensors = envs = [bsk_torch.make(**options, num_envs=3, seed=1, time_limit=1500.0) for _ in range(2)]
    assert all(kernels.images)
    tensors.__dict__["images"] = [None]
    states, imaged, key = [env.reset() for env in envs], 0, kernels.action_keys[0]
    for step in range(40):
        action = kernels.full_action_spec.rand()[key]
        satellite = kernels.satellites[0]
        if step % 10 == 3:  # a target by its index, for which a kernel has nothing to look up
            action.flatten()[0] = -1 - satellite.find_next_opportunities(1).place[0, 0]
        for td in states:
            td[key] = action
        pairs = [env.step_and_maybe_reset(td) for env, td in zip(envs, states, strict=True)]
        steps, states = ([each[k] for each in pairs] for k in (0, 1))
        for entry in steps[0].keys(True, True):
            assert torch.equal(steps[0][entry], steps[1][entry]), entry
        imaged = max(imaged, int(satellite.imaged.sum()))
    moves = torch.tensor([True, False, True])
    for td, env in zip(states, envs, strict=True):
        given = action.clamp(min=0) if isinstance(env, SatelliteTasking) else [action.clamp(min=0)]
        td.update(env.play(given, moves))
    saved = [env.get_state() for env in envs]
    for entry in saved[0].keys(True, True):
        assert torch.equal(saved[0][entry], saved[1][entry]), entry
    assert imaged
    assert satellite.missed.any()


@pytest.mark.compiled
def test_a_wrong_action_changes_nothing():
    env = bsk_torch.make("NadirScan-v1", num_envs=2, seed=0)
    td = env.reset()
    before = env.get_state()
    for wrong in (4, -1, 2**31 - 1):
        with pytest.raises(ValueError, match=f"action {wrong} of environment 1 is out of range"):
            env.step(td.clone().set("action", torch.tensor([1, wrong])))
    assert env.state.begun.all()
    after = env.get_state()
    assert all(torch.equal(before[key], after[key]) for key in before.keys(True, True) if before[key].dtype != torch.float64)
    assert torch.equal(before["satellites_0", "planes"], after["satellites_0", "planes"])


@pytest.mark.compiled
def test_recordings_and_partial_steps_keep_the_phases_on_tensors():
    env = bsk_torch.make("NadirScan-v1", num_envs=2, seed=0)
    td = env.reset()
    assert env.native is not None
    assert env.native.applies
    only = env.play(torch.tensor([1, 1]), torch.tensor([True, False]))
    assert only["duration"].flatten().tolist() == [120.0, 0.0]
    with env.record(["r_BN_N"]):
        assert not env.native.applies
        env.step(env.rand_action(td))
    assert env.native.applies


class OwnCheckDynModel(ScanningSatellite.dyn_type):
    @dyn.aliveness_checker
    def always(self):
        return torch.ones_like(self.battery_valid())


class Checked(ScanningSatellite):
    dyn_type = OwnCheckDynModel


class Proud(ScanningSatellite):
    def is_alive(self):
        return super().is_alive()


class Ending(data.ScanningTimeReward):
    def is_terminated(self):
        return super().is_terminated()


class Heard(act.Charge):
    def begin(self, mask, decision):
        pass


class Hearing(ScanningSatellite):
    action_spec = (Heard(duration=60.0),)


@pytest.mark.parametrize(
    ("satellite", "options", "reason"),
    [
        (ScanningSatellite, {}, None),
        (ScanningSatellite, {"log_level": "INFO"}, "a log of the episodes"),
        (ScanningSatellite, {"rewarder": Ending()}, "a rewarder that ends episodes"),
        (Checked, {}, "custom aliveness checks"),
        (Proud, {}, "custom aliveness checks"),
        (Hearing, {}, "actions that are more than a table"),
    ],
)
def test_reasons_for_tensors(satellite, options, reason):
    options = {"rewarder": data.ScanningTimeReward(), **options}
    env = SatelliteTasking(satellite("EO1"), scenario=scene.UniformNadirScanning(), backend="eager", **options)
    assert reason_for_tensors(env) == reason
    assert env.native is None  # without kernels of ticks there are none of phases
