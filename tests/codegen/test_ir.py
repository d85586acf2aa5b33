"""Programs: which values are one, and how long they hold."""

import math

import pytest
import torch

from bsk_torch.codegen.ir import CALL, TICK, Loop, Program, UntraceableError, shortest


class TestSharing:
    def test_equal_statements_are_one(self, x, y):
        assert x * y is x * y
        assert torch.sin(x) is x.sin()
        assert x * y is not y * x

    def test_equal_constants_are_one(self, program):
        assert program.constant(1, torch.float64) is program.constant(1.0, torch.float64)
        assert program.constant(1.0, torch.float64) is not program.constant(1.0, torch.float32)
        assert program.constant(True, torch.bool) is not program.constant(1.0, torch.float64)

    def test_signs_of_zero_differ(self, program):
        assert math.copysign(1.0, program.constant(0.0, torch.float64).number) == 1.0
        assert math.copysign(1.0, program.constant(-0.0, torch.float64).number) == -1.0

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
        p = program.input("shared", 0)
        (merged,) = (x > 0.0).only(lambda: [p * p], [x])
        assert merged.args[1].region is program.root
        assert merged.args[1] is p * p


class TestLifetimes:
    def test_shortest(self):
        assert (shortest([CALL, CALL]), shortest([CALL, 1]), shortest([2, 2, CALL])) == (CALL, 1, 2)
        assert (shortest([1, 2]), shortest([1, TICK])) == (TICK, TICK)

    def test_statements_last_as_long_as_their_arguments(self, program, x):
        shared = program.input("shared", 0)
        record = program.input("track", 1, 0)
        assert ((shared * 2.0).lifetime, (shared * record).lifetime) == (CALL, 1)
        assert (x * record).lifetime == TICK

    def test_lifetimes_of_inputs_are_those_of_their_sources(self, program):
        assert program.input("track", 2, 5).lifetime == 2
        for source, lifetime in {"state": TICK, "schedule": TICK, "tau": TICK, "own": CALL, "shared": CALL, "flag": CALL}.items():
            assert program.input(source, 1).lifetime == lifetime
        assert program.input("ticks_now").lifetime == TICK


def test_the_clock_may_be_a_row(program, x):
    assert Loop(program, [x], clock=x).clock is x


def test_values_of_a_region_are_not_seen_outside():
    """Without tensor code, too: a program can be made by hand."""
    program = Program()
    x, zero = program.input("state", 0), program.constant(0.0, torch.float64)
    mask = program.operation("gt", (x, zero), torch.bool)
    with program.branch(mask) as region:
        sine = program.operation("sin", (x,), torch.float64)
    (merged,) = program.merge(region, [(sine, x)])
    assert (merged.args, region.merges) == ((mask, sine, x), [merged])
    with pytest.raises(UntraceableError, match="must leave"):
        program.operation("neg", (sine,), torch.float64)
