"""Tracing: what tensor code becomes, and what cannot be traced."""

from __future__ import annotations

import math
import operator

import pytest
import torch

from bsk_torch.codegen.ir import Region, UntraceableError
from bsk_torch.codegen.trace import as_value
from tests.codegen.test_fold import constant


class TestTypes:
    def test_promotion_is_that_of_torch(self, program, x):
        single = program.input("state", 1, dtype=torch.float32)
        mask = x > 0.0
        tensors = {x: torch.ones(2, dtype=torch.float64), single: torch.ones(2), mask: torch.ones(2, dtype=torch.bool)}
        scalars = [2.0, True, torch.tensor(2.0), torch.tensor(2.0, dtype=torch.float64)]
        for a, ta in tensors.items():
            for b, tb in [*tensors.items(), *((s, s) for s in scalars)]:
                assert torch.mul(a, b).dtype == torch.mul(ta, tb).dtype, (ta, tb)
                assert torch.eq(a, b).dtype == torch.bool
                assert torch.where(mask, a, b).dtype == torch.where(tensors[mask], ta, tb).dtype, (ta, tb)

    def test_integers_are_numbers_beside_values(self, x):
        assert (x + 1).args[1].number == 1.0
        assert torch.where(x > 0, x, 0).dtype == torch.float64

    def test_filled_values(self, x):
        assert constant(torch.zeros_like(x)) == 0.0
        assert constant(torch.ones_like(x)) == 1.0
        assert constant(torch.full_like(x, 0.25)) == 0.25
        assert torch.zeros_like(x, dtype=torch.float32).dtype == torch.float32
        assert torch.zeros_like(x > 0.0).number is False

    def test_arithmetic_of_booleans(self, x, y):
        a, b = x > 0.0, y > 0.0
        assert a * b is a & b
        assert a + b is a | b
        assert (a != b) is a ^ b
        assert (a == b) is ~(a ^ b)

    def test_numbers_as_values(self, program, x):
        assert constant(as_value(program, torch.tensor(3), torch.float64)) == 3.0
        assert as_value(program, x, torch.float64) is x
        assert as_value(program, x, torch.float32).dtype == torch.float32

    def test_tensors_without_dimensions_may_stand_on_the_left(self, x):
        for function in (operator.add, operator.sub, operator.mul, operator.truediv, operator.mod):
            assert function(torch.tensor(2.0), x) is function(2.0, x)
        assert torch.atan2(torch.tensor(2.0), x).op == "atan2"


class TestOnly:
    def test_constant_masks_choose(self, program, x, y):
        yes = program.constant(True, torch.bool)
        assert yes.only(lambda: [x * y], [x]) == [x * y]
        assert (~yes).only(lambda: [x * y], [x]) == [x]
        assert not any(item.op == "merge" for item in program.root.statements)

    def test_the_same_on_both_sides_is_not_merged(self, x, y):
        assert (x > 0.0).only(lambda: [y], [y]) == [y]

    def test_numbers(self, x):
        (merged,) = (x > 0.0).only(lambda: [1.0], [0.0])
        assert merged.op == "merge"

    def test_regions_nest(self, program, x, y):
        def outer():
            return (y > 0.0).only(lambda: [torch.sin(y)], [torch.cos(y)])

        (merged,) = (x > 0.0).only(outer, [x])
        region = next(item for item in program.root.statements if isinstance(item, Region))
        inner = next(item for item in region.statements if isinstance(item, Region))
        assert [p.op for p in region.merges] == ["merge"]
        assert inner.parent is region
        assert merged.args[1].region is region

    @pytest.mark.parametrize("use", [lambda p: p + 1.0, lambda p: torch.where(p > 0.0, p, 0.0)])
    def test_nothing_leaks(self, x, use):
        leaked = []
        (x > 0.0).only(lambda: [leaked.append(torch.sin(x)) or x + 1.0], [x])
        with pytest.raises(UntraceableError, match="leave as a result of only"):
            use(leaked[0])
        with pytest.raises(UntraceableError, match="leave as a result of only"):
            (x < 0.0).only(lambda: [leaked[0]], [x])

    def test_masks_are_booleans(self, x):
        with pytest.raises(UntraceableError, match="booleans"):
            x.only(lambda: [x], [x])

    def test_the_region_ends_with_an_error(self, program, x):
        with pytest.raises(UntraceableError):
            (x > 0.0).only(lambda: [x.sum()], [x])
        assert program.region is program.root


def divided(x, **kwargs):
    return torch.div(x, 2.0, **kwargs)


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        (lambda x: 1.0 if x > 0.0 else 2.0, "torch.where"),
        (lambda x: max(x, 1.0), "torch.where"),
        (math.sqrt, "numbers"),
        (int, "numbers"),
        (lambda x: torch.stack([x, x]), r"torch\.stack has no kernel.*element by element"),
        (lambda x: torch.cat([x, x]), r"torch\.cat has no kernel"),
        (lambda x: torch.cumsum(x, 0), r"torch\.cumsum has no kernel.*FUNCTIONS"),
        (lambda x: x.sum(-1), r"Tensor\.sum has no kernel"),
        (lambda x: x.add_(1.0), r"Tensor\.add_ has no kernel"),
        (lambda x: torch.tensor(1.0).add_(x), r"torch\.add_ has no kernel"),
        (lambda x: x.shape[0], r"Tensor\.shape has no kernel"),
        (lambda x: x[0], "no elements"),
        (lambda x: list(x), "no elements"),
        (lambda x: len(x), "no elements"),
        (lambda x: x @ x, "Vec3"),
        (lambda x: x // 2.0, r"torch\.floor"),
        (lambda x: 2.0**x, "no kernel"),
        (lambda x: x**0.5, "squares and cubes"),
        (lambda x: x**x, "squares and cubes"),
        (lambda x: x * torch.ones(3), "tensor with dimensions"),
        (lambda x: torch.where(x > 0.0, x, torch.zeros(3)), "tensor with dimensions"),
        (lambda x: x + "1", "neither a number nor a value"),
        (lambda x: x + None, "neither a number nor a value"),
        (lambda x: divided(x, rounding_mode="floor"), r"torch\.div has no kernel with these arguments.*rounding_mode"),
        (lambda x: x.to(torch.int64), r"torch\.int64"),
        (lambda x: torch.zeros_like(x, dtype=torch.long), r"torch\.int64"),
        (lambda x: (x > 0.0) * 2, r"torch\.int64"),
        (lambda x: torch.where(x > 0.0, 1, 0), r"torch\.int64"),
        (lambda x: torch.where(x, x, 0.0), "booleans"),
        (lambda x: x & x, "booleans"),
        (lambda x: ~x, "booleans"),
        (lambda x: torch.sqrt(x > 0.0), "booleans"),
        (lambda x: (x > 0.0) < (x > 1.0), "booleans"),
    ],
)
def test_untraceable(x, code, reason):
    with pytest.raises(UntraceableError, match=reason):
        code(x)
