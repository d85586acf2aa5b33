"""Fixtures: a program and two of its values."""

import pytest

from bsk_torch.codegen.trace import Tracer


@pytest.fixture
def program():
    return Tracer()


@pytest.fixture
def x(program):
    return program.input("state", 0)


@pytest.fixture
def y(program):
    return program.input("state", 1)
