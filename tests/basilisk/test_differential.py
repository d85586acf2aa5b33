"""differential.py: what it draws, how it compares, and a few random problems flown on Basilisk."""

import copy
import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "validation"))

from differential import summarize
from differential_compare import judge
from differential_draw import FAMILIES, Drawn, draw_case
from differential_flight import Flight, Record
from differential_program import as_program


def flight(*values: float) -> Flight:
    """A flight whose attitude takes these values."""
    return Flight([Record({"time": np.array(float(k)), "Sat0 sigma_BN": np.full(3, value)}) for k, value in enumerate(values)])


def test_a_seed_gives_the_same_problem_and_all_families_are_drawn():
    assert repr(draw_case(5, 3)) == repr(draw_case(5, 3))
    assert {draw_case(seed, 2).family for seed in range(120)} == set(FAMILIES)


def test_the_first_difference_counts_until_a_twin_parts():
    case, there = draw_case(1, 2), flight(0.1, 0.2, 0.3)
    assert judge(case, copy.deepcopy(there), there, flight(0.1, 0.2, 0.3)).word == "same"
    wrong = judge(case, flight(0.1, 0.2001, 0.3), there, flight(0.1, 0.2, 0.3))
    assert (wrong.word, wrong.finding.step, wrong.finding.quantity) == ("different", 1, "Sat0 sigma_BN[0]")
    assert judge(case, flight(0.1, 0.2, 0.4), there, flight(0.1, 0.21, 0.3)).word == "chaos"


def test_programs_leave_draws_to_the_library():
    programs = [as_program(draw_case(seed, 4)) for seed in range(60)]
    assert repr(programs[7]) == repr(as_program(draw_case(7, 4)))
    assert all(program.program for program in programs)
    assert {len(program.seeds) for program in programs} == {1, 2, 3}
    orbits = {type(one.orbit).__name__ for program in programs for one in program.crafts}
    assert orbits == {"Orbit", "Part", "NoneType"}
    assert any(isinstance(value, Drawn) for program in programs for one in program.crafts for value in one.sat_args.values())


def test_exceptions_must_be_the_same():
    case, there = draw_case(1, 2), flight()
    there.error, there.where = RuntimeError("none in view"), "reset"
    other = flight()
    other.error, other.where = KeyError("mass"), "reset"
    assert judge(case, copy.copy(there), there, there).word == "error"
    assert judge(case, other, there, there).word == "error"
    assert judge(as_program(case), other, there, there).finding.here == "KeyError: 'mass'"


def test_the_last_result_of_a_seed_counts(tmp_path):
    case = {"library": "bsk_torch", "seed": 3, "family": "scan", "view": "single", "result": "same", "steps": 4, "finding": None}
    found = {"step": 2, "quantity": "time", "here": "1", "there": "2", "reason": ""}
    file = tmp_path / "results.jsonl"
    later = {"result": "different", "finding": found}, {}, {"seed": 4}
    file.write_text("".join(json.dumps(case | change) + "\n" for change in later))
    (part,) = summarize([file]).values()
    assert (part["results"], (part["cases"], part["steps"], part["differences"])) == ({"same": 2}, (2, 8, []))


@pytest.mark.basilisk
@pytest.mark.parametrize(
    ("library", "seed"),
    [*(("bsk_torch", seed) for seed in (4, 9, 13, 64, 106)), *(("bsk_torch.bsk_rl", seed) for seed in (1001, 1010, 1014, 1036))],
)
def test_random_problems_are_those_of_basilisk(library, seed):
    pytest.importorskip("bsk_rl")
    from differential import compare, libraries, problem

    verdict = compare(problem(seed, 24, library), *libraries(library), "compiled")
    assert verdict.word == "same", verdict
