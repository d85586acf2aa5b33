import itertools
import math
from fractions import Fraction

import pytest

from bsk_torch.astro.multistep import position_weights, velocity_weights


def fractions(numerators: list[int], denominator: int) -> list[float]:
    return [n / denominator for n in numerators]


@pytest.mark.parametrize(
    ("numerators", "denominator"),
    [([1], 1), ([-1, 3], 2), ([5, -16, 23], 12), ([-9, 37, -59, 55], 24), ([251, -1274, 2616, -2774, 1901], 720)],
)
def test_adams_bashforth(numerators, denominator):
    """Hairer, Norsett and Wanner, section III.1; each weight is its fraction, rounded once."""
    nodes = list(range(1 - len(numerators), 1))
    assert velocity_weights(nodes, 0, 1) == fractions(numerators, denominator)


@pytest.mark.parametrize(
    ("numerators", "denominator"),
    [([1], 1), ([1, 1], 2), ([-1, 8, 5], 12), ([1, -5, 19, 9], 24), ([-19, 106, -264, 646, 251], 720)],
)
def test_adams_moulton(numerators, denominator):
    nodes = list(range(2 - len(numerators), 2))
    assert velocity_weights(nodes, 0, 1) == fractions(numerators, denominator)


@pytest.mark.parametrize(
    ("nodes", "numerators", "denominator"),
    [
        ([-1, 0], [0, 1], 1),
        ([-2, -1, 0], [1, -2, 13], 12),
        ([-3, -2, -1, 0], [-1, 4, -5, 14], 12),
        ([-1, 0, 1], [1, 10, 1], 12),  # Numerov, or Cowell of fourth order
    ],
)
def test_stoermer(nodes, numerators, denominator):
    """Forward and backward step together have no velocity: ``x(1) - 2 x(0) + x(-1)``, section III.10."""
    both = zip(position_weights(nodes, 0, 1), position_weights(nodes, 0, -1), strict=True)
    assert [a + b for a, b in both] == pytest.approx(fractions(numerators, denominator), rel=0, abs=1e-15)


FALKNER = {0: "1/2 1/6 1/8 19/180 3/32 863/10080 275/3456", 1: "1/2 -1/3 -1/24 -7/360 -17/1440 -41/5040 -731/120960"}
"""Coefficients of backward differences in the step of the position: explicit, of those that end at node 0, and implicit."""


@pytest.mark.parametrize("last", FALKNER)
@pytest.mark.parametrize("count", range(1, 8))
def test_falkner(count, last):
    betas = [Fraction(x) for x in FALKNER[last].split()[:count]]
    expected = [Fraction(0)] * count  # oldest first
    for j, beta in enumerate(betas):
        for k in range(j + 1):
            expected[count - 1 - k] += beta * (-1) ** k * math.comb(j, k)
    nodes = list(range(last + 1 - count, last + 1))
    assert position_weights(nodes, 0, 1) == [float(x) for x in expected]


def moment(degree: int, start: int, end: int, twice: bool) -> float:
    """Integral of s^degree, once, or twice with a start at rest."""
    if not twice:
        return float(Fraction(end ** (degree + 1) - start ** (degree + 1), degree + 1))
    power = degree + 2
    whole = Fraction(end**power - start**power, power * (degree + 1))
    return float(whole - Fraction(start ** (degree + 1), degree + 1) * (end - start))


def test_exact_on_polynomials():
    sets = {"start": range(13), "explicit": range(-11, 1), "implicit": range(-10, 2), "any": [0, 5, -3]}
    failures = []
    for (name, nodes), end, twice in itertools.product(sets.items(), [-1, 1, 2, 7, 12], [False, True]):
        weights = (position_weights if twice else velocity_weights)(list(nodes), 0, end)
        assert len(weights) == len(nodes) > 0
        for degree in range(len(nodes)):
            terms = [w * n**degree for w, n in zip(weights, nodes, strict=True)]
            found, expected = math.fsum(terms), moment(degree, 0, end, twice)
            if not abs(found - expected) <= 2e-16 * sum(map(abs, terms)) + 1e-300:  # the rounding of weights, 1e-16 of each term
                failures.append(f"{name}, end={end}, twice={twice}, degree={degree}: {found} is not {expected}")
    assert not failures, "\n".join(failures)


@pytest.mark.parametrize("weights", [velocity_weights, position_weights])
def test_not_exact_beyond_the_last_power(weights):
    nodes = [-3, -2, -1, 0]
    found = sum(w * n**4 for w, n in zip(weights(nodes, 0, 1), nodes, strict=True))
    assert abs(found - moment(4, 0, 1, weights is position_weights)) > 1.0


def test_intervals_add_up():
    """From 0 to 5 by way of 3: position gains two seconds of the velocity that the first part brings."""
    nodes = list(range(13))
    first, rest, whole = (position_weights(nodes, *ends) for ends in ((0, 3), (3, 5), (0, 5)))
    speed = velocity_weights(nodes, 0, 3)
    assert [a + b + 2.0 * c for a, b, c in zip(first, rest, speed, strict=True)] == pytest.approx(whole, rel=0, abs=1e-13)
