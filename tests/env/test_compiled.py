"""The compiled back end gives the eager one's numbers, with one graph for every batch size."""

import logging

import pytest
import torch

import bsk_torch
from bsk_torch.sim.compiler import cache_folder, compiled

pytestmark = pytest.mark.compiled

RELATIVE = 1e-12
"""Fused multiply-adds round differently; slews amplify that, so the comparison is over a few minutes."""


def play(backend, n, plan, **options):
    env = bsk_torch.make("NadirScan-v1", num_envs=n, seed=4, backend=backend, dtype=torch.float64, time_limit=3000.0, **options)
    td = env.reset()
    for action in plan:
        td = env.step(td.select("observation").set("action", action))["next"]
    return env, td


@pytest.mark.parametrize("orbit", ["arc", "integrated"])
def test_equals_eager(orbit):
    plan = torch.tensor([[0, 1, 2, 3, 0], [3, 0, 1, 2, 1]])
    (eager, _), (fast, _) = (play(backend, 5, plan, orbit=orbit) for backend in ("eager", "compiled"))
    for name in eager.simulator.tick.state.fields:
        a, b = eager.simulator.read(name), fast.simulator.read(name)
        scale = a.abs().max().clamp(min=1e-3 if name.endswith("_sigma") else 1e-6)
        assert ((a - b).abs().max() / scale) < RELATIVE * (1e3 if name in AMPLIFIED else 1.0), name


AMPLIFIED = {"omega", "motor_torque", "motor_torque_command", "location_sigma", "sun_sigma", "illumination", "control_integral"}
"""Small differences of large numbers: rates near zero, torques, pointing errors and the penumbra lose three digits more."""


def test_one_package_serves_every_batch_size():
    env, _ = play("compiled", 3, torch.tensor([[0, 1, 2]]))
    other, _ = play("compiled", 5, torch.tensor([[0, 1, 2, 3, 0]]))
    step = env.simulator.step_function
    assert other.simulator.step_function is step, "environments of one make share the compiled step"
    packages = set(cache_folder().glob("*.pt2"))
    for n in (2, 3, 17, 64):
        packs = [pack[:, :1].expand(-1, n) for pack in (env.simulator.pack, env.simulator.own)]
        flags, segment, _ = env.simulator._segment(torch.zeros(n, dtype=torch.int64), 0.0)
        clock = torch.tensor([1.0, 1.0], dtype=torch.float64)
        row = torch.ones(2, n, dtype=torch.float64)
        out = step(packs[0], env.simulator.shared, packs[1], flags, segment, clock, row)
        assert out.shape == (env.simulator.tick.state.size, n)
        torch.testing.assert_close(out, out[:, :1].expand_as(out), rtol=1e-11, atol=1e-15)
    assert set(cache_folder().glob("*.pt2")) == packages, "another batch size built another package"


def test_packages_are_kept_and_named_by_what_they_compute(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("BSK_TORCH_CACHE", str(tmp_path))
    x = torch.arange(3.0)
    with caplog.at_level(logging.INFO, logger="bsk_torch"):
        assert torch.equal(compiled(lambda a: a * 2.0, "double", (True,))(x), x * 2.0)
        assert torch.equal(compiled(lambda a: a + a, "double", (True,))(x), x * 2.0)
        assert torch.equal(compiled(lambda a: a * 2.0, "double", (True,))(x.expand(2, 3).mT[:, 0]), x * 2.0)
    assert sum("compiled the double" in record.message for record in caplog.records) == 2
    assert len(list(tmp_path.glob("*.pt2"))) == 2
    for factor in (3.0, 4.0):  # the traced code does not show the values of tensors that a function holds or makes
        held = torch.tensor([factor, 1.0, 1.0])
        holds = compiled(lambda a, c=held: a * c.sum(), "scale", (True,))
        makes = compiled(lambda a, f=factor: a * torch.tensor([f, 1.0]).sum(), "scale", (True,))
        assert torch.equal(holds(x), x * (factor + 2.0))
        assert torch.equal(makes(x), x * (factor + 1.0))
    assert len(list(tmp_path.glob("*.pt2"))) == 2


def test_frozen_rows_are_bit_identical():
    env, td = play("compiled", 4, torch.tensor([[0, 1, 2, 3]]))
    before = env.simulator.pack.clone()
    mask = torch.tensor([[True], [False], [True], [False]])
    env.step(td.select("observation").set("action", torch.tensor([1, 1, 3, 3])).set("_step", mask))
    assert torch.equal(env.simulator.pack[:, 1::2], before[:, 1::2])
    assert not torch.equal(env.simulator.pack[:, ::2], before[:, ::2])
