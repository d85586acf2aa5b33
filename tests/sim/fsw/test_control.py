import torch

from bsk_torch.sim.component import Bus
from bsk_torch.sim.dyn.effectors.wheels import SPIN_INERTIA
from bsk_torch.sim.dyn.hub import box_inertia
from bsk_torch.sim.fsw import control, guidance
from bsk_torch.sim.fsw.steering import MRP_STEERING, fitted_steering
from bsk_torch.vec3 import Vec3
from tests.sim.buses import N, plane, vectors, with_wheels, write

ROUNDING = 1e-13

INERTIA = box_inertia(*(torch.tensor([x], dtype=torch.float64) for x in (330.0, 1.38, 1.04, 1.58)))


def controlled(Ki: float = -1.0, h: float = 1.0) -> Bus:
    bus = write(
        with_wheels(Bus(round(h * 1e9))),
        K=plane(7.0),
        P=plane(35.0),
        Ki=plane(Ki),
        control_on=plane(1.0),
        control_idle=plane(-1.0),
    )
    zero = Vec3.zeros_like(plane(0.0))
    write(bus, inertia_B=Vec3(*(x.expand(N) for x in INERTIA.unbind(-1))), control_integral_B=zero, motor_torque_command_B=zero)
    return write(bus, error=guidance.Error(vectors(0.3), vectors(0.01), vectors(1e-3), vectors(1e-6)))


def feedback(bus: Bus, integral: torch.Tensor | None = None) -> torch.Tensor:
    """Wheel torque by matrix algebra: opposite of the body torque that Basilisk's mrpFeedback requests."""
    s, w, w_R, dw_R = (v.stack() for v in bus.error)
    K, P, Ki = (x.unsqueeze(-1) for x in (bus.K, bus.P, bus.Ki))
    inertia, cross = INERTIA, torch.linalg.cross
    body = w + w_R
    z = torch.zeros_like(s) if integral is None else integral + inertia * w
    weight = torch.zeros_like(Ki) if integral is None else Ki
    return K * s + P * w + P * weight * z - cross(w_R + weight * z, inertia * body) + inertia * (cross(body, w_R) - dw_R)


def test_mrp_feedback_turns_toward_the_reference():
    bus = controlled()
    control.feed_back(bus)
    torch.testing.assert_close(bus.motor_torque_command_B.stack(), feedback(bus), rtol=0, atol=ROUNDING)
    assert (bus.control_integral_B.stack() == 0.0).all()
    # The wheels get the torque that the error calls for; the hub gets the opposite, which reduces it.
    bus = controlled()
    zero = Vec3.zeros_like(plane(0.0))
    bus.error = guidance.Error(vectors(0.1), zero, zero, zero)
    control.feed_back(bus)
    assert (bus.motor_torque_command_B.dot(bus.error.sigma_BR) > 0).all()


def test_feedback_with_an_integral_within_its_limit():
    """The first call ever has dt = 0; then K h s is added each tick, within +-0.2 / Ki."""
    Ki, h = 0.01, 0.5
    bus, expected = controlled(Ki, h), torch.zeros(N, 3, dtype=torch.float64)
    bus.error = guidance.Error(vectors(2.0), *bus.error[1:])
    s = bus.error.sigma_BR.stack()
    for k in range(4):
        control.feed_back(bus)
        expected = (expected + (7.0 * h * s if k else 0.0)).clamp(-0.2 / Ki, 0.2 / Ki)
        torch.testing.assert_close(bus.control_integral_B.stack(), expected, rtol=0, atol=ROUNDING)
        torch.testing.assert_close(bus.motor_torque_command_B.stack(), feedback(bus, expected), rtol=0, atol=100 * ROUNDING)
    assert (expected.abs() == 20.0).any()
    assert (expected.abs() < 20.0).any()
    bus = write(controlled(0.01), integral_limit=plane(0.05))
    bus.error = guidance.Error(vectors(2.0), *bus.error[1:])
    for _ in range(2):
        control.feed_back(bus)
    assert bus.control_integral_B.stack().abs().amax() == 0.05


def test_feedback_with_the_momentum_of_wheels_and_a_known_torque():
    """Both enter the gyroscopic term and the sum as in Basilisk's mrpFeedback with its optional messages connected."""
    bus = write(controlled(), Omega_WB_B=vectors(100.0), known_torque_B=vectors(1e-3))
    control.feed_back_with_wheels(bus)
    w_R, body = bus.error.omega_RN_B.stack(), (bus.error.omega_BR_B + bus.error.omega_RN_B).stack()
    h = (bus.Omega_WB_B.stack() + body) * SPIN_INERTIA
    expected = feedback(bus) - torch.linalg.cross(w_R, h) + bus.known_torque_B.stack()
    torch.testing.assert_close(bus.motor_torque_command_B.stack(), expected, rtol=0, atol=ROUNDING)


def test_terms_of_laws_follow_from_the_arguments():
    given = {arg.name: arg.default for law in (control.MRP_FEEDBACK, MRP_STEERING) for arg in law.args}
    assert control.fitted_feedback(given) is control.MRP_FEEDBACK
    assert fitted_steering(given) is MRP_STEERING
    asked = given | {"compensateWheels": True, "integralLimit": 0.1, "knownTorquePntB_B": [0.0, 0.0, 1e-4]}
    law = control.fitted_feedback(asked)
    assert law.update is control.feed_back_with_wheels
    assert [field.name for field in law.params] == ["K", "Ki", "P", "integral_limit", "known_torque_B"]
    assert {field.name for field in fitted_steering(asked).params} >= {"servo_P", "integral_limit", "known_torque_B"}


def test_the_clock_runs_once_it_has_started():
    bus = controlled(0.01)
    control.feed_back(bus)
    held, integral = bus.motor_torque_command_B.stack(), bus.control_integral_B.stack()
    bus.control_on = plane(0.0)
    bus.error = guidance.Error(vectors(0.2), *bus.error[1:])
    for _ in range(3):
        control.feed_back(bus)
    assert torch.equal(bus.motor_torque_command_B.stack(), held)
    assert torch.equal(bus.control_integral_B.stack(), integral)
    assert (bus.control_idle == 3.0).all()
    bus.control_on = plane(1.0)
    control.feed_back(bus)
    torch.testing.assert_close(
        bus.control_integral_B.stack(), integral + 7.0 * 4.0 * bus.error.sigma_BR.stack(), rtol=0, atol=ROUNDING
    )
    assert (bus.control_idle == 0.0).all()
    bus = controlled(0.01)
    bus.control_on = plane(0.0)
    control.feed_back(bus)
    assert (bus.control_idle == -1.0).all()
