"""Parts of passes in the light, against cosines of time whose crossings are known."""

import math

import pytest
import torch

from bsk_torch.sim.access.light.light import PIECE, parts_where
from bsk_torch.sim.access.passes.passes import Passes

RATE = 2.0 * math.pi / 86164.0
"""Rotation of the Earth, rad/s: the Sun's elevation varies like a cosine of this rate."""


def passes_of(opens: list[float], closes: list[float]) -> Passes:
    numbers = torch.arange(len(opens))
    return Passes(numbers, 10 * numbers, torch.tensor(opens, dtype=torch.float64), torch.tensor(closes, dtype=torch.float64))


def parts(opens: list[float], closes: list[float], mean: list[float], phase: list[float]) -> list[tuple[int, float, float]]:
    """Pass and ends, s, of the parts in which ``mean + cos(RATE t - phase)`` is positive."""
    offset, turn = (torch.tensor(x, dtype=torch.float64) for x in (mean, phase))
    found = parts_where(lambda k, t: offset[k] + torch.cos(RATE * t - turn[k]), passes_of(opens, closes))
    assert torch.equal(found.place, 10 * found.row)
    return list(zip(found.row.tolist(), found.open.tolist(), found.close.tolist(), strict=True))


def expected(opens: float, closes: float, mean: float, phase: float) -> list[tuple[float, float]]:
    """The same for one pass, from the inverse cosine."""
    half = math.acos(min(max(-mean, -1.0), 1.0))
    found = []
    for turn in range(-3, 5):
        begin, end = ((2.0 * math.pi * turn + phase + side * half) / RATE for side in (-1.0, 1.0))
        if max(begin, opens) < min(end, closes):
            found.append((max(begin, opens), min(end, closes)))
    return found


@pytest.mark.parametrize("longest", [400.0, 3000.0, 150_000.0])
def test_parts_are_those_between_the_crossings_of_a_cosine(longest):
    """Within a microsecond, in which the sine changes by 7e-11: the rounding error of its root."""
    torch.manual_seed(3)
    n = 400
    opens = (86164.0 * torch.rand(n, dtype=torch.float64)).tolist()
    closes = [begin + longest * share for begin, share in zip(opens, torch.rand(n).clamp(min=0.01).tolist(), strict=True)]
    mean = (1.8 * torch.rand(n, dtype=torch.float64) - 0.9).tolist()
    phase = (2.0 * math.pi * torch.rand(n, dtype=torch.float64)).tolist()
    found = parts(opens, closes, mean, phase)
    wanted = [(k, *part) for k, form in enumerate(zip(opens, closes, mean, phase, strict=True)) for part in expected(*form)]
    assert [part[0] for part in found] == [part[0] for part in wanted]
    assert len({part[0] for part in found}) < n  # some passes have none
    for one, other in zip(found, wanted, strict=True):
        assert one[1:] == pytest.approx(other[1:], abs=1e-6)


@pytest.mark.parametrize("depth", [1e-9, 1e-7, 1e-5])
@pytest.mark.parametrize("at", [0.1, 0.5, 0.93])
def test_light_that_lasts_for_a_moment_is_found(depth, at):
    """A pass of nine minutes in which the Sun culminates just above the limit, or just below it."""
    phase = RATE * 540.0 * at
    (part,) = parts([0.0], [540.0], [-1.0 + depth], [phase])
    ((begin, end),) = expected(0.0, 540.0, -1.0 + depth, phase)
    assert part[1:] == pytest.approx((begin, end), abs=1e-3)  # s; the sine is flat there: within 1e-11 of its root
    if begin > 0.0 and end < 540.0:
        before, after = parts([0.0], [540.0], [1.0 - depth], [phase + math.pi])
        assert (before[1], after[2]) == (0.0, 540.0)
        assert (before[2], after[1]) == pytest.approx((begin, end), abs=1e-3)
    assert parts([0.0], [540.0], [-1.0 - depth], [phase]) == []


def test_parts_of_passes_do_not_depend_on_others_and_may_be_none():
    torch.manual_seed(4)
    mean, phase = (1.4 * torch.rand(2, 60, dtype=torch.float64) - 0.7).tolist()
    opens, closes = [0.0] * 60, [50_000.0] * 60
    together = parts(opens, closes, mean, phase)
    alone = [(k, *part[1:]) for k in range(60) for part in parts(opens[:1], closes[:1], mean[k : k + 1], phase[k : k + 1])]
    assert (together, parts([], [], [], [])) == (alone, [])
    assert PIECE * RATE < 0.05  # rad: at most one extreme in a piece
