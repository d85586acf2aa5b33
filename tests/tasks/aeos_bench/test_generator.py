"""Random cases with the distributions of AEOS-Bench."""

from __future__ import annotations

import math

import pytest
import torch

import bsk_torch
from bsk_torch.rand import first_key
from bsk_torch.tasks.aeos_bench import AEOSBenchGenerator, read_cases, write_cases
from bsk_torch.tasks.aeos_bench.files import EARTH_RADIUS
from bsk_torch.tasks.aeos_bench.generator import pool, real_orbits
from tests.tasks.aeos_bench.aeos_cases import constellation, tasks, write


def test_numbers_are_in_the_ranges_of_the_benchmark():
    cases = AEOSBenchGenerator().draw(first_key(512))
    ours = {name: value[cases.present] for name, value in cases.satellites.items()}
    ranges = {
        "panelArea": (0.1, 0.5),
        "panelEfficiency": (0.1, 0.5),
        "sensorFieldOfView": (math.radians(0.1), math.radians(0.5)),
        "sensorPower": (-10.0, -1.0),
        "batteryStorageCapacity": (8e3, 30e3),
        "mass": (50.0, 200.0),
    }
    for name, (low, high) in ranges.items():
        assert low <= ours[name].min() < low + 0.02 * (high - low), name
        assert high - 0.02 * (high - low) < ours[name].max() <= high, name
    duration, release, due = (cases.tasks[name] for name in ("duration", "release", "due"))
    exists = duration > 0.0
    assert duration[exists].unique().tolist() == [float(k) for k in range(15, 61)]
    assert bool((release + 3.0 * duration <= due)[exists].all())
    assert (release.min(), due.max()) == (0.0, 3600.0)
    assert bool((cases.places.norm(dim=-1) - EARTH_RADIUS).abs().max() < 1e-8)
    assert sorted(set(cases.present.sum(1).tolist())) == list(range(1, 51))
    counts = exists.sum(1)
    assert 50 <= counts.min() <= 55
    assert 295 <= counts.max() <= 300


def test_means_are_those_of_the_distributions():
    """Within five standard errors."""
    cases = AEOSBenchGenerator(50, 300).draw(first_key(200))
    a, e = cases.satellites["oe"][..., 0], cases.satellites["oe"][..., 1]
    share = cases.satellites["storedCharge_Init"] / cases.satellites["batteryStorageCapacity"]
    sine = cases.places[..., 2] / EARTH_RADIUS
    for values, mean, deviation in (
        (a, 7.4e6, 1.2e6 / math.sqrt(12.0)),
        (e, 0.0025, 0.005 / math.sqrt(12.0)),
        (share, 0.55, 0.9 / math.sqrt(12.0)),
        (sine.asin(), 0.0, math.pi / math.sqrt(12.0)),  # uniform latitudes: denser at the poles
    ):
        assert abs(values.mean().item() - mean) < 5.0 * deviation / math.sqrt(values.numel())


REAL = {
    "satellites": (32, [8.0, 27.0, 45.7]),
    "tasks": (32, [105.1, 217.5, 288.0]),
    "duration": (6488, [19.0, 37.0, 56.0]),
    "release": (6488, [358.0, 1739.0, 3142.0]),
    "window": (6488, [184.0, 760.0, 2146.0]),
    "latitude": (6488, [-71.79, -0.6202, 71.51]),
    "longitude": (6488, [-143.2, 0.3747, 142.7]),
    "panelArea": (854, [0.1437, 0.307, 0.4671]),
    "panelEfficiency": (854, [0.1414, 0.2953, 0.454]),
    "field of view": (854, [0.1431, 0.3036, 0.4558]),
    "sensor power": (854, [1.951, 5.634, 9.165]),
    "batteryStorageCapacity": (854, [9847.0, 18940.0, 28350.0]),
    "charge": (854, [0.179, 0.5566, 0.9214]),
    "normal y": (854, [0.04858, 0.3687, 0.8565]),
    "normal z": (854, [-0.9599, 0.0431, 0.9425]),
    "anomaly": (854, [0.6572, 3.111, 5.627]),
    "mass": (359, [63.5, 119.2, 184.8]),
    "Ki": (359, [0.001183, 0.004697, 0.008419]),
    "wheel speed": (359, [432.1, 565.2, 710.5]),
}
"""Of 32 cases of the benchmark's test set: how many numbers, and their tenth, fiftieth and ninetieth percentile.

Angles of tasks in degrees and their times in s, fields of view in degrees, powers in W, areas in m^2, capacities in J, anomalies
in rad, masses in kg, speeds in rpm. There are 359 different satellites.
"""


def test_distributions_are_those_of_the_files_of_the_benchmark():
    """Within 4.5 standard errors of the shares below the percentiles."""
    cases = AEOSBenchGenerator().draw(first_key(300))
    duration, release, due = (cases.tasks[name] for name in ("duration", "release", "due"))
    exists, (x, y, z) = duration > 0.0, cases.places.unbind(-1)
    ours = {name: value[cases.present] for name, value in cases.satellites.items()}
    found = ours | {
        "satellites": cases.present.sum(1),
        "tasks": exists.sum(1),
        "duration": duration[exists],
        "release": release[exists],
        "window": (due - release)[exists],
        "latitude": torch.rad2deg(torch.asin(z / EARTH_RADIUS))[exists],
        "longitude": torch.rad2deg(torch.atan2(y, x))[exists],
        "field of view": torch.rad2deg(ours["sensorFieldOfView"]),
        "sensor power": -ours["sensorPower"],
        "charge": ours["storedCharge_Init"] / ours["batteryStorageCapacity"],
        "normal y": ours["nHat_B"][:, 1],
        "normal z": ours["nHat_B"][:, 2],
        "anomaly": ours["oe"][:, 5],
        "wheel speed": ours["wheelSpeeds"],
    }
    for name, (count, percentiles) in REAL.items():
        for share, bound in zip((0.1, 0.5, 0.9), percentiles, strict=True):
            margin = 4.5 * math.sqrt(share * (1.0 - share) / count)
            below, up_to = ((found[name] < bound).double().mean(), (found[name] <= bound).double().mean())
            assert below - margin < share < up_to + margin, (name, share)


def test_satellites_of_a_case_are_different_ones_of_the_pool():
    generator = AEOSBenchGenerator(50)
    mass = generator.draw(first_key(8)).satellites["mass"]
    assert all(len(row.unique()) == 50 for row in mass)
    assert set(mass.flatten().tolist()) <= set(pool()["mass"].tolist())


def test_a_case_does_not_depend_on_the_number_of_environments():
    generator = AEOSBenchGenerator((1, 5), (10, 20))
    many, one = generator.draw(first_key(6)), generator.draw(first_key(6).take([4]))
    assert torch.equal(many.places[4:5], one.places)
    assert all(torch.equal(many.satellites[name][4:5], one.satellites[name]) for name in one.satellites)


def test_given_orbits_are_drawn_without_replacement():
    orbits = torch.tensor([[6.9e6 + 1e3 * k, 1e-4, 0.9, 0.1 * k, 0.2] for k in range(6)], dtype=torch.float64)
    drawn = AEOSBenchGenerator(4, 10, orbits).draw(first_key(20)).satellites["oe"]
    assert set(drawn[..., 0].flatten().tolist()) == set(orbits[:, 0].tolist())
    assert all(len(row.unique()) == 4 for row in drawn[..., 0])
    assert drawn[..., 5].std() > 1.0  # true anomalies are random


def test_real_orbits_are_those_of_the_benchmark():
    """Numbers of the file in the benchmark's repository, and orbits drawn from all of it."""
    orbits = real_orbits()
    a, e, angles = orbits[:, 0], orbits[:, 1], torch.rad2deg(orbits[:, 2:])
    assert orbits.shape == (4993, 5)
    assert (a.min(), a.median(), a.max()) == (6771e3, 6921e3, 7871e3)
    assert int((a == 6921e3).sum()) == 3832
    assert e.min().item() == pytest.approx(7.2e-6, rel=1e-12)
    assert (a * (1.0 - e)).min() > EARTH_RADIUS
    assert angles.amin(0).tolist() == pytest.approx([0.0476, 0.3239, 0.083], rel=1e-12)
    assert angles.amax(0).tolist() == pytest.approx([141.7312, 359.9398, 359.8869], rel=1e-12)
    drawn = AEOSBenchGenerator(50, 50, "real").draw(first_key(64)).satellites["oe"]
    assert all(len(row.unique(dim=0)) == 50 for row in drawn)
    assert set(drawn[..., 3].flatten().tolist()) <= set(orbits[:, 3].tolist())
    share = (drawn[..., 0] == 6921e3).double().mean()
    assert abs(share - 3832 / 4993) < 4.5 * math.sqrt(0.77 * 0.23 / 3200)


def test_drawn_cases_can_be_written_to_files(tmp_path):
    """Files of random cases have the same satellites and tasks up to rounding."""
    cases = AEOSBenchGenerator((2, 4), (5, 9), "real").draw(first_key(3))
    assert [path.name for path in write_cases(cases, tmp_path)] == ["00000", "00001", "00002"]
    again = read_cases(tmp_path, 4, 9)
    assert torch.equal(again.present, cases.present)
    exists = cases.tasks["duration"] > 0.0
    for name, values in cases.satellites.items():
        torch.testing.assert_close(again.satellites[name][cases.present], values[cases.present], rtol=1e-14, atol=1e-13)
    for name, values in cases.tasks.items():
        assert torch.equal(again.tasks[name][exists], values[exists])
    torch.testing.assert_close(again.places[exists], cases.places[exists], rtol=0.0, atol=1e-8)


def test_a_preset_of_random_cases():
    """Small by default; episodes are the same in other batches, and other sizes can be chosen."""
    env = bsk_torch.make("AEOSBench-v1", num_envs=2, seed=3, backend="eager")
    assert (len(env.names), env.scenario.n_tasks) == (8, 50)
    sizes = dict(satellites=(1, 3), tasks=(5, 9), backend="eager", seed=3)
    many, one = (
        bsk_torch.make("AEOSBench-v1", num_envs=5, **sizes),
        bsk_torch.make("AEOSBench-v1", num_envs=1, env_ids=[4], **sizes),
    )
    seen = []
    for env in (many, one):
        td, rule = env.reset(), bsk_torch.rule("nearest_task", env)
        for _ in range(3):
            td = env.step(rule(td))["next"]
        seen.append(td["agents", "observation"][-1])
        assert env.scenario.drawn("case")[-1] == -1.0
    assert torch.equal(*seen)
    present = many.scenario.fleet.joined([satellite.present for satellite in many.scenario.fleet.satellites])
    assert len(set(present.sum(1).tolist())) > 1


def test_a_generator_takes_the_place_of_a_folder(tmp_path):
    generator = AEOSBenchGenerator(2, (6, 7))
    env = bsk_torch.make("AEOSBench-v1", num_envs=1, folder=generator, backend="eager")
    assert env.scenario.cases is generator
    for arguments, message in (
        (dict(folder=generator, satellites=3), r"those given have their sizes"),
        (dict(folder=generator, orbits="real"), r"orbits='real' is of random cases"),
        (dict(order="listed"), r"order='listed' lists cases, but a generator draws them"),
        (
            dict(folder=write(tmp_path / "one", constellation(1), tasks(1)), satellites=(1, 2)),
            r"satellites=\(1, 2\) must be a whole",
        ),
        (dict(folder=tmp_path / "none"), r"none: no constellation.json"),
    ):
        with pytest.raises((ValueError, FileNotFoundError), match=message):
            bsk_torch.make("AEOSBench-v1", num_envs=1, **arguments)
