"""Results that are known when a program is made."""

import math

import pytest
import torch

FOLDED = [
    (lambda a, b: a + b, 8.0),
    (lambda a, b: a - b, 4.0),
    (lambda a, b: a * b, 12.0),
    (lambda a, b: a / b, 3.0),
    (lambda a, b: -a, -6.0),
    (lambda a, b: abs(-a), 6.0),
    (lambda a, b: torch.sqrt(a - b), 2.0),
    (lambda a, b: torch.minimum(a, b), 2.0),
    (lambda a, b: torch.maximum(a, b), 6.0),
    (lambda a, b: torch.clamp(a, max=4.0), 4.0),
    (lambda a, b: a / (b - 2.0), math.inf),
    (lambda a, b: -a / (b - 2.0), -math.inf),
    (lambda a, b: a / -(b - 2.0), -math.inf),
    (lambda a, b: torch.where(a > b, a, b), 6.0),
    (lambda a, b: torch.where((a < b) | (a != a), a, b), 2.0),
    (lambda a, b: ((a >= b) & ~(a == b) & (b <= a)).to(torch.float64), 1.0),
    (lambda a, b: b**3, 8.0),
]


def constant(value):
    assert value.op == "constant"
    return value.number


class TestFolding:
    def test_constants(self, program):
        failures = []
        for dtype in (torch.float64, torch.float32):
            a, b = program.constant(6.0, dtype), program.constant(2.0, dtype)
            for build, value in FOLDED:
                found = build(a, b)
                if found.op != "constant" or found.number != value:
                    failures.append(f"line {build.__code__.co_firstlineno}, {dtype}: {found.op} {found.number}, not {value}")
        assert not failures, "\n".join(failures)

    def test_nan(self, program):
        zero = program.constant(0.0, torch.float64)
        assert math.isnan(constant(zero / zero))
        assert math.isnan(constant(torch.sqrt(zero - 1.0)))
        assert constant(zero / zero != zero / zero) is True

    def test_singles_are_rounded(self, program):
        tenth = program.constant(0.1, torch.float32)
        assert constant(tenth) == torch.tensor(0.1).item()
        assert constant(tenth * 3.0) == (torch.tensor(0.1) * 3.0).item()
        assert constant(tenth.double()) == torch.tensor(0.1).double().item()
        assert constant(program.constant(0.1, torch.float64).float()) == torch.tensor(0.1).item()
        assert constant(program.constant(1e300, torch.float64).float()) == math.inf

    @pytest.mark.parametrize(
        "build", [lambda a: a + 0.0, lambda a: 0.0 + a, lambda a: a - 0, lambda a: a * 1.0, lambda a: 1 * a, lambda a: a / 1.0]
    )
    def test_neutral_numbers_vanish(self, x, build):
        assert build(x) is x

    def test_what_could_matter_stays(self, x):
        assert (x * 0.0).op == "mul"  # NaN and infinity
        assert ((0.0 - x).op, (1.0 / x).op) == ("sub", "div")

    def test_where(self, program, x, y):
        yes = program.constant(True, torch.bool)
        assert torch.where(yes, x, y) is x
        assert torch.where(~yes, x, y) is y
        assert torch.where(x > y, x, x) is x

    def test_single_constants_on_the_way_to_double_need_no_singles(self, x):
        chosen = torch.where(x > 0.0, 1.0, 0.0)
        assert chosen.dtype == torch.float32  # as in torch
        assert [a.dtype for a in (chosen * x).args[0].args] == [torch.bool, torch.float64, torch.float64]
        assert ((x > 0.0).float() * x).args[0].args[0].dtype == torch.bool
