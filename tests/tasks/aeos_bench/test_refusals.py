"""AEOS-Bench: wrong arguments, and files of cases with wrong entries."""

import math

import bsk_torch
from bsk_torch import ConstellationTasking, SatelliteTasking, scene
from bsk_torch.presets.nadir_scan import ScanningSatellite
from bsk_torch.tasks.aeos_bench import AEOSBench, AEOSBenchGenerator, PointAtTask, TaskProperties, TaskReward, read_cases
from bsk_torch.tasks.aeos_bench.bound import sight_bound
from bsk_torch.tasks.aeos_bench.preset import BenchSatellite, CaseSatellites
from bsk_torch.tasks.aeos_bench.rules import NearestTask
from tests.support.refusals import check_refusals, refusal
from tests.tasks.aeos_bench.aeos_cases import constellation, tasks, write


def test_rejects_wrong_arguments_of_benches(tmp_path):
    def make(**options):
        return bsk_torch.make("AEOSBench-v1", num_envs=1, backend="eager", **options)

    def alone(satellite, *given):
        return SatelliteTasking(satellite, *given, sim_rate=1.0, backend="eager")

    def scanning(*given):
        return alone(ScanningSatellite("A"), *given)

    nadir, reward = scene.UniformNadirScanning(), TaskReward()
    slow = BenchSatellite("A", action_spec=[PointAtTask(duration=2.0)])
    drawn, folder = AEOSBench(AEOSBenchGenerator(1, 5)), tmp_path / "cases"
    write(folder / "a", constellation(2), tasks(40))
    write(folder / "b", constellation(3), tasks(60))
    cases = AEOSBench(folder)
    several = dict(sat_arg_randomizer=CaseSatellites(cases), sim_rate=1.0)
    check_refusals(
        refusal(lambda: AEOSBench(folder, order="list"), ValueError, "order", "'list'", "'listed'"),
        refusal(lambda: AEOSBench(folder, horizon=0), ValueError, "horizon=0"),
        refusal(lambda: TaskReward(2), ValueError, "progress_share=2"),
        refusal(lambda: PointAtTask("of"), ValueError, "sensor", "'of'"),
        refusal(lambda: PointAtTask(duration=0), ValueError, "duration=0"),
        refusal(lambda: PointAtTask(duration=-1.0), ValueError, "duration", -1.0),
        refusal(lambda: PointAtTask(until_done=2), ValueError, "until_done=2", True, False),
        refusal(lambda: PointAtTask(n_candidates=0), ValueError, "n_candidates=0"),
        refusal(lambda: TaskProperties(dict(prop="slac")), ValueError, "prop", "'slac'", "'slack'"),
        refusal(lambda: make(until_done=True), ValueError, "until_done", True, "step_duration", "1 s"),
        refusal(lambda: make(step_duration=0.5), ValueError, "step_duration", 0.5),
        refusal(lambda: make(candidates=True, haste=2.0), ValueError, "haste", 2.0),
        refusal(lambda: make(as_set=True), ValueError, "as_set", True, "candidates"),
        refusal(lambda: make(candidates=True, sensor="on"), ValueError, "sensor", "'on'", "'assigned'"),
        refusal(lambda: alone(BenchSatellite("A")), ValueError, "PointAtTask", "'point'", "AEOSBench"),
        refusal(lambda: scanning(nadir, reward), ValueError, "TaskReward", "AEOSBench", "UniformNadirScanning"),
        refusal(lambda: scanning(cases), ValueError, "AEOSBench", "AEOSBenchDynModel"),
        refusal(lambda: alone(slow, drawn), ValueError, "duration=2 s", "1 s", "AEOSBenchTracedDynModel"),
        refusal(lambda: ConstellationTasking([BenchSatellite("A")], cases, **several), ValueError, "3 satellites", "has 1"),
        refusal(lambda: NearestTask(scanning()), ValueError, "AEOSBench"),
        refusal(lambda: sight_bound(scanning()), ValueError, "AEOSBench"),
        refusal(lambda: sight_bound(make(satellites=1, tasks=1), interval=20.0), ValueError, "interval", 20.0),
    )


def test_rejects_wrong_arguments_of_random_cases():
    def orbits(value, satellites=1):
        return AEOSBenchGenerator(satellites, 10, value)

    check_refusals(
        refusal(lambda: AEOSBenchGenerator(0), ValueError, "satellites=0"),
        refusal(lambda: AEOSBenchGenerator((5, 2)), ValueError, "satellites", (5, 2)),
        refusal(lambda: AEOSBenchGenerator((1, 2, 3)), ValueError, "satellites", (1, 2, 3)),
        refusal(lambda: AEOSBenchGenerator(2, 1001), ValueError, "tasks", 1001),
        refusal(lambda: orbits([[7e6, 0.0, 1.0, 0.0, 0.0]], 3), ValueError, "satellites=3", "1 of orbits"),
        refusal(lambda: orbits([[7e6, 1.0, 1.0, 0.0, 0.0]]), ValueError, "orbits", "a > 0 m", "0 <= e < 1"),
        refusal(lambda: orbits("reel"), ValueError, "orbits", "'reel'", ["random", "real"]),
        refusal(lambda: orbits([[7e6, 0.0, 1.0]]), ValueError, "orbits", [1, 3]),
        refusal(lambda: orbits([[7e6, 0.0, math.nan, 0.0, 0.0]]), ValueError, "orbits", "finite"),
    )


def test_rejects_wrong_case_files(tmp_path):
    def read(change):
        satellites, jobs = constellation(2), tasks(2)
        change(satellites, jobs)
        return read_cases(write(tmp_path / "bad", satellites, jobs))

    def satellite(part=None, k=0, **entries):
        """Read a case where entries of a satellite, or of a part of it, are others, or are missing if they are None."""

        def change(c, t):
            changed = c["satellites"][k] if part is None else c["satellites"][k][part]
            for name, value in entries.items():
                changed[name] = value
                if value is None:
                    del changed[name]

        return read(change)

    def task(k=0, **entries):
        return read(lambda c, t: t[k].update(entries))

    def orbit(**entries):
        return read(lambda c, t: c["orbits"][0].update(entries))

    def with_text(text):
        folder = write(tmp_path / "text", constellation(1), tasks(1))
        (folder / "taskset.json").write_text(text)
        return read_cases(folder)

    (tmp_path / "empty").mkdir()
    folder = write(tmp_path / "one", constellation(3), tasks(4))
    alone = write(tmp_path / "alone", constellation(1), tasks(1))
    (alone / "taskset.json").unlink()
    wheels = constellation(1)["satellites"][0]["reaction_wheels"][:2]
    first, task_0 = "constellation.json: satellites[0]", "taskset.json: [0]"
    check_refusals(
        refusal(lambda: satellite(k=1, mass=None), ValueError, "constellation.json: satellites[1] lacks", "'mass'"),
        refusal(lambda: satellite(mas=1.0, mass="x"), ValueError, first, "mass", "'x'"),
        refusal(lambda: satellite(orbit=7), ValueError, first, "orbit=7", [0]),
        refusal(lambda: satellite(k=1, id=0), ValueError, "constellation.json", "satellites", [0, 0]),
        refusal(lambda: satellite("sensor", type=3), ValueError, f"{first}.sensor", "type=3"),
        refusal(lambda: satellite(reaction_wheels=wheels), ValueError, first, "reaction_wheels", "3 items"),
        refusal(lambda: satellite(inertia=[1.0, 2.0, 3.0]), ValueError, first, "inertia", [1.0, 2.0, 3.0], "at least 9 items"),
        refusal(
            lambda: satellite("battery", percentage=1.5),
            ValueError,
            f"{first}.battery",
            "percentage",
            1.5,
            "less than or equal to 1",
        ),
        refusal(lambda: orbit(eccentricity=math.nan), ValueError, "constellation.json: orbits[0]", "eccentricity", "nan"),
        refusal(lambda: task(1, due_time=-5), ValueError, "taskset.json: [1]", "due_time", "-5 s", "release_time"),
        refusal(lambda: task(sensor_type=9), ValueError, task_0, "sensor_type=9"),
        refusal(lambda: task(coordinate=[137.0, 2.0]), ValueError, task_0, "coordinate", [137.0, 2.0], "latitude"),
        refusal(lambda: task(duration=300), ValueError, task_0, "duration", 300, "less than or equal to 255"),
        refusal(lambda: read(lambda c, t: t.clear()), ValueError, "taskset.json", "at least 1 item"),
        refusal(lambda: read_cases(tmp_path / "empty"), FileNotFoundError, tmp_path / "empty", "constellation.json"),
        refusal(lambda: with_text("[{"), ValueError, "taskset.json", "JSON"),
        refusal(lambda: with_text('"tasks"'), ValueError, "taskset.json", "'tasks'", "object"),
        refusal(lambda: read_cases(alone), FileNotFoundError, alone / "taskset.json", alone / "constellation.json"),
        refusal(lambda: read_cases(folder, satellites=2), ValueError, "'one'", "3 satellites", "satellites=2"),
        refusal(lambda: read_cases(folder, tasks=1), ValueError, "'one'", "4 tasks", "tasks=1"),
    )
