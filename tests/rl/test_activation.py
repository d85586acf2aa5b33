"""The faster hyperbolic tangent is that of torch."""

import torch

from bsk_torch.rl.networks.plans import Tanh


def test_values_and_gradients_are_those_of_torch_and_nan_stays():
    x = torch.cat([torch.linspace(-12.0, 12.0, 4001), torch.tensor([-1e30, -100.0, 100.0, 1e30, 0.0])]).requires_grad_()
    direction = torch.linspace(-1.0, 1.0, len(x))
    found, expected = Tanh()(x), torch.tanh(x)
    torch.testing.assert_close(found, expected, rtol=0.0, atol=2e-7)
    gradients = [torch.autograd.grad(y, x, direction)[0] for y in (found, expected)]
    torch.testing.assert_close(*gradients, rtol=0.0, atol=5e-7)
    assert float(found.abs().max()) <= 1.0
    assert float(found[-1]) == 0.0
    assert bool(Tanh()(torch.tensor(float("nan"))).isnan())
