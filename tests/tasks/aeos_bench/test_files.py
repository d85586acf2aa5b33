"""Files of AEOS-Bench: what they mean, in all forms."""

from __future__ import annotations

import math
import shutil

import pytest
import torch

from bsk_torch.tasks.aeos_bench import read_cases
from bsk_torch.tasks.aeos_bench.files import EARTH_RADIUS, on_sphere
from tests.tasks.aeos_bench.aeos_cases import constellation, tasks, write


def test_numbers_are_those_of_the_file(tmp_path):
    cases = read_cases(write(tmp_path / "one", constellation(2), tasks(3)))
    assert cases.names == ("one",)
    assert len(cases) == 1
    found = {name: values[0, 1].tolist() for name, values in cases.satellites.items()}
    assert found["rwJs"] == [50.0 / (6000.0 * math.pi / 30.0)] * 3
    assert found["sensorFieldOfView"] == math.radians(0.3)
    assert found["oe"] == [7e6, 0.001, *(math.radians(x) for x in (53.0, 10.0, 90.0, 36.0))]
    assert (found["storedCharge_Init"], found["sensorPower"], found["panelArea"]) == (10000.0, -5.0, 0.4)
    assert cases.tasks["duration"].tolist() == [[15.0, 15.0, 15.0]]
    assert cases.places.norm(dim=-1).tolist() == [pytest.approx([EARTH_RADIUS] * 3, rel=1e-15)]
    assert not cases.enabled.any()


def test_cases_of_different_sizes_are_padded(tmp_path):
    write(tmp_path / "a", constellation(1), tasks(4))
    write(tmp_path / "b", constellation(3), {"tasks": tasks(2)})
    cases = read_cases(tmp_path, satellites=4, tasks=5)
    assert cases.names == ("a", "b")
    assert cases.present.tolist() == [[True, False, False, False], [True, True, True, False]]
    assert (cases.tasks["duration"] > 0).tolist() == [[True] * 4 + [False], [True, True, False, False, False]]
    first = cases.satellites["oe"][1, 0]
    assert torch.equal(cases.satellites["oe"][1, 3], first)


@pytest.mark.parametrize("layout", ["folder", "stem", "benchmark"])
def test_layouts_of_folders(tmp_path, layout):
    source = write(tmp_path / "source", constellation(1), tasks(1))
    places = {
        "folder": ("00006/constellation.json", "00006/taskset.json"),
        "stem": ("00006.constellation.json", "00006.taskset.json"),
        "benchmark": ("constellations/test/00/00006.json", "tasksets/test/00/00006.json"),
    }[layout]
    for kind, place in zip(("constellation", "taskset"), places, strict=True):
        target = tmp_path / "cases" / place
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source / f"{kind}.json", target)
    assert read_cases(tmp_path / "cases").names == ("00006",)


def test_satellites_and_tasks_are_sorted_by_their_ids(tmp_path):
    orbits, jobs = constellation(3), tasks(3)
    orbits["satellites"].reverse()
    jobs.reverse()
    found = read_cases(write(tmp_path / "one", orbits, jobs))
    assert torch.equal(found.satellites["oe"][0, :, 5], torch.deg2rad(torch.tensor([0.0, 36.0, 72.0], dtype=torch.float64)))
    assert found.places[0, 0, 2] > 0.0


def test_places_are_on_the_sphere_of_the_benchmark():
    found = on_sphere(torch.tensor([0.0, 90.0], dtype=torch.float64), torch.tensor([90.0, 0.0], dtype=torch.float64))
    assert found[0].tolist() == pytest.approx([0.0, EARTH_RADIUS, 0.0], abs=1e-9)
    assert found[1].tolist() == pytest.approx([0.0, 0.0, EARTH_RADIUS], abs=1e-9)


def test_impossible_inertias_are_told(tmp_path, caplog):
    read_cases(write(tmp_path / "usual", constellation(2), tasks(1)))
    assert not caplog.records
    odd = constellation(2)
    odd["satellites"][1].update(inertia=[50.0, 0, 0, 0, 60.0, 0, 0, 0, 190.0])
    cases = read_cases(write(tmp_path / "odd", odd, tasks(2)))
    assert [record.getMessage() for record in caplog.records] == [
        f"{tmp_path / 'odd'}: 1 of 2 satellites have an inertia that no body has; they fly with it, as in the benchmark"
    ]
    assert cases.satellites["inertia"][0, 1, 8] == 190.0
