"""The criterion of stable gains agrees with eigenvalues, and with what satellites do on both sides of the border."""

import logging

import numpy as np
import pytest
import torch

import bsk_torch
from bsk_torch import SatelliteTasking, act, obs, sats
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.fsw.stability import Law, attitude_rate, gains_at, is_stable, rate_gain, roots_within
from tests.support.refusals import check_refusals, refusal


def one(x: float) -> torch.Tensor:
    return torch.tensor([[x]], dtype=torch.float64)


def test_roots_within():
    generator = np.random.default_rng(3)
    turns = np.array([0.0, 0.0, 1.0, -1.0]) * generator.uniform(0, 3, (500, 1))
    roots = generator.uniform(-1.3, 1.3, (500, 4)) * np.exp(1j * turns)
    roots[:, 3] = roots[:, 2].conj()
    polynomials = [np.poly(row).real for row in roots]
    found = roots_within([torch.tensor([p[k] for p in polynomials]) for k in range(5)])
    assert found.tolist() == (np.abs(roots).max(1) < 1.0).tolist()
    assert 50 < int(found.sum()) < 450


def closed_loop(a0: float, a1: float, r0: float, r1: float, J: float, h: float, differenced: bool) -> np.ndarray:
    """One tick of the loop on (s, w, torque of this tick, last s, sum of s, sum of w), built step by step."""
    columns = []
    for start in np.eye(6):
        s, w, u, last, sum_s, sum_w = start
        rate = 4.0 * (s - last) / h if differenced else w
        sum_s, sum_w = sum_s + s, sum_w + rate
        command = a0 * s + a1 * sum_s + r0 * rate + r1 * sum_w
        columns.append([s + 0.25 * (w * h - u * h * h / (2 * J)), w - u * h / J, command, s, sum_s, sum_w])
    return np.array(columns).T


@pytest.mark.parametrize("integral", [False, True])
def test_criterion_against_eigenvalues(integral):
    generator = np.random.default_rng(4)
    counts = {True: 0, False: 0}
    for _ in range(300):
        J, h = generator.uniform(0.5, 300.0), generator.uniform(0.1, 5.0)
        p, kappa = generator.uniform(0.0, 1.2), generator.uniform(0.0, 0.4)
        a0, r0 = kappa * 4 * J / h**2, p * J / h
        a1, r1 = (generator.uniform(0.0, 0.1) * a0, generator.uniform(0.0, 0.1) * r0) if integral else (0.0, 0.0)
        size = 6 if integral else 4  # sums that nothing reads keep their values
        loops = (closed_loop(a0, a1, r0, r1, J, h, differenced)[:size, :size] for differenced in (False, True))
        radius = max(np.abs(np.linalg.eigvals(loop)).max() for loop in loops)
        if abs(radius - 1.0) < 1e-6:
            continue
        law = Law(one(a0), one(a1), one(r0), one(r1))
        stable = bool(is_stable(law, one(J), h))
        counts[stable] += 1
        assert stable == (radius < 1.0), (p, kappa, radius)
    assert integral or min(counts.values()) > 30


class Pointer(sats.Satellite):
    observation_spec = (obs.SatProperties(dict(prop="omega_BH_H"), dict(prop="wheel_speeds")),)
    action_spec = (act.NadirPoint(duration=900.0),)
    dyn_type = dyn.BasicDynamicsModel
    fsw_type = fsw.BasicFSWModel


class Watcher(Pointer):
    """Points by differences of errors."""

    action_spec = (act.Charge(duration=900.0),)


def rate_after(kind: type, seconds: float = 60.0, **sat_args) -> float:
    """Largest rate relative to the Hill frame, rad/s, after pointing for a while."""
    given = dict(wheelSpeeds=[0.0, 0.0, 0.0], sigma_init=[0.01, 0.02, 0.03], omega_init=[0.0, 0.0, 0.0])
    env = SatelliteTasking(kind("A", sat_args=given | sat_args), num_envs=1, seed=0, backend="eager", max_step_duration=seconds)
    td = env.reset()
    td["action"] = torch.zeros(1, dtype=torch.int64)
    return float(env.step(td)["next", "observation"][:, :3].abs().max())


SMALLEST = 330.0 / 12.0 * (1.38**2 + 1.04**2) - 50.0 / 628.3185


@pytest.mark.parametrize(("kind", "border"), [(Pointer, 1.0), (Watcher, 0.828)])
def test_border_is_that_of_flights(kind, border, caplog):
    """``P h / J`` below the border: at rest. Above: the rate grows, and the log says so."""
    caplog.set_level(logging.WARNING)
    assert rate_after(kind, P=0.7 * border * SMALLEST, K=1.0, u_max=100.0) < 0.01
    assert not caplog.records
    assert rate_after(kind, P=1.3 * border * SMALLEST, K=1.0, u_max=100.0) > 0.02
    assert [record.getMessage() for record in caplog.records if "are stable, or a smaller sim_rate" in record.getMessage()]


def test_small_satellite():
    """Gains of a large satellite make a small one overflow: refused, with gains that hold it, which do."""
    light = dict(mass=4.0, wheelSpeeds=[0.0, 0.0, 0.0])
    check_refusals(refusal(lambda: rate_after(Pointer, **light), ValueError, "K=7", "P=35", "K=0.051", "P=0.33", "Ki=-1"))
    for kind in (Pointer, Watcher):
        assert rate_after(kind, **light, K=0.051, P=0.33) < 0.01


def test_rejects_bodies_that_wheels_turn_too_fast():
    small, fast = dict(mass=4.0, width=0.1, depth=0.1, height=0.34), dict(wheelSpeeds=[3e4, 0.0, 0.0])
    sizes = "mass=4", "width=0.1", "depth=0.1", "height=0.34"
    check_refusals(
        refusal(lambda: rate_after(Pointer, **small), ValueError, *sizes, "reaction wheels", "0.0796 kg m^2"),
        refusal(lambda: rate_after(Pointer, **fast), ValueError, "wheelSpeeds", "omega_init", "sim_rate"),
    )


def test_gains_do_not_matter_to_those_that_drift():
    class Drifter(Pointer):
        action_spec = (act.Drift(duration=60.0),)

    SatelliteTasking(Drifter("A", sat_args=dict(K=1e5, P=1e5, u_max=-1.0)), backend="eager")


@pytest.mark.parametrize("ratio", [1.0, 3.0, 30.0, 100.0])
@pytest.mark.parametrize("h", [0.1, 1.0, 10.0])
def test_proposed_gains_are_stable(ratio, h):
    """About all axes, for both control laws, with and without integral."""
    J = torch.tensor([[2.0, 2.0 * ratio, 1.5 * ratio + 0.5]], dtype=torch.float64)
    P = rate_gain(2.0, h)
    gains = {name: one(gain) for name, gain in gains_at(attitude_rate(P, float(J.max())), P).items()}
    none = one(0.0)
    assert bool(is_stable(Law(gains["K"], none, gains["P"], none), J, h).all())
    integral = gains["Ki"] * gains["P"]
    feedback = Law(gains["K"], integral * gains["K"] * h, gains["P"] + integral * J, none + 0.0 * J)
    assert bool(is_stable(feedback, J, h).all())
    K1, Ki = gains["K1"], gains["servo_Ki"]
    for sums in (0.0 * Ki, Ki * h):
        steering = Law(gains["servo_P"] * K1 - J * K1 * K1 / 4.0, sums * K1 + 0.0 * J, gains["servo_P"] + 0.0 * J, sums + 0.0 * J)
        assert bool(is_stable(steering, J, h).all())


def test_fixed_gains_are_checked_once_and_changed_ones_again(caplog):
    env = bsk_torch.make("NadirScan-v1", num_envs=2, seed=0, backend="eager")
    env.reset()
    checked = env.simulator.type.arguments._checked
    assert "control" in checked
    assert "hub" not in checked  # initial rates are random
    assert "is not stable" not in caplog.text
    env.set_sat_args({"P": 1e4})
    env.reset()
    assert "P=10000" in caplog.text
    assert "is not stable" in caplog.text
