"""Recordings as CZML, which CesiumJS and other virtual globes show.

Positions of satellites are in the inertial frame (``INERTIAL``: J2000 axes, which are those of N), places in ``FIXED``.
Source of the format: "CZML Guide", AnalyticalGraphicsInc/czml-writer.
"""

from __future__ import annotations

import json
import math
from datetime import datetime, timedelta
from typing import Any

import numpy as np
import torch

from bsk_torch.astro.attitude import dcm_to_mrp, mrp_subtract
from bsk_torch.astro.frames import rotate_z
from bsk_torch.recording.recording import Recording, Scene, Track
from bsk_torch.vec3 import Mat3, Vec3

__all__ = ["czml"]

J2000 = datetime(2000, 1, 1, 12)
"""Epoch of ephemeris time."""

SHIFT = 69.184
"""Ephemeris time minus UTC since 2017, s; before, up to five seconds less."""

ATTITUDE_STEP = 10.0
"""Least time between two orientations, s."""

COLORS = {
    "satellite": [86, 180, 233, 255],
    "open": [230, 159, 0, 255],
    "done": [0, 158, 115, 255],
    "station": [204, 121, 167, 255],
}
"""Colors, RGBA, that remain distinct for the color-blind (Okabe and Ito)."""

OTHERS = ([230, 159, 0, 255], [204, 121, 167, 255], [0, 114, 178, 255], [213, 94, 0, 255], [240, 228, 66, 255])
"""Colors of the satellites of other futures, likewise."""

BEFORE = 300.0
"""Seconds of another future before it begins, for interpolation."""


def flight_over_earth(recording: Recording, track: int, form: str) -> tuple[Track, Scene]:
    """Return a track and its scene; IndexError for one that does not exist, ValueError without the Earth that ``form`` needs."""
    if not 0 <= track < len(recording.tracks):
        raise IndexError(f"track={track} must lie from 0 to {len(recording.tracks) - 1}")
    flight = recording.tracks[track]
    scene = recording.scenes[flight.scene]
    if not scene.PN0:
        raise ValueError(f"{recording.preset or 'the recording'} has no Earth, which {form} needs; write .html instead")
    return flight, scene


def czml(recording: Recording, track: int = 0) -> str:
    """Return a track as the text of a CZML file, with the satellites of other futures from where they branch.

    Other futures are the tracks of the same scene: branches, and the track from which this one branches.

    Args:
        recording: Flights around the Earth.
        track: Which of its tracks.

    Raises:
        IndexError: For a track that does not exist.
        ValueError: For a flight without the Earth.
    """
    flight, scene = flight_over_earth(recording, track, "CZML")
    start = J2000 + timedelta(seconds=scene.et - SHIFT)
    packets = [_document(recording, flight, start), *_stations(scene)]
    packets += [_satellite(recording, flight, scene, start, k) for k in range(len(recording.satellites))]
    packets += _targets(recording, flight, scene, start)
    packets += _links(recording, flight, start)
    for n, other in enumerate(recording.tracks):
        if n != track and other.scene == flight.scene:
            packets += _future(recording, n, parting(recording, track, n), start)
    return json.dumps(packets, ensure_ascii=False, allow_nan=False)


def parting(recording: Recording, track: int, other: int) -> float:
    """Return the time until which two tracks of a scene are the same, s."""
    ways = [_way(recording, k) for k in (track, other)]
    for (first, until), (second, end) in zip(*ways, strict=False):
        if first != second:
            return 0.0
        if until != end:
            return min(until, end)
    return min(way[-1][1] for way in ways)


def _way(recording: Recording, track: int) -> list[tuple[int, float]]:
    """The tracks that have led to a track, first the oldest one, with the time until which it follows each."""
    way, until = list[tuple[int, float]](), math.inf
    number: int | None = track
    while number is not None:
        way.insert(0, (number, until))
        flight = recording.tracks[number]
        until = min(until, flight.branch.time) if flight.branch is not None else until
        number = flight.parent
    return way


def _future(recording: Recording, number: int, begin: float, start: datetime) -> list[dict[str, object]]:
    flight, scene = recording.tracks[number], recording.scenes[recording.tracks[number].scene]
    folder = f"track/{number}"
    packets: list[dict[str, object]] = [{"id": folder, "name": flight.label}]
    for k in range(len(recording.satellites)):
        packet = _satellite(recording, flight, scene, start, k, OTHERS[(number - 1) % len(OTHERS)], begin)
        packets.append(packet | {"id": f"{folder}/satellite/{k}", "parent": folder, "name": f"{flight.label}: {packet['name']}"})
    return packets


def _time(start: datetime, seconds: float) -> str:
    return (start + timedelta(seconds=float(seconds))).isoformat(timespec="milliseconds") + "Z"


def _span(start: datetime, begin: float, end: float) -> str:
    return f"{_time(start, begin)}/{_time(start, end)}"


def _document(recording: Recording, flight: Track, start: datetime) -> dict[str, object]:
    clock = {
        "interval": _span(start, 0.0, flight.duration),
        "currentTime": _time(start, 0.0),
        "multiplier": 60,
        "range": "CLAMPED",
    }
    return {"id": "document", "name": recording.title, "version": "1.0", "clock": clock}


def _satellite(
    recording: Recording,
    flight: Track,
    scene: Scene,
    start: datetime,
    k: int,
    color: list[int] = COLORS["satellite"],
    begin: float = 0.0,
) -> dict[str, Any]:
    """A satellite of a track, with its path in a color, from a time on."""
    times, r_N = flight.arrays["key_times"], flight.arrays["r_N"][:, k].astype("f8")
    present = np.isfinite(r_N).all(-1) & (times >= begin - BEFORE)
    rows = np.concatenate([times[present, None], r_N[present]], 1).round(3)
    death = min([death.time for death in flight.deaths if death.satellite == k], default=flight.duration)
    packet = {
        "id": f"satellite/{k}",
        "name": recording.satellites[k].name,
        "availability": _span(start, min(begin, flight.duration), flight.duration),
        "position": {
            "epoch": _time(start, 0.0),
            "referenceFrame": "INERTIAL",
            "interpolationAlgorithm": "LAGRANGE",
            "interpolationDegree": 5,
            "cartesian": rows.flatten().tolist(),
        },
        "point": {"pixelSize": 8, "color": {"rgba": color}},
        "label": {"text": recording.satellites[k].name, "font": "12px sans-serif", "pixelOffset": {"cartesian2": [12, 0]}},
        "path": {"leadTime": 0, "trailTime": 5400, "width": 1, "material": _solid(color)},
        "description": _description(recording, flight, k, death),
    }
    turn = _orientation(flight, scene, k, begin - BEFORE)
    if turn is not None:
        packet["orientation"] = {
            "epoch": _time(start, 0.0),
            "interpolationAlgorithm": "LINEAR",
            "interpolationDegree": 1,
            "unitQuaternion": turn,
        }
    return packet


def _description(recording: Recording, flight: Track, k: int, death: float) -> str:
    """What has become of a satellite; markup in names is text."""
    deaths = [entry for entry in flight.deaths if entry.satellite == k]
    if not deaths:
        return f"{flight.label}: survived"
    return f"{flight.label}: lost at {death:.0f} s ({', '.join(deaths[0].causes)})"


def _solid(color: list[int]) -> dict[str, Any]:
    return {"solidColor": {"color": {"rgba": color}}}


def _orientation(flight: Track, scene: Scene, k: int, begin: float) -> list[float] | None:
    """Times and quaternions (x, y, z, w) of the turn from body to Earth-fixed axes, from a time on; None without attitudes."""
    sigma = flight.arrays["sigma"][:, k].astype("f8")
    if not len(sigma):
        return None
    at = np.arange(0, len(sigma), max(1, round(ATTITUDE_STEP / flight.attitude_step)))
    times = flight.attitude_start + at * flight.attitude_step
    good = np.isfinite(sigma[at]).all(-1) & (times >= begin)
    times, sigma = times[good], sigma[at][good]
    if not len(times):
        return None
    angle = torch.from_numpy(scene.rate * times)  # of the Earth since time 0
    columns = Mat3.of(torch.tensor(scene.PN0, dtype=torch.float64).view(3, 3)).mT
    PN = Mat3(*(rotate_z(column, angle.cos(), angle.sin()) for column in columns)).mT
    sigma_BP = mrp_subtract(Vec3.of(torch.from_numpy(sigma)), dcm_to_mrp(PN)).stack()
    square = sigma_BP.square().sum(-1, keepdim=True)
    turn = torch.cat([2.0 * sigma_BP, 1.0 - square], -1) / (1.0 + square)
    return np.concatenate([times[:, None], turn.numpy()], 1).round(7).flatten().tolist()


def _stations(scene: Scene) -> list[dict[str, object]]:
    return [
        {
            "id": f"station/{k}",
            "name": name,
            "position": {"cartesian": np.asarray(place, "f8").round(1).tolist()},
            "point": {"pixelSize": 6, "color": {"rgba": COLORS["station"]}},
            "label": {"text": name, "font": "11px sans-serif", "pixelOffset": {"cartesian2": [10, 0]}},
        }
        for k, (name, place) in enumerate(zip(scene.station_names, scene.arrays["stations_P"], strict=True))
    ]


def _targets(recording: Recording, flight: Track, scene: Scene, start: datetime) -> list[dict[str, Any]]:
    """Targets on the ground, which change their color when they are imaged."""
    if recording.places != "ground":
        return []
    arrays = flight.arrays
    imaged = arrays["event_kind"] == 0
    first = dict(zip(arrays["event_target"][imaged][::-1].tolist(), arrays["event_time"][imaged][::-1].tolist(), strict=True))
    packets = []
    for k, place in enumerate(scene.arrays["targets_P"].astype("f8")):
        if not np.isfinite(place).all():
            continue
        when = first.get(k, flight.duration)
        color = [{"interval": _span(start, 0.0, when), "rgba": COLORS["open"]}]
        if when < flight.duration:
            color.append({"interval": _span(start, when, flight.duration), "rgba": COLORS["done"]})
        position, point = {"cartesian": place.round(1).tolist()}, {"pixelSize": 4, "color": color}
        packets.append({"id": f"target/{k}", "name": f"target {k}", "position": position, "point": point})
    return packets


def _links(recording: Recording, flight: Track, start: datetime) -> list[dict[str, Any]]:
    arrays = flight.arrays
    pairs: dict[tuple[int, int], list[tuple[float, float]]] = {}
    for a, b, begin, end in zip(*(arrays[f"link_{name}"].tolist() for name in ("a", "b", "start", "end")), strict=True):
        pairs.setdefault((a, b), []).append((begin, end))
    packets = []
    for (a, b), spans in pairs.items():
        show: list[dict[str, object]] = [{"interval": _span(start, 0.0, flight.duration), "boolean": False}]
        show += [{"interval": _span(start, begin, end), "boolean": True} for begin, end in spans]
        line = {
            "positions": {"references": [f"satellite/{a}#position", f"satellite/{b}#position"]},
            "arcType": "NONE",
            "width": 1,
            "show": show,
            "material": _solid(COLORS["done"]),
        }
        packets.append({"id": f"link/{a}/{b}", "availability": _span(start, 0.0, flight.duration), "polyline": line})
    return packets
