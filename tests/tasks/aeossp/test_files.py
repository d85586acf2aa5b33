"""Cases and solutions of aeossp_standard: readers and refusals, with file, entry, value and what is allowed."""

import json

import numpy as np
import pytest
import yaml

from bsk_torch.files import write_file
from bsk_torch.tasks.aeossp import read_case, read_solution, write_solution
from bsk_torch.untrusted import DEEPEST_YAML, parse_yaml, read_yaml
from tests.support.refusals import check_refusals, refusal
from tests.tasks.aeossp.part import FILES, part


@pytest.fixture
def changed(tmp_path):
    """Reads the case after a change of one of its files, given as text or as a function of its content."""

    def read(name, change):
        for other, content in FILES.items():
            write_file(tmp_path / other, content)
        content = yaml.safe_load(FILES[name])
        if name == "tasks.yaml":
            del content["tasks"][6:]  # to write few
        write_file(tmp_path / name, change if isinstance(change, bytes) else yaml.safe_dump(change(content) or content))
        return read_case(tmp_path)

    return read


def entry(kind, number, **values):
    """Changes an entry of the list ``kind``; names of nested ones have dots."""

    def change(content):
        for name, value in values.items():
            *path, last = name.split("__")
            part = content[kind] if number is None else content[kind][number]
            for key in path:
                part = part[key]
            part[last] = value

    return change


def test_case_has_what_the_files_say(case):
    satellite = case.satellites[0]
    assert (case.name, case.horizon_s, case.step_s, case.resource_step_s) == ("case_0001", 43200, 5, 10)
    assert case.start.isoformat() == "2026-04-14T04:00:00+00:00"
    assert (satellite.name, satellite.sensor, satellite.slew_rate, satellite.capacity_wh) == ("sat_003", "visible", 1.8, 1300.0)
    assert {craft.sensor for craft in case.satellites} == {"visible", "infrared"}
    tasks = yaml.safe_load(FILES["tasks.yaml"])["tasks"]
    requests = case.requests
    assert len(requests) == len(tasks)
    for k in (0, 7, -1):
        assert requests.names[k] == tasks[k]["task_id"]
        assert requests.latitude[k] == tasks[k]["latitude_deg"]
        assert requests.weight[k] == tasks[k]["weight"]
        assert (requests.due_s[k] - requests.release_s[k]) % 5 == 0
    assert tasks[0]["release_time"] == "2026-04-14T04:00:00Z" or requests.release_s[0] > 0


def test_times_of_other_zones_and_without_quotes_are_read(changed, case):
    other = changed("mission.yaml", entry("mission", None, horizon_start="2026-04-14T06:00:00+02:00"))
    assert other.start == case.start
    bare = FILES["mission.yaml"].replace(b"'", b"")
    assert changed("mission.yaml", bare).start == case.start


def test_solutions_are_read_as_they_were_written(case, observations, tmp_path):
    write_solution(tmp_path / "x.json", case, observations)
    again = read_solution(tmp_path / "x.json", case)
    order = np.lexsort((observations.satellite, observations.start_s))
    for name in ("satellite", "task", "start_s", "end_s"):
        np.testing.assert_array_equal(getattr(again, name), getattr(observations, name)[order])
    for empty in ("{}", '{"actions": []}'):
        write_file(tmp_path / "x.json", empty)
        assert len(read_solution(tmp_path / "x.json", case)) == 0


def test_wrong_cases_are_refused(changed):
    task = lambda **values: lambda: changed("tasks.yaml", entry("tasks", 2, **values))
    craft = lambda **values: lambda: changed("satellites.yaml", entry("satellites", 1, **values))
    mission = lambda **values: lambda: changed("mission.yaml", entry("mission", None, **values))
    lines = [yaml.safe_load(FILES["satellites.yaml"])["satellites"][k]["tle_line1"] for k in range(2)]
    due = yaml.safe_load(FILES["tasks.yaml"])["tasks"][2]["due_time"]
    check_refusals(
        refusal(task(longitude_deg=200.0), ValueError, "tasks.yaml", "line ", "tasks[2].longitude_deg", "200.0", "180"),
        refusal(task(latitude_deg=-91.0), ValueError, "tasks[2].latitude_deg", "-91.0", "-90"),
        refusal(task(latitude_deg="north"), ValueError, "tasks[2].latitude_deg", "north", "number"),
        refusal(task(release_time=due), ValueError, "tasks[2]", "due_time", due, "after"),
        refusal(task(required_duration_s=86400), ValueError, "tasks[2]", "required_duration_s=86400", "window"),
        refusal(task(required_duration_s=7), ValueError, "tasks[2]", "required_duration_s=7", "multiple of 5"),
        refusal(task(required_duration_s=True), ValueError, "tasks[2].required_duration_s", "integer"),
        refusal(task(required_sensor_type="radar"), ValueError, "tasks[2].required_sensor_type", "radar", "visible", "infrared"),
        refusal(task(release_time="2026-04-14T04:30:00"), ValueError, "tasks[2]", "release_time", "zone", "Z"),
        refusal(task(release_time="2026-04-14T04:30:01Z"), ValueError, "tasks[2]", "release_time", "multiple of 5"),
        refusal(task(release_time="2026-04-13T04:30:00Z"), ValueError, "tasks[2]", "release_time", "43200"),
        refusal(task(release_time="noon"), ValueError, "tasks[2]", "noon", "ISO 8601"),
        refusal(
            task(task_id=yaml.safe_load(FILES["tasks.yaml"])["tasks"][0]["task_id"]), ValueError, "tasks[2].task_id", "tasks[0]"
        ),
        refusal(task(weight=0.0), ValueError, "tasks[2].weight", "greater than 0"),
        refusal(task(weight=float("nan")), ValueError, "tasks[2].weight", "nan"),
        refusal(craft(tle_line1=lines[1][:68] + str((int(lines[1][68]) + 1) % 10)), ValueError, "satellites[1]", "checksum"),
        refusal(craft(tle_line1=lines[1][:50]), ValueError, "satellites[1]", "tle_line1", "69"),
        refusal(craft(tle_line1=lines[0]), ValueError, "satellites[1]", "tle_line2", lines[0][2:7]),
        refusal(craft(satellite_id="sat_003"), ValueError, "satellites.yaml", "satellites[1].satellite_id", "sat_003"),
        refusal(craft(sensor__sensor_type="sar"), ValueError, "satellites[1].sensor.sensor_type", "sar", "visible"),
        refusal(craft(attitude_model__max_off_nadir_deg=90.0), ValueError, "max_off_nadir_deg=90.0", "less than 90"),
        refusal(craft(resource_model__initial_battery_wh=9e3), ValueError, "initial_battery_wh=9000", "battery_capacity_wh"),
        refusal(mission(horizon_end="2026-04-14T03:00:00Z"), ValueError, "mission.yaml", "horizon_end"),
        refusal(mission(action_time_step_s=7), ValueError, "action_time_step_s=7", "43200"),
        refusal(mission(geometry_sample_step_s=1), ValueError, "geometry_sample_step_s=1", "action_time_step_s=5"),
        refusal(mission(propagation__model="j2"), ValueError, "mission.propagation.model", "j2", "sgp4"),
        refusal(lambda: changed("tasks.yaml", b"tasks: []"), ValueError, "tasks.yaml", "at least 1"),
        refusal(lambda: changed("tasks.yaml", b"task: []"), ValueError, "tasks.yaml", "'tasks'"),
    )


def test_missing_files_are_named(tmp_path):
    check_refusals(refusal(lambda: read_case(tmp_path), FileNotFoundError, "mission.yaml"))


def test_wrong_solutions_are_refused(case, tmp_path):
    def read(content):
        write_file(tmp_path / "x.json", content if isinstance(content, str) else json.dumps(content))
        return read_solution(tmp_path / "x.json", case)

    actions = json.loads(part("solution.json"))["actions"]

    def action(**values):
        return lambda: read({"actions": [actions[0], {**actions[1], **values}]})

    check_refusals(
        refusal(lambda: read("[]"), ValueError, "x.json"),
        refusal(lambda: read("{"), ValueError, "x.json"),
        refusal(action(type="downlink"), ValueError, "x.json", "actions[1].type", "downlink", "observation"),
        refusal(action(satellite_id="sat_3"), ValueError, "actions[1]", "satellite_id='sat_3'", "sat_003"),
        refusal(action(task_id="nowhere"), ValueError, "actions[1]", "task_id='nowhere'"),
        refusal(action(start_time="2026-04-14T05:00:00"), ValueError, "actions[1]", "start_time", "zone"),
        refusal(action(start_time="2026-04-14T05:00:00z"), ValueError, "actions[1]", "start_time", "zone"),
        refusal(action(start_time="2026-04-14T05:00:00.000001Z"), ValueError, "actions[1]", "multiple of 5"),
        refusal(action(end_time="2026-04-15T05:00:00Z"), ValueError, "actions[1]", "end_time", "43200"),
    )


def test_yaml_is_plain():
    deep = b"[" * (DEEPEST_YAML + 1) + b"]" * (DEEPEST_YAML + 1)
    read = lambda content: lambda: parse_yaml(content, dict[str, int])
    assert parse_yaml(b"a: 1\n", dict[str, int]) == {"a": 1}
    check_refusals(
        refusal(read(b"a: 1\nb: x\n"), ValueError, "line 2", "b='x'", "integer"),
        refusal(read(b"a: 1\na: 2\n"), ValueError, "line 2", "'a'", "twice"),
        refusal(read(b"[1]: 2\n"), ValueError, "line 1"),
        refusal(read(b"a: &x 1\nb: *x\n"), ValueError, "line 1", "aliases"),
        refusal(read(b"a: 1\n---\na: 1\n"), ValueError, "line 2", "second document"),
        refusal(read(b"a: !!int 1\n"), ValueError, "line 1", "tag"),
        refusal(read(b"a: [\n"), ValueError, "line 2"),
        refusal(read(b"a: \xff\n"), ValueError),
        refusal(read(b""), ValueError),
        refusal(read(deep), ValueError, "line 1", DEEPEST_YAML),
        refusal(lambda: read_yaml(b"[" + b"1," * 99 + b"1]", most=100), ValueError, 100),
    )
