"""The printer: how values and statements are written."""

import math

import pytest
import torch

from bsk_torch.codegen.cpp import converted, expression, name, signature, source
from bsk_torch.codegen.ir import Loop, Variable
from bsk_torch.codegen.passes import lower
from bsk_torch.sim.component import Field, Track

PAIR = Track("pair", 3.0, (Field("x"), Field("y")), count=2, before=0)


@pytest.mark.parametrize(
    ("number", "dtype", "text"),
    [
        (0.1, torch.float64, "D(0.1)"),
        (-0.0, torch.float64, "D(-0.0)"),
        (1e-30, torch.float64, "D(1e-30)"),
        (0.5, torch.float32, "F(0.5f)"),
        (True, torch.bool, "constant(true)"),
        (math.inf, torch.float64, "D(std::numeric_limits<double>::infinity())"),
        (-math.inf, torch.float32, "F(-std::numeric_limits<float>::infinity())"),
        (math.nan, torch.float64, "D(std::numeric_limits<double>::quiet_NaN())"),
    ],
)
def test_constants(program, number, dtype, text):
    assert name(program.constant(number, dtype)) == text


def test_names_expressions_and_conversions(program, x, y):
    assert name(program.input("track", 2, 7)) == "track_2_7"
    assert (name(program.input("ticks_now")), name(x.sin())) == ("ticks_now", "v" + str(x.sin().index))
    assert name(Variable("out_3", torch.float64)) == "out_3"
    a, b = name(x), name(y)
    assert (expression(x / y), expression(torch.minimum(x, y))) == (f"{a} / {b}", f"minimum({a}, {b})")
    assert expression(torch.atan2(x, y)) == f"{a}.atan2({b})"
    assert expression((x > 0.0) & (y > 0.0)) == f"both({name(x > 0.0)}, {name(y > 0.0)})"
    assert expression(x.float()) == f"narrow({a})"
    (merged,) = (x > 0.0).only(lambda: [x * y], [y])
    assert expression(merged) == f"where({name(x > 0.0)}, {name(merged.args[1])}, {b})"
    single, mask = x.float(), x > 0.0
    assert converted(x, torch.float64) == name(x)
    assert converted(single, torch.float64) == f"widen({name(single)})"
    assert converted(x, torch.float32) == f"narrow({name(x)})"
    assert converted(mask, torch.float64) == f"where({name(mask)}, D(1), D(0))"
    assert converted(x, torch.bool) == f"ne({name(x)}, D(0))"


def loop(program, x, **options):
    slope = program.input("track", 1, 2) - program.input("track", 1, 0)
    moved = x + slope * program.input("tau", 1)
    return Loop(program, [moved], (PAIR,), **{"stop": moved > 3.0} | options)


@pytest.mark.parametrize("lockstep", [False, True])
def test_the_signature_is_that_of_the_parameters(program, x, lockstep):
    lowered = lower(loop(program, x), lockstep)
    text = source(lowered, "")
    parameters = text[text.index("void run(") + len("void run(") : text.index(") {", text.index("void run("))].split(",")
    codes = "".join("p" if "*" in parameter else "i" for parameter in parameters)
    assert signature(lowered) == codes
    assert codes.endswith("pppi")


@pytest.mark.parametrize("lockstep", [False, True])
def test_lines_are_indented_by_the_braces_around_them(program, x, lockstep):
    text = source(lower(loop(program, x), lockstep), "")
    depth = 1
    for line in text[text.index(") {\n") + 4 :].splitlines():
        depth -= line.strip().startswith("}")
        assert line.startswith("#") or not line or len(line) - len(line.lstrip()) == 2 * depth, line
        depth += line.count("{") - line.count("}") + line.strip().startswith("}")
    assert depth == 0


def test_the_clock_may_be_a_row_of_the_state(program, x):
    assert "const D time_now = state_0;" in source(lower(loop(program, x, clock=x)), "")
    assert "time_now = D(schedule[(k - 1) * 3]);" in source(lower(loop(program, x, clock="schedule", schedule=3)), "")
    plain = source(lower(Loop(program, [x + 1.0])), "")
    for part in ("stopping", "remember", "written +", "elapsed_", "LANES_MIXED", "Common"):
        assert part not in plain
    full = source(lower(loop(program, x, written=[x.float()])), "")
    for part in ("stopping", "remember", "written +", "elapsed_1", "#define LANES_MIXED"):
        assert part in full
    assert "struct Common" in source(lower(loop(program, x), lockstep=True), "")
