"""Passes: which statements a traced tick becomes."""

import torch

from bsk_torch.codegen import cpp
from bsk_torch.codegen.ir import Branch, Declare, Define, Loop, Store, Update, Variable
from bsk_torch.codegen.passes import (
    changed,
    live_values,
    lower,
    read_elsewhere,
    reads,
    schedule_stores,
    statements,
    uniform_values,
    writes,
)
from bsk_torch.sim.component import Field, Track

PAIR = Track("pair", 3.0, (Field("x"), Field("y")), count=2, before=0)


def rows(program, count):
    return [program.input("state", k) for k in range(count)]


def same(found, expected) -> bool:
    """Whether values are the same objects, in the same order; ``==`` of values is an operation."""
    found, expected = list(found), list(expected)
    return len(found) == len(expected) and all(a is b for a, b in zip(found, expected, strict=True))


def outline(statements) -> list:
    """Statements as tuples of names, and lists for branches."""
    lines = []
    for statement in statements:
        match statement:
            case Branch(mask, body):
                lines.append([mask.op, *outline(body)])
            case Define(value):
                lines.append(f"define {value.op}")
            case Update(value):
                lines.append(f"update {value.op}")
            case Declare(value, initial):
                lines.append(f"declare {value.op}" + ("" if initial is None else f" = {'_'.join(map(str, initial.attr))}"))
            case Store(target, value):
                lines.append(f"{target.name} = {value.name if isinstance(value, Variable) else value.op}")
    return lines


class TestDeadCode:
    def test_only_what_results_need_is_live(self, program):
        x, y = rows(program, 2)
        dead = x.sin() * y
        needed = x.cos()
        outputs = [needed + 1.0, y]
        live = live_values(Loop(program, outputs))
        assert not any(value is dead or value.op == "sin" for value in live)
        assert [value.op for value in live if value.op not in ("input", "constant")] == ["cos", "add"]

    def test_written_values_and_the_stop_are_results(self, program):
        x, y = rows(program, 2)
        live = live_values(Loop(program, [x, y], written=[x.sin()], stop=y > 0.0))
        assert [value.op for value in live if value.op not in ("input", "constant")] == ["sin", "gt"]

    def test_the_clock_is_live(self, program):
        x, y = rows(program, 2)
        assert same(live_values(Loop(program, [x], clock=y)), [x, y])

    def test_regions_without_live_results_vanish(self, program):
        x, y = rows(program, 2)
        one, two = (x > 0.0).only(lambda: [y.sin(), y.cos()], [x, y])
        assert outline(lower(Loop(program, [x, y])).body) == []
        assert outline(lower(Loop(program, [one, y])).body) == [
            "define gt",
            "declare merge = state_0",
            ["gt", "define sin", "update merge"],
        ]
        assert outline(lower(Loop(program, [x, two])).body)[-1] == ["gt", "define cos", "update merge"]


class TestBranches:
    def test_regions_nest(self, program):
        x, y = rows(program, 2)

        def outer():
            return (y > 0.0).only(lambda: [y.sqrt() + x.exp()], [y])

        (merged,) = (x > 0.0).only(outer, [x])
        assert outline(lower(Loop(program, [merged, y])).body) == [
            "define gt",
            "declare merge = state_0",
            [
                "gt",
                "define gt",
                "declare merge = state_1",
                ["gt", "define sqrt", "define exp", "define add", "update merge"],
                "update merge",
            ],
        ]

    def test_what_lasts_longer_is_computed_outside(self, program):
        (x,), gain = rows(program, 1), program.input("shared", 0)
        (merged,) = (x > 0.0).only(lambda: [x * gain.sin()], [x])
        loop = lower(Loop(program, [merged]))
        assert [value.op for value in loop.constants] == ["sin"]
        assert outline(loop.body)[-1] == ["gt", "define mul", "update merge"]

    def test_reads_and_writes_of_a_branch_are_those_of_its_statements(self, program):
        x, y, z = rows(program, 3)
        (merged,) = (x > 0.0).only(lambda: [y.sin()], [z])
        define, declare, branch = statements(program.root, set(live_values(Loop(program, [merged]))))
        assert same(writes(define), [define.value])
        assert same(reads(declare), [z])
        assert same(writes(declare), [merged])
        sine = branch.body[0].value
        assert same(reads(branch), [define.value, y, define.value, sine, z])
        assert same(writes(branch), [sine, merged])


class TestLifetimes:
    def test_values_are_computed_as_rarely_as_they_may(self, program):
        (x,) = rows(program, 1)
        gain, own = program.input("shared", 0), program.input("own", 0)
        first, second = program.input("track", 1, 0), program.input("track", 1, 2)
        slope = (second - first) * (gain * own)
        out = x + slope * program.input("tau", 1)
        loop = lower(Loop(program, [out], (PAIR,)))
        assert [value.op for value in loop.constants] == ["mul"]
        (record,) = loop.records
        assert same(record.inputs, [first, second])
        assert [value.op for value in record.computed] == ["sub", "mul"]
        assert same(record.outputs, [first, second, *record.computed])
        assert outline(loop.body) == ["define mul", "define add"]

    def test_inputs_are_loaded_by_source(self, program):
        shared, flag, own, state = (program.input(source, 0) for source in ("shared", "flag", "own", "state"))
        loop = lower(Loop(program, [shared + flag + own + state]))
        assert same(loop.loads, [state, own, flag, shared])

    def test_numbers_of_the_schedule_are_those_of_a_tick(self, program):
        (x,), number = rows(program, 1), program.input("schedule", 1)
        assert outline(lower(Loop(program, [x + number], schedule=2)).body) == ["define input", "define add"]

    def test_uniform_values_depend_on_nothing_else(self, program):
        (x,) = rows(program, 1)
        shared, own = program.input("shared", 0), program.input("own", 0)
        square, mixed = shared * shared * 2.0, shared * own
        uniform = uniform_values(live_values(Loop(program, [x + square + mixed])))
        assert square in uniform
        assert shared in uniform
        assert not {own, mixed, x} & uniform

    def test_mixed_kernels_are_those_with_singles(self, program):
        (x,) = rows(program, 1)
        rounded = (x * 0.1).float().double()
        assert lower(Loop(program, [rounded])).mixed
        assert not lower(Loop(program, [x + 1.0])).mixed


class TestState:
    def test_rows_that_stay_are_not_touched(self, program):
        x, _, z = rows(program, 3)
        found = changed([x, z, z + 1.0])
        assert [k for k, _ in found] == [1, 2]

    def test_the_new_state_is_copied_before_it_is_passed_on(self, program):
        """Rows may trade places."""
        x, y, _ = rows(program, 3)
        loop = lower(Loop(program, [y, x, x + y]))
        assert outline(loop.commit) == ["new_0 = input", "new_1 = input", "state_0 = new_0", "state_1 = new_1"]
        assert [store.declare for store in loop.commit] == [True, True, False, False]
        assert [k for k, _ in loop.results] == [0, 1, 2]

    def test_rows_that_no_tick_reads_are_only_left_at_the_end(self, program):
        (x,) = rows(program, 1)
        loop = lower(Loop(program, [x + 1.0, x * 2.0]))
        assert outline(loop.commit) == ["new_0 = add", "state_0 = new_0"]
        assert [k for k, _ in loop.results] == [0, 1]


class TestStores:
    """Where new values are stored in the course of a tick."""

    def body(self, program, *values):
        return statements(program.root, set(live_values(Loop(program, values))))

    def test_a_value_is_stored_at_once_where_its_row_is_read_no_more(self, program):
        x, y = rows(program, 2)
        new, other = x + 1.0, y * 2.0
        body = self.body(program, new, other)
        stores = [Store(Variable("state_0", torch.float64), new), Store(Variable("state_1", torch.float64), other)]
        assert outline(schedule_stores(body, stores)) == ["define add", "state_0 = add", "define mul", "state_1 = mul"]

    def test_a_value_waits_for_the_last_statement_that_reads_its_row(self, program):
        x, y = rows(program, 2)
        new, other = y.sin(), x * y
        store = Store(Variable("state_0", torch.float64), new)
        assert outline(schedule_stores(self.body(program, new, other), [store])) == ["define sin", "define mul", "state_0 = sin"]

    def test_stores_stay_out_of_branches(self, program):
        x, y = rows(program, 2)
        new = y.sin()
        (merged,) = (y > 0.0).only(lambda: [x.sqrt()], [y])
        stores = [Store(Variable("state_0", torch.float64), new), Store(Variable("state_1", torch.float64), merged)]
        assert outline(schedule_stores(self.body(program, new, merged), stores)) == [
            "define sin",
            "define gt",
            "declare merge = state_1",
            ["gt", "define sqrt", "update merge"],
            "state_0 = sin",
            "state_1 = merge",
        ]

    def test_what_holds_otherwise_is_read_by_the_branch_too(self, program):
        x, y = rows(program, 2)
        (merged,) = (y > 0.0).only(lambda: [y.sqrt()], [x])
        store = Store(Variable("state_0", torch.float64), y)
        assert outline(schedule_stores(self.body(program, merged), [store])) == [
            "define gt",
            "declare merge = state_0",
            ["gt", "define sqrt", "update merge"],
            "state_0 = input",
        ]

    def test_what_no_tick_computes_is_stored_first(self, program):
        x, gain = rows(program, 1)[0], program.input("shared", 0)
        store = Store(Variable("out_3", torch.float64), gain)
        assert outline(schedule_stores(self.body(program, x + 1.0), [store])) == ["out_3 = input", "define add"]


class TestLockstep:
    def loop(self, program):
        x, y, single = *rows(program, 2), program.input("state", 2, dtype=torch.float32)
        shared, own = program.input("shared", 0), program.input("own", 0)
        before, after = program.input("track", 1, 0), program.input("track", 1, 2)
        slope = after - before
        moved = x * (shared * shared) + slope * program.input("tau", 1) + own * own + single.double()
        return Loop(program, [moved, x, y * 2.0, moved > 1.0], (PAIR,), stop=moved > 3.0)

    def test_carried_variables_are_those_that_the_next_tick_reads(self, program):
        carried = lower(self.loop(program), lockstep=True).carried
        names = lambda values: [v.name if isinstance(v, Variable) else v.op + "_".join(map(str, v.attr or ())) for v in values]
        assert names(carried.common) == ["mul"]
        track = ["start_1", "base_1", "from_1", "until_1"]
        states = ["inputstate_0", "inputstate_1", "inputstate_2"]
        assert names(carried.initial) == ["ticks_start", *states, "mul", *track]
        assert names(carried.block) == [*names(carried.initial), "sub", "out_2", "out_3"]

    def test_records_are_kept_only_where_ticks_read_them(self, program):
        loop = self.loop(program)
        (plain,), (record,) = (lower(loop, lockstep).records for lockstep in (False, True))
        assert plain.local == ()
        assert [value.op for value in plain.outputs] == ["input", "input", "sub"]
        assert [value.op for value in record.outputs] == ["sub"]
        assert same(record.local, record.inputs)

    def test_state_is_stored_in_the_course_of_the_tick(self, program):
        """Row 1 becomes row 0, which is copied; row 2 comes as another type than it is read as; no tick reads row 3."""
        loop = lower(self.loop(program), lockstep=True)
        assert loop.commit == ()
        found = outline(loop.body)
        assert found[0] == "new_1 = input"
        assert [line for line in found if " = " in line] == [
            "new_1 = input",
            "state_0 = add",
            "state_1 = new_1",
            "out_2 = mul",
            "state_2 = mul",
            "out_3 = gt",
        ]
        assert [(k, variable.name) for k, variable in loop.results] == [
            (0, "state_0"),
            (1, "state_1"),
            (2, "out_2"),
            (3, "out_3"),
        ]

    def test_values_of_another_lifetime_and_results_outlive_their_statements(self, program):
        loop = self.loop(program)
        outliving = read_elsewhere(live_values(loop), loop.results)
        assert loop.stop in outliving
        assert not any(value.is_input("own") for value in outliving)
        assert not any(value.is_input("tau") for value in outliving)

    def test_rows_of_the_new_state_are_written_from_where_they_are_kept(self, program):
        x, y = rows(program, 2)
        loop = Loop(program, [x + 1.0, y], written=[x + 1.0, y], stop=x > 0.0)
        assert list(lower(loop).written) == list(loop.written)
        assert [cpp.name(value) for value in lower(loop, lockstep=True).written] == ["state_0", "state_1"]
