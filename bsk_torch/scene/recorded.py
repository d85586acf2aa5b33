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
    """The T targets of an episode at a decision, as tensors on the CPU.

    Attributes:
        places: What they are.
        r: Positions, [T, 3] m: Earth-fixed, of objects in N, of points in the axes of their spacecraft; NaN for padding.
        priority: Priorities, [T].
        cloud: Fractions of the sky covered by clouds, [T]; None where clouds play no part.
        v_N: Velocities of objects in orbit, [T, 3] m/s.
        names: Names; empty where numbers suffice.
        owner: Number of the satellite that bears the points; None for a spacecraft that is not simulated.
        viewers: Numbers of the satellites that image or inspect the targets; empty for all.
        reach: Largest distance from which they do, m, if there is one.
    """

    places: Places
    r: Tensor
    priority: Tensor
    cloud: Tensor | None = None
    v_N: Tensor | None = None
    names: Sequence[str] = ()
    owner: int | None = None
    viewers: Sequence[int] = ()
    reach: float | None = None


@dataclass(frozen=True, kw_only=True)
class RecordedProgress:
    """What a rewarder knows of an episode at a decision.

    Attributes:
        kind: Kind of a constellation's episode, which names its figure in :data:`bsk_torch.viz.episodes.KINDS`; empty for the
            usual one.
        track_kind: Likewise, of the episode of a single satellite.
        targets: Targets of the rewarder, where the scenario has none.
        marks: Targets by what has become of them, [T] bool on the CPU each: ``"done"`` for imaged or inspected ones, and others.
        images: Satellite, target and time of each image on board; None where data are not delivered.
        completed: Time at which the task was completed, s; None before, or without an end.
    """

    kind: str = ""
    track_kind: str = ""
    targets: RecordedTargets | None = None
    marks: Mapping[str, Tensor] = field(default_factory=dict)
    images: Sequence[tuple[int, int, float]] | None = None
    completed: float | None = None
