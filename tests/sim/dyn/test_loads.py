"""Facets, sunlight and torque bars; their numbers are compared with Basilisk's in ``tests/basilisk/test_craft_parity.py``."""

import torch

from bsk_torch.sim.component import Bus, Effector
from bsk_torch.sim.dyn.effectors.torque_bars import magnetic_torque
from bsk_torch.sim.fsw.unloading import unload
from bsk_torch.vec3 import Mat3, Vec3
from tests.sim.buses import N, vectors, write


def test_bars_take_momentum_across_the_field():
    """The torque is across the field, against the momentum, and within the largest dipoles."""
    h, B = vectors(5.0), vectors(3e-5)
    zero, one = torch.zeros(N, dtype=torch.float64), torch.ones(N, dtype=torch.float64)
    axes = tuple(Vec3(*(one * float(k == j) for j in range(3))) for k in range(3))
    bus = write(Bus(1_000_000_000), sigma_BN=Vec3(zero, zero, zero), magnetic_field_N=B, control_on=one, bar_gain=one)
    bus.bar_map, bus.bar_axes_B, bus.bar_max_dipole = axes, axes, (30.0 * one,) * 3
    bus.effectors = (Effector(momentum=lambda bus, omega: h),)
    unload(bus)
    identity = Mat3.diagonal(Vec3(one, one, one))
    torque = magnetic_torque(bus, identity, h)[1]
    assert all(bool((dipole.abs() <= 30.0 * (1 + 1e-12)).all()) for dipole in bus.bar_command)
    assert torch.stack(bus.bar_command).abs().max() > 29.9
    across = h - B * (h.dot(B) / B.dot(B))
    torch.testing.assert_close(torque.unit().stack(), (-across.unit()).stack(), rtol=0, atol=1e-9)
