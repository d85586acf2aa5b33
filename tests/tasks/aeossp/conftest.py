"""The part of a case, its observations, and the verifier's report, shared by the tests of the task."""

import json

import pytest

from bsk_torch.tasks.aeossp import read_case, read_solution
from bsk_torch.tasks.aeossp.geometry import find_passes, tracks
from bsk_torch.tasks.aeossp.network import build
from bsk_torch.tasks.aeossp.slews import verifier
from tests.cli.conftest import run
from tests.tasks.aeossp.part import PART, part

__all__ = ["run"]


@pytest.fixture(scope="session")
def case():
    return read_case(PART)


@pytest.fixture(scope="session")
def positions(case):
    return tracks(case)


@pytest.fixture(scope="session")
def observations(case):
    return read_solution(PART / "solution.json", case)


@pytest.fixture(scope="session")
def report():
    return json.loads(part("report.json"))


@pytest.fixture(scope="session")
def network(case, positions):
    return build(case, positions, find_passes(case, positions), verifier, 0.0)
