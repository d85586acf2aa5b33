import pytest

from tests.support.programs import forked_processes


@pytest.fixture(scope="module")
def forked():
    """Processes that collect start at once; those of tests/cli/test_train.py import what they need, as those of users do."""
    with forked_processes():
        yield
