"""Planes: what a traced program looks like, and what cannot be traced."""

from __future__ import annotations

import math
import operator

import pytest
import torch

from bsk_torch.lanes.expr import ALWAYS, DOUBLE, MASK, SINGLE, TICK, Plane, Program, UntraceableError, as_kind, shortest


@pytest.fixture
def program():
    return Program()


@pytest.fixture
def x(program):
    return program.input(("x", 0), DOUBLE, TICK)


@pytest.fixture
def y(program):
    return program.input(("x", 1), DOUBLE, TICK)


def constant(plane):
    assert plane.op == "constant"
    return plane.value


class TestSharing:
    def test_equal_statements_are_one(self, x, y):
        assert x * y is x * y
        assert torch.sin(x) is x.sin()
        assert x * y is not y * x

    def test_equal_constants_are_one(self, program):
        assert program.constant(1, DOUBLE) is program.constant(1.0, DOUBLE)
        assert program.constant(1.0, DOUBLE) is not program.constant(1.0, SINGLE)
        assert program.constant(True, MASK) is not program.constant(1.0, DOUBLE)

    def test_signs_of_zero_differ(self, program):
        assert math.copysign(1.0, program.constant(0.0, DOUBLE).value) == 1.0
        assert math.copysign(1.0, program.constant(-0.0, DOUBLE).value) == -1.0

    def test_statements_inside_a_region_are_not_shared_with_the_outside(self, x, y):
        inner = []

        def compute():
            inner.append(x * y)
            return [inner[0] + 1.0]

        (x > 0.0).only(compute, [x])
        assert x * y is not inner[0]

    def test_statements_before_a_region_are_shared_with_it(self, x, y):
        product = x * y
        (merged,) = (x > 0.0).only(lambda: [x * y], [x])
        assert merged.args[1] is product

    def test_what_lasts_longer_leaves_its_region(self, program, x):
        p = program.input(("shared", 0), DOUBLE, ALWAYS)
        (merged,) = (x > 0.0).only(lambda: [p * p], [x])
        assert merged.args[1].home is program.root
        assert merged.args[1] is p * p


class TestLifetimes:
    def test_shortest(self):
        assert shortest([ALWAYS, ALWAYS]) == ALWAYS
        assert shortest([ALWAYS, 1]) == 1
        assert shortest([2, 2, ALWAYS]) == 2
        assert shortest([1, 2]) == TICK
        assert shortest([1, TICK]) == TICK

    def test_statements_last_as_long_as_their_arguments(self, program, x):
        shared = program.input(("shared", 0), DOUBLE, ALWAYS)
        record = program.input(("track", 1, 0), DOUBLE, 1)
        assert (shared * 2.0).lasts == ALWAYS
        assert (shared * record).lasts == 1
        assert (x * record).lasts == TICK


class TestFolding:
    @pytest.mark.parametrize(
        ("build", "value"),
        [
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
        ],
    )
    @pytest.mark.parametrize("kind", [DOUBLE, SINGLE])
    def test_constants(self, program, build, value, kind):
        assert constant(build(program.constant(6.0, kind), program.constant(2.0, kind))) == value

    def test_nan(self, program):
        zero = program.constant(0.0, DOUBLE)
        assert math.isnan(constant(zero / zero))
        assert math.isnan(constant(torch.sqrt(zero - 1.0)))
        assert constant(zero / zero != zero / zero) is True

    def test_singles_are_rounded(self, program):
        tenth = program.constant(0.1, SINGLE)
        assert constant(tenth) == torch.tensor(0.1).item()
        assert constant(tenth * 3.0) == (torch.tensor(0.1) * 3.0).item()
        assert constant(tenth.double()) == torch.tensor(0.1).double().item()
        assert constant(program.constant(0.1, DOUBLE).float()) == torch.tensor(0.1).item()
        assert constant(program.constant(1e300, DOUBLE).float()) == math.inf

    @pytest.mark.parametrize(
        "build",
        [lambda a: a + 0.0, lambda a: 0.0 + a, lambda a: a - 0, lambda a: a * 1.0, lambda a: 1 * a, lambda a: a / 1.0],
    )
    def test_neutral_numbers_vanish(self, x, build):
        assert build(x) is x

    def test_what_could_matter_stays(self, x):
        assert (x * 0.0).op == "mul"  # NaN and infinity
        assert (0.0 - x).op == "sub"
        assert (1.0 / x).op == "div"

    def test_where(self, program, x, y):
        yes = program.constant(True, MASK)
        assert torch.where(yes, x, y) is x
        assert torch.where(~yes, x, y) is y
        assert torch.where(x > y, x, x) is x

    def test_single_constants_on_the_way_to_double_need_no_singles(self, x):
        chosen = torch.where(x > 0.0, 1.0, 0.0)
        assert chosen.kind == SINGLE  # as in torch
        assert [a.kind for a in (chosen * x).args[0].args] == [MASK, DOUBLE, DOUBLE]
        assert ((x > 0.0).float() * x).args[0].args[0].kind == MASK


class TestKinds:
    def test_promotion_is_that_of_torch(self, program, x):
        single = program.input(("x", 1), SINGLE, TICK)
        mask = x > 0.0
        tensors = {x: torch.ones(2, dtype=torch.float64), single: torch.ones(2), mask: torch.ones(2, dtype=torch.bool)}
        scalars = [2.0, True, torch.tensor(2.0), torch.tensor(2.0, dtype=torch.float64)]
        for a, ta in tensors.items():
            for b, tb in [*tensors.items(), *((s, s) for s in scalars)]:
                assert torch.mul(a, b).dtype == torch.mul(ta, tb).dtype, (ta, tb)
                assert torch.eq(a, b).dtype == torch.bool
                assert torch.where(mask, a, b).dtype == torch.where(tensors[mask], ta, tb).dtype, (ta, tb)

    def test_integers_are_numbers_beside_planes(self, x):
        assert (x + 1).args[1].value == 1.0
        assert torch.where(x > 0, x, 0).kind == DOUBLE

    def test_filled_planes(self, x):
        assert constant(torch.zeros_like(x)) == 0.0
        assert constant(torch.ones_like(x)) == 1.0
        assert constant(torch.full_like(x, 0.25)) == 0.25
        assert torch.zeros_like(x, dtype=torch.float32).kind == SINGLE
        assert torch.zeros_like(x > 0.0).value is False

    def test_arithmetic_of_booleans(self, x, y):
        a, b = x > 0.0, y > 0.0
        assert a * b is a & b
        assert a + b is a | b
        assert (a != b) is a ^ b
        assert (a == b) is ~(a ^ b)

    def test_numbers_as_planes(self, program, x):
        assert constant(as_kind(program, torch.tensor(3), DOUBLE)) == 3.0
        assert as_kind(program, x, DOUBLE) is x
        assert as_kind(program, x, SINGLE).dtype == torch.float32

    def test_tensors_without_dimensions_may_stand_on_the_left(self, x):
        for function in (operator.add, operator.sub, operator.mul, operator.truediv, operator.mod):
            assert function(torch.tensor(2.0), x) is function(2.0, x)
        assert torch.atan2(torch.tensor(2.0), x).op == "atan2"


class TestOnly:
    def test_constant_masks_choose(self, program, x, y):
        yes = program.constant(True, MASK)
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
        region = next(item for item in program.root.statements if not isinstance(item, Plane))
        inner = next(item for item in region.statements if not isinstance(item, Plane))
        assert [p.op for p in region.merges] == ["merge"]
        assert inner.parent is region
        assert merged.args[1].home is region

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
        (lambda x: x + "1", "neither a number nor a plane"),
        (lambda x: x + None, "neither a number nor a plane"),
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
