from __future__ import annotations

import math

import pytest
import torch

from bsk_torch.astro.roots import find_maximum, find_root


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def root(f, a: torch.Tensor, b: torch.Tensor, **options) -> torch.Tensor:
    return find_root(f, a, b, f(a), f(b), **options)


def test_straight_lines_in_one_step():
    slope, zero = tensor(2.0, -3.0, 0.1), tensor(0.3, 0.9, 0.5)
    found = root(lambda x: slope * (x - zero), torch.zeros(3).double(), torch.ones(3).double(), iterations=1)
    torch.testing.assert_close(found, zero, rtol=0, atol=1e-15)


def test_nearly_straight_functions_reach_rounding():
    """Bends like those of an elevation over thirty seconds; the root is known."""
    zero, bend = torch.rand(200, dtype=torch.float64), (torch.rand(200, dtype=torch.float64) - 0.5)
    f = lambda x: torch.sinh(bend * (x - zero)) / bend + 0.3 * (x - zero) ** 3
    found = root(f, torch.zeros(200).double(), torch.ones(200).double())
    torch.testing.assert_close(found, zero, rtol=0, atol=1e-14)


def test_bends_that_stall_the_plain_rule():
    """Plain regula falsi keeps one end for ever here; the Illinois step frees it."""
    found = root(lambda x: x**9 - 0.5, tensor(0.0), tensor(1.2), iterations=40)
    assert found.item() == pytest.approx(0.5 ** (1 / 9), abs=1e-14)


@pytest.mark.parametrize(("a", "b"), [(0.0, 2.0), (2.0, 0.0)])
def test_either_end_first(a, b):
    assert root(torch.cos, tensor(a), tensor(b)).item() == pytest.approx(math.pi / 2, abs=1e-14)


def test_root_at_an_end():
    assert root(lambda x: x - 1.0, tensor(0.0), tensor(1.0)).item() == 1.0
    assert root(lambda x: x, tensor(0.0), tensor(1.0)).item() == pytest.approx(0.0, abs=1e-14)


def test_rows_are_independent():
    zero = torch.rand(50, dtype=torch.float64)
    f = lambda z: lambda x: torch.expm1(x - z)
    together = root(f(zero), torch.zeros(50).double(), torch.ones(50).double())
    alone = torch.cat([root(f(z), torch.zeros(1).double(), torch.ones(1).double()) for z in zero.split(1)])
    assert torch.equal(together, alone)


PROMISED = 6e-6  # of the bracket


def test_maximum():
    top, width = torch.linspace(0.0, 5.0, 30, dtype=torch.float64), 5.0
    found = find_maximum(lambda x: -((x - top) ** 2), torch.zeros(30).double(), torch.full((30,), width).double())
    torch.testing.assert_close(found, top, rtol=0, atol=PROMISED * width)


def test_maximum_of_a_slanted_peak():
    found = find_maximum(lambda x: x * torch.exp(-x), tensor(0.0), tensor(10.0))
    assert found.item() == pytest.approx(1.0, abs=PROMISED * 10.0)


def test_maximum_needs_few_evaluations():
    """Every iteration of a golden section evaluates once; the number is what a look at a pass costs."""
    calls = []
    find_maximum(lambda x: calls.append(1) or torch.sin(x), tensor(0.0), tensor(3.0), iterations=10)
    assert len(calls) == 12
