"""Files of AEOS-Bench: what they mean, in all forms, and errors that name the file and the entry."""

from __future__ import annotations

import json
import math
import shutil

import pytest
import torch

from bsk_torch.scene import CaseError, read_cases
from bsk_torch.scene.aeos_files import EARTH_RADIUS, on_sphere
from tests.scene.aeos_cases import constellation, tasks, write


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


def broken(change) -> tuple[dict, list]:
    orbits, jobs = constellation(2), tasks(2)
    change(orbits, jobs)
    return orbits, jobs


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c, t: c["satellites"][1].pop("mass"), r"constellation.json.satellites\[1\] lacks 'mass'"),
        (lambda c, t: c["satellites"][0].update(mas=1.0, mass="x"), r"satellites\[0\]: mass='x' must be a number"),
        (lambda c, t: c["satellites"][0].update(orbit=7), r"orbit=7 is not among the ids of orbits, \[0\]"),
        (lambda c, t: c["satellites"][1].update(id=0), r"satellites have the ids \[0, 0\]"),
        (lambda c, t: c["satellites"][0]["sensor"].update(type=3), r"satellites\[0\].sensor: type=3 must be one of"),
        (lambda c, t: c["satellites"][0]["reaction_wheels"].pop(), r"reaction_wheels must be a list of 3 objects"),
        (lambda c, t: c["satellites"][0].update(inertia=[1.0, 2.0, 3.0]), r"must be a list of 9 numbers"),
        (lambda c, t: c["satellites"][0]["battery"].update(percentage=1.5), r"percentage=1.5 must be a number in \[0, 1\]"),
        (lambda c, t: c["orbits"][0].update(eccentricity=float("nan")), r"eccentricity=nan must be a number"),
        (lambda c, t: t[1].update(due_time=-5), r"taskset.json.tasks\[1\]: due_time=-5 s is before release_time=0 s"),
        (lambda c, t: t[0].update(sensor_type=9), r"tasks\[0\]: sensor_type=9 must be one of"),
        (lambda c, t: t[0].update(coordinate=[137.0, 2.0]), r"must be latitude and longitude"),
        (lambda c, t: t[0].update(duration=300), r"duration=300 must be a number in \[1, 255\]"),
        (lambda c, t: t.clear(), r"no tasks"),
    ],
)
def test_a_wrong_entry_is_named(tmp_path, change, message):
    folder = write(tmp_path / "bad", *broken(change))
    with pytest.raises(CaseError, match=message):
        read_cases(folder)


def test_impossible_inertias_are_told(tmp_path, caplog):
    read_cases(write(tmp_path / "usual", constellation(2), tasks(1)))
    assert not caplog.records
    orbits, jobs = broken(lambda c, t: c["satellites"][1].update(inertia=[50.0, 0, 0, 0, 60.0, 0, 0, 0, 190.0]))
    cases = read_cases(write(tmp_path / "odd", orbits, jobs))
    assert [record.getMessage() for record in caplog.records] == [
        f"{tmp_path / 'odd'}: 1 of 2 satellites have an inertia that no body has; they fly with it, as in the benchmark"
    ]
    assert cases.satellites["inertia"][0, 1, 8] == 190.0


def test_missing_and_unreadable_files(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no constellation.json"):
        read_cases(tmp_path)
    folder = write(tmp_path / "one", constellation(1), tasks(1))
    (folder / "taskset.json").write_text("[{")
    with pytest.raises(CaseError, match=r"taskset.json: no JSON"):
        read_cases(folder)
    (folder / "taskset.json").write_text(json.dumps("tasks"))
    with pytest.raises(CaseError, match="must be an object"):
        read_cases(folder)
    (folder / "taskset.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"taskset.json: the tasks of .*constellation.json are missing"):
        read_cases(folder)


def test_more_than_the_padding(tmp_path):
    folder = write(tmp_path / "one", constellation(3), tasks(4))
    with pytest.raises(CaseError, match=r"case 'one' has 3 satellites, more than satellites=2"):
        read_cases(folder, satellites=2)
    with pytest.raises(CaseError, match=r"case 'one' has 4 tasks, more than tasks=1"):
        read_cases(folder, tasks=1)
