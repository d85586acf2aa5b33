"""Least times between two images, as step functions of the angle between their targets, learned from flights.

The angle is that between the directions of both targets from the satellite at the time of the first image. After a slew from one
target at rest to the next, with the mean rate of both lines of sight taken away, the time depends on little else. *Direct* is a
slew in one step. Where a step ends without an image, because its target's window closes, the satellite may be on the way already;
such slews, *any*, have a separate, lower envelope. An image is counted at the end of its step.

The flight software takes an image as soon as the pointing error is below its limit. The satellite then still points short of
the target, toward the one that it comes from, so that turning back is quicker than turning further. Where it points depends on
the direction of the previous target on the ground. Directions are counted in *sectors*, so that a path in a graph can remember
them.

Times with a *reserve* are ones that flights may beat, but not for long. A clock runs behind the images of a flight at ticks t_k::

    v_1 = t_1,  v_k = max(t_k, v_(k-1) + f(angle to target k at v_(k-1)))

and image k is late by ``max(0, v_k - b_k)``, with the end b_k of its window. Where no image is later than the reserve, and all of
a flight together no later than a budget, a bound over schedules with times f, windows that close as much later and no more
lateness holds for all such flights, whatever the order of their images. ``benchmarks/image_leads.py`` measures the lateness of
flights, and fits such times.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from bsk_torch.files import write_file
from bsk_torch.untrusted import read_json

FILE = Path(__file__).with_name("agile.json")
"""Envelope of the agile satellite of AEOS-v1, which ``benchmarks/envelope.py`` fits and checks."""

SUSTAINED = Path(__file__).with_name("agile_sustained.json")
"""Times that the same satellite cannot beat for long, which ``benchmarks/sustained.py`` fits and checks."""

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
    valid = monotone < NEVER
    return torch.where(valid, monotone, monotone[valid].max() if bool(valid.any()) else 1)


def quantile(angle: Tensor, ticks: Tensor, width: float, bins: int, share: float) -> Tensor:
    """Return the time of each bin that a ``share`` of its transitions is quicker than, not descending, [bins] ticks.

    Bins without transitions repeat the one before.
    """
    index = (angle / width).long().clamp(0, bins - 1)
    by = torch.argsort(ticks, stable=True)
    by = by[torch.argsort(index[by], stable=True)]
    edge = torch.searchsorted(index[by], torch.arange(bins + 1))
    chosen = edge[:-1] + ((edge[1:] - edge[:-1]).double() * share).long()
    return torch.where(edge[1:] > edge[:-1], ticks[by][chosen.clamp(max=len(ticks) - 1)], 0).cummax(0).values


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
        typical: Median time of each bin in one step, ticks; what schedules count with.
        reserve: Ticks by which an image may come after its window on the clock of these times (see the module); 0 if every
            single transition obeys them.
        lateness: Ticks for each tick of a flight by which its images may together come after their windows on that clock, and
            ``reserve`` once more; None if there is no such limit.
        lag: Angle, rad, by which the satellite points short of the target of the first image, on the side of the target before;
            the angle is measured from there. 0 if it is measured from the target.
        sectors: Directions that are told apart for the lag; 0 without lag.
        near: Distance on the ground, m, below which the satellite hardly turns from one target to the next, so that the sector
            stays.
    """

    width: float
    direct: tuple[int, ...]
    any: tuple[int, ...]
    step: float
    arguments: Mapping[str, str]
    transitions: int
    typical: tuple[int, ...] = ()
    reserve: int = 0
    lateness: float | None = None
    lag: float = 0.0
    sectors: int = 0
    near: float = 0.0

    def __post_init__(self) -> None:
        if not self.width > 0.0 or not self.step > 0.0 or not self.direct or not self.any:
            raise ValueError(f"width={self.width:g} and step={self.step:g} must be positive, and the tables must have times")
        if self.lag < 0.0 or self.sectors < 0 or (self.lag > 0.0) != (self.sectors > 0):
            raise ValueError(f"lag={self.lag:g}, sectors={self.sectors}: a lag has one sector or more, and no lag has none")

    def least(self, angle: Tensor, *, direct: bool) -> Tensor:
        """Return the least ticks, for angles of any shape, rad."""
        table = torch.tensor(self.direct if direct else self.any, dtype=torch.int64, device=angle.device)
        return table[(angle / self.width).long().clamp(0, len(table) - 1)]

    def most_late(self, ticks: int) -> float:
        """Return the ticks by which images of a flight of so many ``ticks`` may together come after their windows."""
        return math.inf if self.lateness is None else self.reserve + self.lateness * ticks

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
        enough: int = 2000,
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
            enough: Number of transitions of a bin in one step without which its least time is not trusted: bins behind the last
                that has so many repeat that one.

        Raises:
            ValueError: If no bin has enough transitions.
        """
        index = (angle[one_step] / width).long().clamp(0, bins - 1)
        trusted = torch.nonzero(torch.bincount(index, minlength=bins) >= max(1, enough)).flatten()
        if not len(trusted):
            raise ValueError(
                f"{len(angle)} transitions, {len(index)} in one step: no bin of the angle has {enough} of them, so no envelope "
                "can be fitted; fly more episodes"
            )
        overall = lowest(angle, ticks, width, bins)
        direct = lowest(angle[one_step], ticks[one_step], width, bins)
        overall, direct = ((table - margin).clamp(min=SOONEST) for table in (torch.minimum(overall, direct), direct))
        usual = quantile(angle[one_step], ticks[one_step], width, bins, 0.5)
        last = torch.arange(bins).clamp(max=int(trusted[-1]))
        tables = (direct, overall, torch.maximum(usual, direct))
        one, several, typical = (tuple(table[last].tolist()) for table in tables)
        return cls(width, one, several, step, dict(arguments), len(angle), typical)

    @property
    def expected(self) -> Envelope:
        """The same with typical times in place of the least ones: no bound, but what a schedule counts with."""
        if not self.typical:
            raise ValueError("the envelope has no typical times; fit one with Envelope.below")
        return replace(self, direct=self.typical, any=self.typical, reserve=0, lateness=None)

    def smallest_margin(self, angle: Tensor, ticks: Tensor, one_step: Tensor) -> int:
        """Return how many ticks the nearest transition lies above the envelope; negative if one lies below."""
        least = torch.where(one_step, self.least(angle, direct=True), self.least(angle, direct=False))
        return int((ticks - least).min())

    def save(self, path: Path) -> None:
        """Write the envelope as JSON."""
        write_file(path, json.dumps(asdict(self)) + "\n")

    @classmethod
    def load(cls, path: Path = FILE) -> Envelope:
        """Read the envelope of a file (default: that of the agile satellites of the presets); ValueError for another file."""
        return read_json(path, cls, "is no envelope of imaging times")


def sector_from(before_P: Tensor, at_P: Tensor, sectors: int) -> Tensor:
    """Return the sector in which a place lies as seen from another: 0 is east, and sectors go by north.

    Args:
        before_P: Earth-fixed positions of the places, [..., 3] m.
        at_P: Earth-fixed positions from which they are seen, [..., 3] m.
        sectors: Number of sectors, each centered on its direction.
    """
    east, north = _horizon(at_P)
    offset = before_P - at_P
    azimuth = torch.atan2((offset * north).sum(-1), (offset * east).sum(-1))
    return torch.round(azimuth * (sectors / (2.0 * math.pi))).long() % sectors


def pointing(r_P: Tensor, at_P: Tensor, sector: Tensor, lag: float, sectors: int) -> Tensor:
    """Return the direction in which a satellite points that comes from a sector, [..., 3], of length one.

    Args:
        r_P: Earth-fixed positions of the satellite, [..., 3] m.
        at_P: Earth-fixed positions of the target, [..., 3] m.
        sector: Where it comes from, [...]; ``sectors`` for a satellite that points at the target itself.
        lag: Angle between this direction and the line of sight, rad.
        sectors: Number of sectors.
    """
    east, north = _horizon(at_P)
    azimuth = (sector.double() * (2.0 * math.pi / max(1, sectors))).unsqueeze(-1)
    towards = azimuth.cos() * east + azimuth.sin() * north
    sight = torch.nn.functional.normalize(at_P - r_P, dim=-1)
    aside = torch.nn.functional.normalize(towards - (towards * sight).sum(-1, keepdim=True) * sight, dim=-1)
    off = torch.where(sector < sectors, lag, 0.0).unsqueeze(-1)
    return sight * off.cos() + aside * off.sin()


def _horizon(at_P: Tensor) -> tuple[Tensor, Tensor]:
    """Return the directions of east and north on a sphere, [..., 3] each; at the poles, some directions in the horizon."""
    up = torch.nn.functional.normalize(at_P, dim=-1)
    axis = torch.zeros_like(up)
    axis[..., 2] = 1.0
    east = torch.linalg.cross(axis, up)
    pole = east.norm(dim=-1, keepdim=True) < 1e-9
    other = torch.zeros_like(up)
    other[..., 1] = 1.0
    east = torch.nn.functional.normalize(torch.where(pole, other, east), dim=-1)
    return east, torch.linalg.cross(up, east)
