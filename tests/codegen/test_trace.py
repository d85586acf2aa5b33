"""Tracing: what tensor code becomes, and what cannot be traced."""

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
        assert (constant(torch.zeros_like(x)), constant(torch.ones_like(x))) == (0.0, 1.0)
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

    def test_the_region_ends_with_an_error(self, program, x):
        with pytest.raises(UntraceableError):
            (x > 0.0).only(lambda: [x.sum()], [x])
        assert program.region is program.root
