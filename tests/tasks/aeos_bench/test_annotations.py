"""Assignments of AEOS-Bench in its files: what flights write, and flights of what files say."""

import json

import pytest
import torch

from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.policies.shared_policy import rule
from bsk_torch.tasks.aeos_bench import read_cases
from bsk_torch.tasks.aeos_bench.annotations import (
    DATA,
    ENABLED,
    PROGRESS,
    TASK_ID,
    VISIBLE,
    AssignedTasks,
    Trajectory,
    export_annotations,
    fly_cases,
    read_assignments,
)
from bsk_torch.tasks.aeos_bench.preset import aeos_bench
from tests.support.refusals import check_refusals, refusal
from tests.tasks.aeos_bench.aeos_cases import constellation, tasks, write

SECONDS = 300

pytestmark = pytest.mark.compiled


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("cases")
    write(path / "00007", constellation(2), tasks(120))
    write(path / "01003", constellation(3), tasks(90))
    return path


def made(folder, **options):
    usual = dict(order="listed", num_envs=2, env_ids=[0, 0], sensor="on", time_limit=SECONDS)
    return aeos_bench(folder, **usual | options)


@pytest.fixture(scope="module")
def flown(folder):
    env = made(folder)
    return list(fly_cases(rule("nearest_task", env), env))


def test_a_trajectory_has_every_second_of_a_flight(flown):
    assert [one.name for one in flown] == ["00007", "01003"]
    for one, crew, jobs in zip(flown, (2, 3), (120, 90), strict=True):
        shapes = {TASK_ID: (crew,), ENABLED: (crew,), DATA: (crew, 8), PROGRESS: (jobs,), VISIBLE: (crew, jobs)}
        assert {name: tuple(table.shape) for name, table in one.tensors.items()} == {
            name: (SECONDS, *shape) for name, shape in shapes.items()
        }
        assert one.tensors[PROGRESS].dtype == torch.uint8
        assert not one.tensors[ENABLED][0].any()
        assert one.tensors[ENABLED][1:].all()
        visible, progress = one.tensors[VISIBLE].any(1), one.tensors[PROGRESS].long()
        assert torch.equal(progress[1:] > 0, visible[1:])  # in the second of success, too
        assert (progress == 15).any()
        assert one.measures["PCR"] > 0.0
        assert (one.tensors[DATA][..., 0] <= 1.0).all()
        assert one.tensors[DATA][0, :, 1:4].flatten().tolist() == pytest.approx([500.0] * 3 * crew, abs=0.5)
    assert flown[0].tensors[DATA][0, 1, 4] == pytest.approx(36.0, abs=0.1)


def test_flights_of_exported_files_are_the_same(flown, folder, tmp_path):
    written = export_annotations(flown, tmp_path, "val_seen", 2)
    names = [path.relative_to(tmp_path).as_posix() for path in written]
    assert names == [
        *(f"trajectories.2/val_seen/00/00007.{kind}" for kind in ("pth", "json")),
        *(f"trajectories.2/val_seen/01/01003.{kind}" for kind in ("pth", "json")),
        "annotations/val_seen.json",
    ]
    assert json.loads(written[-1].read_text()) == {"ids": [7, 1003], "epochs": [2, 2]}
    cases = read_cases(folder)
    found = read_assignments(tmp_path, cases)
    assert torch.equal(found[0, :, :2], flown[0].tensors[TASK_ID])
    assert (found[0, :, 2] == -1).all()
    for size in (1, 2):  # one case after the other, or both together
        env = made(cases, num_envs=size, env_ids=[0] * size)
        result = evaluate(AssignedTasks(env, found).module(), env, seeds=range(2))
        for k, one in enumerate(flown):
            kept = json.loads(written[2 * k + 1].read_text())
            for name, value in result.measures.items():
                assert float(value[k]) == pytest.approx(one.measures[name], rel=1e-12, nan_ok=True), name
                assert kept[name] is None or kept[name] == one.measures[name]
        assert result.summary()["measures"]["CR"]["mean"] == pytest.approx(sum(one.measures["CR"] for one in flown) / 2)


def test_flights_among_candidates_are_exported_second_by_second(folder):
    env = made(folder, sensor="assigned", candidates=True, step_duration=20.0, until_done=True)
    policy = rule("soonest_task", env)
    flown = list(fly_cases(policy, env))
    result = evaluate(policy, env, seeds=range(2))
    assert result.measures["PCR"].min() > 0.0
    for k, one in enumerate(flown):
        assert len(one.tensors[TASK_ID]) == SECONDS
        for name, value in result.measures.items():
            assert one.measures[name] == pytest.approx(float(value[k]), rel=1e-12, nan_ok=True), name
    changes = (flown[0].tensors[TASK_ID].diff(dim=0) != 0).any(1).nonzero().flatten() + 1
    assert len(changes) > 1
    env = made(folder, sensor="chosen", step_duration=200.0, backend="eager")
    flights = fly_cases(rule("nearest_task", env), env)
    check_refusals(refusal(lambda: next(flights), ValueError, "sensor='chosen'"))


def test_runs_of_each_satellite_are_read(folder, tmp_path):
    for name, crew in (("00007", 2), ("01003", 3)):
        runs = {str(k): [[-1, 3], [k + 1, 4]] for k in range(crew)}
        (tmp_path / name).mkdir()
        (tmp_path / name / "assignment_runs.json").write_text(json.dumps(runs))
    found = read_assignments(tmp_path, read_cases(folder))
    assert found[1].mT.tolist() == [[-1] * 3 + [k + 1] * 4 for k in range(3)]


def test_rejects_wrong_assignments(folder, tmp_path):
    cases, place = read_cases(folder), tmp_path / "00007"

    def runs(of):
        place.mkdir(exist_ok=True)
        (place / "assignment_runs.json").write_text(json.dumps(of))
        read_assignments(tmp_path, cases)

    def trajectory(write):
        (place / "assignment_runs.json").unlink(missing_ok=True)
        write(tmp_path / "00007.pth")
        read_assignments(tmp_path, cases)

    def assigned(count, **options):
        AssignedTasks(made(folder, backend="eager", **options), torch.zeros(count, 5, 3, dtype=torch.int64))

    check_refusals(
        refusal(lambda: read_assignments(tmp_path, cases), FileNotFoundError, "00007.pth", "00007/assignment_runs.json"),
        refusal(lambda: runs({"0": [[-1, 3]]}), ValueError, "assignment_runs.json", "'00007'", "1 satellites", 2),
        refusal(lambda: runs({"0": [[120, 3]], "1": [[0, 3]]}), ValueError, "assignment_runs.json", "'00007'", "0 to 120"),
        refusal(lambda: runs({"0": [[1, 3]], "1": [[0, 4]]}), ValueError, "assignment_runs.json", "[3, 4] s"),
        refusal(lambda: runs({"0": [3], "1": [4]}), ValueError, "assignment_runs.json", "[task, seconds]"),
        refusal(lambda: runs({"a": [[1, 3]]}), ValueError, "assignment_runs.json", "[task, seconds]"),
        refusal(lambda: trajectory(lambda path: path.write_bytes(b"none")), ValueError, "00007.pth", "trajectory"),
        refusal(lambda: trajectory(lambda path: torch.save({"actions": 1}, path)), ValueError, "00007.pth", "'actions.task_id'"),
        refusal(lambda: export_annotations([Trajectory("one", {}, {})], tmp_path), ValueError, "'one'", "100,000"),
        refusal(lambda: assigned(1), ValueError, "assignments", [1, 5, 3], "C=2", "S=3"),
        refusal(lambda: assigned(2, order="random"), ValueError, "annotations", "order='listed'"),
        refusal(lambda: assigned(2, step_duration=30.0), ValueError, "annotations", "step_duration", "candidates"),
    )
