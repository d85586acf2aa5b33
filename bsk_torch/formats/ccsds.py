"""CCSDS Orbit Ephemeris Messages (OEM), in and out, and Orbit Parameter Messages (OPM), in, as keyword = value text.

Source: "Orbit Data Messages", CCSDS 502.0-B-3, sections 3 and 5.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from bsk_torch.astro.earth_rotation import itrf_axes, teme_axes
from bsk_torch.astro.element_sets import Ephemeris
from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE, TT_MINUS_TAI, date_in_words, et_of_tt, et_of_utc
from bsk_torch.formats.elements import check_satellites
from bsk_torch.formats.source import Source, read_source
from bsk_torch.sim.names import nearest

__all__ = ["read_ccsds", "write_oem"]

NEAREST, FARTHEST, FASTEST = 6300.0, 1e6, 20.0
"""Least and largest distance of a state from the Earth's center, km, and its largest speed, km/s."""

MOST_STATES = 1_000_000
"""Most states in a file: a month at 3 s."""


def _identity(et: Tensor) -> Tensor:
    return torch.eye(3, dtype=torch.float64).expand(*et.shape, 3, 3)


FRAMES: dict[str, Callable[[Tensor], Tensor]] = {
    **dict.fromkeys(("ICRF", "GCRF", "EME2000", "J2000"), _identity),
    "TEME": teme_axes,
    **dict.fromkeys(("ITRF", "ITRF1997", "ITRF2000", "ITRF2005", "ITRF2008", "ITRF2014", "ITRF2020"), itrf_axes),
}
"""DCM from N by the name of a frame. EME2000 is taken as ICRF, as SPICE does: they differ by 0.023 arcseconds, 0.8 m in low
orbit. Polar motion and UT1 - UTC of ITRF are left out, see :mod:`bsk_torch.astro.earth_rotation`."""

ROTATING = {name for name, axes in FRAMES.items() if axes is itrf_axes}

SCALES = ("UTC", "TAI", "TT", "TDB", "GPS")
GPS_MINUS_TAI = -19.0

EPOCH = re.compile(r"(\d{4})-(?:(\d{2})-(\d{2})|(\d{3}))T(\d{2}):(\d{2}):(\d{2}(?:\.\d+)?)Z?", re.A)
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.A)


class _Line(NamedTuple):
    number: int
    text: str


def _pair(text: Source, line: _Line) -> tuple[str, str]:
    keyword, equals, value = line.text.partition("=")
    if not equals:
        text.fail(line.number, f"{line.text!r:.40} must be KEYWORD = value")
    return keyword.strip().upper(), re.sub(r"\s*\[[^\]]*\]$", "", value.strip())


def _epoch(text: Source, number: int, word: str, scale: str) -> float:
    """Return ET, s, of an epoch on a time scale."""
    matched = EPOCH.fullmatch(word)
    if matched is None:
        text.fail(number, f"epoch {word!r:.40} must be like '2026-04-13T22:18:17.006' or '2026-103T22:18:17.006'")
    year, month, day, of_year, hour, minute, second = matched.groups()
    try:
        date = np.datetime64(f"{year}-{month or '01'}-{day or '01'}", "D") + (int(of_year) - 1 if of_year else 0)
    except ValueError:
        text.fail(number, f"epoch {word!r} names no date")
    if int(hour) > 23 or int(minute) > 59 or float(second) >= 60.0 or str(date)[:4] != year:
        text.fail(number, f"epoch {word!r} must have a day of the year, hours below 24, minutes and seconds below 60")
    days = (date - np.datetime64("2000-01-01", "D")).astype(int)
    seconds = (days * 86400 - 43200 + int(hour) * 3600 + int(minute) * 60) + float(second)
    if scale == "UTC":
        return float(et_of_utc(np.float64(seconds)))
    if scale == "TDB":
        return float(seconds)
    tai = seconds - (TT_MINUS_TAI if scale == "TT" else GPS_MINUS_TAI if scale == "GPS" else 0.0)
    return float(et_of_tt(tai + TT_MINUS_TAI))


def _numbers(text: Source, line: _Line, words: Sequence[str]) -> list[float]:
    for word in words:
        if not NUMBER.fullmatch(word):
            text.fail(line.number, f"{word!r:.40} must be a number")
    return [float(word) for word in words]


def _check_state(text: Source, line: int, state: Sequence[float]) -> None:
    """Raise ValueError for a state that is not near the Earth in km and km/s."""
    distance, speed = math.hypot(*state[:3]), math.hypot(*state[3:])
    if not (NEAREST <= distance <= FARTHEST and speed <= FASTEST):
        text.fail(
            line,
            f"the state is {distance:g} km from the Earth's center, with {speed:g} km/s; it must be from {NEAREST:g} to "
            f"{FARTHEST:g} km, with at most {FASTEST:g} km/s. The units are km and km/s",
        )


def _to_N(frame: str, times: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Return states in N, m and m/s, of states in km and km/s along a frame's axes at ET [K], s."""
    axes = FRAMES[frame](torch.from_numpy(times)).mT.numpy()
    r, v = states[:, :3] * 1e3, states[:, 3:] * 1e3
    if frame in ROTATING:
        v = v + EARTH_ROTATION_RATE * np.stack([-r[:, 1], r[:, 0], np.zeros(len(r))], -1)
    return np.concatenate([np.einsum("kij,kj->ki", axes, part) for part in (r, v)], -1)


def _metadata(text: Source, line: int, fields: Mapping[str, str]) -> tuple[str, str, str, str]:
    """Return name, identifier, frame and time scale; ValueError for others than can be converted."""
    for field in ("OBJECT_NAME", "OBJECT_ID", "CENTER_NAME", "REF_FRAME", "TIME_SYSTEM"):
        if not fields.get(field):
            text.fail(line, f"{field} is missing; {nearest(field, fields)}")
    if fields["CENTER_NAME"].upper() != "EARTH":
        text.fail(line, f"CENTER_NAME={fields['CENTER_NAME']!r:.40} must be EARTH")
    frame, scale = fields["REF_FRAME"].upper().replace("ITRF-", "ITRF"), fields["TIME_SYSTEM"].upper()
    if frame not in FRAMES:
        text.fail(line, f"REF_FRAME={fields['REF_FRAME']!r:.40} must be one of {list(FRAMES)}")
    if scale not in SCALES:
        text.fail(line, f"TIME_SYSTEM={fields['TIME_SYSTEM']!r:.40} must be one of {list(SCALES)}")
    return fields["OBJECT_NAME"], fields["OBJECT_ID"], frame, scale


def read_ccsds(source: str | Path) -> list[Ephemeris]:
    """Return the satellites of an OEM, with the states of all their segments, or the one of an OPM.

    Raises:
        OSError: If the file cannot be read.
        ValueError: For anything else; the message names file, line, field and value.
    """
    text = read_source(source)
    lines = [
        _Line(k, line.strip())
        for k, line in enumerate(text.text.splitlines(), 1)
        if line.strip() and not re.match(r"\s*COMMENT(\s|$)", line)
    ]
    keyword, version = _pair(text, lines[0]) if lines else ("", "")
    readers = {"CCSDS_OEM_VERS": _oem, "CCSDS_OPM_VERS": _opm}
    if keyword not in readers or version not in ("1.0", "2.0", "3.0"):
        text.fail(lines[0].number if lines else None, f"it must begin with one of {list(readers)} and a version, 1.0 to 3.0")
    return readers[keyword](text, lines[1:])


def _opm(text: Source, lines: Sequence[_Line]) -> list[Ephemeris]:
    fields: dict[str, str] = {}
    places: dict[str, int] = {}
    for line in lines:
        keyword, value = _pair(text, line)
        if keyword.startswith("MAN_"):
            text.fail(line.number, f"{keyword}: maneuvers of an OPM are not flown; write them as actions")
        if keyword in fields:
            text.fail(line.number, f"{keyword} is also in line {places[keyword]}")
        fields[keyword], places[keyword] = value, line.number
    last = lines[-1].number if lines else 1
    name, identifier, frame, scale = _metadata(text, last, fields)
    axes = ("EPOCH", "X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
    for field in axes:
        if field not in fields:
            text.fail(last, f"{field} is missing; {nearest(field, fields)}")
    times = np.array([_epoch(text, places["EPOCH"], fields["EPOCH"], scale)])
    states = np.array([[_numbers(text, _Line(places[field], ""), [fields[field]])[0] for field in axes[1:]]])
    _check_state(text, places["X"], states[0].tolist())
    check_satellites(text, [(places["OBJECT_NAME"], name, identifier)])
    return [Ephemeris(name, identifier, times, _to_N(frame, times, states))]


def _oem(text: Source, lines: Sequence[_Line]) -> list[Ephemeris]:
    parts: dict[tuple[str, str], list[tuple[np.ndarray, np.ndarray]]] = {}
    begun: dict[tuple[str, str], int] = {}
    fields: dict[str, str] | None = None
    meta: tuple[str, str, str, str] | None = None
    times: list[float] = []
    states: list[list[float]] = []
    start, count, covariance = 0, 0, False

    def close() -> None:
        if meta is None:
            return
        if not states:
            text.fail(start, f"the segment of {meta[0]!r:.40} holds no states")
        epochs = np.array(times)
        wrong = np.flatnonzero(np.diff(epochs) <= 0.0)
        if len(wrong):
            text.fail(start, f"state {wrong[0] + 2} of the segment does not follow the one before in time")
        parts.setdefault(meta[:2], []).append((epochs, _to_N(meta[2], epochs, np.array(states))))
        begun.setdefault(meta[:2], start)
        times.clear()
        states.clear()

    for line in lines:
        if line.text == "META_START":
            close()
            fields, meta, start = {}, None, line.number
        elif line.text == "META_STOP":
            if fields is None:
                text.fail(line.number, "META_STOP without META_START")
            meta, fields = _metadata(text, line.number, fields), None
        elif fields is not None:
            keyword, value = _pair(text, line)
            if keyword in fields:
                text.fail(line.number, f"{keyword} appears twice in this segment")
            fields[keyword] = value
        elif line.text in ("COVARIANCE_START", "COVARIANCE_STOP"):
            covariance = line.text == "COVARIANCE_START"
        elif meta is not None and not covariance:
            count += 1
            if count > MOST_STATES:
                text.fail(line.number, f"more than {MOST_STATES:,} states; split the file")
            words = line.text.split()
            if len(words) not in (7, 10):
                text.fail(
                    line.number, f"it has {len(words)} fields; a state has an epoch and 6 numbers, and may have 3 of acceleration"
                )
            times.append(_epoch(text, line.number, words[0], meta[3]))
            states.append(_numbers(text, line, words[1:7]))
            _check_state(text, line.number, states[-1])
        elif meta is None:
            keyword, _ = _pair(text, line)
            if keyword not in ("CREATION_DATE", "ORIGINATOR", "CLASSIFICATION", "MESSAGE_ID"):
                text.fail(line.number, f"{keyword!r:.40} is no keyword of the header")
    if fields is not None:
        text.fail(start, "META_START without META_STOP")
    close()
    if not parts:
        text.fail(None, "it holds no segment, which begins with META_START")
    orbits = []
    for (name, identifier), segments in parts.items():
        epochs, values = (np.concatenate(column) for column in zip(*segments, strict=True))
        kept = np.concatenate([[True], np.diff(epochs) != 0.0])  # segments share the state at which one ends
        if (np.diff(epochs) < 0.0).any():
            text.fail(begun[name, identifier], f"segments of {name!r:.40} overlap in time")
        orbits.append(Ephemeris(name, identifier, epochs[kept], values[kept]))
    check_satellites(text, [(begun[each.name, each.object_id], each.name, each.object_id) for each in orbits])
    return orbits


def write_oem(satellites: Iterable[Ephemeris]) -> str:
    """Return satellites as the text of an OEM (KVN, version 2.0): states in km and km/s along ICRF axes, epochs in UTC."""
    created = datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%S")
    lines = ["CCSDS_OEM_VERS = 2.0", f"CREATION_DATE = {created}", "ORIGINATOR = bsk_torch"]
    for satellite in satellites:
        epochs = [date_in_words(float(time)).removesuffix("Z") for time in satellite.times]
        lines += [
            "",
            "META_START",
            f"OBJECT_NAME = {satellite.name}",
            f"OBJECT_ID = {satellite.object_id}",
            "CENTER_NAME = EARTH",
            "REF_FRAME = ICRF",
            "TIME_SYSTEM = UTC",
            f"START_TIME = {epochs[0]}",
            f"STOP_TIME = {epochs[-1]}",
            "INTERPOLATION = HERMITE",
            "INTERPOLATION_DEGREE = 7",
            "META_STOP",
            "",
        ]
        for epoch, state in zip(epochs, satellite.states * 1e-3, strict=True):
            lines.append(f"{epoch} " + " ".join(f"{x:.9f}" for x in state))
    return "\n".join(lines) + "\n"
