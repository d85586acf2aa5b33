"""Failures that end steps: the first tick with an empty battery, or a wheel at its largest speed."""

from typing import Any

import pytest
import torch

from bsk_torch import ConstellationTasking, SatelliteTasking, act, data, obs, rand, sats, scene
from bsk_torch.constants import RPM
from bsk_torch.sim import dyn, fsw

N = 3
STILL = {name: [0.0, 0.0, 0.0] for name in ("sigma_init", "omega_init", "wheelSpeeds")}
DARK = {"rN": [7e6, 0.0, 0.0], "vN": [0.0, 7500.0, 0.0], "oe": None, "panelArea": 1e-9, **STILL}
POOR = {**DARK, "basePowerDraw": -10.0, "storedCharge_Init": 900.0, "batteryStorageCapacity": 1e5}
RICH = {**DARK, "storedCharge_Init": 9e4, "batteryStorageCapacity": 1e5}


class Scanner(sats.Satellite):
    observation_spec = (obs.Time(), obs.SatProperties(dict(prop="battery_charge_fraction"), dict(prop="storage_level")))
    action_spec = (act.Scan(duration=400.0), act.Drift(duration=300.0), act.Charge(duration=500.0))
    dyn_type = dyn.ContinuousImagingDynModel
    fsw_type = fsw.ContinuousImagingFSWModel


class Passive(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=450.0),)
    dyn_type = dyn.DynamicsModel
    fsw_type = fsw.FSWModel


OPTIONS: dict[str, Any] = {
    "scenario": scene.UniformNadirScanning(),
    "rewarder": data.ScanningTimeReward(),
    "num_envs": N,
    "time_limit": 2000.0,
    "failure_penalty": -7.0,
    "seed": 0,
    "world_args": {"utc_init": "2021 JUN 21 00:00:00"},
    "dtype": torch.float64,
}


def single(args: dict[str, Any], failures: str = "continuous", **options: Any) -> SatelliteTasking:
    fixed = {"imageAttErrorRequirement": 1.0, "imageRateErrorRequirement": 1.0, "instrumentBaudRate": 1.0}
    return SatelliteTasking(Scanner("A", {**fixed, **args}), **{**OPTIONS, "failures": failures, **options})


def step(env: Any, action: int) -> Any:
    return env.step(env.reset().set("action", torch.full((len(env.env_ids),), action)))["next"]


def flown(args: dict[str, Any], action: int, field: str) -> torch.Tensor:
    """A field at every tick of a step that a failure does not end, from reset on, [T]."""
    env = single(args, "step")
    td = env.reset()
    with env.record(field) as recording:
        env.step(td.set("action", torch.full((N,), action)))
    return recording.of(0)[field]


@pytest.mark.parametrize("backend", ["eager", pytest.param("compiled", marks=pytest.mark.compiled)])
def test_an_empty_battery_ends_the_step(backend):
    charge = flown(POOR, 2, "charge")
    dead = int((charge <= 0.0).nonzero()[0])
    assert 20 < dead < len(charge) - 1
    env = single(POOR, backend=backend)
    td = step(env, 2)
    assert td["duration"].flatten().tolist() == [float(dead)] * N
    assert td["terminated"].all()
    assert not td["truncated"].any()
    assert td["reward"].flatten().tolist() == [-7.0] * N
    assert env.dead.all()
    torch.testing.assert_close(env.simulator.read("charge")[0], charge[dead], rtol=0, atol=0 if backend == "compiled" else 1e-6)
    assert not env.satellite.aliveness()["battery_valid"].any()


@pytest.mark.compiled
def test_a_battery_that_recovers_within_a_step_matters_only_here():
    """In bsk_rl the battery may stand at zero, as long as it is charged again at the end of the step."""
    sun = {"panelArea": 3.0, "basePowerDraw": -60.0, "rN": [-7e6, 0.0, 0.0], "vN": [0.0, -7500.0, 0.0]}
    args = {**POOR, **sun}
    ends = {failures: step(single(args, failures), 2) for failures in ("step", "continuous")}
    charge = flown(args, 2, "charge")
    assert bool((charge <= 0.0).any())
    assert charge[-1] > 0.0
    assert not ends["step"]["terminated"].any()
    assert ends["step"]["duration"].flatten().tolist() == [500.0] * N
    assert ends["continuous"]["terminated"].all()
    assert ends["continuous"]["duration"].flatten().tolist() == [float((charge <= 0.0).nonzero()[0])] * N


@pytest.mark.compiled
def test_a_wheel_at_its_largest_speed_ends_the_step():
    args = {**RICH, "wheelSpeeds": [0.0, 0.0, 1490.0], "maxWheelSpeed": 1500.0, "disturbance_vector": [0.0, 0.0, 0.05]}
    speed = flown(args, 2, "Omega_WB_B").abs().amax(-1)
    dead = int((speed >= 1500.0 * RPM).nonzero()[0])
    assert 1 < dead < len(speed) - 1
    td = step(single(args), 2)
    assert td["duration"].flatten().tolist() == [float(dead)] * N
    assert td["terminated"].all()


@pytest.mark.compiled
def test_data_up_to_the_failure_count():
    args = {**POOR, "instrumentPowerDraw": -5.0, "storedCharge_Init": 1500.0}
    td = step(single(args), 0)
    level = flown(args, 0, "storage")[int(td["duration"][0])]
    assert level > 0.0
    assert td["reward"].flatten().tolist() == [float(level) - 7.0] * N
    assert td["observation"][:, 2].tolist() == [float(level)] * N


@pytest.mark.compiled
@pytest.mark.parametrize("failures", ["step", "continuous"])
def test_episodes_without_failures_are_the_same(failures):
    env = single(RICH, failures)
    td = env.reset()
    for action in (2, 0, 1):
        td = env.step(td.set("action", torch.full((N,), action)))["next"]
    again = single(RICH, "step")
    seen = again.reset()
    for action in (2, 0, 1):
        seen = again.step(seen.set("action", torch.full((N,), action)))["next"]
    assert torch.equal(td["observation"], seen["observation"])
    assert torch.equal(env.simulator.read("sigma_BN"), again.simulator.read("sigma_BN"))


@pytest.mark.compiled
def test_a_failure_ends_the_step_of_all_satellites_once():
    """The others go on with their tasks; the battery of the dead one stays empty without ending further steps."""
    satellites = [
        Scanner("Poor", POOR),
        Scanner("Rich", RICH),
        Passive("Passive", {"rN": DARK["rN"], "vN": DARK["vN"], "oe": None}),
    ]
    env = ConstellationTasking(satellites, **{**OPTIONS, "failures": "continuous"})
    td = env.reset()
    dead = int((flown(POOR, 2, "charge") <= 0.0).nonzero()[0])
    groups = env.group_map
    actions = {"Poor": 2, "Rich": 2, "Passive": 0}
    durations, rewards, deaths, waiting = [], [], [], []
    for _ in range(3):
        for group, names in groups.items():
            chosen = torch.tensor([actions[name] for name in names]).expand(N, -1)
            mask = td[group, "action_mask"]
            td[group, "action"] = torch.where(mask.gather(-1, chosen.unsqueeze(-1)).squeeze(-1), chosen, mask.shape[-1] - 1)
        td = env.step(td)["next"]
        durations.append(float(td["duration"][0]))
        deaths.append(env.dead[0].tolist())
        found = {name: td[group, "reward"][0, k].item() for group, names in groups.items() for k, name in enumerate(names)}
        rewards.append([found[name] for name in ("Poor", "Rich", "Passive")])
        waiting.append(env.requires_retasking[0].tolist())
    assert (durations, deaths) == ([float(dead), 450.0 - dead, 50.0], [[True, False, False]] * 3)
    assert rewards == [[-7.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    assert (waiting[0][1:], waiting[1][1:]) == ([False, False], [False, True])


@pytest.mark.compiled
def test_failures_do_not_depend_on_the_batch():
    args = {**POOR, "storedCharge_Init": rand.Uniform(500.0, 4500.0)}
    few, many = (step(single(args, num_envs=n), 2) for n in (N, 2 * N))
    assert torch.equal(few["duration"], many["duration"][:N])
    assert len(set(few["duration"].flatten().tolist())) > 1


@pytest.mark.compiled
def test_saved_episodes_go_on():
    env = single({**POOR, "storedCharge_Init": 3000.0})
    td = env.reset()
    td = env.step(td.set("action", torch.full((N,), 1)))["next"]
    other = single({**POOR, "storedCharge_Init": 3000.0})
    other.restore(env.get_state())
    ends = [one.step(td.clone().set("action", torch.full((N,), 2)))["next"]["duration"] for one in (env, other)]
    assert torch.equal(*ends)
