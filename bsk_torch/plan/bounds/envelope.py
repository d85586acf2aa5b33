"""Least times between two images, as step functions of the angle between their targets, learned from flights.

The angle is that between the directions of both targets from the satellite at the time of the first image. After a slew from one
target at rest to the next, with the mean rate of both lines of sight taken away, the time depends on little else. *Direct* is a
slew in one step. Where a step ends without an image, because its target's window closes, the satellite may be on the way already;
such slews, *any*, have a lower envelope of their own. An image is counted at the end of its step.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from bsk_torch.files import write_file

FILE = Path(__file__).with_name("agile.json")
"""Envelope of the agile satellite of AEOS-v1, which ``benchmarks/bounds.py`` fits and checks."""

SOONEST = 2
"""Least number of ticks of a step that ends with an image: one until the instrument may record, one until data have come."""

NEVER = torch.iinfo(torch.int64).max


def lowest(angle: Tensor, ticks: Tensor, width: float, bins: int) -> Tensor:
    """Return the highest step function, not descending, that no transition lies below, [bins] ticks.

    Args:
        angle: Angles of the transitions, [n] rad.
        ticks: Their times, [n] int64 ticks.
        width: Width of a bin, rad; the last bin has all larger angles, too.
        bins: Number of bins. Those beyond the largest angle repeat the last known one.
    """
    index = (angle / width).long().clamp(0, bins - 1)
    least = torch.full((bins,), NEVER, dtype=torch.int64).scatter_reduce(0, index, ticks, "amin")
    monotone = least.flip(0).cummin(0).values.flip(0)
    known = monotone < NEVER
    return torch.where(known, monotone, monotone[known].max() if bool(known.any()) else 1)


@dataclass(frozen=True)
class Envelope:
    """Least ticks between two images, by the angle between the targets; see the module.

    Attributes:
        width: Width of the bins of the angle, rad.
        direct: Least time of each bin in one step, not descending, ticks; the last is that of all larger angles.
        any: The same in any number of steps.
        step: Length of a tick, s.
        arguments: Arguments of the satellite that it was fitted on, as text by name.
        transitions: Number of transitions that it was fitted on.
    """

    width: float
    direct: tuple[int, ...]
    any: tuple[int, ...]
    step: float
    arguments: Mapping[str, str]
    transitions: int

    def least(self, angle: Tensor, *, direct: bool) -> Tensor:
        """Return the least ticks, for angles of any shape, rad."""
        table = torch.tensor(self.direct if direct else self.any, dtype=torch.int64, device=angle.device)
        return table[(angle / self.width).long().clamp(0, len(table) - 1)]

    @property
    def longest(self) -> int:
        """Ticks after which every target may be imaged."""
        return max(self.direct)

    @classmethod
    def below(
        cls,
        angle: Tensor,
        ticks: Tensor,
        one_step: Tensor,
        *,
        step: float,
        arguments: Mapping[str, str],
        width: float = 0.02,
        bins: int = 70,
        margin: int = 1,
    ) -> Envelope:
        """Return the highest envelope ``margin`` ticks below all transitions.

        Args:
            angle: Angle of each transition, [n] rad.
            ticks: Its time, [n] int64 ticks.
            one_step: Whether it took one step, [n].
            step: Length of a tick, s.
            arguments: Arguments of the satellite.
            width: Width of the bins, rad.
            bins: Number of bins.
            margin: Ticks.

        Raises:
            ValueError: Without transitions.
        """
        if not bool(one_step.any()):
            raise ValueError(f"{len(angle)} transitions, none in one step: no envelope can be fitted; fly more episodes")
        every = lowest(angle, ticks, width, bins)
        direct = lowest(angle[one_step], ticks[one_step], width, bins)
        every, direct = ((table - margin).clamp(min=SOONEST) for table in (torch.minimum(every, direct), direct))
        return cls(width, tuple(direct.tolist()), tuple(every.tolist()), step, dict(arguments), len(angle))

    def smallest_margin(self, angle: Tensor, ticks: Tensor, one_step: Tensor) -> int:
        """Return how many ticks the nearest transition lies above the envelope; negative if one lies below."""
        least = torch.where(one_step, self.least(angle, direct=True), self.least(angle, direct=False))
        return int((ticks - least).min())

    def save(self, path: Path) -> None:
        """Write the envelope as JSON."""
        write_file(path, json.dumps(asdict(self)) + "\n")

    @classmethod
    def load(cls, path: Path = FILE) -> Envelope:
        """Read the envelope of a file, that of the agile satellites of the presets unless given."""
        saved: dict[str, Any] = json.loads(path.read_text())
        return cls(**saved | {name: tuple(saved[name]) for name in ("direct", "any")})
