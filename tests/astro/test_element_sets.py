"""Element sets: their positions against Skyfield, and what is said about old ones."""

import dataclasses
import logging

import numpy as np
import pytest
import torch
from skyfield.api import EarthSatellite, load

from bsk_torch.astro import element_sets
from bsk_torch.astro.ephemeris import DAY
from bsk_torch.formats.tle import read_tle
from tests.formats.samples import FLEET, GREENSAT
from tests.support.refusals import check_refusals, refusal

DEEP = """MOLNIYA 2-14
1 08195U 75081A   06176.33215444  .00000099  00000-0  11873-3 0   813
2 08195  64.1586 279.0717 6877146 264.7651  20.2257  2.00491383225656
XM-3
1 28626U 05008A   06176.46683397 -.00000205  00000-0  10000-3 0  2190
2 28626   0.0019 286.9433 0000335  13.7918  55.6504  1.00270176  4891
"""
"""From the verification cases of SGP4 (AIAA 2006-6753): 12 h resonant, and geostationary."""


def test_positions_are_those_of_skyfield_to_a_meter():
    timescale = load.timescale(builtin=True)
    text = GREENSAT + DEEP
    lines, sets = text.splitlines(), read_tle(text)
    assert len(sets) == 3
    for k, elements in enumerate(sets):
        et = elements.epoch + DAY * torch.linspace(-1.0, 1.0, 9, dtype=torch.float64)
        other = EarthSatellite(*lines[3 * k + 1 : 3 * k + 3], None, timescale).at(timescale.tdb_jd(2451545.0, et.numpy() / DAY))
        r, v = dataclasses.replace(elements, matched=False).state_at(et)
        assert np.linalg.norm(r.numpy() - other.position.m.T, axis=-1).max() < 1.0
        assert np.linalg.norm(v.numpy() - other.velocity.m_per_s.T, axis=-1).max() < 1e-3


def test_matching_changes_velocities_a_little_and_no_positions():
    sets = read_tle(GREENSAT + DEEP)
    assert len(sets) == 3
    for elements in sets:
        et = torch.tensor([elements.epoch + 3000.0], dtype=torch.float64)
        (r, v), (r_matched, v_matched) = (dataclasses.replace(elements, matched=on).state_at(et) for on in (False, True))
        assert torch.equal(r, r_matched)
        assert 1e-3 < float((v - v_matched).norm()) < 5.0


def test_states_do_not_depend_on_the_batch():
    elements = read_tle(FLEET)[1]
    et = elements.epoch + torch.linspace(0.0, DAY, 5, dtype=torch.float64)
    whole, alone = elements.state_at(et), elements.state_at(et[3:4])
    assert all(torch.equal(part[3:4], one) for part, one in zip(whole, alone, strict=True))
    same = elements.state_at(et[3:4].repeat(4))
    assert all(torch.equal(part, one.expand(4, 3)) for part, one in zip(same, alone, strict=True))


def test_constants_of_gravity_differ_by_tens_of_meters():
    sets = [read_tle(GREENSAT, gravity=name)[0] for name in ("wgs72", "wgs84")]
    et = torch.tensor([sets[0].epoch + 0.5 * DAY], dtype=torch.float64)
    one, other = (each.teme_states(et)[0] for each in sets)
    assert 10.0 < float((one - other).norm()) < 75.0


def test_old_sets_are_logged_once_and_refused_later(caplog, monkeypatch):
    monkeypatch.setattr(element_sets, "_warned", set())
    (elements,) = read_tle(GREENSAT)
    at = lambda days: torch.tensor([elements.epoch + days * DAY], dtype=torch.float64)
    with caplog.at_level(logging.WARNING):
        for days in (6.0, -8.0, 9.0):
            elements.state_at(at(days))
    assert [record.getMessage().count("8.0 days") for record in caplog.records] == [1]
    (patient,) = read_tle(GREENSAT, max_age_days=400.0)
    patient.check_age(at(399.0))
    check_refusals(
        refusal(lambda: elements.state_at(at(31.0)), ValueError, "GREENSAT-1 (A)", "31.0 days", "30", "utc_init", "max_age_days"),
        refusal(lambda: elements.state_at(at(-400.0)), ValueError, "400.0 days"),
    )


def test_satellites_that_fall_have_no_state():
    text = """1 29141U 85108AA  06170.26783845  .99999999  00000-0  13519-0 0   718
2 29141  82.4288 273.4882 0015848 277.2124  83.9133 15.93343074  6828
"""
    (elements,) = read_tle(text)  # lost within seven hours, as the cases of AIAA 2006-6753 say
    with pytest.raises(ValueError, match=r"29141.*0\.3 days"):
        elements.teme_states(torch.tensor([elements.epoch + 0.3 * DAY], dtype=torch.float64))
