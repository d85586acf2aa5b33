"""Recordings of episodes: their contents, and their files (.bskview), which figures, reports and the viewer read.

A file is a gzip stream of the bytes ``BSKVIEW`` and a line feed, the version and the length of the header (two little-endian
32-bit numbers), the header (JSON in UTF-8), and the arrays, each at a multiple of 8 bytes. The header lists the arrays with
types, shapes and offsets, so that a page in a browser can use them without a copy. The same recording always has the same bytes.

:data:`SCENE_ARRAYS` and :data:`TRACK_ARRAYS` are the arrays of a recording. Units are SI, times are seconds since reset, and
frames are N (inertial) and P (Earth-fixed).
"""

from __future__ import annotations

import gzip
import json
import struct
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from html import escape
from math import prod
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import MaxLen

from bsk_torch._rooms import resolve
from bsk_torch.files import write_file
from bsk_torch.scene.recorded import Places
from bsk_torch.untrusted import MOST_JSON, Count, NotRead, Word, gunzip, parse_json

__all__ = [
    "EVENTS",
    "SCENE_ARRAYS",
    "TRACK_ARRAYS",
    "VERSION",
    "Branch",
    "Craft",
    "Death",
    "Form",
    "Instrument",
    "Recording",
    "Scene",
    "Series",
    "Track",
    "check",
    "decode",
    "load",
]

MAGIC = b"BSKVIEW\n"
"""How the content of a file begins."""

VERSION = 1
"""Version of the format, which this module writes and reads."""

SUFFIX = ".bskview"
"""What the names of files end with."""

LARGEST = 2**29
"""Largest content of a file, bytes unpacked."""

SIGMA_SCALE = 1.0 / 32767.0
"""Step of modified Rodrigues parameters, which are stored as 16-bit numbers; their norm is at most 1."""

NOT_A_NUMBER = -32768
"""Stored number that stands for NaN where values are stored as 16-bit numbers."""

Array = np.ndarray

Arrays = Annotated[dict[str, Array], NotRead]

BITS = 12
"""Binary digits of rounded arrays in files, 0.02 % of the number."""


class Form(NamedTuple):
    """Type and shape of an array.

    Attributes:
        dtypes: Allowed types, the first of which a recorder uses; ``i2`` stands for numbers with the step :data:`SIGMA_SCALE`.
        dims: Names of the dimensions, which have one size for each name in a scene or track; digits are sizes.
        required: Whether every recording has it.
        rounded: Whether numbers are rounded to :data:`BITS` binary digits, which compress well, when they are stored.
    """

    dtypes: tuple[str, ...]
    dims: tuple[str, ...]
    required: bool = True
    rounded: bool = False


def _form(dtypes: str, dims: str, required: bool = True, rounded: bool = False) -> Form:
    return Form(tuple(dtypes.split("|")), tuple(dims.split()), required, rounded)


SCENE_ARRAYS: dict[str, Form] = {
    "stations_P": _form("f4", "stations 3"),
    "targets_P": _form("f4", "T 3"),
    "priority": _form("f4", "T"),
    "cloud": _form("f4", "T", required=False),
    "highest_priority": _form("f4", "T", required=False),
}
"""Arrays of a scene with T targets: positions in P, or in the frame of the inspected spacecraft (NaN for objects in orbit, whose
positions are in tracks); priorities at the start; fractions of clouds; highest priorities at any decision, where they change."""

TRACK_ARRAYS: dict[str, Form] = {
    "key_times": _form("f8", "K"),
    "r_N": _form("f4|f8", "K S 3"),
    "v_N": _form("f4|f8", "K S 3"),
    "sun_N": _form("f4", "K 3"),
    "sigma": _form("i2", "M S 3"),
    "series_times": _form("f8", "J"),
    "series": _form("f4", "J S n", rounded=True),
    "decision_time": _form("f8", "D"),
    "decision_end": _form("f8", "D"),
    "decision_satellite": _form("i4", "D"),
    "decision_action": _form("i4", "D"),
    "decision_target": _form("i4", "D"),
    "decision_reward": _form("f4", "D"),
    "decision_mask": _form("u1", "D A"),
    "decision_probability": _form("f4", "D A", rounded=True),
    "decision_action_value": _form("f4", "D A", rounded=True),
    "decision_control": _form("f4", "D C", required=False),
    "decision_action_target": _form("i4", "D A", required=False),
    "decision_action_opens": _form("f4", "D A", required=False, rounded=True),
    "observation": _form("f4", "D O", rounded=True),
    "event_time": _form("f8", "E"),
    "event_satellite": _form("i4", "E"),
    "event_target": _form("i4", "E"),
    "event_kind": _form("i4", "E"),
    "link_start": _form("f8", "L"),
    "link_end": _form("f8", "L"),
    "link_a": _form("i4", "L"),
    "link_b": _form("i4", "L"),
    "passes": _form("f8", "P 2"),
    "passes_satellite": _form("i4", "P"),
    "eclipses": _form("f8", "Q 2"),
    "eclipses_satellite": _form("i4", "Q"),
    "object_times": _form("f8", "G", required=False),
    "object_r_N": _form("f4", "G T 3", required=False),
    "object_v_N": _form("f4", "G T 3", required=False),
    "step_time": _form("f8", "B", required=False),
    "step_reward": _form("f4", "B S", required=False),
    "step_r_P": _form("f4", "B S 3", required=False),
    "step_values": _form("f4", "B S q", required=False, rounded=True),
    "decision_task": _form("i4", "D", required=False),
    "decision_priority": _form("f4", "D", required=False),
    "mark_time": _form("f8", "T m", required=False),
}
"""Arrays of a track: K keyframes, between which cubic Hermite polynomials give the S satellites (NaN for absent ones);
attitudes at M equal steps; n series at J times; D decisions in the order of their times with A actions, C controls and O observed
numbers, and the target of each action, -1 for none, with the time at which its window opens; E events of targets (kinds: see
:data:`EVENTS`); L links; P passes over stations; Q eclipses; G keyframes of T objects in orbit; B boundaries of steps with q
quantities of each satellite, and the rewards of the steps that begin there (NaN at the end, and for satellites but the first of
an agent); when each of m marks was first set on a target, infinite for never.
Recordings without optional arrays come from older versions, or have nothing to record."""

EVENTS = ("rewarded", "unrewarded", "delivered")
"""Kinds of events: a target is imaged or a point inspected, with or without a reward; its data reach the ground."""

ASCENDING = ("key_times", "series_times", "decision_time", "step_time")
"""Arrays of a track that never decrease."""


@dataclass(frozen=True, kw_only=True)
class Instrument:
    """Direction in the body frame in which a satellite looks, and the half angle of its cone, rad."""

    axis_B: list[float]
    half_angle: float


@dataclass(frozen=True, kw_only=True)
class Craft:
    """A satellite, the same in all tracks.

    Attributes:
        name: Its name.
        kind: What sort of satellite it is.
        actions: Label of every discrete action, by index; empty where actions are continuous.
        controls: Name of every continuous action; empty where actions are discrete.
        observation: Name of every number of the observation.
        instrument: Where it looks, if anywhere.
        panel_normal_B: Normal of the solar panel in the body frame, if it has one.
        tasks: Names of the entries of its ``action_spec``, to which its actions belong.
        least_elevation: Least elevation, rad, of the satellite above the horizon of a target that it images, if any.
    """

    name: str
    kind: str
    actions: list[str]
    controls: list[str] = field(default_factory=list)
    observation: list[str] = field(default_factory=list)
    instrument: Instrument | None = None
    panel_normal_B: list[float] | None = None
    tasks: list[str] = field(default_factory=list)
    least_elevation: float | None = None


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Surroundings of the tracks of one episode.

    Attributes:
        seed: Seed of the episode.
        et: Ephemeris time at time 0, s since J2000.
        PN0: DCM from N to P at time 0, 9 numbers by rows; empty where there is no Earth.
        rate: Rotation rate of the Earth about the third axis of P, rad/s.
        station_names: Names of the ground stations.
        points_of: Index of the satellite that bears the points, for recordings of points.
        planes: Index of the orbital plane of each satellite; empty where orbits were not given as elements.
        target_names: Names of the targets; empty where numbers suffice.
        viewers: Indices of the satellites that image or inspect the targets; empty for all.
        reach: Largest distance from which they do, m, if there is one.
        arrays: :data:`SCENE_ARRAYS`.
    """

    seed: int
    et: float
    PN0: list[float]
    rate: float
    station_names: list[str] = field(default_factory=list)
    points_of: int | None = None
    planes: list[int] = field(default_factory=list)
    target_names: list[str] = field(default_factory=list)
    viewers: list[int] = field(default_factory=list)
    reach: float | None = None
    arrays: Arrays = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Series:
    """A quantity over time: its name, its label, and which of its values is bad."""

    name: str
    label: str
    bad: Literal["low", "high"] | None = None


@dataclass(frozen=True, kw_only=True)
class Death:
    """The death of a satellite, by index, with the checks that have failed."""

    satellite: int
    time: float
    causes: list[str]


@dataclass(frozen=True, kw_only=True)
class Branch:
    """Where a track leaves its parent: a decision of the parent, and the action that is taken there instead."""

    time: float
    decision: int
    satellite: int
    action: int


@dataclass(frozen=True, kw_only=True)
class Track:
    """One flight of all satellites.

    Attributes:
        label: What it is called.
        scene: Index of its scene.
        parent: Index of the track that it leaves, if any; the common past is part of both.
        branch: Where it leaves its parent.
        total: Return.
        duration: Seconds that it lasts.
        limit: Length of the episode, s, if it has one.
        deaths: Deaths of satellites.
        series: What the columns of the array ``series`` are.
        counts: What is counted, by name, of all satellites together.
        attitude_start: Time of the first attitude, s.
        attitude_step: Time from one attitude to the next, s.
        quantities: Names of the columns of the array ``step_values``; numbers of a vector end with ``_0``, ``_1`` and so on.
        marks: Names of the columns of the array ``mark_time``.
        completed: Time at which the task was completed, s; None where it was not, or has no end.
        arrays: :data:`TRACK_ARRAYS`.
    """

    label: str
    scene: int
    parent: int | None = None
    branch: Branch | None = None
    total: float
    duration: float
    limit: float | None = None
    deaths: list[Death]
    series: list[Series]
    counts: dict[str, int]
    attitude_start: float
    attitude_step: float
    quantities: list[str] = field(default_factory=list)
    marks: list[str] = field(default_factory=list)
    completed: float | None = None
    arrays: Arrays = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Recorded flights of one environment.

    Attributes:
        title: Headline.
        preset: Name of the environment.
        policy: What acts.
        package: Version of bsk_torch that has recorded it.
        places: What the targets are.
        station_min_elevation: Elevation above which a station sees satellites, rad.
        satellites: The satellites of all tracks.
        scenes: The surroundings, one for each episode.
        tracks: The flights.
        kind: What its figure shows, one of :data:`bsk_torch.viz.episodes.KINDS`; empty in files of older versions.
    """

    title: Word
    preset: Word
    policy: Word
    package: Word
    places: Places
    station_min_elevation: float
    satellites: list[Craft]
    scenes: list[Scene]
    tracks: list[Track]
    kind: Word = ""

    def encode(self) -> bytes:
        """Return the content of a file; ValueError for a recording that contradicts itself, or is too large."""
        check(self)
        entries, payload = _packed(_all_arrays(self))
        header = {"version": VERSION, "payload_bytes": len(payload), **_plain(self), "arrays": entries}
        text = json.dumps(header, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
        text += b" " * (-(len(MAGIC) + 8 + len(text)) % 8)
        content = MAGIC + struct.pack("<II", VERSION, len(text)) + text + payload
        if len(content) > LARGEST:
            raise ValueError(f"the recording has {len(content):,} bytes; at most {LARGEST:,} are read again: record less")
        return gzip.compress(content, mtime=0)

    def html(self) -> str:
        """Return a page that plays the recording: one file of HTML, without a server or a network."""
        page: str = resolve("bsk_torch.viewer.page:build_page")(self.encode(), title=self.title)
        return page

    def _repr_html_(self) -> str:
        """Return the page as a frame, which notebooks show."""
        page = escape(self.html(), quote=True)
        return f'<iframe srcdoc="{page}" title="{escape(self.title)}" style="width:100%;height:640px;border:0"></iframe>'

    def save(self, path: Path | str) -> None:
        """Write a file; its name must end with :data:`SUFFIX`."""
        path = Path(path)
        if path.suffix != SUFFIX:
            raise ValueError(f"path={str(path)!r} must end with {SUFFIX!r}")
        write_file(path, self.encode())


def load(path: Path | str) -> Recording:
    """Read a file.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is no recording, cut off, of another version, or contradicts itself; the error names the file.
    """
    try:
        return decode(Path(path).read_bytes())
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


@dataclass
class ArrayEntry:
    """Where an array is: type, shape, first byte, and the step of numbers that are stored as whole ones."""

    dtype: Literal["f4", "f8", "i2", "i4", "u1"]
    shape: Annotated[list[Count], MaxLen(4)]
    offset: Count
    scale: float | None = None


@dataclass(frozen=True, kw_only=True)
class Header(Recording):
    """The header of a file. Scenes and tracks get their arrays afterwards."""

    payload_bytes: Count
    arrays: dict[str, ArrayEntry]


def decode(content: bytes) -> Recording:
    """Return the recording in the content of a file; ValueError as for :func:`load`."""
    header, payload = _opened(content)
    try:
        arrays = {name: _unpacked(entry, payload) for name, entry in header.arrays.items()}
        scenes = [replace(scene, arrays=_arrays_of(f"s{k}/", arrays)) for k, scene in enumerate(header.scenes)]
        tracks = [replace(track, arrays=_arrays_of(f"t{k}/", arrays)) for k, track in enumerate(header.tracks)]
        parts = {part.name: getattr(header, part.name) for part in fields(Recording)} | {"scenes": scenes, "tracks": tracks}
        recording = Recording(**parts)
        check(recording)
    except ValueError as error:
        raise ValueError(f"a damaged recording: {error}") from error
    return recording


def _opened(content: bytes) -> tuple[Header, bytes]:
    foreign = f"not a recording of the viewer: those are written by 'bsk-torch view' as *{SUFFIX}"
    try:
        raw = gunzip(content, LARGEST)
    except EOFError:
        raise ValueError("the recording is cut off; copy or download it again" if content else foreign) from None
    except ValueError as error:
        raise ValueError(f"{foreign} ({error})") from None
    if not raw.startswith(MAGIC):
        raise ValueError(f"not a recording of the viewer: its content does not begin with {MAGIC!r}")
    if len(raw) < len(MAGIC) + 8:
        raise ValueError("the recording is cut off; copy or download it again")
    version, length = struct.unpack_from("<II", raw, len(MAGIC))
    if version != VERSION:
        raise ValueError(
            f"a recording of version {version}, and this bsk_torch reads version {VERSION}; record the episode again"
        )
    start = len(MAGIC) + 8
    if len(raw) < start + length:
        raise ValueError("the recording is cut off; copy or download it again")
    try:
        if length > MOST_JSON:
            raise ValueError(f"it has {length:,} bytes")
        header = parse_json(raw[start : start + length], Header)
    except ValueError as error:
        raise ValueError(f"a damaged recording: its header cannot be read ({error})") from None
    missing = header.payload_bytes - (len(raw) - start - length)
    if missing > 0:
        raise ValueError(f"the recording is cut off: {missing:,} bytes are missing; copy or download it again")
    return header, raw[start + length :]


def _plain(recording: Recording) -> dict[str, object]:
    entries = {entry.name: getattr(recording, entry.name) for entry in fields(recording)}
    for name in ("satellites", "scenes", "tracks"):
        entries[name] = [{key: value for key, value in asdict(part).items() if key != "arrays"} for part in entries[name]]
    return entries


def _all_arrays(recording: Recording) -> Iterator[tuple[str, Form, Array]]:
    owners: list[tuple[str, dict[str, Form], list[dict[str, Array]]]] = [
        ("s", SCENE_ARRAYS, [scene.arrays for scene in recording.scenes]),
        ("t", TRACK_ARRAYS, [track.arrays for track in recording.tracks]),
    ]
    for letter, forms, owned in owners:
        for k, arrays in enumerate(owned):
            for name, form in forms.items():
                if name in arrays:
                    yield f"{letter}{k}/{name}", form, arrays[name]


def _packed(arrays: Iterator[tuple[str, Form, Array]]) -> tuple[Mapping[str, object], bytes]:
    entries: dict[str, dict[str, object]] = {}
    parts: list[bytes] = []
    offset = 0
    for name, form, value in arrays:
        dtype = stored_as(form, value)
        entries[name] = {"dtype": dtype, "shape": list(value.shape), "offset": offset}
        if dtype == "i2":
            entries[name]["scale"] = SIGMA_SCALE
            numbers = np.rint(np.clip(np.asarray(value, "f8"), -1.0, 1.0) / SIGMA_SCALE)
            value = np.where(np.isnan(numbers), NOT_A_NUMBER, numbers)
        if form.rounded:
            value = _rounded(value)
        raw = np.ascontiguousarray(value, f"<{dtype}" if dtype != "u1" else "u1").tobytes()
        raw += bytes(-len(raw) % 8)
        parts.append(raw)
        offset += len(raw)
    return entries, b"".join(parts)


def _rounded(values: Array) -> Array:
    """Numbers rounded to :data:`BITS` binary digits, as float32."""
    dropped = 24 - BITS
    digits = np.ascontiguousarray(values, "f4").view("u4")
    rounded = ((digits.astype("u8") + (1 << (dropped - 1))) >> dropped << dropped).astype("u4").view("f4")
    result: Array = np.where(np.isfinite(rounded), rounded, values).astype("f4")
    return result


def stored_as(form: Form, value: Array) -> str:
    """Return the type in which an array is stored: its own where the form allows it, otherwise the first of the form."""
    dtype = f"{value.dtype.kind}{value.dtype.itemsize}"
    return dtype if dtype in form.dtypes else form.dtypes[0]


def _unpacked(entry: ArrayEntry, payload: bytes) -> Array:
    dtype = np.dtype(f"<{entry.dtype}" if entry.dtype != "u1" else "u1")
    count = prod(entry.shape)
    if count * dtype.itemsize + entry.offset > len(payload):
        raise ValueError(f"an array of the shape {entry.shape} ends behind the file")
    value = np.frombuffer(payload, dtype, count, entry.offset).reshape(entry.shape)
    if entry.scale is None:
        return value
    return np.where(value == NOT_A_NUMBER, np.nan, value * entry.scale).astype("f4")


def _arrays_of(prefix: str, arrays: Mapping[str, Array]) -> dict[str, Array]:
    return {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}


def check(recording: Recording) -> None:
    """Raise ValueError where a recording contradicts itself: missing arrays, shapes, the order of times, indices."""
    if not recording.tracks:
        raise ValueError("tracks=[] must hold at least one flight")
    crafts = recording.satellites
    common = {
        "S": len(crafts),
        "A": max((len(craft.actions) for craft in crafts), default=0),
        "O": max((len(craft.observation) for craft in crafts), default=0),
    }
    sizes = []
    for k, scene in enumerate(recording.scenes):
        sizes.append(_check_forms(f"scene {k}", SCENE_ARRAYS, scene.arrays, {"stations": len(scene.station_names)}))
    for k, track in enumerate(recording.tracks):
        if not 0 <= track.scene < len(recording.scenes):
            raise ValueError(f"track {k}: scene={track.scene} must be one of the {len(recording.scenes)} scenes")
        if track.parent is not None and not 0 <= track.parent < k:
            raise ValueError(f"track {k}: parent={track.parent} must be one of the tracks before it")
        targets = sizes[track.scene]["T"]
        widths = {"n": len(track.series), "q": len(track.quantities), "m": len(track.marks)}
        _check_forms(f"track {k}", TRACK_ARRAYS, track.arrays, common | widths | {"T": targets})
        tasks = max((len(craft.tasks) for craft in crafts), default=0)
        _check_values(f"track {k}", track.arrays, len(crafts), common["A"], targets, tasks)


def _check_forms(title: str, forms: Mapping[str, Form], arrays: Mapping[str, Array], fixed: Mapping[str, int]) -> dict[str, int]:
    """Raise ValueError for missing or unknown arrays and for wrong shapes; return the sizes of the dimensions."""
    sizes = dict(fixed)
    missing = [name for name, form in forms.items() if form.required and name not in arrays]
    unknown = [name for name in arrays if name not in forms]
    if missing or unknown:
        raise ValueError(f"{title}: arrays {missing} are missing, and {unknown} are unknown")
    for name, value in arrays.items():
        dims = forms[name].dims
        expected = [
            int(dim) if dim.isdigit() else sizes.setdefault(dim, size) for dim, size in zip(dims, value.shape, strict=False)
        ]
        if list(value.shape) != expected or len(dims) != value.ndim:
            raise ValueError(f"{title}: {name} has the shape {list(value.shape)}, not [{', '.join(dims)}] with {sizes}")
    return sizes


def _check_values(title: str, arrays: Mapping[str, Array], satellites: int, actions: int, targets: int, tasks: int) -> None:
    """Raise ValueError for times that decrease or are no numbers, and for indices out of range."""
    for name in ASCENDING:
        if name in arrays and not (np.isfinite(arrays[name]).all() and (np.diff(arrays[name]) >= 0.0).all()):
            raise ValueError(f"{title}: {name} must be numbers that never decrease")
    ends = {
        "satellite": (0, satellites),
        "action": (-1, actions),
        "target": (-1, targets),
        "kind": (0, len(EVENTS)),
        "task": (0, tasks),
    }
    for name, value in arrays.items():
        low, high = ends.get(name.rpartition("_")[2], (0, satellites)) if name not in ("link_a", "link_b") else (0, satellites)
        if TRACK_ARRAYS[name].dtypes == ("i4",) and value.size and not (low <= value.min() and value.max() < high):
            raise ValueError(f"{title}: {name} must lie from {low} to {high - 1}")
