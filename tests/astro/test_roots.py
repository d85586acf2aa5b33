import math

import pytest
import torch

from bsk_torch.astro.roots import GOLDEN, find_maximum, find_root, narrowed, next_guess, placed, refined, sections


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def root(f, a: torch.Tensor, b: torch.Tensor, **options) -> torch.Tensor:
    return find_root(f, a, b, f(a), f(b), **options)


def test_roots_of_functions_that_are_hard_for_secants():
    slope, zero = tensor(2.0, -3.0, 0.1), tensor(0.3, 0.9, 0.5)
    found = root(lambda x: slope * (x - zero), torch.zeros(3).double(), torch.ones(3).double(), iterations=1)
    torch.testing.assert_close(found, zero, rtol=0, atol=1e-15)
    # Bends like those of an elevation over thirty seconds; the root is known.
    zero, bend = torch.rand(200, dtype=torch.float64), (torch.rand(200, dtype=torch.float64) - 0.5)
    f = lambda x: torch.sinh(bend * (x - zero)) / bend + 0.3 * (x - zero) ** 3
    found = root(f, torch.zeros(200).double(), torch.ones(200).double())
    torch.testing.assert_close(found, zero, rtol=0, atol=1e-14)
    # Plain regula falsi keeps one end for ever here; the Illinois step frees it.
    found = root(lambda x: x**9 - 0.5, tensor(0.0), tensor(1.2), iterations=40)
    assert found.item() == pytest.approx(0.5 ** (1 / 9), abs=1e-14)
    assert root(lambda x: x - 1.0, tensor(0.0), tensor(1.0)).item() == 1.0
    assert root(lambda x: x, tensor(0.0), tensor(1.0)).item() == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize(("a", "b"), [(0.0, 2.0), (2.0, 0.0)])
def test_either_end_first(a, b):
    assert root(torch.cos, tensor(a), tensor(b)).item() == pytest.approx(math.pi / 2, abs=1e-14)


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
    found = find_maximum(lambda x: x * torch.exp(-x), tensor(0.0), tensor(10.0))
    assert found.item() == pytest.approx(1.0, abs=PROMISED * 10.0)
    # Every iteration of a golden section evaluates once; the number is what a look at a pass costs.
    calls = []
    find_maximum(lambda x: calls.append(1) or torch.sin(x), tensor(0.0), tensor(3.0), iterations=10)
    assert len(calls) == 12


def test_next_guess():
    a, b, slope, zero = tensor(0.0, 1.0, 5.0), tensor(2.0, 0.0, 4.0), tensor(3.0, -1.0, 7.0), tensor(0.5, 0.25, 4.125)
    torch.testing.assert_close(next_guess(a, b, slope * (a - zero), slope * (b - zero)), zero, rtol=0, atol=1e-15)
    # Once both heights are zero nothing moves and nothing becomes NaN.
    zero, b = tensor(0.0), tensor(2.5)
    assert next_guess(b, b, zero, zero).item() == 2.5
    assert [x.item() for x in refined(b, b, zero, zero, b, zero)] == [2.5, 2.5, 0.0, 0.0]


@pytest.mark.parametrize(
    ("f_c", "expected"),
    [
        (-1.0, (2.0, 1.5, 6.0, -1.0)),  # a sign change between c and b: they are the new bracket
        (1.0, (1.0, 1.5, -2.0, 1.0)),  # none: a stays, and counts half
        (0.0, (1.0, 1.5, -2.0, 0.0)),
    ],
)
def test_refined(f_c, expected):
    bracket = (tensor(x) for x in (1.0, 2.0, -4.0, 6.0))
    assert tuple(x.item() for x in refined(*bracket, tensor(1.5), tensor(f_c))) == expected


def test_brackets_keep_a_sign_change():
    """The root never leaves the bracket, whichever side the guesses fall on."""
    f = lambda x: x**3 - 0.2
    a, b = torch.zeros(50).double(), torch.linspace(0.6, 3.0, 50, dtype=torch.float64)
    bracket = a, b, f(a), f(b)
    for _ in range(15):
        c = next_guess(*bracket)
        bracket = refined(*bracket, c, f(c))
        lower, upper = torch.minimum(*bracket[:2]), torch.maximum(*bracket[:2])
        assert ((lower <= 0.2 ** (1 / 3) + 1e-15) & (upper >= 0.2 ** (1 / 3) - 1e-15)).all()


def test_sections_are_golden():
    left, right = (x.item() for x in sections(tensor(2.0), tensor(3.0)))
    assert pytest.approx(1.0, abs=1e-15) == GOLDEN**2 + GOLDEN
    assert (left, right) == pytest.approx((3.0 - GOLDEN, 2.0 + GOLDEN), abs=1e-15)


@pytest.mark.parametrize(("f_left", "f_right"), [(1.0, 2.0), (2.0, 1.0), (1.0, 1.0)])
def test_a_narrowed_interval_has_golden_sections_again(f_left, f_right):
    """One of them is an old point, the other the new one; the higher old point stays inside."""
    a, b = tensor(2.0), tensor(5.0)
    (left, right), heights = sections(a, b), (tensor(f_left), tensor(f_right))
    points = left, heights[0], right, heights[1]
    a, b, new = narrowed(a, b, *points)
    assert (b - a).item() == pytest.approx(3.0 * GOLDEN, abs=1e-14)
    left_after, f_left_after, right_after, f_right_after = placed(*points, new, tensor(9.0))
    expected = sections(a, b)
    assert (left_after.item(), right_after.item()) == pytest.approx(tuple(x.item() for x in expected), abs=1e-14)
    assert sorted((f_left_after.item(), f_right_after.item())) == [max(f_left, f_right), 9.0]
    assert (f_left_after.item() == 9.0) == (new.item() == left_after.item())


def test_building_blocks_are_the_searches():
    """Iterated as kernels do, with the next point in the state, bit for bit."""
    f = lambda x: torch.sin(x) - 0.3
    a, b = tensor(0.0, 0.1), tensor(1.5, 1.2)
    bracket = a, b, f(a), f(b)
    guess = next_guess(*bracket)
    for _ in range(8):
        bracket = refined(*bracket, guess, f(guess))
        guess = next_guess(*bracket)
    assert torch.equal(bracket[1], find_root(f, a, b, f(a), f(b), 8))
    a, b = tensor(0.0, 1.0), tensor(3.0, 2.5)
    expected = find_maximum(f, a, b, 8)
    left, right = sections(a, b)
    points = left, f(left), right, f(right)
    a, b, new = narrowed(a, b, *points)
    for _ in range(8):
        points = placed(*points, new, f(new))
        interval, (a, b, new) = (a, b), narrowed(a, b, *points)
    assert torch.equal(0.5 * (interval[0] + interval[1]), expected)
