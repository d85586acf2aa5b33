"""Faults: when they act, what they change, what is observed of them, and errors; flights with Basilisk: tests/basilisk."""

import math
import pickle

import pytest
import torch

from bsk_torch import SatelliteTasking, act, dyn, faults, fsw, obs, rand, sats
from bsk_torch.sim.component import Arg, Component, Field
from tests.sim.dyn.flights import CHARGE, SCAN, fly
from tests.support.refusals import check_refusals, refusal


def clicks(bus):
    bus.clicks = bus.clicks + bus.click_size


CLICKER = Component(
    slot="clicker",
    after="battery",
    update=clicks,
    args=(Arg("clickSize", 1.0, "-", "what is counted in each tick"),),
    state=(Field("clicks", 1, "-", exact=True),),
    params=(Field("click_size", 1, "-", exact=True),),
    initial=lambda args: {"clicks": torch.zeros(1, dtype=torch.float64)},
    prepare=lambda args: {"click_size": args["clickSize"]},
)


class ClickingDynModel(dyn.GroundStationDynModel):
    components = (CLICKER,)

    @dyn.observable
    def clicks(now):  # noqa: N805
        """What has been counted."""
        return now.clicks


class Clicking(sats.Satellite):
    observation_spec = (obs.SatProperties(dict(prop="clicks"), dict(prop="fault_severity")),)
    action_spec = (act.Drift(duration=10.0), act.Drift(name="long", duration=100.0))
    dyn_type = ClickingDynModel
    fsw_type = fsw.BasicFSWModel


def clicking(*listed: faults.Fault, n: int = 1, **options) -> SatelliteTasking:
    given = {"num_envs": n, "backend": "eager", "time_limit": 1000.0, "seed": 0} | options
    return SatelliteTasking(Clicking("A", {"faults": list(listed)}), **given)


class PlainClicking(Clicking):
    observation_spec = (obs.SatProperties(dict(prop="clicks")),)


def counted(env: SatelliteTasking, steps: int = 1, action: int = 0) -> torch.Tensor:
    """What is counted after some steps, [N]."""
    td = env.reset()
    for _ in range(steps):
        td = env.step(td.set("action", torch.full((env.num_envs,), action)))["next"]
    return env.satellite.dynamics.clicks


CASES = {
    "value": ([faults.Fault("clickSize", value=3.0, at=4.0)], 4.0 + 6 * 3.0),
    "between two ticks": ([faults.Fault("clickSize", value=3.0, at=3.2)], 4.0 + 6 * 3.0),
    "factor": ([faults.Fault("clickSize", factor=0.0, at=4.0)], 4.0),
    "recovers": ([faults.Fault("clickSize", value=3.0, at=4.0, lasts=2.0)], 4.0 + 2 * 3.0 + 4.0),
    "grows": ([faults.Fault("clickSize", value=5.0, at=4.0, over=4.0)], 4.0 + (2 + 3 + 4 + 5) + 2 * 5.0),
    "two": (
        [faults.Fault("clickSize", factor=2.0, at=2.0), faults.Fault("clickSize", factor=3.0, at=5.0, name="more")],
        2.0 + 3 * 2.0 + 5 * 6.0,
    ),
    "later ones end first": (
        [
            faults.Fault("clickSize", value=7.0, at=2.0, name="a"),
            faults.Fault("clickSize", value=2.0, at=4.0, lasts=1.0, name="b"),
        ],
        2.0 + 2 * 7.0 + 2.0 + 5 * 7.0,
    ),
    "never": ([faults.Fault("clickSize", value=3.0)], 10.0),
    "after the step": ([faults.Fault("clickSize", value=3.0, at=10.0)], 10.0),
}


@pytest.mark.parametrize("backend", ["eager", pytest.param("compiled", marks=pytest.mark.compiled)])
@pytest.mark.nightly("eager")
def test_faults_act_from_the_tick_after_their_time(backend):
    """Every satellite has two, so that all have the same kernels, of which the second one may never happen."""
    failures = []
    for case, (listed, expected) in CASES.items():
        two = [*listed, faults.Fault("clickSize", value=9.0, name="never")][:2]
        env = clicking(*two, backend=backend)
        start = counted(env, 0)
        gained = float(counted(env) - start)
        failures += [f"{case}: {gained}, not {expected}"] * (gained != expected)
    assert not failures, "\n".join(failures)


def test_satellites_without_faults_count_alike():
    env = SatelliteTasking(PlainClicking("A"), num_envs=1, backend="eager", time_limit=1000.0, seed=0)
    start = counted(env, 0)
    assert float(counted(env) - start) == 10.0


def test_faults_are_drawn_for_each_environment_at_their_rate():
    listed = faults.Fault("clickSize", value=2.0, at=faults.Sometimes(0.5, rand.Uniform(0.0, 100.0)))
    many = counted(clicking(listed, n=40), 1, 1)
    assert 5 < len(many.unique()) < 40
    assert 10 < (many == many.min()).sum() < 30  # half of them never have it
    few = counted(clicking(listed, n=3, env_ids=[7, 0, 39]), 1, 1)
    assert torch.equal(few, many[[7, 0, 39]])
    times = faults.Hazard(0.02).draw(
        rand.Key(torch.full((20000,), 5), torch.arange(20000), torch.zeros(20000, dtype=torch.int64)).named("hazard")
    )
    assert times.min() >= 0.0
    assert math.isclose(times.mean(), 50.0, rel_tol=0.03)  # 4 sigma of the mean of 20,000
    assert math.isclose((times > 50.0).double().mean(), math.exp(-1.0), abs_tol=0.015)


def test_injected_faults_begin_now_in_some_environments():
    env = clicking(faults.Fault("clickSize", value=5.0, lasts=4.0, name="loud"), n=4)
    start = counted(env, 1)
    env.inject("loud", envs=[1, 3])
    td = env.step(current(env).set("action", torch.zeros(4, dtype=torch.int64)))
    gained = td["next", "observation"][:, 0].double() - start
    assert gained.tolist() == [10.0, 26.0, 10.0, 26.0]
    assert torch.equal(env.satellite.dynamics.fault_severity, torch.zeros(4, 1, dtype=torch.float64))  # over again


def current(env: SatelliteTasking):
    """The tensordict of the current state."""
    return env.full_action_spec.zero().update(env.fake_tensordict().exclude("next"))


def test_saved_states_and_copies_have_the_faults():
    env = clicking(faults.Fault("clickSize", value=5.0, name="loud"), n=2)
    counted(env, 1)
    env.inject("loud", envs=[1])
    saved = pickle.loads(pickle.dumps(env.get_state()))
    other = env.like(2)
    other.reset()
    other.restore(env, [0, 1], [0, 1])
    step = {"action": torch.zeros(2, dtype=torch.int64)}
    outcomes = []
    for each in (env, other):
        each.step(current(each).update(step))
        outcomes.append(each.satellite.dynamics.clicks.clone())
    assert torch.equal(outcomes[0], outcomes[1])
    env.restore(saved)
    env.step(current(env).update(step))
    assert torch.equal(env.satellite.dynamics.clicks, outcomes[0])
    env.reset()
    assert float(env.satellite.dynamics.fault_severity.max()) == 0.0  # an injected fault ends with its episode


def test_ready_faults_of_wheels_and_instruments():
    env = fly({"faults": [faults.wheel_torque(0, at=0.0)]}, actions=(CHARGE,))
    sound = fly({}, actions=(CHARGE,))
    turned = [each.simulator.state.read("motor_torque_B") for each in (env, sound)]
    assert float(turned[0][:, 0].abs().max()) <= 1e-12
    assert float(turned[1][:, 0].abs().max()) > 1e-6
    lost = fly({"faults": [faults.instrument(at=0.0)]}, actions=(SCAN,) * 4).satellite.dynamics.storage_level
    sound = fly({}, actions=(SCAN,) * 4).satellite.dynamics.storage_level
    assert bool((lost < sound).any())
    assert not any(field.startswith("fault_") for field in fly({}, actions=()).simulator.tick.own.fields)


@pytest.fixture(scope="module")
def sound():
    """A satellite without faults, after the same action."""
    return fly({}, actions=(CHARGE,)).satellite.dynamics


@pytest.mark.parametrize(
    ("fault", "quantity"),
    [
        (faults.panel(0.0, at=0.0), "battery_charge"),
        (faults.battery(0.3, at=0.0), "battery_charge"),
        (faults.wheel_power(1, 0.01, at=0.0), "wheel_speeds"),
        (faults.wheel_friction(2, at=0.0), "wheel_speeds"),
        (faults.wheel_unavailable(0, at=0.0), "wheel_speeds"),
        (faults.stuck_panel([1.0, 0.0, 0.0], at=0.0), "battery_charge"),
    ],
    ids=lambda given: getattr(given, "name", given),
)
def test_ready_faults_change_what_they_name(fault, quantity, sound):
    faulty = fly({"faults": [fault]}, actions=(CHARGE,)).satellite.dynamics
    read = [getattr(dynamics, quantity) for dynamics in (faulty, sound)]
    as_tensors = [torch.stack(value, -1) if isinstance(value, tuple) else value for value in read]
    assert not torch.allclose(*(torch.as_tensor(value) for value in as_tensors), rtol=1e-6, atol=0.0)


def test_rejects_wrong_faults():
    loud = clicking(faults.Fault("clickSize", value=5.0, name="loud"), n=2)
    sound = SatelliteTasking(PlainClicking("A"), num_envs=1, backend="eager", time_limit=1000.0)
    wrong = Clicking("A", {"faults": "wheel"})
    for env in (loud, sound):
        env.reset()
    twice = [faults.Fault("clickSize", value=1.0 + k) for k in range(2)]
    check_refusals(
        refusal(lambda: faults.Fault("u_max"), ValueError, "'u_max'", "value=None", "factor=None"),
        refusal(lambda: clicking(faults.Fault("u_maximum", value=1.0)), ValueError, "'u_maximum'", "'u_max'"),
        refusal(lambda: clicking(faults.wheel_torque(9, at=1.0)), ValueError, "wheel_torque9", "index=9", "3"),
        refusal(lambda: SatelliteTasking(wrong, backend="eager"), ValueError, "sat_args", "faults='wheel'"),
        refusal(lambda: clicking(*twice), ValueError, "sat_args", "2 faults", "'clickSize'"),
        refusal(lambda: faults.Fault("u_max", value=1.0, at=math.inf), ValueError, "'u_max'", "at=inf", "[0, inf)"),
        refusal(lambda: clicking(faults.wheel_torque(0, 0.0, at=1.0)), ValueError, "'wheel_torque0'", "u_max=0", "limit"),
        refusal(lambda: faults.Hazard(-1.0), ValueError, "Hazard", "rate=-1.0", "(0, inf)"),
        refusal(lambda: faults.Sometimes(1.5, 10.0), ValueError, "Sometimes", "chance=1.5", "[0, 1]"),
        refusal(lambda: clicking(faults.Fault("wheels", value=1.0)), ValueError, "fault 'wheels'", "environment", "episode"),
        refusal(lambda: faults.Fault("u_max", value=1.0, index=-1), ValueError, "'u_max-1'", "index=-1", "part"),
        refusal(lambda: loud.inject("lout"), ValueError, "'lout'", "'loud'"),
        refusal(lambda: loud.inject("loud", envs=[2]), IndexError, "envs=[2]"),
        refusal(lambda: sound.inject("loud"), ValueError, "'loud'", "none"),
    )
