"""Cases of AEOS-Bench as environments, next to recorded flights: access, progress, successes, and the benchmark's rule."""

from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from bsk_torch import ConstellationTasking
from bsk_torch.tasks.aeos_bench.preset import aeos_bench
from bsk_torch.tasks.aeos_bench.rules import NearestTask
from tests.tasks.aeos_bench.replay import Flight


def environment(file: dict[str, NDArray], folder: Path, **options) -> ConstellationTasking:
    """The environment of a recorded case, whose files are written to a folder."""
    for kind in ("constellation", "taskset"):
        (folder / f"{kind}.json").write_text(str(file[kind]))
    return aeos_bench(folder, order="listed", **{"num_envs": 1, "seed": 0} | options)


def choices(file: dict[str, NDArray], count: int) -> NDArray:
    """Task of each satellite, -1 for none, and whether its sensor is switched, in each second, [T, S, 2]."""
    seconds = int(file["tick"].max())
    found = np.zeros((seconds, count, 2), dtype=int)
    task = np.full(count, -1)
    for t in range(seconds):
        for _, s, chosen, toggle in file["action"][file["action"][:, 0] == t]:
            task[s] = chosen
            found[t, s, 1] = toggle
        found[t, :, 0] = task
    return found


@pytest.mark.parametrize(
    ("name", "backend"),
    [*(pytest.param(name, "compiled", marks=pytest.mark.compiled) for name in ("random", "odd", "greedy")), ("odd", "eager")],
)
@pytest.mark.nightly("odd-eager", "greedy-compiled")
def test_access_and_successes_are_those_of_basilisk(name, backend, tmp_path):
    """All events to the second: the flights are gentle enough for two flights of Basilisk to have the same (``sensitivity``)."""
    file = Flight.file_of(name)
    env = environment(file, tmp_path, sensor="chosen", backend=backend)
    td, scenario = env.reset(), env.scenario
    count = scenario.cases.present.shape[1]
    on = scenario.drawn("sensor_enabled")[0] > 0.5
    before = torch.zeros(count, scenario.n_tasks, dtype=torch.bool)
    events = []
    for t, row in enumerate(choices(file, count)):
        now = scenario.task_access()[0]
        events += [(t, s, k, int(now[s, k])) for s, k in torch.nonzero(now != before).tolist()]
        before = now
        task, toggle = torch.tensor(row).unbind(1)
        on = on ^ (toggle > 0)
        td = env.step(td.set(("agents", "action"), (task + 1 + on * (scenario.n_tasks + 1)).unsqueeze(0)))["next"]
    flown = file["tick"].max()
    assert events == [tuple(event) for event in file["access"].tolist() if event[0] < flown]
    counted = file["success"] < flown  # the recorder does not count in the last second
    success = scenario.memory["task_success"][0].numpy()
    assert success[counted].tolist() == file["success"][counted].tolist()


def test_the_rule_decides_as_recorded(tmp_path):
    file = Flight.file_of("greedy")
    env = environment(file, tmp_path, sensor="on", backend="compiled")
    td, rule = env.reset(), NearestTask(env)
    wanted = choices(file, env.scenario.cases.present.shape[1])[..., 0]
    found = []
    for _ in wanted:
        found.append(rule.tasks()[0])
        td = env.step(td.set(("agents", "action"), rule(td["agents", "action_mask"])))["next"]
    assert torch.stack(found).tolist() == wanted.tolist()
    assert env.scenario.memory["task_best"][0].tolist() == file["most"].tolist()
