"""Which cases of a test run in CI, and which with scripts/test.sh --nightly."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import pytest


def by_night(cases: Iterable[Any], nightly: Iterable[Any]) -> list[Any]:
    """Cases of a test, those of ``nightly`` with the marker of that name; all of these must be cases."""
    cases, nightly = list(cases), list(nightly)
    assert all(case in cases for case in nightly), f"{nightly} are not all cases of {cases}"
    return [pytest.param(*_values(case), marks=pytest.mark.nightly) if case in nightly else case for case in cases]


def runs_in_ci(test: Callable[..., None], *case: Any) -> bool:
    """Whether a test runs in CI with these values of its parameters, in the order of its decorators from the lowest one."""
    marks = getattr(test, "pytestmark", [])
    if any(mark.name == "nightly" for mark in marks):
        return False
    lists = [list(_plain(mark.args[1])) for mark in marks if mark.name == "parametrize"]
    return case in [tuple(itertools.chain(*values)) for values in itertools.product(*lists)]


def _values(case: Any) -> tuple[Any, ...]:
    """The values of a case: several of a tuple, else one."""
    return case if isinstance(case, tuple) else (case,)


def _plain(cases: Iterable[Any]) -> Iterator[tuple[Any, ...]]:
    """Values of the cases that are not marked as nightly."""
    for case in cases:
        if not any(mark.name == "nightly" for mark in getattr(case, "marks", ())):
            yield tuple(getattr(case, "values", None) or _values(case))
