"""One episode of a policy that images targets, recorded to be drawn: where the satellite was, and what it imaged from there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.act import Image
from bsk_torch.astro.frames import fixed_to_lla
from bsk_torch.constants import R_EARTH
from bsk_torch.env import SatelliteTasking
from bsk_torch.sim.orbit import ARC, Arcs, spans_for
from bsk_torch.sim.sight import View, owned, planned_position
from bsk_torch.sim.simulator import Simulator
from bsk_torch.sim.sky import SKY, fixed
from bsk_torch.viz.record import Episode, Recorder

if TYPE_CHECKING:
    from bsk_torch.sats import ImagingSatellite
    from bsk_torch.scene.targets import TargetScenario

SAMPLE = 30.0
"""Seconds between the samples of a ground track."""

NONE = -1
"""Target of a decision that does something else."""

OPEN, LOST, UNPAID, IMAGED = range(4)
"""What becomes of a target: not chosen; chosen, but not imaged; imaged without reward; imaged."""


@dataclass(frozen=True, kw_only=True)
class ImagingEpisode(Episode):
    """An :class:`Episode` of T decisions with K targets; positions are Earth-fixed, m.

    Attributes:
        r_BN_P: The satellite at the decision boundaries, [T + 1, 3].
        track_times: Times of the track, [M] s since reset: every :data:`SAMPLE` seconds from each decision on, and the end.
        track: The satellite then, [M, 3].
        r_LP_P: The targets, [K, 3], padding included.
        exists: Which of them are no padding, [K].
        priority: The most that each was worth at any decision, [K].
        chosen: Target of each decision, [T]; :data:`NONE` where something else was done.
        worth: What the chosen target was worth when it was chosen, [T].
        imaged: Which decisions led to an image, [T].
        missed: Which ended because the target's window closed without one, [T].
        stations: Ground stations, [S, 3].
        least_elevation: Least elevation, rad, of a satellite that images a target.
    """

    r_BN_P: Tensor
    track_times: Tensor
    track: Tensor
    r_LP_P: Tensor
    exists: Tensor
    priority: Tensor
    chosen: Tensor
    worth: Tensor
    imaged: Tensor
    missed: Tensor
    stations: Tensor
    least_elevation: float

    @property
    def reach(self) -> float:
        """Angle, rad, at the Earth's centre between the satellite and the farthest target that it can image.

        ``acos(q cos e) - e`` at elevation e, with q the Earth's radius over the satellite's.
        """
        e = torch.tensor(self.least_elevation, dtype=torch.float64)
        return float(torch.acos(R_EARTH / self.track.norm(dim=-1).mean() * torch.cos(e)) - e)

    @property
    def outcomes(self) -> Tensor:
        """What became of the target of every decision, [T]; :data:`OPEN` where something else was done.

        Decisions for the same target in a row are one: they have the outcome of the last one.
        """
        now = torch.where(self.imaged, torch.where(self.rewards > 0.0, IMAGED, UNPAID), LOST)
        goes_on = (self.chosen[1:] == self.chosen[:-1]) & ~self.imaged[:-1]
        number = torch.cat([torch.zeros(1, dtype=torch.int64), (~goes_on).cumsum(0)])
        last = torch.bincount(number).cumsum(0) - 1
        return torch.where(self.chosen >= 0, now[last[number]], OPEN)

    @property
    def fate(self) -> Tensor:
        """The best that became of every target, [K]."""
        rows = self.chosen >= 0
        none = torch.full((len(self.r_LP_P),), OPEN)
        return none.scatter_reduce(0, self.chosen[rows], self.outcomes[rows], "amax")


def ground(r_P: Tensor) -> tuple[Tensor, Tensor]:
    """Longitude and latitude, degrees, below Earth-fixed positions [..., 3]."""
    latitude, longitude, _ = fixed_to_lla(r_P)
    return torch.rad2deg(longitude), torch.rad2deg(latitude)


class ImagingRecorder(Recorder):
    """Also notes orbit, targets and counters."""

    def look(self) -> dict[str, Tensor]:
        """See :meth:`Recorder.look`."""
        satellite, dynamics = cast("ImagingSatellite", self.satellite), self.satellite.dynamics
        seen = {name: getattr(dynamics, name)[0] for name in ("r_BN_N", "v_BN_N", "r_BN_P")}
        seen |= {name: getattr(satellite, name)[0] for name in ("latest_target", "imaged", "missed")}
        return super().look() | seen | {"priority": satellite.scenario.priority[0]}

    def episode(self) -> ImagingEpisode:
        """See :meth:`Recorder.episode`."""
        scenario, priority = cast("TargetScenario", self.env.scenario), self.noted("priority")
        entries = self.satellite.actions.entries
        images = torch.tensor([isinstance(entries[k], Image) for k in self.actions], dtype=torch.bool)
        chosen = torch.where(images, self.noted("latest_target")[1:], NONE)
        track_times, track = self._track()
        return ImagingEpisode(
            **vars(super().episode()),
            r_BN_P=self.noted("r_BN_P"),
            track_times=track_times,
            track=track,
            r_LP_P=scenario.r_LP_P[0].cpu(),
            exists=scenario.drawn("target_exists")[0].cpu() > 0.5,
            priority=priority.amax(0),
            chosen=chosen,
            worth=priority[:-1].gather(1, chosen.clamp(min=0).unsqueeze(-1)).squeeze(-1) * images,
            imaged=self.noted("imaged").diff() > 0,
            missed=self.noted("missed").diff() > 0,
            stations=self._stations(),
            least_elevation=float(self.simulator.argument("imageTargetMinimumElevation")[0]),
        )

    def _stations(self) -> Tensor:
        kinds = self.simulator.access.kinds  # type: ignore[union-attr]
        station = kinds.get("ground_station")
        return torch.empty(0, 3, dtype=torch.float64) if station is None else station(self.simulator.all_rows).r_P[0].cpu()

    def _track(self) -> tuple[Tensor, Tensor]:
        """Times [M] and Earth-fixed positions [M, 3] along the whole orbit."""
        times, device = self.noted("times"), self.simulator.device
        r_N, v_N = self.noted("r_BN_N")[:-1], self.noted("v_BN_N")[:-1]
        counts = torch.ceil(times.diff() / SAMPLE).long()
        row = torch.repeat_interleave(torch.arange(len(counts)), counts)
        elapsed = SAMPLE * (torch.arange(len(row)) - (counts.cumsum(0) - counts)[row])
        r_P = between(self.simulator, times[:-1].to(device), r_N.to(device), v_N.to(device), row.to(device), elapsed.to(device))
        return torch.cat([times[row] + elapsed, times[-1:]]), torch.cat([r_P.cpu(), self.noted("r_BN_P")[-1:]])


def between(simulator: Simulator, times: Tensor, r_N: Tensor, v_N: Tensor, row: Tensor, elapsed: Tensor) -> Tensor:
    """Where the satellite of row 0 was, Earth-fixed [M, 3] m, from where it was at a few times.

    Each stretch of the orbit is solved anew from its beginning, which has no effect on the simulation, does not ask how far back
    that remembers, and follows orbits with drag.

    Args:
        simulator: Of the episode.
        times: Seconds since reset, [T].
        r_N: Position in N then, [T, 3] m.
        v_N: Velocity in N then, [T, 3] m/s.
        row: From which of the T times to go on, [M].
        elapsed: For how long, [M] s.
    """
    arcs = Arcs(len(times), spans_for(float(elapsed.max()) + SAMPLE), simulator.arcs.solver)
    arcs.reset(torch.arange(len(times), device=times.device), simulator.arcs.et[0] + times, r_N, v_N)
    flown, sky = (owned(samples, row) for samples in arcs.tracks((ARC, SKY)))
    r, around = planned_position(View(flown, sky), elapsed)
    return fixed(around, r).stack()


def record_imaging_episode(policy: TensorDictModuleBase, env: SatelliteTasking, *, seed: int) -> ImagingEpisode:
    """Play the first episode of ``seed`` in row 0 of ``env``, with the most probable actions.

    Images are counted at the ends of decisions, which are the times of the images unless ``variable_interval`` is off.

    Raises:
        ValueError: For an environment without targets.
    """
    _check(env)
    recorder = ImagingRecorder(env)
    recorder.play(policy, seed)
    return recorder.episode()


def _check(env: SatelliteTasking) -> None:
    for part, name in ((env.scenario, "most_targets"), (env.satellite, "latest_target")):
        if not hasattr(part, name):
            raise ValueError(
                f"env has a {type(part).__name__}; a ground track needs a scenario with targets, such as scene.UniformTargets, "
                "and a sats.ImagingSatellite, as in AEOS-v1"
            )
