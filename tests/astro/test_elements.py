"""Orbital elements as objects of users; see ``tests/astro/test_orbit.py`` for the conversions themselves."""

import math

import numpy as np
import pytest
import torch

from bsk_torch.astro.elements import ClassicElements, elem2rv, rv2elem
from bsk_torch.constants import MU_EARTH
from bsk_torch.sim.arguments.values import numbers


def orbit() -> ClassicElements:
    oe = ClassicElements()
    oe.a, oe.e, oe.i, oe.Omega, oe.omega, oe.f = 7e6, 0.01, 0.9, 1.0, 2.0, 3.0
    return oe


def test_elements_are_set_one_by_one_or_are_not_numbers():
    assert numbers(orbit()).tolist() == [7e6, 0.01, 0.9, 1.0, 2.0, 3.0]
    assert numbers([orbit(), orbit()]).shape == (2, 6)
    oe = ClassicElements()
    oe.a = 7e6
    assert torch.isnan(numbers(oe)[1:]).all()


def test_conversions_and_radii():
    r, v = elem2rv(MU_EARTH, orbit())
    assert isinstance(r, np.ndarray)
    assert r.shape == v.shape == (3,)
    again = rv2elem(MU_EARTH, list(r), v)
    assert numbers(again).tolist() == pytest.approx(numbers(orbit()).tolist(), rel=1e-9)
    oe = orbit()
    assert (oe.rPeriap, oe.rApoap) == pytest.approx((6.93e6, 7.07e6))
    assert (oe.rmag, oe.alpha) == (pytest.approx(np.linalg.norm(elem2rv(MU_EARTH, oe)[0])), 1.0 / 7e6)
    assert math.isclose(rv2elem(MU_EARTH, *elem2rv(MU_EARTH, oe)).f, 3.0)
