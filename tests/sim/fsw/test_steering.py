import math
from pathlib import Path

import numpy as np
import pytest
import torch

from bsk_torch.astro.attitude import mrp_rate
from bsk_torch.sim.component import Bus
from bsk_torch.sim.dyn.effectors.wheels import SPIN_INERTIA
from bsk_torch.sim.fsw import BasicFSWModel, SteeringFSWModel, SteeringImagerFSWModel, guidance, steering
from bsk_torch.vec3 import Vec3
from tests.sim.buses import N, plane, vectors, with_wheels, write

TABLE = np.load(Path(__file__).parents[1] / "data" / "steering.npz")
"""Recorded by record_modules.py: mrpSteering and rateServoFullNonlinear, with ticks in which they do not run."""

ROUNDING = 1e-13
GAINS = (0.25, 3.0, math.radians(3.0))


def tensor(values: np.ndarray) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def servo(bus: Bus, inertia: torch.Tensor) -> Bus:
    """Gains of the recorded cases, and a servo that has never been called."""
    write(with_wheels(bus), **dict(zip(steering.GAINS, tensor(TABLE["gains"]).unbind(-1), strict=True)))
    zero = plane(0.0, len(TABLE["gains"]))
    write(bus, motor_torque_command_B=Vec3(zero, zero, zero), control_integral_B=Vec3(zero, zero, zero), control_idle=zero - 1.0)
    return write(bus, inertia_B=Vec3(*(x + zero for x in inertia)))


def flown() -> tuple[torch.Tensor, torch.Tensor]:
    """Motor torques and integrals under the recorded inputs, [T, cases, 3] each."""
    bus, torques, integrals = servo(Bus(int(TABLE["h_ns"])), tensor(TABLE["inertia"])), [], []
    for inputs, on in zip(TABLE["inputs"], TABLE["on"], strict=True):
        *error, bus.Omega_WB_B = (Vec3.of(part) for part in tensor(inputs).split(3, -1))
        bus.error, bus.control_on = guidance.Error(*error), plane(float(on), len(inputs))
        steering.steer(bus)
        torques.append(bus.motor_torque_command_B.stack())
        integrals.append(bus.control_integral_B.stack())
    return torch.stack(torques), torch.stack(integrals)


def test_basilisks_steering_tick_by_tick_up_to_the_limit_of_the_integral():
    """Torques of up to 13 N m; sums are taken in another order, which makes 4e-15 N m."""
    torques, _ = flown()
    torch.testing.assert_close(torques, -tensor(TABLE["torque"]), rtol=0, atol=ROUNDING)
    assert 0 in TABLE["on"][3:]  # a pause, after which the integral accounts for all of it
    # Two cases do, one does not, and one has no integral.
    largest = flown()[1].abs().amax((0, 2))
    assert largest[:2].tolist() == pytest.approx([0.2 / 5.0] * 2, rel=1e-15)
    assert 0.0 < largest[2] < 0.2 / 0.05
    assert largest[3] == 0.0


def steered(sigma: Vec3) -> tuple[Vec3, Vec3]:
    return steering.steering_rate(sigma, *(plane(gain) for gain in GAINS))


def test_steering_rate_and_its_derivative():
    """The rate opposes every component of the error and approaches the limit; small errors see K1 alone."""
    sigma = vectors(0.4)
    rate, _ = steered(sigma)
    assert (rate.scale(sigma).stack() < 0.0).all()
    assert (rate.stack().abs() < GAINS[2]).all()
    assert (steered(sigma * 1e3)[0].stack().abs() > 0.999 * GAINS[2]).any()
    small = sigma * 1e-6
    torch.testing.assert_close(steered(small)[0].stack(), (small * -GAINS[0]).stack(), rtol=1e-9, atol=0.0)
    # Along the motion that the rate itself brings about, by central differences: their error is of second order in dt.
    sigma, dt = vectors(0.3), 1e-4
    rate, derivative = steered(sigma)
    step = mrp_rate(sigma, rate) * dt
    difference = (steered(sigma + step)[0] - steered(sigma - step)[0]) / (2.0 * dt)
    torch.testing.assert_close(derivative.stack(), difference.stack(), rtol=1e-5, atol=1e-10)


def test_a_servo_on_its_course_and_one_that_is_off_hold():
    """Without an error of the rate, the torque on the hub is what makes it move along the course: ``H' = L``."""
    inertia, zero = tensor(TABLE["inertia"]), Vec3.zeros_like(plane(0.0))
    bus = write(with_wheels(Bus(1_000_000_000)), control_on=plane(1.0), control_idle=plane(-1.0), Omega_WB_B=vectors(200.0))
    write(bus, **{name: plane(gain) for name, gain in zip(steering.GAINS, (*GAINS, 5.0, 150.0), strict=True)})
    write(bus, motor_torque_command_B=zero, control_integral_B=zero, inertia_B=Vec3(*(x + zero.x for x in inertia)))
    sigma, w_R, dw_R = vectors(0.3), vectors(1e-3), vectors(1e-6)
    w_s, dw_s = steered(sigma)
    bus.error = guidance.Error(sigma, w_s, w_R, dw_R)
    steering.steer(bus)
    w = w_s + w_R
    dw = dw_s + dw_R - w.cross(w_R)  # of the body, in its own axes
    H = bus.inertia_B.scale(w) + (w + bus.Omega_WB_B) * SPIN_INERTIA
    torque = bus.inertia_B.scale(dw) + w.cross(H)
    torch.testing.assert_close(bus.motor_torque_command_B.stack(), -torque.stack(), rtol=0, atol=ROUNDING)
    assert (bus.control_integral_B.stack().abs() < 1e-18).all()
    bus = servo(Bus(1_000_000_000), tensor(TABLE["inertia"]))
    n = len(TABLE["gains"])
    held, integral = vectors(1.0, n), vectors(1e-3, n)
    write(bus, motor_torque_command_B=held, control_integral_B=integral, control_on=plane(0.0, n), Omega_WB_B=vectors(100.0, n))
    bus.error = guidance.Error(*(vectors(0.1, n) for _ in range(4)))
    steering.steer(bus)
    assert (bus.control_idle == -1.0).all()  # never called: its clock does not run
    bus.control_idle = plane(2.0, n)
    steering.steer(bus)
    assert torch.equal(bus.motor_torque_command_B.stack(), held.stack())
    assert torch.equal(bus.control_integral_B.stack(), integral.stack())
    assert (bus.control_idle == 3.0).all()


@pytest.mark.parametrize("model", [SteeringFSWModel, SteeringImagerFSWModel])
def test_steering_replaces_feedback(model):
    parts = {part.slot: part for part in model.all_components()}
    assert parts["control"] is steering.MRP_STEERING
    names = {arg.name for part in parts.values() for arg in part.args}
    assert set(steering.GAINS) | {"controlAxes_B"} <= names
    assert not {"K", "Ki", "P"} & names
    feedback = {part.slot for part in BasicFSWModel.all_components()}
    assert feedback <= set(parts)
    assert ("image" in model.all_modes()) == (model is SteeringImagerFSWModel)


def test_batch_of_one():
    """Rows do not depend on each other."""
    together = vectors(0.3, N)
    rates = steered(together)
    alone = steering.steering_rate(Vec3(*(x[7:8] for x in together)), *(plane(gain, 1) for gain in GAINS))
    assert len(alone) == len(rates) > 1
    for many, one in zip(rates, alone, strict=True):
        torch.testing.assert_close(many.stack()[7:8], one.stack(), rtol=1e-15, atol=0.0)  # vectorised atan may differ
