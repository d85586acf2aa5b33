"""The compiled back end gives the eager one's numbers, with one graph for every batch size."""

import logging

import pytest
import torch

import bsk_torch

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


@torch.no_grad()
def test_one_graph_serves_every_batch_size(caplog):
    with caplog.at_level(logging.INFO, logger="bsk_torch"):
        env, _ = play("compiled", 3, torch.tensor([[0, 1, 2]]))
    assert sum("compiled the tick" in record.message for record in caplog.records) == 1
    torch._dynamo.utils.counters.clear()
    step = env.simulator.step_function
    for n in (2, 3, 17, 64):
        pack = env.simulator.pack[:, :1].expand(-1, n).contiguous()
        own = env.simulator.own[:, :1].expand(-1, n).contiguous()
        flags, segment, _ = env.simulator._segment(torch.zeros(n, dtype=torch.int64), 0.0, 60.0)
        clock = torch.tensor([1.0, 1.0], dtype=torch.float64)
        out = step(pack, env.simulator.shared, own, flags, segment, clock, torch.ones(2, n, dtype=torch.float64))
        assert out.shape == (env.simulator.tick.state.size, n)
        torch.testing.assert_close(out, out[:, :1].expand_as(out), rtol=1e-11, atol=1e-15)
    assert torch._dynamo.utils.counters["stats"]["unique_graphs"] == 0, "another batch size compiled another graph"


def test_frozen_rows_are_bit_identical():
    env, td = play("compiled", 4, torch.tensor([[0, 1, 2, 3]]))
    before = env.simulator.pack.clone()
    mask = torch.tensor([[True], [False], [True], [False]])
    env.step(td.select("observation").set("action", torch.tensor([1, 1, 3, 3])).set("_step", mask))
    assert torch.equal(env.simulator.pack[:, 1::2], before[:, 1::2])
    assert not torch.equal(env.simulator.pack[:, ::2], before[:, ::2])
