"""Flown arcs at twice as many nodes."""

import math

import torch

from bsk_torch.sim.access.visibility.planned import halved
from bsk_torch.sim.orbit.grid import LEAD_NODES, NODE_SPACING


def test_positions_between_nodes_of_a_circle():
    """A low orbit turns by 0.065 rad between nodes: interpolation in the middle is good to micrometers, at the end to meters."""

    def circle(time):
        angle = 2.0 * math.pi / 5700.0 * time
        return 7e6 * torch.stack([torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)], -1)

    time = NODE_SPACING * torch.arange(-LEAD_NODES, 41, dtype=torch.float64)
    found = halved(circle(time).unsqueeze(0))[0]
    exact = circle(0.5 * NODE_SPACING * torch.arange(81, dtype=torch.float64))
    error = (found - exact).norm(dim=-1)
    assert error[:-9].max() < 1e-5
    assert error[-9:].max() < 1e-2
    assert error[::2].max() == 0.0
