"""Places against ERFA, passes against all times of the grid."""

import dataclasses

import erfa
import numpy as np
import pytest

from bsk_torch.tasks.aeossp.geometry import find_passes, on_ellipsoid, sunlit, tracks


def test_places_are_on_the_ellipsoid(case):
    requests = case.requests
    theirs = erfa.gd2gc(1, np.radians(requests.longitude), np.radians(requests.latitude), requests.altitude)
    np.testing.assert_allclose(on_ellipsoid(requests), theirs, atol=1e-6)


def test_rates_are_derivatives_of_lines_of_sight(positions):
    index = np.array([0, 1, 2]), np.array([3, 30, 60])
    k = np.array([500, 1000, 1500])
    ahead, behind = (positions.sight(*index, k + step) for step in (1, -1))
    # differences over 10 s: lines of sight turn by less than 0.02 rad/s, and bend slowly at these distances
    np.testing.assert_allclose(positions.sight_rate(*index, k), (ahead - behind) / 10.0, atol=2e-6)


def test_passes_are_all_times_in_the_cone(case, positions):
    passes = find_passes(case, positions)
    assert len(passes) > 40
    step, requests = case.step_s, case.requests
    k = np.arange(len(positions.sidereal))
    found = {(s, t): [] for s, t in zip(passes.satellite.tolist(), passes.task.tolist(), strict=True)}
    for s, t, first, starts in zip(passes.satellite, passes.task, passes.first, passes.starts, strict=True):
        found[s, t] += range(first, first + starts)
    for s, satellite in enumerate(case.satellites):
        for t in range(0, len(requests), 7):
            seen = positions.sees(np.full_like(k, s), np.full_like(k, t), k, np.full(len(k), satellite.off_nadir))
            seen &= (k * step >= requests.release_s[t]) & (k * step <= requests.due_s[t])
            length = requests.duration_s[t] // step
            starts = [a for a in k[: len(k) - length] if seen[a : a + length + 1].all()]
            assert sorted(found.get((s, t), [])) == (starts if satellite.sensor == requests.sensor[t] else [])


def test_shadow_covers_the_time_that_low_orbits_spend_in_it(case):
    share = [sunlit(case, number, np.arange(0.0, 43200.0, 30.0)).mean() for number in range(len(case.satellites))]
    assert all(0.55 < part <= 1.0 for part in share)


def test_satellites_that_fall_are_named(case):
    def summed(line):
        return line + str(sum(int(c) if c.isdigit() else c == "-" for c in line) % 10)

    craft = case.satellites[0]
    line1 = summed(craft.line1[:53] + " 99999-1" + craft.line1[61:68])  # much drag, and a low orbit
    line2 = summed(craft.line2[:52] + "16.20000000" + craft.line2[63:68])
    with pytest.raises(ValueError, match="no state of 'sat_003'"):
        tracks(dataclasses.replace(case, satellites=(dataclasses.replace(craft, line1=line1, line2=line2),)))
