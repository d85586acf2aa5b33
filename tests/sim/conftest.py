"""Fixtures that the tests of arcs share."""

from collections.abc import Callable

import pytest

from tests.sim.orbit.arcs import Solved


@pytest.fixture(scope="session")
def fly(solve_arcs, backend) -> Callable[..., Solved]:
    """Arcs of ``spans`` hours under the back end of the test."""
    return lambda initials, spans: Solved(*solve_arcs(initials, spans, backend=backend), backend)
