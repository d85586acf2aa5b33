"""Schedules of flights as CSV and JSON: tasks, images, passes over stations and eclipses, in the order of their times."""

from __future__ import annotations

from typing import Literal

import torch

from bsk_torch.formats.intervals import interval_table
from bsk_torch.recording.recording import EVENTS, Recording

__all__ = ["schedule"]


def schedule(recording: Recording, form: Literal["csv", "json"], track: int = 0) -> str:
    """Return the schedule of a track as text, a row for each task, event, pass and eclipse of a satellite.

    Args:
        recording: The flights.
        form: ``"csv"`` or ``"json"``.
        track: Which of its tracks.

    Raises:
        IndexError: For a track that does not exist.
    """
    if not 0 <= track < len(recording.tracks):
        raise IndexError(f"track={track} must lie from 0 to {len(recording.tracks) - 1}")
    flight = recording.tracks[track]
    scene, columns = recording.scenes[flight.scene], {name: array.tolist() for name, array in flight.arrays.items()}
    rows: list[tuple[float, float, str, str, str, str, float | None]] = []

    def add(k: int, kind: str, start: float, end: float, target: int = -1, what: str = "", reward: float | None = None) -> None:
        name = scene.target_names[target] if 0 <= target < len(scene.target_names) else str(target) if target >= 0 else ""
        rows.append((start, end, recording.satellites[k].name, kind, name, what, reward))

    tasks = ("satellite", "time", "end", "target", "action", "reward")
    for k, start, end, target, action, reward in zip(*(columns[f"decision_{name}"] for name in tasks), strict=True):
        actions = recording.satellites[k].actions
        add(k, "task", start, end, target, actions[action] if 0 <= action < len(actions) else "", round(reward, 6))
    for k, time, target, kind in zip(
        *(columns[f"event_{name}"] for name in ("satellite", "time", "target", "kind")), strict=True
    ):
        add(k, "event", time, time, target, EVENTS[kind])
    for name, kind in (("passes", "pass"), ("eclipses", "eclipse")):
        for k, (start, end) in zip(columns[f"{name}_satellite"], columns[name], strict=True):
            add(k, kind, start, end)
    rows.sort(key=lambda row: row[0])
    starts, ends = (torch.tensor([row[k] for row in rows], dtype=torch.float64) for k in (0, 1))
    before = {name: [str(row[k]) for row in rows] for name, k in (("satellite", 2), ("kind", 3))}
    after = {name: [row[k] for row in rows] for name, k in (("target", 4), ("what", 5), ("reward", 6))}
    return interval_table(before, scene.et, starts, ends, form, after)
