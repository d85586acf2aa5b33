"""What scenarios and rewarders tell recordings and films about the targets of an episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from torch import Tensor

Places = Literal["ground", "orbit", "points", "none"]
"""What targets are: places on the Earth, objects in orbit, points of a spacecraft, or nothing."""


@dataclass(frozen=True, kw_only=True)
class RecordedTargets:
    """The T targets of an episode at a decision, as tensors on the CPU."""

    places: Places  # what they are
    r: Tensor  # positions, [T, 3] m: Earth-fixed, of objects in N, of points in the axes of their spacecraft; NaN for padding
    priority: Tensor  # priorities, [T]
    cloud: Tensor | None = None  # fractions of the sky covered by clouds, [T]; None where clouds play no part
    v_N: Tensor | None = None  # velocities of objects in orbit, [T, 3] m/s
    names: Sequence[str] = ()  # empty where numbers suffice
    owner: int | None = None  # number of the satellite that bears the points; None for a spacecraft that is not simulated
    viewers: Sequence[int] = ()  # numbers of the satellites that image or inspect the targets; empty for all
    reach: float | None = None  # largest distance from which they do, m, if there is one


@dataclass(frozen=True, kw_only=True)
class RecordedProgress:
    """What a rewarder knows of an episode at a decision."""

    kind: str = ""  # kind of a constellation's episode, which names its figure in KINDS; empty for the usual one
    track_kind: str = ""  # likewise, of the episode of a single satellite
    targets: RecordedTargets | None = None  # targets of the rewarder, where the scenario has none
    # targets by what has become of them, [T] bool on the CPU each: "done" for imaged or inspected ones, and others
    marks: Mapping[str, Tensor] = field(default_factory=dict)
    # satellite, target and time of each image on board; None where data are not delivered
    images: Sequence[tuple[int, int, float]] | None = None
    completed: float | None = None  # time at which the task was completed, s; None before, or without an end
