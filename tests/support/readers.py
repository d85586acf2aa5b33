"""Every reader of files that others may have made, with a right file: for tests with planted and with mutated files."""

import functools
import gzip
import io
import json
import struct
import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import torch
import yaml
from tensordict import TensorDict

from bsk_torch.cli.run_folder import Summary
from bsk_torch.files import write_file
from bsk_torch.formats.ccsds import read_ccsds
from bsk_torch.formats.geojson import read_regions
from bsk_torch.formats.omm import read_omm
from bsk_torch.formats.orbits import read_orbits
from bsk_torch.formats.places import read_csv, read_geojson
from bsk_torch.formats.requests import read_requests
from bsk_torch.lab.bounds.envelope import FILE, Envelope
from bsk_torch.lab.commands.results import PlayedResults, Results
from bsk_torch.lab.offline import open_dataset
from bsk_torch.lab.risk.rare_flights import KIND, read_paths
from bsk_torch.recording.recording import MAGIC, decode
from bsk_torch.rl.marl.runs import read_config
from bsk_torch.rl.policies.checksummed import load_checksummed, save_checksummed
from bsk_torch.rl.policies.files import policy_of_file
from bsk_torch.rl.policies.loading import read_policy
from bsk_torch.rl.policies.pretrained import pretrained_file
from bsk_torch.rl.training.config import PPOConfig, save_config
from bsk_torch.rl.training.log import read_log
from bsk_torch.tasks.aeos_bench import read_cases
from bsk_torch.tasks.aeos_bench.annotations import TASK_ID, read_assignments
from bsk_torch.tasks.aeossp import read_case, read_solution
from bsk_torch.tasks.objects import RSOTarget, RSOTargetCatalog
from bsk_torch.untrusted import Word, parse_json, read_json
from tests.formats import samples as orbits
from tests.support.outside_policies import Net, exported, onnx_model
from tests.support.recordings import synthetic_recording
from tests.tasks.aeos_bench import aeos_cases
from tests.tasks.aeossp.part import FILES, PART, part

Change = Callable[[Any], Any]
"""Changes nested dictionaries and lists."""


class Reader(NamedTuple):
    """A reader.

    ``content`` is that of a right file, ``place`` its name, and ``read`` reads the folder in which it is, after ``others`` has
    written the further files. ``changed`` returns the content with a changed structure, None where it has none.
    """

    place: str
    content: bytes
    read: Callable[[Path], object]
    changed: Callable[[bytes, Change], bytes] | None = None
    others: Callable[[Path], object] = lambda folder: None

    def of(self, folder: Path, content: bytes) -> object:
        """Read a folder with this content."""
        self.others(folder)
        path = folder / self.place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        return self.read(folder)


def of_json(content: bytes, change: Change) -> bytes:
    return json.dumps(change(json.loads(content))).encode()


def of_yaml(content: bytes, change: Change) -> bytes:
    return yaml.safe_dump(change(yaml.safe_load(content))).encode()


def of_checksummed(content: bytes, change: Change) -> bytes:
    entries = torch.load(io.BytesIO(content), weights_only=True)
    buffer = io.BytesIO()
    torch.save(change(entries), buffer)
    return buffer.getvalue()  # as those of release 0.1: without a checksum


def of_header(content: bytes, change: Change) -> bytes:
    raw = gzip.decompress(content)
    version, length = struct.unpack_from("<II", raw, len(MAGIC))
    start = len(MAGIC) + 8
    text = json.dumps(change(json.loads(raw[start : start + length]))).encode()
    return gzip.compress(MAGIC + struct.pack("<II", version, len(text)) + text + raw[start + length :], 1)


def json_bytes(value: object) -> bytes:
    return json.dumps(value).encode()


def catalog() -> bytes:
    target = RSOTarget("a", "A", rN=(7e6, 0.0, 0.0), vN=(0.0, 7500.0, 0.0))
    return json_bytes(RSOTargetCatalog((target,)).to_dict())


def checkpoint(folder: Path) -> None:
    save_checksummed(folder / "checkpoint.pt", {"best": {"return": 1.0, "networks": {"w": torch.zeros(3)}}, "n": (1, 2.0)})


def written(write: Callable[[Path], object], name: str) -> bytes:
    """The content of a file that the package writes."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder))
        return (Path(folder) / name).read_bytes()


def write_dataset_rows(folder: Path) -> None:
    """The rows of a dataset."""
    rows = {"episode": torch.zeros(3, dtype=torch.int64), "observation": torch.zeros(3, 2), "next": {"reward": torch.ones(3, 1)}}
    TensorDict(rows, [3]).memmap(folder / "a" / "transitions")
    TensorDict({"seed": torch.arange(2)}, [2]).memmap(folder / "starts")


CARD = {"format": 1, "behaviors": {"a": {"folder": "a", "episodes": 1}}, "targets": ["t"], "share": 1.0, "preset": "x"}

CASE = SimpleNamespace(
    names=("00001",), present=torch.ones(1, 2, dtype=torch.bool), tasks={"duration": torch.ones(1, 3)}, n_satellites=2
)
"""A case of two satellites and three tasks."""

CITIES = b'name,lat,lon,alt,weight\n"Alphaville, North",48.86,2.35,30,0.5\nB,-33.87,151.21,,1\n'
POINT = {"type": "Feature", "properties": {"name": "A", "weight": 1.5}, "geometry": {"type": "Point", "coordinates": [2.3, 48.9]}}
POINTS = {"type": "FeatureCollection", "features": [POINT, POINT]}

PATHS = {
    "kind": KIND,
    "preset": "x",
    "episodes": [{"seed": 3, "parts": [1, 2], "steps": [1.0, 0.5], "shares": [1.0, 0.2], "time": None, "actions": [[1], [2]]}],
}

REGIONS = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"name": "a", "weight": 2},
            "geometry": {"type": "Polygon", "coordinates": [[[0, 0], [9, 0], [0, 9], [0, 0]], [[1, 1], [1, 2], [2, 1], [1, 1]]]},
        },
        {
            "type": "Feature",
            "properties": {},
            "geometry": {"type": "MultiPolygon", "coordinates": [[[[170, 0], [-170, 0], [-170, 9], [170, 0]]]]},
        },
    ],
}

ESTIMATE = {"mean": 0.5, "half_width": 0.1}
SUMMARY = {
    "return": ESTIMATE,
    "survival": 1.0,
    "survival_interval": [0.9, 1.0],
    "deaths": {"battery_valid": 2},
    "gain": {"x": ESTIMATE},
}
PLAYED = SUMMARY | {"returns": [0.1, 0.2], "seconds_per_decision": 0.1, "score": ESTIMATE}
RESULTS = {"format": 1, "suite": "v3", "policies": {"random": {"areas": PLAYED}}}

REQUESTS = {
    "json": b'{"requests": [{"id": "a", "latitude": 1.5, "longitude": 2, "due": 600, "sensors": ["visible"]}]}',
    "csv": b"id,latitude,longitude,due,sensors\na,1.5,2,600,visible|infrared\n",
    "yaml": b"requests:\n- id: a\n  latitude: 1.5\n  longitude: 2\n  due: 600\n  sensors: [visible]\n",
}
"""Requests for images in each kind of file."""


SB3_DATA = {
    "policy_class": {"__module__": "stable_baselines3.common.policies"},
    "policy_kwargs": {":type:": "<class 'dict'>", "activation_fn": "<class 'torch.nn.modules.activation.ReLU'>"},
    "observation_space": {":type:": "<class 'gymnasium.spaces.box.Box'>"},
    "action_space": {":type:": "<class 'gymnasium.spaces.discrete.Discrete'>", "n": "4"},
}


def sb3_zip(data: bytes) -> bytes:
    """A model of Stable-Baselines3 with settings as JSON."""
    layers = {"mlp_extractor.policy_net.0.": (12, 3), "action_net.": (3, 4)}
    weights = {f"{name}weight": torch.zeros(out, size) for name, (size, out) in layers.items()}
    buffer, file = io.BytesIO(), io.BytesIO()
    torch.save(weights | {f"{name}bias": torch.zeros(out) for name, (_, out) in layers.items()}, buffer)
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in {"data": data, "policy.pth": buffer.getvalue(), "_stable_baselines3_version": b"2.9.2"}.items():
            archive.writestr(name, content)
    return file.getvalue()


def of_sb3(content: bytes, change: Change) -> bytes:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return sb3_zip(of_json(archive.read("data"), change))


def other_file_of_case(name: str) -> Callable[[Path], object]:
    whole = {"constellation.json": aeos_cases.constellation(2), "taskset.json": aeos_cases.tasks(3)}
    return lambda folder: write_file(folder / name, json_bytes(whole[name]))


def other_files_of_part(name: str) -> Callable[[Path], object]:
    return lambda folder: [write_file(folder / other, content) for other, content in FILES.items() if other != name]


@functools.cache
def readers() -> dict[str, Reader]:
    """Readers by name."""
    buffer = io.BytesIO()
    torch.save({TASK_ID: torch.zeros(4, 2, dtype=torch.int64)}, buffer)
    card = lambda folder: write_file(folder / "dataset.json", json_bytes(CARD))
    rows = lambda folder: (write_dataset_rows(folder), card(folder))
    meta = written(write_dataset_rows, "a/transitions/meta.json")
    results = lambda schema: lambda folder: read_json(folder / "x.json", schema, "is no result")
    cases = [json_bytes(part) for part in (aeos_cases.constellation(2), aeos_cases.tasks(3))]
    assignments = lambda folder: read_assignments(folder, CASE)
    return {
        "policy": Reader("policy.pt", pretrained_file("NadirScan-v1").read_bytes(), policy_of_file, of_checksummed),
        "model of Stable-Baselines3": Reader("x.zip", sb3_zip(json_bytes(SB3_DATA)), lambda f: read_policy(f / "x.zip"), of_sb3),
        "exported program": Reader("x.pt2", exported(Net()), lambda folder: read_policy(folder / "x.pt2")),
        **(
            {"ONNX": Reader("x.onnx", onnx_model(torch.zeros(12, 4)), lambda folder: read_policy(folder / "x.onnx"))}
            if find_spec("onnx") and find_spec("onnxruntime")
            else {}
        ),
        "checkpoint": Reader(
            "checkpoint.pt",
            written(checkpoint, "checkpoint.pt"),
            lambda folder: load_checksummed(folder / "checkpoint.pt", "checkpoint"),
            of_checksummed,
        ),
        "configuration": Reader(
            "config.yaml", written(lambda folder: save_config(PPOConfig(), folder / "config.yaml"), "config.yaml"), read_config
        ),
        "log": Reader("log.csv", b"frames,seconds,return\n20,1.5,0.1\n40,3.0,nan\n", lambda folder: read_log(folder / "log.csv")),
        "catalog": Reader("x.json", catalog(), lambda folder: RSOTargetCatalog.load(folder / "x.json"), of_json),
        "constellation": Reader("constellation.json", cases[0], read_cases, of_json, other_file_of_case("taskset.json")),
        "tasks": Reader("taskset.json", cases[1], read_cases, of_json, other_file_of_case("constellation.json")),
        **{name: Reader(name, FILES[name], read_case, of_yaml, other_files_of_part(name)) for name in FILES},
        "solution": Reader(
            "x.json", part("solution.json"), lambda folder: read_solution(folder / "x.json", read_case(PART)), of_json
        ),
        "runs": Reader("00001/assignment_runs.json", b'{"0": [[0, 3], [-1, 2]], "1": [[2, 5]]}', assignments, of_json),
        "trajectory": Reader("00001.pth", buffer.getvalue(), assignments, of_checksummed),
        "cities": Reader("x.csv", CITIES, lambda folder: read_csv(folder / "x.csv")),
        "points": Reader("x.json", json_bytes(POINTS), lambda folder: read_geojson(folder / "x.json"), of_json),
        "paths": Reader("x.json", json_bytes(PATHS), lambda folder: read_paths(folder / "x.json"), of_json),
        "envelope": Reader("x.json", FILE.read_bytes(), lambda folder: Envelope.load(folder / "x.json"), of_json),
        "card": Reader("dataset.json", json_bytes(CARD), lambda folder: read_dataset(folder), of_json, write_dataset_rows),
        "rows": Reader("a/transitions/meta.json", meta, lambda folder: read_dataset(folder), of_json, rows),
        "recording": Reader(
            "x.bskview", synthetic_recording().encode(), lambda folder: decode((folder / "x.bskview").read_bytes()), of_header
        ),
        "bench": Reader("x.json", json_bytes(RESULTS), results(PlayedResults), of_json),
        "leaderboard": Reader("x.json", json_bytes(RESULTS), results(Results), of_json),
        "evaluation": Reader("x.json", json_bytes({"trained": SUMMARY}), results(dict[Word, Summary]), of_json),
        **{
            f"requests in {kind}": Reader(
                f"x.{kind}",
                content,
                lambda folder, kind=kind: read_requests(folder / f"x.{kind}"),
                of_json if kind == "json" else None,
            )
            for kind, content in REQUESTS.items()
        },
        "regions": Reader("x.geojson", json_bytes(REGIONS), lambda folder: read_regions(folder / "x.geojson"), of_json),
        "request": Reader(
            "x.json",
            b'{"track": 1, "decision": 2}',
            lambda folder: parse_json((folder / "x.json").read_bytes(), dict[str, int]),
            of_json,
        ),
        "two-line sets": Reader("x.tle", orbits.FLEET.encode(), lambda folder: read_orbits(folder / "x.tle")),
        "elements as JSON": Reader("x.json", orbits.OMM_JSON.encode(), lambda folder: read_omm(folder / "x.json"), of_json),
        "elements as CSV": Reader("x.csv", orbits.OMM_CSV.encode(), lambda folder: read_omm(folder / "x.csv")),
        "elements as XML": Reader("x.xml", orbits.OMM_XML.encode(), lambda folder: read_omm(folder / "x.xml")),
        "ephemeris": Reader("x.oem", orbits.oem(orbits.STATES).encode(), lambda folder: read_ccsds(folder / "x.oem")),
        "parameters": Reader("x.opm", orbits.OPM.encode(), lambda folder: read_ccsds(folder / "x.opm")),
    }


def read_dataset(folder: Path) -> object:
    """All that a dataset holds."""
    data = open_dataset(folder)
    return data.card, data.transitions().clone(), data.replay_buffer(batch_size=2).sample(), data.starts().clone()
